"""Columns of a DataFlash log's messages: names, boot times, parameters."""

from __future__ import annotations

import numpy as np

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_records import Tables
from ekf_companion.logs.stored_rows import Column
from ekf_companion.nav.arrays import Stamps


def names_of(table: Column) -> tuple[str, ...]:
    """Return the names of a table's columns."""
    return table.dtype.names or ()


def boot_ns(table: Column) -> Stamps | None:
    """Return the boot time of each row, ns, or None if the rows carry none."""
    names = names_of(table)
    if "TimeUS" in names:
        return series.nanoseconds(table["TimeUS"])
    for column in ("T", "TimeMS"):
        # GPS rows of the old layout: TimeMS is the GPS time of week, T the boot time.
        if column in names and table[column].dtype.kind in "iu":
            return np.asarray(table[column], dtype=np.int64) * 1_000_000
    return None


def stamps(table: Column) -> Stamps:
    """Return the boot time of each row, ns; 0 if the rows carry none."""
    t_ns = boot_ns(table)
    return np.zeros(len(table), dtype=np.int64) if t_ns is None else t_ns


def parameter(tables: Tables, name: bytes) -> float | None:
    """Return the first value that a log has of a parameter: what was flown with."""
    table = tables.get("PARM")
    if table is None or not {"Name", "Value"} <= {*table.names}:
        return None
    for _, rows in table.parts():
        found = rows["Value"][rows["Name"] == name]
        if len(found) and np.isfinite(found[0]):
            return float(found[0])
    return None
