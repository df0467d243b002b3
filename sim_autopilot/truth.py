"""A motion as a function of time, with the rates and forces that an ideal sensor would measure.

Position and attitude are two quintic B-splines: metres north, east, down of a ``LocalFrame``, and
roll, pitch, yaw. Whatever is derived from them is derived exactly, on the rotating ellipsoid, so
gyro and accelerometer integrate back to the motion to the precision of the integration. The
control points are not interpolated but approximated (uniform B-spline, four times continuously
differentiable): equal control points in a row are rest up to rounding, without ringing nearby.
Pitch stays away from 90 degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ekf_companion.errors import part_of
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import (
    ECCENTRICITY_SQUARED,
    SEMI_MAJOR_AXIS,
    LocalFrame,
    earth_rate_n,
    gravity,
    radii,
    transport_rate_n,
)

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 5
"""Of the splines: specific force is then three times, body rate four times differentiable."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Truth:
    """The motion at some times; every array has the times as its first axis."""

    t: Array
    """Since the start of the flight, s."""
    pos_n: Array
    """North, east, down of the trajectory's frame, m."""
    lat: Array
    """rad."""
    lon: Array
    """rad."""
    alt: Array
    """Above mean sea level, m."""
    vel_n: Array
    """Against the Earth, north, east, down, m/s."""
    q_nb: Array
    euler: Array
    """Roll, pitch, yaw, rad; roll and yaw are not wrapped."""
    rate_nb_b: Array
    """Turn rate of the body against north, east, down, rad/s."""
    gyro_b: Array
    """Turn rate of the body against the stars: of an ideal gyro, rad/s."""
    accel_b: Array
    """Specific force: of an ideal accelerometer, m/s^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A motion from time 0 to ``duration``; before and after, it is at rest at its ends."""

    frame: LocalFrame
    duration: float
    """s."""
    position: BSpline
    """North, east, down, m."""
    attitude: BSpline
    """Roll, pitch, yaw, rad."""

    def at(self, t: float | Array) -> Truth:
        """Return the motion at times (s), shape (n,)."""
        t = np.atleast_1d(np.asarray(t, dtype=float)).clip(0.0, self.duration)
        pos_n = np.asarray(self.position(t))
        lat, lon, alt = self.frame.to_geodetic(pos_n)
        vel_n, vel_dot_n = _on_ellipsoid(
            self.frame, lat, alt, np.asarray(self.position(t, 1)), np.asarray(self.position(t, 2))
        )

        euler = np.asarray(self.attitude(t))
        q_nb = so3.from_euler(euler[:, 0], euler[:, 1], euler[:, 2])
        rate_nb_b = _body_rate(euler, np.asarray(self.attitude(t, 1)))

        earth_n = earth_rate_n(lat)
        transport_n = transport_rate_n(lat, alt, vel_n)
        gravity_n = np.zeros_like(vel_n)
        gravity_n[:, 2] = gravity(lat, alt)
        force_n = vel_dot_n - gravity_n + np.cross(2.0 * earth_n + transport_n, vel_n)

        q_bn = so3.conjugate(q_nb)
        return Truth(
            t=t,
            pos_n=pos_n,
            lat=lat,
            lon=lon,
            alt=alt,
            vel_n=vel_n,
            q_nb=q_nb,
            euler=euler,
            rate_nb_b=rate_nb_b,
            gyro_b=rate_nb_b + so3.rotate(q_bn, earth_n + transport_n),
            accel_b=so3.rotate(q_bn, force_n),
        )


def spline(path: Callable[[Array], Array], duration: float, step: float) -> BSpline:
    """Fit a spline, valid from 0 to ``duration`` at least, with a control point every step, s.

    The path returns the control points of times (s), shape (n,) to (n, m).
    """
    count = int(np.ceil(duration / step)) + DEGREE + 1
    # The control point of knots i .. i + 6 belongs to their middle (Greville)
    middle = (np.arange(count) - (DEGREE - 1) / 2) * step
    knots = (np.arange(count + DEGREE + 1) - DEGREE) * step
    with part_of("sim", "a generated flight"):
        from scipy.interpolate import BSpline
    return BSpline(knots, path(np.asarray(middle, dtype=np.float64)), DEGREE)


def _on_ellipsoid(
    frame: LocalFrame, lat: Array, alt: Array, pos_dot: Array, pos_ddot: Array
) -> tuple[Array, Array]:
    """Return velocity and its derivative in n from the derivatives of the local position."""
    scale_north, scale_east = frame.scale
    meridian, transverse = radii(lat)
    sin, cos = np.sin(lat), np.cos(lat)
    w2 = 1.0 - ECCENTRICITY_SQUARED * sin * sin
    bulge = SEMI_MAJOR_AXIS * ECCENTRICITY_SQUARED * sin * cos
    lat_dot = pos_dot[:, 0] / scale_north
    alt_dot = -pos_dot[:, 2]
    meridian_dot = 3.0 * (1.0 - ECCENTRICITY_SQUARED) * bulge / w2**2.5 * lat_dot
    transverse_dot = bulge / w2**1.5 * lat_dot

    north = (meridian + alt) / scale_north
    east = (transverse + alt) * cos / scale_east
    north_dot = (meridian_dot + alt_dot) / scale_north
    east_dot = ((transverse_dot + alt_dot) * cos - (transverse + alt) * sin * lat_dot) / scale_east
    metres = np.stack([north, east, np.ones_like(north)], axis=-1)
    metres_dot = np.stack([north_dot, east_dot, np.zeros_like(north)], axis=-1)
    vel_dot_n = metres * pos_ddot + metres_dot * pos_dot
    return np.asarray(metres * pos_dot), np.asarray(vel_dot_n)


def _body_rate(euler: Array, euler_dot: Array) -> Array:
    """Return the turn rate of b against n, in b, from roll, pitch, yaw and their derivatives."""
    sr, cr = np.sin(euler[:, 0]), np.cos(euler[:, 0])
    sp, cp = np.sin(euler[:, 1]), np.cos(euler[:, 1])
    roll_dot, pitch_dot, yaw_dot = euler_dot.T
    return np.stack(
        [
            roll_dot - sp * yaw_dot,
            cr * pitch_dot + sr * cp * yaw_dot,
            -sr * pitch_dot + cr * cp * yaw_dot,
        ],
        axis=-1,
    )
