"""A simulated radar: few points with the radial speed of each, movers and ghosts among them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from sim_autopilot.lidar.beams import Beams
from sim_autopilot.lidar.motion import Motion
from sim_autopilot.lidar.record import (
    UNIT,
    ImuErrors,
    Lidar,
    Points,
    Simulated,
    record,
    usual_lidar,
)
from sim_autopilot.lidar.worlds import Array, World, cast

RAYS = Beams(
    "radar", 1, 60, -30, 30, nearest=0.3, farthest=40, range_sigma=0.04, range_bias=0.0,
    angle_sigma=0.02,
)  # fmt: skip
"""Directions drawn within 60 deg to each side and these elevations; rad of error of each point."""
_SIDE = np.radians(60.0)
_SECTORS = 8
"""Of the azimuth: points of one object share the error of its direction."""


@dataclass(frozen=True, slots=True)
class RadarErrors:
    """Errors of a 60 GHz radar of one chip, with antennas on it."""

    shared_angle: float = 0.03
    """rad, of all points of a sector in one scan, one sigma on each axis."""
    speed_sigma: float = 0.01
    """m/s."""
    step: float = 0.125
    """m/s between two speeds that are told apart."""
    most_speed: float = 1e3
    """m/s: beyond it speeds wrap to the other sign."""
    ghosts: float = 0.08
    """Share of points that come over two surfaces: the speed of another direction."""
    frame: float = 0.02
    """s that a scan takes from its stamp on."""


def simulate_radar(
    world: str,
    seed: int,
    *,
    duration: float = 20.0,
    radar: Lidar | None = None,
    errors: RadarErrors | None = None,
    imu: ImuErrors | None = None,
    scene: World | None = None,
    motion: Motion | None = None,
) -> Simulated:
    """Return a recording with radial speeds, positive away; the same seed gives the same numbers.

    Args:
        world: One of `WORLDS`.
        seed: Of the world, the noise and the biases.
        duration: s.
        radar: Its rays and mounting; None: what fits the world.
        errors: Of the radar.
        imu: Errors of the inertial sensor.
        scene: Another world in its place.
        motion: Another motion.
    """
    scan = partial(_scan, errors=errors or RadarErrors())
    fitted = radar or usual_lidar(world, RAYS)
    return record(world, world, seed, duration, fitted, imu, scene, motion, scan)


def _scan(
    world: World,
    motion: Motion,
    radar: Lidar,
    duration: float,
    rng: np.random.Generator,
    *,
    errors: RadarErrors,
) -> Points:
    beams = radar.beams
    stamps = np.array(0.02 + np.arange(int((duration - 0.1) * beams.rate)) / beams.rate)
    xyz, labels, speeds, counts = [], [], [], [0]
    for stamp in stamps:
        t = np.full(beams.shots, stamp + 0.5 * errors.frame)
        azimuth = rng.uniform(-_SIDE, _SIDE, beams.shots)
        elevation = np.radians(rng.uniform(beams.low, beams.high, beams.shots))
        true = _unit(azimuth, elevation)
        turn = motion.rotation(t[:1])[0]
        mount = turn @ radar.rotation
        lever = turn @ np.cross(motion.gyro(t[:1])[0], radar.position)
        vel = motion.velocity(t[:1])[0] + lever
        origin = motion.position(t) + turn @ radar.position
        hits = cast(world, origin, true @ mount.T, t)
        speed = ((true @ mount.T) * (hits.velocity - vel)).sum(axis=1)
        # An echo over two surfaces has the speed of the first leg's direction
        ghost = rng.random(beams.shots) < errors.ghosts
        speed[ghost] = speed[rng.permutation(beams.shots)][ghost]
        speed = speed + rng.normal(0.0, errors.speed_sigma, beams.shots)
        span = 2.0 * errors.most_speed
        speed = (speed + errors.most_speed) % span - errors.most_speed
        if errors.step > 0.0:
            speed = np.round(speed / errors.step) * errors.step
        sector = ((azimuth / _SIDE + 1.0) * 0.5 * _SECTORS).astype(int).clip(0, _SECTORS - 1)
        shared = rng.normal(0.0, errors.shared_angle, (2, _SECTORS))[:, sector]
        own = rng.normal(0.0, beams.angle_sigma, (2, beams.shots))
        seen_at = _unit(azimuth + shared[0] + own[0], elevation + shared[1] + own[1])
        reach = hits.distance + rng.normal(0.0, beams.range_sigma, beams.shots)
        seen = (hits.distance > beams.nearest) & (hits.distance < beams.farthest)
        seen &= rng.random(beams.shots) > beams.missing
        xyz.append(np.round(seen_at[seen] * reach[seen, None] / UNIT).astype(np.int16))
        labels.append(hits.label[seen])
        speeds.append(speed[seen].astype(np.float32))
        counts.append(int(seen.sum()))
    return (
        stamps,
        np.cumsum(counts).astype(np.int32),
        np.concatenate(xyz),
        np.zeros(sum(counts), np.uint16),
        np.zeros(sum(counts), np.uint8),
        np.concatenate(labels),
        np.concatenate(speeds),
    )


def _unit(azimuth: Array, elevation: Array) -> Array:
    flat = np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), -1)
