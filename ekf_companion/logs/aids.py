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
    """Return the ranges of RFND of the first sensor that looks down.

    Source: ArduPilot, ``LogStructure.h``. Before 3.5 no orientation is logged; then two sensors
    stand in a row, and since 4.0 each in its own.
    """
    for suffix in ("", "1", "2"):
        names = f"Dist{suffix}", f"Orient{suffix}"
        if not {*names} <= {*table}:
            continue
        distance, orientation = (np.asarray(table[name]) for name in names)
        if {distance.dtype.kind, orientation.dtype.kind} - {*"iuf"}:
            continue
        good = (orientation == DOWN) & (distance > 0.0)
        if (status := table.get(f"Stat{suffix}")) is not None:
            good &= np.asarray(status) == GOOD
        if good.any() and "Instance" in table:
            good &= np.asarray(table["Instance"]) == np.asarray(table["Instance"])[good].min()
        if good.any():
            return good, (distance.astype(float), np.full(len(distance), np.nan))
    nothing = np.full(len(next(iter(table.values()), ())), np.nan)
    return np.zeros(len(nothing), dtype=bool), (nothing, nothing)


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
"""The unit of each quantity, by kind."""
