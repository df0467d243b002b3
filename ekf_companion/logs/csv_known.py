"""Headers of other programs' CSV files, and the map that a ``.columns.yaml`` would hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Known:
    """A header that needs no map beside the file."""

    name: str
    """Whose it is, for the notes."""
    header: frozenset[str]
    """Columns that together identify it; there may be others."""
    columns: Mapping[str, Any]
    """As in a ``.columns.yaml``."""


def _axes(quantity: str, column: str, unit: str, signs: tuple[int, int, int]) -> dict[str, Any]:
    """Give the entries of x, y, z; ``{}`` in the column's name stands for the axis."""
    return {
        f"{quantity}_{axis}": {"column": column.format(axis.upper()), "unit": unit, "sign": sign}
        for axis, sign in zip("xyz", signs, strict=True)
    }


UP = (1, -1, -1)
"""Signs that turn axes forward, left, up into forward, right, down."""

KNOWN: tuple[Known, ...] = (
    Known(
        name="x-IO (time, gyroscope in deg/s, accelerometer in g; z up)",
        header=frozenset({"Time (s)", "Gyroscope X (deg/s)", "Accelerometer X (g)"}),
        columns={
            "time": {"column": "Time (s)", "unit": "s"},
            **_axes("gyro", "Gyroscope {} (deg/s)", "deg/s", UP),
            **_axes("accel", "Accelerometer {} (g)", "g", UP),
        },
    ),
)


def find(names: Sequence[str]) -> Known | None:
    """Give the known header that these column names hold; None: there is none."""
    return next((one for one in KNOWN if one.header <= set(names)), None)
