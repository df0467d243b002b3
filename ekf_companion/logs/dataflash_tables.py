"""Which of a DataFlash log's messages can be used: whose columns are whole, of the first sensor.

Both generations are known: stamps in ``TimeMS`` (boot, ms; in GPS rows the GPS time of week, boot
time being ``T`` there) and in ``TimeUS`` (boot, us); sensors told apart by name (IMU, IMU2) and by
an instance column (``I``, for the estimators ``C``).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_records import Column, Columns

Stamps = npt.NDArray[np.int64]

_ANGLES, _PLACE = ("Roll", "Pitch", "Yaw"), ("Lat", "Lng", "Alt")
_MOTION = ("VN", "VE", "VD", "PN", "PE", "PD")
_NEEDED: dict[str, tuple[str, ...]] = {
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
}
"""The messages that count, and the columns without which they are of no use."""


def choose(tables: Columns, notes: list[str]) -> Columns:
    """Keep what can be used: the messages that count, of the first sensor, on one course of time.

    Args:
        tables: All messages, as the file has them.
        notes: Grows by what was left out.
    """
    notes += _other_sensors(tables)
    tables = {
        name: _first_instance(name, table, notes)
        for name, table in tables.items()
        if name in _NEEDED and _is_usable(table, _NEEDED[name])
    }
    return _on_course(tables, notes)


def names_of(table: Column) -> tuple[str, ...]:
    """Give the names of a table's columns."""
    return table.dtype.names or ()


def boot_ns(table: Column) -> Stamps | None:
    """Give the boot time of each row, ns; None: the rows carry none."""
    names = names_of(table)
    if "TimeUS" in names:
        return np.asarray(np.minimum(table["TimeUS"], 2**62 // 1000), dtype=np.int64) * 1000
    for column in ("T", "TimeMS"):
        # GPS rows of the old layout: TimeMS is the GPS time of week, T the boot time.
        if column in names and table[column].dtype.kind in "iu":
            return np.asarray(table[column], dtype=np.int64) * 1_000_000
    return None


def rows_of(tables: Columns, name: str) -> tuple[Column, Stamps] | None:
    """Give a message's rows in which the numbers are finite, and their stamps; None: no rows."""
    table = tables.get(name)
    if table is None or (t_ns := boot_ns(table)) is None:
        return None
    finite = np.ones(len(table), dtype=bool)
    for column in names_of(table):
        if table[column].dtype.kind == "f":
            finite &= np.isfinite(table[column].reshape(len(table), -1)).all(axis=1)
    return (table[finite], t_ns[finite]) if finite.any() else None


def _is_usable(table: Column, needed: tuple[str, ...]) -> bool:
    """Say whether the columns are there and hold numbers: a damaged FMT may say otherwise."""
    kinds = {name: table.dtype[name].kind for name in names_of(table)}
    return all(kinds.get(name, "") in ("i", "u", "f") for name in needed)


def _first_instance(name: str, table: Column, notes: list[str]) -> Column:
    """Keep the rows of the lowest instance, and say which others there are."""
    for column in ("I", "C"):
        # SIM's and others' C is something else; estimators' C is the core.
        if column in names_of(table) and table[column].dtype == np.uint8:
            instances = np.unique(table[column])
            if len(instances) > 1 and name in ("IMU", "GPS", "MAG", "BARO", "XKF1", "NKF1"):
                used, others = instances[0], ", ".join(map(str, instances[1:]))
                notes.append(f"{name}: instance {used} is used; the log also holds {others}")
            return np.asarray(table[table[column] == instances[0]])
    return table


def _other_sensors(tables: Columns) -> list[str]:
    """Say which further sensors stand in messages of their own."""
    others = [name for name in ("IMU2", "IMU3", "GPS2", "MAG2", "MAG3", "BAR2") if name in tables]
    return (
        [f"only the first sensor of each kind is used, not {', '.join(others)}"] if others else []
    )


def _on_course(tables: Columns, notes: list[str]) -> Columns:
    """Drop rows whose stamps leave the one course of time: damage, or another boot."""
    kept: Columns = {}
    spans: series.Spans = []
    if "IMU" in tables and (t_ns := boot_ns(tables["IMU"])) is not None:
        spans = series.course(t_ns)[1]
    wild = 0
    for name, table in tables.items():
        t_ns = boot_ns(table)
        if t_ns is None:
            kept[name] = table
            continue
        mask = series.course(t_ns)[0]
        if spans and name not in ("PARM", "ORGN"):
            mask &= series.inside(t_ns, spans)
        wild += len(mask) - int(mask.sum()) if name in ("IMU", "GPS", "MAG", "BARO", "ATT") else 0
        kept[name] = table[mask] if name != "PARM" else table
    if wild:
        notes.append(f"{wild} rows whose time stamps leave the log's course were dropped")
    return {name: table for name, table in kept.items() if len(table)}
