"""The sensors of each kind in a DataFlash log, and when each of them measures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.logs.dataflash_columns import boot_ns, names_of
from ekf_companion.logs.dataflash_records import Tables
from ekf_companion.logs.instances import Good
from ekf_companion.logs.series import FIX_3D, is_repeated
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Mask
from ekf_companion.nav.earth import is_place

SECOND_NS = 1_000_000_000
INSTANCE = "I"
"""Column of the number of a sensor."""


class Family(NamedTuple):
    """The messages of one kind of sensor."""

    messages: tuple[str, ...]
    """Messages of the first, second and third sensor, where they have names of their own."""
    patience_ns: int
    """Time without a good row after which another sensor is taken."""
    lack: str
    """What a sensor that is left lacks, for the note."""


FAMILIES = {
    "IMU": Family(("IMU", "IMU2", "IMU3"), SECOND_NS // 5, "has no good sample there"),
    "GPS": Family(("GPS", "GPS2"), 2 * SECOND_NS, "has no new fix there"),
    "MAG": Family(("MAG", "MAG2", "MAG3"), 3 * SECOND_NS, "has no good field there"),
    "BARO": Family(("BARO", "BAR2", "BAR3"), 3 * SECOND_NS, "has no good pressure there"),
}
"""Families by the message that receives all rows in use."""
FOLLOWERS = {"GPA": ("GPA", "GPA2")}
"""Messages that accompany a receiver's."""
ALIGNED = {
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "MAG": ("MagX", "MagY", "MagZ"),
    "BARO": ("Alt",),
}
"""Columns that are continued from the sensor before: each sensor has its own bias, magnetic field
of the vehicle, and zero of height."""


class Sensor(NamedTuple):
    """The rows of one sensor."""

    number: int
    message: str
    table: StoredRows
    is_named: bool
    """Whether it has a message of its own."""

    def rows_of(self, rows: Column) -> Mask:
        """Return which rows of the message are its own."""
        if self.is_named:
            return np.ones(len(rows), dtype=bool)
        return np.asarray(rows[INSTANCE] == self.number)


def sensors_of(tables: Tables, messages: Sequence[str]) -> Iterator[Sensor]:
    """Yield the sensors of a kind, in the order of their numbers."""
    for number, message in enumerate(messages):
        if (table := tables.get(message)) is None:
            continue
        if not is_numbered(table):
            yield Sensor(number, message, table, is_named=True)
            continue
        parts = [np.unique(rows[INSTANCE]) for _, rows in table.parts()]
        for each in np.unique(np.concatenate(parts)).tolist() if parts else ():
            yield Sensor(each, message, table, is_named=False)


def is_numbered(table: StoredRows) -> bool:
    """Return whether the rows say of which sensor each is."""
    return INSTANCE in table.names and table.dtype[INSTANCE] == np.uint8


def good_of(name: str, sensors: Sequence[Sensor], family: Family) -> dict[int, Good]:
    """Return when each sensor measures."""
    found: dict[int, Good] = {}
    for one in sensors:
        good = found[one.number] = Good(family.patience_ns)
        before: Column | None = None
        for _, rows in one.table.parts():
            rows = rows[one.rows_of(rows)]
            t_ns = boot_ns(rows)
            if t_ns is not None and len(rows):
                good.add(t_ns, IS_GOOD[name](rows, before))
                before = rows[-1:]
        good.finish()
    return found


def _is_sample(rows: Column, before: Column | None) -> Mask:
    """Return which inertial samples are known, healthy and not repeated."""
    axes = ALIGNED["IMU"]
    values = np.stack([rows[axis] for axis in axes], axis=1)
    good = np.isfinite(values).all(axis=1) & (values != 0.0).any(axis=1)
    last = values[:1] * np.nan if before is None else np.stack([before[axis] for axis in axes], 1)
    good &= (np.diff(values, axis=0, prepend=last) != 0.0).any(axis=1)
    return np.asarray(good & has_flag(rows, "GH") & has_flag(rows, "AH"))


def _is_fix(rows: Column, before: Column | None) -> Mask:
    """Return which rows hold a new fix."""
    good = (rows["Status"] >= FIX_3D) & np.asarray(is_place(rows["Lat"], rows["Lng"]))
    if "GMS" in names_of(rows):
        times = rows["GMS"].astype(np.int64)
        last = times[:1] - 1 if before is None else before["GMS"].astype(np.int64)
        good &= np.diff(times, prepend=last) != 0
    # Of the old layout, TimeMS is the time of GPS
    week = ("TimeMS",) if {"T", "TimeMS"} <= {*names_of(rows)} else ()
    place = [name for name in ("Lat", "Lng", "Alt") if name in names_of(rows)]
    velocity = [name for name in ("Spd", "GCrs", "VZ") if name in names_of(rows)]
    return np.asarray(good & ~is_repeated(rows, before, week, place, velocity))


def _is_field(rows: Column, before: Column | None) -> Mask:
    values = np.stack([rows[axis] for axis in ALIGNED["MAG"]], axis=1)
    good = np.isfinite(values).all(axis=1) & (values != 0).any(axis=1)
    return np.asarray(good & has_flag(rows, "Health"))


def _is_pressure(rows: Column, before: Column | None) -> Mask:
    good = np.isfinite(rows["Alt"])
    if "Press" in names_of(rows):
        good &= rows["Press"] > 0.0
    return np.asarray(good & has_flag(rows, "H") & has_flag(rows, "Health"))


def has_flag(rows: Column, flag: str) -> Mask:
    """Return where a flag is set; everywhere if there is none."""
    names = names_of(rows)
    return np.asarray(rows[flag] != 0) if flag in names else np.ones(len(rows), dtype=bool)


IS_GOOD: dict[str, Callable[[Column, Column | None], Mask]] = {
    "IMU": _is_sample,
    "GPS": _is_fix,
    "MAG": _is_field,
    "BARO": _is_pressure,
}
