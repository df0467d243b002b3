"""What every form of recording offers: scans and samples as stored, before anything is decided."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.lidar.recording import Mounting
from ekf_companion.nav.arrays import Array

Stored = npt.NDArray[Any]
"""Numbers of the type in which the recording has them."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """A scan as the recording has it."""

    stamp: float
    """Of the header, in the recording's unit of stamps."""
    points: Array
    """m, shape (n, 3), in the lidar's frame; not finite, or 0 0 0, where nothing returned."""
    times: Stored | None = None
    """Of each point, shape (n,), in the recording's unit and from its origin."""
    ring: Stored | None = None
    """The laser of each point, shape (n,)."""
    arrival: float | None = None
    """s, when it was recorded."""
    doppler: Stored | None = None
    """Radial speed of each point, shape (n,); None: a lidar."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredInertial:
    """Inertial samples as the recording has them."""

    stamp: Array
    """Shape (n,), in the recording's unit of stamps, in the recorded order."""
    gyro: Array
    """Shape (n, 3), rad/s if the form is kept to."""
    accel: Array
    """Shape (n, 3), m/s2 or g."""
    arrival: Array | None = None
    """s, shape (n,), when each was recorded."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """An opened recording."""

    name: str
    scans: Callable[[], Iterator[StoredScan]]
    """Begins a pass over the scans in the recorded order."""
    inertial: StoredInertial
    mounting: Mounting | None
    """None: the recording does not say."""
    notes: tuple[str, ...] = ()
    """What opening it has decided or found, one sentence each."""
    time_field: str = "time"
    """The name of the points' times, for sentences."""
    inertial_name: str = "imu"
    """The name of the inertial samples, for sentences."""
    stamp_unit: float | None = None
    """s, of the stamps of scans; None: to be decided."""
    inertial_stamp_unit: float | None = None
    """s, of the stamps of inertial samples; None: to be decided."""
    time_unit: float | None = None
    """s, of the points' times; None: to be decided."""
    faults: list[str] = field(default_factory=list)
    """What a pass over the scans has found, one sentence each: the first pass fills it."""


def whole(values: Any, columns: int) -> Array:
    """Return numbers as a float64 array of so many columns.

    Raises:
        ValueError: They have another shape.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"shape {array.shape}, not (n, {columns})")
    return array
