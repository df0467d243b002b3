"""A recording of a lidar or a radar and its inertial sensor: what readers return, filters take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.nav.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One turn (or frame) of a lidar."""

    stamp: float
    """s, of the start of the scan, on the clock of the inertial samples."""
    points: Array
    """m, shape (n, 3), in the lidar's frame (forward, left, up), each at its own time."""
    times: Array
    """s after the stamp, shape (n,)."""
    ring: Array | None = None
    """The laser of each point, shape (n,), where the recording has it."""
    doppler: Array | None = None
    """Radial speed of each point, m/s, positive away from the sensor, shape (n,); None: a lidar."""


@dataclass(frozen=True, slots=True, eq=False)
class StampedScan:
    """A scan with its stamp in whole ns."""

    t_ns: int
    """Of the start, the lidar's clock."""
    scan: Scan
    """Its own stamp does not count."""


@dataclass(frozen=True, slots=True, eq=False)
class InertialSamples:
    """Samples of the inertial sensor, in the body's frame (forward, left, up)."""

    stamp: Array
    """s, shape (n,), increasing, of the middle of each sample."""
    gyro: Array
    """rad/s, shape (n, 3)."""
    accel: Array
    """m/s2, shape (n, 3): specific force, +9.81 in z at rest and level."""


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """The lidar on the inertial sensor: a point is at `rotation @ point + position` there."""

    rotation: Array = field(default_factory=lambda: np.eye(3))
    """Shape (3, 3), lidar to body."""
    position: Array = field(default_factory=lambda: np.zeros(3))
    """m, shape (3,), of the lidar in the body's frame."""
    rotation_sigma: float = np.radians(0.5)
    """rad, for each axis."""
    position_sigma: float = 0.01
    """m, for each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What the filter takes. Scans are read one by one: there may be more than memory holds."""

    name: str
    scans: Iterable[Scan]
    """In the order of their stamps; may be iterated again."""
    inertial: InertialSamples
    mounting: Mounting
    decisions: tuple[str, ...] = ()
    """What the reader decided about stamps, units and axes, one sentence each."""
    by_doppler: bool = False
    """Whether the way is found by the radial speeds of its points: a radar."""
    doppler_noise: float = 1.0
    """Variance of velocities by radial speeds, as a multiple of what the points of a scan say."""
