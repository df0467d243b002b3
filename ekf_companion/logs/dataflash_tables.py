"""Selection of a DataFlash log's usable messages: with whole columns, of the first sensor.

Both generations are read: stamps in ``TimeMS`` (boot, ms; in GPS rows the GPS time of week, boot
time being ``T`` there) and in ``TimeUS`` (boot, us); sensors told apart by name (IMU, IMU2) and by
an instance column (``I``, for the estimators ``C``).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_records import Column, Columns
from ekf_companion.nav.arrays import Stamps

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
    "PARM": ("Value",),
    "MSG": (),
}
"""The messages that are used, and the columns that each needs."""
READ: dict[str, tuple[str, ...] | None] = {
    **dict.fromkeys(NEEDED),
    "IMU": ("TimeUS", "TimeMS", "I", *NEEDED["IMU"]),
}
"""The columns that are read of each message; None: all. Of inertial samples there are millions."""


def choose(tables: Columns, others: Collection[str], notes: list[str]) -> Columns:
    """Keep the usable messages of the first sensor, on one clock run; note what is left out.

    ``others`` are the names of messages that the log holds besides the tables.
    """
    more = [name for name in ("IMU2", "IMU3", "GPS2", "MAG2", "MAG3", "BAR2") if name in others]
    if more:
        notes.append(f"only the first sensor of each kind is used, not {', '.join(more)}")
    tables = {
        name: _first_instance(name, table, notes)
        for name, table in tables.items()
        if name in NEEDED and _is_usable(table, NEEDED[name])
    }
    if "IMU" in tables:
        tables["IMU"] = _in_nanoseconds(tables["IMU"])
    # Rows whose stamps are damaged, or of another boot, are dropped; tables without stamps kept
    stamps = {name: t_ns for name, one in tables.items() if (t_ns := boot_ns(one)) is not None}
    masks = series.common_run(stamps, "IMU", apart=("PARM", "ORGN", "MSG"))
    for name in ("PARM", "MSG"):
        masks.pop(name, None)
    sensors = ("IMU", "GPS", "MAG", "BARO", "ATT")
    if wild := sum(int((~masks[name]).sum()) for name in sensors if name in masks):
        notes.append(f"{wild} rows whose time stamps do not fit the log's clock were dropped")
    kept = {
        name: one if name not in masks or masks[name].all() else one[masks[name]]
        for name, one in tables.items()
    }
    return {name: table for name, table in kept.items() if len(table)}


def names_of(table: Column) -> tuple[str, ...]:
    """Return the names of a table's columns."""
    return table.dtype.names or ()


def boot_ns(table: Column) -> Stamps | None:
    """Return the boot time of each row, ns, or None if the rows carry none."""
    names = names_of(table)
    if "TimeNS" in names:
        return np.asarray(table["TimeNS"])
    if "TimeUS" in names:
        return series.nanoseconds(table["TimeUS"])
    for column in ("T", "TimeMS"):
        # GPS rows of the old layout: TimeMS is the GPS time of week, T the boot time.
        if column in names and table[column].dtype.kind in "iu":
            return np.asarray(table[column], dtype=np.int64) * 1_000_000
    return None


def _in_nanoseconds(table: Column) -> Column:
    """Return a table with ``TimeNS`` where ``TimeUS`` was, in the same memory."""
    if "TimeUS" not in names_of(table) or table.dtype["TimeUS"].itemsize != 8:
        return table
    series.nanoseconds_in_place(table["TimeUS"])
    fields = [
        ("TimeNS", "<i8") if name == "TimeUS" else (name, table.dtype[name])
        for name in names_of(table)
    ]
    return table.view(np.dtype(fields))


def rows_of(tables: Columns, name: str) -> tuple[Column, Stamps] | None:
    """Return a message's rows with finite numbers, and their stamps; None if there is no row."""
    table = tables.get(name)
    if table is None or (t_ns := boot_ns(table)) is None:
        return None
    finite = np.ones(len(table), dtype=bool)
    for column in names_of(table):
        if table[column].dtype.kind == "f":
            finite &= np.isfinite(table[column].reshape(len(table), -1)).all(axis=1)
    if finite.all() and len(table):
        return table, t_ns
    return (table[finite], t_ns[finite]) if finite.any() else None


def _is_usable(table: Column, needed: tuple[str, ...]) -> bool:
    """Return whether the columns exist and hold numbers: a damaged FMT may make them text."""
    kinds = {name: table.dtype[name].kind for name in names_of(table)}
    return all(kinds.get(name, "") in ("i", "u", "f") for name in needed)


def _first_instance(name: str, table: Column, notes: list[str]) -> Column:
    """Keep the rows of the lowest instance, and note the others."""
    for column in ("I", "C"):
        # Only an estimator's C is its core
        if column in names_of(table) and table[column].dtype == np.uint8:
            instances = np.unique(table[column])
            if len(instances) > 1 and name in ("IMU", "GPS", "MAG", "BARO", "XKF1", "NKF1"):
                used, others = instances[0], ", ".join(map(str, instances[1:]))
                notes.append(f"{name}: instance {used} is used; the log also holds {others}")
            return np.asarray(table[table[column] == instances[0]])
    return table
