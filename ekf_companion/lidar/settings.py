"""Settings of the odometry: what the sensors are good for, and how far the map reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Noise as data sheets state it; sizes in metres, times in seconds."""

    range_noise: float = 0.02
    """Of one range, one sigma, m: what data sheets of spinning and rosette lidars state."""
    range_bias: float = 0.003
    """Of each laser, constant, one sigma, m."""
    angle_noise: float = 3e-4
    """Of the direction of a beam, one sigma, rad."""
    least_range: float = 0.5
    """Nearer points are of the vehicle itself, m."""
    most_range: float = 80.0
    """Points beyond it are left out, m."""

    doppler_noise: float = 0.02
    """Of the radial speed of one point of a radar besides its step, one sigma, m/s."""
    doppler_angle: float = 0.022
    """Of the direction of one point of a radar, one sigma on each axis, rad: what the speeds across
    show in a recording of a 60 GHz radar (0.036 m/s at rest, 0.044 at 1.2 m/s)."""
    doppler_scan: float = 0.04
    """Of the velocity by one scan of a radar as a whole, one sigma on each axis, m/s, and besides
    the error of a direction, which points of one object share. Innovations of that recording at 1.2
    m/s have 0.04 to 0.05 more than its points explain; Doer and Trommer 2020 take 0.025 to 0.05."""
    most_doppler: float = 0.0
    """Radial speed at which those of a radar wrap to the other sign, m/s; 0: they do not."""

    gyro_noise: float = 3e-4
    """Density, rad/s/sqrt(Hz)."""
    accel_noise: float = 2e-3
    """Density, m/s^2/sqrt(Hz)."""
    gyro_walk: float = 5e-5
    """Of the bias, rad/s/sqrt(s)."""
    accel_walk: float = 1e-3
    """Of the bias, m/s^2/sqrt(s)."""
    inertial_scale: float = 0.003
    """Error of scale and alignment of both, one sigma."""
    gyro_bias: float = 0.01
    """At the start, one sigma, rad/s."""
    accel_bias: float = 0.1
    """At the start, one sigma, m/s^2."""
    gravity: float = 9.80665
    """m/s^2."""

    delay_sigma: float = 0.0
    """Of the inertial stamps relative to the lidar's, s; 0: not estimated."""
    is_mounting_estimated: bool = False

    voxel: float = 0.25
    """Edge of the smallest voxel of the map, m."""
    levels: int = 4
    """Sizes of voxels, each twice the one before."""
    scan_voxel: float = 0.2
    """One point is taken in each voxel of this size, m."""
    most_points: int = 1200
    """Of a scan that are matched."""
    most_map_points: int = 4800
    """Of a scan that the map learns, four times as many: each costs 1 us, and of 19 000 of a
    Mid-360 the others made neither room nor hall better known."""
    map_radius: float = 80.0
    """Farther voxels are forgotten, m."""
    most_voxels: int = 150_000
    """Of all sizes together, of some 400 bytes: beyond them the farthest are forgotten."""
    anchors: int = 16
    """Poses of the past that the map is tied to; 0: the map is taken as known."""
    is_scan_to_scan: bool = False
    """The last scan is the map."""
    spacing: float = 1.0
    """Between such poses, s; relative poses are given over it."""
    iterations: int = 5

    @property
    def densities(self) -> Array:
        """Return variances per second of gyro, accelerometer and their biases, shape (12,)."""
        each = (self.gyro_noise, self.accel_noise, self.gyro_walk, self.accel_walk)
        return np.repeat(np.square(each), 3)
