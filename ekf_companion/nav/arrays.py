"""The types of arrays, two operations on masks that NumPy lacks, a median, and work in pieces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
"""Times, ns."""
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


PIECE = 1 << 14
"""Rows."""


def in_pieces(
    function: Callable[..., npt.NDArray[np.float64]], *series: npt.NDArray[np.generic]
) -> Array:
    """Return what a function of each row gives, called with some rows of all series at once.

    Of hours, what it needs on its way would be larger than the series.
    """
    firsts = range(0, max(len(series[0]), 1), PIECE)
    return np.concatenate(
        [function(*(one[first : first + PIECE] for one in series)) for first in firsts]
    )


def known_rows(values: Array) -> Mask:
    """Return which rows are finite in all columns, shape (n,)."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def median(values: npt.ArrayLike) -> float:
    """Return the median of one or more numbers, none of them NaN, to the bit of ``np.median``.

    That imports the masked arrays of NumPy first: a twentieth of the time in which a program
    starts and converts a short log.
    """
    numbers = np.asarray(values, dtype=np.float64)
    low, high = (len(numbers) - 1) // 2, len(numbers) // 2
    ordered = np.partition(numbers, (low, high))
    return float((ordered[low] + ordered[high]) / 2.0)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first index and the one past the last of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]
