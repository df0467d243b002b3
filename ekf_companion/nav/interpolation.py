"""Interpolation of a series of rows at other stamps, never across a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Stamps, in_pieces, median

GAP = 0.5
"""Longest step from row to row over which a series is interpolated, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Between:
    """Where stamps lie between the rows of a series."""

    wanted: Indices
    """Indices of the stamps that lie between two rows near enough, ascending, shape (k,)."""
    before: Indices
    """Row of the series at or just before each of these stamps; the row after it is the other."""
    share: Array
    """Share of the step from that row to the next at which each stamp lies, 0 to 1."""

    def values(self, series: Array) -> Array:
        """Interpolate a series of vectors linearly at the stamps, shape (k, m)."""
        share = self.share[:, None]
        return series[self.before] * (1.0 - share) + series[self.before + 1] * share

    def rotations(self, series: Array) -> Array:
        """Interpolate a series of quaternions at the stamps, each step a turn of constant rate."""

        def at(before: Indices, share: Array) -> Array:
            start, end = series[before], series[before + 1]
            turn = so3.log(so3.multiply(so3.conjugate(start), end)) * share[:, None]
            return so3.multiply(start, so3.exp(turn))

        return in_pieces(at, self.before, self.share)


def between(t_ns: Stamps, at_ns: Stamps, gap_ns: float = GAP * 1e9) -> Between:
    """Find stamps between the rows of a series.

    Args:
        t_ns: Of the series, ascending, two or more.
        at_ns: Stamps wanted, in any order.
        gap_ns: Largest step from row to row that is interpolated over.
    """
    wanted = np.flatnonzero((at_ns >= t_ns[0]) & (at_ns <= t_ns[-1]))
    before = np.clip(np.searchsorted(t_ns, at_ns[wanted], side="right") - 1, 0, len(t_ns) - 2)
    step = t_ns[before + 1] - t_ns[before]
    near = step <= gap_ns
    wanted, before, step = wanted[near], before[near], step[near]
    return Between(wanted=wanted, before=before, share=(at_ns[wanted] - t_ns[before]) / step)


def resample(at_ns: Stamps, t_ns: Stamps, values: Array) -> Array:
    """Interpolate rows, shape (n, m), linearly over any gap; beyond the ends the end row holds."""
    at, t = (at_ns - t_ns[0]) * 1e-9, (t_ns - t_ns[0]) * 1e-9
    return np.stack([np.interp(at, t, column) for column in values.T], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two series brought to the stamps of the sparser one."""

    at_ns: Stamps
    of_sparse: Indices
    """Rows of the sparser series."""
    of_dense: Between
    """Where its stamps are in the denser series."""
    is_swapped: bool
    """Whether the denser series is the second."""

    def difference(self, first: Array, second: Array) -> Array:
        """Return first minus second, shape (n, 3)."""
        dense, sparse = (second, first) if self.is_swapped else (first, second)
        less = self.of_dense.values(dense) - sparse[self.of_sparse]
        return less * (-1.0 if self.is_swapped else 1.0)

    def rotations(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return both series of quaternions at the stamps."""
        dense, sparse = (second, first) if self.is_swapped else (first, second)
        here, there = self.of_dense.rotations(dense), sparse[self.of_sparse]
        return (there, here) if self.is_swapped else (here, there)


def pair(first_ns: Stamps, second_ns: Stamps, begin: int, end: int) -> Pair | None:
    """Match two ascending series between two stamps; return None if they share no time.

    The denser one is interpolated over ``GAP``, or over three steps of a slower series.
    """
    if len(first_ns) < 2 or len(second_ns) < 2:
        return None
    periods = [median(np.diff(t_ns)) for t_ns in (first_ns, second_ns)]
    is_swapped = periods[0] > periods[1]
    dense, sparse = (second_ns, first_ns) if is_swapped else (first_ns, second_ns)
    rows = np.flatnonzero((sparse >= begin) & (sparse <= end))
    found = between(dense, sparse[rows], max(GAP * 1e9, 3.0 * min(periods)))
    rows = rows[found.wanted]
    return Pair(sparse[rows], rows, found, is_swapped) if len(rows) else None
