"""Columns of the aids that declare themselves, in each kind of log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import Kind

DOWN = 25
"""ROTATION_PITCH_270 (ArduPilot), ROTATION_DOWNWARD_FACING (PX4)."""
GOOD = 4
"""RFND.Stat: RangeFinder::Status::Good."""

Table = Mapping[str, Any]
"""Columns by name."""


class Columns(NamedTuple):
    """Where an aid stands in one format."""

    name: str
    """Of the message or topic."""
    needed: tuple[str, ...]
    """Columns without which it is not used."""
    read: Callable[[Table], tuple[Mask, tuple[Array, ...]]]
    """Returns which rows are measurements, and the columns of the events."""


class Logged(NamedTuple):
    """Where an aid stands in the logs."""

    csv: dict[str, str]
    """The unit of each quantity, in the order of the row; the first is the measurement."""
    dataflash: Columns
    ulog: Columns


_FIELDS = ("current_distance", "min_distance", "max_distance")


def _rfnd(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the ranges of RFND, of the first instance that looks down.

    Source: ArduPilot, ``AP_RangeFinder`` (Write_RFND); before 4.0 two sensors stood in one row.
    """
    suffix = "" if "Dist" in table else "1"
    distance = np.asarray(table[f"Dist{suffix}"], dtype=float)
    good = np.asarray(table[f"Orient{suffix}"]) == DOWN
    if "Stat" in table:
        good &= np.asarray(table["Stat"]) == GOOD
    if "Instance" in table:
        good &= np.asarray(table["Instance"]) == 0
    return good & (distance > 0.0), (distance, np.full(len(distance), np.nan))


def _distance_sensor(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the ranges of distance_sensor that are within the sensor's own and look down."""
    distance = np.asarray(topic["current_distance"], dtype=float)
    good = np.isfinite(distance)
    good &= distance > np.asarray(topic["min_distance"])
    good &= distance < np.asarray(topic["max_distance"])
    if "orientation" in topic:
        good &= np.asarray(topic["orientation"]) == DOWN
    if "signal_quality" in topic:
        good &= np.asarray(topic["signal_quality"]) != 0
    variance = np.asarray(topic["variance"], dtype=float) if "variance" in topic else np.nan
    std = np.sqrt(np.where(np.asarray(variance) > 0.0, variance, np.nan))
    return good, (distance, np.broadcast_to(std, distance.shape))


LOGGED = {
    Kind.RANGE: Logged(
        {"range": "m", "range_std": "m"},
        Columns("RFND", (), _rfnd),
        Columns("distance_sensor", _FIELDS, _distance_sensor),
    ),
}
"""By kind."""
DATAFLASH = {one.dataflash.name: (kind, one.dataflash) for kind, one in LOGGED.items()}
"""By message."""
ULOG = {one.ulog.name: (kind, one.ulog) for kind, one in LOGGED.items()}
"""By topic."""
CSV = {kind: one.csv for kind, one in LOGGED.items()}
