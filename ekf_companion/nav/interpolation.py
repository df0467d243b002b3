"""A series at other stamps than its own: between two of its rows, never over a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

GAP = 0.5
"""s; over a longer one nothing is interpolated."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Between:
    """Where stamps lie between the rows of a series."""

    wanted: npt.NDArray[np.int64]
    """Which of the stamps lie between two rows that are near enough, ascending, shape (k,)."""
    before: npt.NDArray[np.int64]
    """Rows of the series at or just before each of these; the next one follows."""
    share: Array
    """How far each stamp is from there to the next, 0 to 1."""

    def values(self, series: Array) -> Array:
        """Give a series of vectors at the stamps, shape (k, m)."""
        share = self.share[:, None]
        return series[self.before] * (1.0 - share) + series[self.before + 1] * share

    def rotations(self, series: Array) -> Array:
        """Give a series of quaternions at the stamps, turned evenly from row to row."""
        start, end = series[self.before], series[self.before + 1]
        turn = so3.log(so3.multiply(so3.conjugate(start), end)) * self.share[:, None]
        return so3.multiply(start, so3.exp(turn))


def between(t_ns: Stamps, at_ns: Stamps, gap_ns: float = GAP * 1e9) -> Between:
    """Find stamps between the rows of a series.

    Args:
        t_ns: Of the series, ascending, two or more.
        at_ns: Where it is asked for, in any order.
        gap_ns: Largest step from row to row that is interpolated over.
    """
    wanted = np.flatnonzero((at_ns >= t_ns[0]) & (at_ns <= t_ns[-1]))
    before = np.clip(np.searchsorted(t_ns, at_ns[wanted], side="right") - 1, 0, len(t_ns) - 2)
    step = t_ns[before + 1] - t_ns[before]
    near = step <= gap_ns
    wanted, before, step = wanted[near], before[near], step[near]
    return Between(wanted=wanted, before=before, share=(at_ns[wanted] - t_ns[before]) / step)
