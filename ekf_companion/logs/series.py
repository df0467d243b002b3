"""Stamped columns: thinning, changes, nearest rows, and assumed accuracies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array, Mask, Stamps

LATEST_US = 2**62 // 1000
"""us; a later stamp is damaged."""
FIX_3D = 3
"""Lowest GNSS fix type with a position, in all formats."""
GNSS_HEADING_STD = float(np.deg2rad(5.0))
"""rad, where the receiver gives a heading and no accuracy of it."""
HEADING_STD = float(np.deg2rad(5.0))
"""rad, of the autopilot's own heading: that of a calibrated compass in flight."""
HEADING_RATE = 10.0
"""Hz at most, of the autopilot's own heading: its errors are correlated, so more rows add
nothing."""


def nanoseconds(stamps_us: npt.NDArray[Any]) -> Stamps:
    """Convert microseconds to ns; values that would overflow are damage, and stay huge.

    Damaged stamps of other types: negative and non-finite ones become 0.
    """
    if stamps_us.dtype.kind != "u":
        stamps_us = np.where(stamps_us > 0, stamps_us, 0)
    return np.asarray(np.minimum(stamps_us, np.uint64(LATEST_US)), dtype=np.int64) * 1000


def ascending(t_ns: Stamps) -> Mask:
    """Return which rows are later than every row before them."""
    if len(t_ns) == 0:
        return np.zeros(0, dtype=bool)
    newest = np.maximum.accumulate(t_ns)
    return np.concatenate([[True], newest[1:] > newest[:-1]])


def is_repeated(
    rows: npt.NDArray[Any],
    before: npt.NDArray[Any] | None,
    time: Sequence[str],
    place: Sequence[str],
    velocity: Sequence[str],
) -> Mask:
    """Return which fixes are the one before to the bit: the receiver is frozen.

    Also its time is the same then, or it reports a motion in which the place would have changed.

    Args:
        rows: Of one receiver, shape (n,).
        before: The row before them, shape (1,); None: there is none.
        time: Columns of the receiver's own time, where 0 is none; there may be none.
        place: Columns of its position.
        velocity: Columns of its velocity.
    """

    def is_same(*columns: str) -> Mask:
        values = stack(rows, *columns)
        last = values[:1] * np.nan if before is None else stack(before, *columns)
        return np.asarray((np.diff(values, axis=0, prepend=last) == 0.0).all(axis=1))

    is_timed = np.zeros(len(rows), dtype=bool)
    if time:
        is_timed = (stack(rows, *time) != 0.0).any(axis=1) & is_same(*time)
    is_moving = (stack(rows, *velocity) != 0.0).any(axis=1)
    return np.asarray(is_same(*place, *velocity) & (is_timed | is_moving))


def thinned(t_ns: Stamps, rate: float) -> slice:
    """Return the stride that thins a steady series to a rate, Hz; it may be exceeded by 10 %."""
    if len(t_ns) < 3:
        return slice(None)
    period_ns = max(float(np.median(np.diff(t_ns))), 1.0)
    return slice(None, None, max(1, int(np.ceil(1e9 / (rate * period_ns) - 0.1))))


def changed(*columns: npt.ArrayLike) -> Mask:
    """Return in which rows a column differs from the row before; the first row counts."""
    first = np.asarray(columns[0])
    mask = np.zeros(len(first), dtype=bool)
    mask[:1] = True
    for column in columns:
        column = np.asarray(column)
        # NaN differs from NaN: a missing value after a missing value is no change.
        both_nan = np.isnan(column[1:]) & np.isnan(column[:-1])
        mask[1:] |= (column[1:] != column[:-1]) & ~both_nan
    return mask


def nearest(t_ns: Stamps, others_ns: Stamps) -> Stamps:
    """Return for each stamp the index of the nearest of others (sorted, not empty)."""
    right = np.clip(np.searchsorted(others_ns, t_ns), 1, max(len(others_ns) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(others_ns) - 1)
    nearer = np.abs(others_ns[right] - t_ns) < np.abs(t_ns - others_ns[left])
    return np.where(nearer, right, left)


def accuracy(value: npt.ArrayLike, otherwise: npt.ArrayLike) -> Array:
    """Return accuracies where they are known (finite, positive), defaults elsewhere."""
    value = np.asarray(value, dtype=float)
    return np.where(np.isfinite(value) & (value > 0.0), value, otherwise)


def stack(table: Mapping[str, npt.NDArray[Any]] | npt.NDArray[np.void], *names: str) -> Array:
    """Return columns of a table as rows of floats, shape (n, k)."""
    return np.stack([table[name] for name in names], axis=1).astype(float)
