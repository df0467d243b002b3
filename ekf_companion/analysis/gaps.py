"""Where a line or a track must be interrupted: in gaps, and where it jumped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps

GAP_NS = 2_000_000_000
GAP_STEPS = 5.0
"""Steps longer than this, ns, and longer than so many usual ones, are not drawn over."""


def begins(t_ns: Stamps, jumps_ns: Sequence[int] = ()) -> Indices:
    """Return the rows that begin a piece of a line, without the first.

    Args:
        t_ns: Ascending, shape (n,).
        jumps_ns: Times of jumps: the first row at or after each begins a piece.
    """
    steps = np.diff(t_ns)
    if not len(steps):
        return np.zeros(0, dtype=np.intp)
    longest = max(GAP_NS, GAP_STEPS * float(np.median(steps)))
    anew = np.searchsorted(t_ns, np.asarray(jumps_ns, dtype=np.int64))
    anew = anew[(anew > 0) & (anew < len(t_ns))]
    return np.union1d(np.flatnonzero(steps > longest) + 1, anew).astype(np.intp)


def broken(
    t_ns: Stamps, x: Array, *columns: Array, jumps_ns: Sequence[int] = ()
) -> tuple[Array, ...]:
    """Return a line with a NaN between its pieces, at the end of the one before; x has none."""
    at = begins(t_ns, jumps_ns)
    return np.insert(x, at, x[at - 1]), *(np.insert(one, at, np.nan) for one in columns)


def thinned(t_ns: Stamps, most: int, jumps_ns: Sequence[int] = ()) -> tuple[Indices, Mask]:
    """Return rows of a track, every n-th and the ends of its pieces, and which end a piece.

    Gaps are found in all rows: between the rows of a thinned long flight every step is long.
    """
    at = begins(t_ns, jumps_ns)
    every = np.arange(0, len(t_ns), max(-(-len(t_ns) // most), 1))
    rows = np.union1d(every, np.concatenate([at, at - 1])).astype(np.intp)
    return rows, np.isin(rows, at - 1)


def parted(is_end: Mask, *columns: Array) -> tuple[Array, ...]:
    """Return columns with a NaN behind each row that ends a piece."""
    at = np.flatnonzero(is_end) + 1
    return tuple(np.insert(one, at, np.nan) for one in columns)


def covers(t_ns: Stamps, at_ns: Stamps) -> Mask:
    """Return which moments lie in a gap of ascending stamps."""
    return np.isin(np.searchsorted(t_ns, at_ns), begins(t_ns)) & ~np.isin(at_ns, t_ns)


def middles(t_ns: Stamps) -> Stamps:
    """Return a moment in each gap of ascending stamps."""
    at = begins(t_ns)
    return np.asarray(t_ns[at - 1] + (t_ns[at] - t_ns[at - 1]) // 2)
