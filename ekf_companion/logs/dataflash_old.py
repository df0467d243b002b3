"""Rows of old ArduPilot logs: a barometer's height in CTUN, and rows without a stamp.

ArduCopter 3.1 writes no BARO message, and no time in ATT, MAG and CTUN.

Source: ArduPilot ArduCopter/Log.pde of 3.1 to 3.3 (``log_Control_Tuning``).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ekf_companion.logs.dataflash_columns import boot_ns
from ekf_companion.logs.dataflash_records import OFFSET, Tables
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Stamps

TUNING = "CTUN"
STAMPS = ("TimeUS", "TimeMS")
HEIGHTS = ("BarAlt", "BAlt")
"""Columns of CTUN with the barometer's height, m, above the place where it was zeroed."""
_BAROMETERS = ("BARO", "BAR2", "BAR3")
_UNSTAMPED = ("ATT", "MAG", "BARO")
"""Messages that once had no stamp."""


def with_barometer(tables: Tables, notes: list[str]) -> Tables:
    """Return the tables without CTUN; its barometer's height replaces a missing BARO."""
    found = {name: table for name, table in tables.items() if name != TUNING}
    table = tables.get(TUNING)
    if table is None or any(len(found.get(name, ())) for name in _BAROMETERS):
        return found
    height = next((name for name in HEIGHTS if name in table.names), None)
    if height is None or table.dtype[height].kind != "f" or not len(table):
        return found
    kept = [name for name in (OFFSET, *STAMPS) if name in table.names]
    dtype = np.dtype([*((name, table.dtype[name]) for name in kept), ("Alt", "<f8")])

    def renamed(rows: Column) -> Column:
        new = np.zeros(len(rows), dtype=dtype)
        for name in kept:
            new[name] = rows[name]
        new["Alt"] = rows[height]
        return new

    found["BARO"] = _made(table, dtype, renamed)
    notes.append(f"BARO: the log holds none; the barometer's height is {TUNING}.{height}")
    return found


def stamp_by_place(tables: Tables, notes: list[str]) -> None:
    """Stamp rows without a time by the inertial samples around them in the file."""
    unstamped = [
        name for name in _UNSTAMPED if name in tables and not {*STAMPS} & {*tables[name].names}
    ]
    imu = tables.get("IMU")
    if not unstamped or imu is None:
        return
    places: list[Stamps] = []
    times: list[Stamps] = []
    for _, rows in imu.parts():
        if (t_ns := boot_ns(rows)) is not None:
            places.append(rows[OFFSET])
            times.append(t_ns // 1000)
    if not places:
        return
    place, t_us = np.concatenate(places), np.concatenate(times)
    for name in unstamped:
        table = tables[name]
        dtype = np.dtype([*((one, table.dtype[one]) for one in table.names), ("TimeUS", "<u8")])

        def stamped(rows: Column, dtype: np.dtype[np.void] = dtype) -> Column:
            new = np.zeros(len(rows), dtype=dtype)
            for one in rows.dtype.names or ():
                new[one] = rows[one]
            new["TimeUS"] = np.interp(rows[OFFSET], place, t_us)
            return new

        tables[name] = _made(table, dtype, stamped)
    notes.append(
        f"the rows of {', '.join(unstamped)} have no time: they are taken to be of the time of the "
        "IMU rows around them in the file"
    )


def _made(
    table: StoredRows, dtype: np.dtype[np.void], make: Callable[[Column], Column]
) -> StoredRows:
    found = StoredRows(dtype)
    for _, rows in table.parts():
        found.append(make(rows))
    return found
