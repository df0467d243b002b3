"""A recording of a lidar and an inertial sensor in a world, from one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sim_autopilot.lidar.beams import BEAMS, Beams
from sim_autopilot.lidar.motion import MOTIONS, Motion, from_euler
from sim_autopilot.lidar.worlds import WORLDS, Array, World, cast

UNIT = 0.003
"""m, of a stored point."""
TICK = 2e-6
"""s, of the stored time of a point."""


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """Errors of an inertial sensor of the BMI088's class."""

    rate: float = 200.0
    """Samples a second."""
    gyro_noise: float = 0.00024
    """rad/s/rtHz."""
    accel_noise: float = 0.0017
    """m/s2/rtHz."""
    gyro_bias: float = 0.004
    """rad/s, one sigma."""
    accel_bias: float = 0.06
    """m/s2, one sigma."""
    gyro_walk: float = 2e-5
    """rad/s/rts."""
    accel_walk: float = 2e-4
    """m/s2/rts."""


@dataclass(frozen=True, slots=True, eq=False)
class Lidar:
    """A lidar as it is mounted: a point is at `rotation @ point + position` in the body."""

    beams: Beams
    rotation: Array = field(default_factory=lambda: np.eye(3))
    position: Array = field(default_factory=lambda: np.array((0.05, 0.0, 0.08)))
    """m."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """A recording with its truth."""

    name: str
    lidar: Lidar
    errors: ImuErrors
    motion: Motion
    world: World
    stamp: Array
    """s, of the start of each scan."""
    first: npt.NDArray[np.int32]
    """Scan k has the points first[k] to first[k + 1]."""
    xyz: npt.NDArray[np.int16]
    """Points in the lidar's frame, in `UNIT`, shape (n, 3)."""
    dt: npt.NDArray[np.uint16]
    """Times after the stamp, in `TICK`, shape (n,)."""
    ring: npt.NDArray[np.uint8]
    label: npt.NDArray[np.uint8]
    """What each point lies on: 0 static, 1 moving, 2 foliage."""
    imu_stamp: Array
    """s."""
    gyro: npt.NDArray[np.float32]
    """rad/s, shape (n, 3)."""
    accel: npt.NDArray[np.float32]
    """m/s2, shape (n, 3)."""
    gyro_bias: Array
    """rad/s, of each sample, shape (n, 3)."""
    accel_bias: Array
    """m/s2, of each sample, shape (n, 3)."""
    doppler: npt.NDArray[np.float32] | None = None
    """m/s, radial speed of each point of a radar, positive away, shape (n,)."""


Points = tuple[
    Array,
    npt.NDArray[np.int32],
    npt.NDArray[np.int16],
    npt.NDArray[np.uint16],
    npt.NDArray[np.uint8],
    npt.NDArray[np.uint8],
    npt.NDArray[np.float32] | None,
]
"""Of :class:`Simulated`: stamp, first, xyz, dt, ring, label, doppler."""


def simulate(
    world: str,
    seed: int,
    *,
    duration: float = 20.0,
    lidar: Lidar | None = None,
    errors: ImuErrors | None = None,
    name: str | None = None,
    scene: World | None = None,
    motion: Motion | None = None,
) -> Simulated:
    """Return a recording; the same seed gives the same numbers.

    Args:
        world: One of `WORLDS`.
        seed: Of the world, the noise and the biases.
        duration: s.
        lidar: The lidar and its mounting; None: what fits the world.
        errors: Of the inertial sensor.
        name: None: that of the world.
        scene: Another world in its place, for the same lidar.
        motion: Another motion.
    """
    fitted = lidar or usual_lidar(world)
    return record(name or world, world, seed, duration, fitted, errors, scene, motion, _scan)


def record(
    name: str,
    world: str,
    seed: int,
    duration: float,
    fitted: Lidar,
    errors: ImuErrors | None,
    scene: World | None,
    motion: Motion | None,
    scan: Callable[[World, Motion, Lidar, float, np.random.Generator], Points],
) -> Simulated:
    """Return a recording of what ``scan`` makes of a motion in a world; else as :func:`simulate`.

    World, points and samples have a generator each.
    """
    of_world, of_points, of_imu = np.random.default_rng(seed).spawn(3)
    scene, motion, errors = (
        scene or WORLDS[world](of_world),
        motion or MOTIONS[world],
        errors or ImuErrors(),
    )
    points = scan(scene, motion, fitted, duration, of_points)
    samples = _sample(motion, errors, duration, of_imu)
    return Simulated(name, fitted, errors, motion, scene, *points[:6], *samples, points[6])


def usual_lidar(world: str, beams: Beams | None = None) -> Lidar:
    """Return a lidar as it would be mounted in a world: tilted to the ground on a drone."""
    usual = {
        "street": "spin32",
        "forest": "rosette",
        "plain": "spin32",
        "hall": "rosette",
    }.get(world, "spin16")
    tilt = {"plain": 20.0, "forest": 12.0}.get(world, 0.0)
    rotation = from_euler(np.array([[0.0, np.radians(tilt), 0.0]]))[0]
    return Lidar(beams or BEAMS[usual], rotation)


def _scan(
    world: World, motion: Motion, lidar: Lidar, duration: float, rng: np.random.Generator
) -> Points:
    beams = lidar.beams
    period = 1.0 / beams.rate
    count = int((duration - 0.05) / period - 0.2)
    stamps = np.array(0.02 + period * np.arange(count), np.float64)
    bias = rng.normal(0.0, beams.range_bias, beams.rings)
    shots = np.arange(beams.shots) * (period / beams.shots)
    xyz, ticks, rings, labels, counts = [], [], [], [], [0]
    for stamp in stamps:
        times, direction, ring = beams.fire(stamp + shots)
        # Stored times are those of the measurements: rays are fired at whole ticks
        tick = np.round((times - stamp) / TICK)
        times = stamp + tick * TICK
        turn = motion.rotation(times)
        origin = motion.position(times) + turn @ lidar.position
        aimed = direction + rng.normal(0.0, beams.angle_sigma, direction.shape)
        aimed /= np.linalg.norm(aimed, axis=1, keepdims=True)
        hits = cast(world, origin, np.einsum("nij,nj->ni", turn, aimed @ lidar.rotation.T), times)
        sigma = beams.range_sigma * (1.5 - 0.5 * hits.cosine)
        measured = hits.distance + bias[ring] + rng.normal(size=len(times)) * sigma
        lost = beams.missing + 0.5 * (hits.distance / beams.farthest) ** 4
        seen = (
            (rng.random(len(times)) > lost)
            & (hits.distance > beams.nearest)
            & (hits.distance < beams.farthest)
        )
        xyz.append(np.round(direction[seen] * measured[seen, None] / UNIT).astype(np.int16))
        ticks.append(tick[seen].astype(np.uint16))
        rings.append(ring[seen])
        labels.append(hits.label[seen])
        counts.append(int(seen.sum()))
    return (
        stamps,
        np.cumsum(counts).astype(np.int32),
        np.concatenate(xyz),
        np.concatenate(ticks, dtype=np.uint16),
        np.concatenate(rings),
        np.concatenate(labels),
        None,
    )


def _sample(
    motion: Motion, errors: ImuErrors, duration: float, rng: np.random.Generator
) -> tuple[Array, npt.NDArray[np.float32], npt.NDArray[np.float32], Array, Array]:
    step = 1.0 / errors.rate
    stamp = np.array(step * np.arange(1, int(duration * errors.rate)), np.float64)
    shape = (len(stamp), 3)

    def drift(start: float, walk: float) -> Array:
        steps = rng.normal(0.0, walk * np.sqrt(step), shape)
        biases: Array = rng.normal(0.0, start, 3) + np.cumsum(steps, axis=0)
        return biases

    gyro_bias = drift(errors.gyro_bias, errors.gyro_walk)
    accel_bias = drift(errors.accel_bias, errors.accel_walk)
    white = np.sqrt(errors.rate)
    gyro = motion.gyro(stamp) + gyro_bias + rng.normal(0.0, errors.gyro_noise * white, shape)
    accel = motion.accel(stamp) + accel_bias + rng.normal(0.0, errors.accel_noise * white, shape)
    return stamp, gyro.astype(np.float32), accel.astype(np.float32), gyro_bias, accel_bias
