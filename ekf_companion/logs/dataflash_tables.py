"""Selection of a DataFlash log's usable messages: with whole columns, of the sensors in use.

Both generations are read: stamps in ``TimeMS`` (boot, ms; in GPS rows the GPS time of week, boot
time being ``T`` there) and in ``TimeUS`` (boot, us); sensors told apart by name (IMU, IMU2) and by
an instance column (``I``, for the estimators ``C``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ekf_companion.logs import (
    aids,
    clock_run,
    dataflash_instances,
    dataflash_old,
    dataflash_sensors,
    repeats,
)
from ekf_companion.logs.clock_run import Extent
from ekf_companion.logs.dataflash_columns import boot_ns, names_of
from ekf_companion.logs.dataflash_records import OFFSET, Tables
from ekf_companion.logs.recording import Damage
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Mask, Stamps

Columns = dict[str, Column]
"""Tables in memory."""

_ANGLES, _PLACE = ("Roll", "Pitch", "Yaw"), ("Lat", "Lng", "Alt")
_MOTION = ("VN", "VE", "VD", "PN", "PE", "PD")
NEEDED: dict[str, tuple[str, ...]] = {
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GPS": ("Status", *_PLACE, "Spd", "GCrs"),
    "GPA": (),
    "MAG": ("MagX", "MagY", "MagZ"),
    "BARO": ("Alt",),
    "ATT": _ANGLES,
    "AHR2": (*_ANGLES, *_PLACE),
    "POS": _PLACE,
    "ORGN": ("Type", *_PLACE),
    "SIM": (*_ANGLES, *_PLACE),
    "SIM2": ("VN", "VE", "VD"),
    **dict.fromkeys(("XKF1", "NKF1", "EKF1"), (*_ANGLES, *_MOTION)),
    "ARM": ("ArmState",),
    "EV": ("Id",),
    dataflash_old.TUNING: (),
    "PARM": ("Value",),
    "MSG": (),
    **{one.name: one.needed for _, one in aids.DATAFLASH},
    **{name: columns[-1:] for name, columns in dataflash_instances.ASKED.items()},
}
for _first, *_more in (one.messages for one in dataflash_sensors.FAMILIES.values()):
    NEEDED |= dict.fromkeys(_more, NEEDED[_first])
NEEDED["GPA2"] = NEEDED["GPA"]
"""The messages that are used, and the columns that each needs."""
_IMU = ("TimeUS", "TimeMS", "I", "GH", "AH", *NEEDED["IMU"])
READ: dict[str, tuple[str, ...] | None] = {
    **dict.fromkeys(NEEDED),
    **dict.fromkeys(dataflash_sensors.FAMILIES["IMU"].messages, _IMU),
    **dataflash_instances.ASKED,
    dataflash_old.TUNING: (*dataflash_old.STAMPS, *dataflash_old.HEIGHTS),
}
"""Columns that are read of each message; None: all. There are millions of inertial samples."""


def choose(tables: Tables, notes: list[str]) -> tuple[Tables, Extent, Damage]:
    """Select the usable messages of the sensors in use, on one clock run; note what is left out.

    Also return first and last stamp of the log's sensors, of which the samples may be a part, and
    how many rows were dropped.
    """
    tables = dataflash_old.with_barometer(tables, notes)
    usable = {name: t for name, t in tables.items() if _is_usable(t, NEEDED[name]) and len(t)}
    tables = dataflash_instances.choose(usable, notes)
    tables, twice = repeats.left_out(tables, boot_ns, OFFSET)
    notes += twice
    # Rows whose stamps are damaged, or of another boot, are dropped; tables without stamps kept
    stamps = {
        name: stamps_of(table)
        for name, table in tables.items()
        if is_stamped(table) and name not in ("PARM", "MSG")
    }
    runs = clock_run.common(stamps, "IMU", apart=("ORGN",))
    kept = {
        name: _on_run(table, runs[name]) if name in runs else table
        for name, table in tables.items()
    }
    dataflash_old.stamp_by_place(kept, notes)
    sensors = [name for name in ("IMU", "GPS", "MAG", "BARO", "ATT") if name in tables]
    counts: dict[str, tuple[int, int]] = {
        name: (len(tables[name]), len(kept[name])) for name in sensors
    }
    left_out, lost = clock_run.left_out(runs, counts, lambda name: stamps_of(tables[name]))
    notes += left_out
    extent = clock_run.extent(runs, sensors, "IMU")
    return {name: table for name, table in kept.items() if len(table)}, extent, lost


def _on_run(table: StoredRows, run: clock_run.CommonRun) -> StoredRows:
    def holds(first: int, rows: Column) -> Mask:
        t_ns = boot_ns(rows)
        assert t_ns is not None, "only stamped rows are on a run"
        return run.holds(first, t_ns)

    return table.kept(holds)


def is_stamped(table: StoredRows) -> bool:
    """Return whether the rows have a boot time."""
    return boot_ns(np.empty(0, dtype=table.dtype)) is not None


def stamps_of(table: StoredRows) -> Iterator[Stamps]:
    """Yield the boot times of a stamped table, part by part, ns."""
    for _, rows in table.parts():
        if (t_ns := boot_ns(rows)) is not None:
            yield t_ns


UNKNOWN = {"GPS": ("Spd", "GCrs", "VZ", "Yaw")}
"""Columns of a message in which NaN means that this one is not known."""


def rows_of(tables: Columns, name: str) -> tuple[Column, Stamps] | None:
    """Return a message's rows with finite numbers, and their stamps; None if there is no row."""
    table = tables.get(name)
    if table is None or (t_ns := boot_ns(table)) is None:
        return None
    finite = np.ones(len(table), dtype=bool)
    for column in names_of(table):
        if table[column].dtype.kind == "f" and column not in UNKNOWN.get(name, ()):
            finite &= np.isfinite(table[column].reshape(len(table), -1)).all(axis=1)
    if finite.all() and len(table):
        return table, t_ns
    return (table[finite], t_ns[finite]) if finite.any() else None


def _is_usable(table: StoredRows, needed: tuple[str, ...]) -> bool:
    """Return whether the columns exist and hold numbers: a damaged FMT may make them text."""
    kinds = {name: table.dtype[name].kind for name in table.names}
    return all(kinds.get(name, "") in ("i", "u", "f") for name in needed)
