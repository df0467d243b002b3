"""Columns of a DataFlash log's messages: names, boot times, parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ekf_companion.logs import series
from ekf_companion.logs.onboard import clean
from ekf_companion.logs.stored_rows import Column, StoredRows
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


def parameters(tables: Mapping[str, StoredRows | Column]) -> dict[str, float]:
    """Return the first value of each parameter in the log."""
    table = tables.get("PARM")
    if table is None:
        return {}
    dtype = table.dtype
    if not {"Name", "Value"} <= {*(dtype.names or ())} or dtype["Name"].kind != "S":
        return {}
    found: dict[str, float] = {}
    for _, rows in table.parts() if isinstance(table, StoredRows) else ((0, table),):
        names, first = np.unique(rows["Name"], return_index=True)
        values = rows["Value"][first].astype(float).tolist()
        for name, value in zip(names.tolist(), values, strict=True):
            found.setdefault(clean(name), value)
    return found


def parameter(tables: Mapping[str, StoredRows | Column], name: str) -> float | None:
    """Return the first value of a parameter in the log; None: it is not there."""
    value = parameters(tables).get(name)
    return value if value is not None and np.isfinite(value) else None
