"""The types of arrays, and the two operations on masks that NumPy lacks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
"""Times, ns."""
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


def known_rows(values: Array) -> Mask:
    """Return which rows are finite in all columns, shape (n,)."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first index and the one past the last of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]
