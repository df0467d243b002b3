"""Types of arrays, masks and runs, a fast median, and work on long series in pieces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

T = TypeVar("T")
Item = TypeVar("Item", bound=np.generic)

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
"""Times, ns."""
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Column: TypeAlias = npt.NDArray[Item]
"""Of one dimension and contiguous, as what is compiled takes it."""
Table: TypeAlias = npt.NDArray[Item]
"""The same of two dimensions."""
Bytes: TypeAlias = bytes | bytearray | memoryview
"""Read where they lie."""
Const: TypeAlias = Annotated[T, "const"]
"""An array that may not be writable."""


PIECE = 1 << 14
"""Rows."""


def in_pieces(
    function: Callable[..., npt.NDArray[np.float64]], *series: npt.NDArray[np.generic]
) -> Array:
    """Apply a function of rows to long series piece by piece, and join what it returns.

    Over hours of samples its intermediate arrays would be larger than the series.
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
    """Return the first index of each run of true, and the index past its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]
