"""Two series in time brought to common stamps, never over a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

GAP = 0.5
"""s; over a longer one nothing is interpolated (or over three steps of a slower series)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two series brought to the stamps of the sparser one."""

    at_ns: Stamps
    of_sparse: npt.NDArray[np.int64]
    """Rows of the sparser series."""
    before: npt.NDArray[np.int64]
    """Rows of the denser series at or just before each stamp; the next one follows."""
    share: Array
    """How far each stamp is from there to the next, 0 to 1."""
    is_swapped: bool
    """The denser one is the second."""

    def difference(self, first: Array, second: Array) -> Array:
        """Give first minus second, shape (n, 3)."""
        dense, sparse = (second, first) if self.is_swapped else (first, second)
        share = self.share[:, None]
        between = dense[self.before] * (1.0 - share) + dense[self.before + 1] * share
        return (between - sparse[self.of_sparse]) * (-1.0 if self.is_swapped else 1.0)

    def rotations(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Give both at the stamps, the denser one turned evenly from row to row."""
        dense, sparse = (second, first) if self.is_swapped else (first, second)
        start, end = dense[self.before], dense[self.before + 1]
        turn = so3.log(so3.multiply(so3.conjugate(start), end)) * self.share[:, None]
        between, there = so3.multiply(start, so3.exp(turn)), sparse[self.of_sparse]
        return (there, between) if self.is_swapped else (between, there)


def pair(first_ns: Stamps, second_ns: Stamps, begin: int, end: int) -> Pair | None:
    """Match two ascending series between two stamps; None: they have no time in common."""
    if len(first_ns) < 2 or len(second_ns) < 2:
        return None
    periods = [float(np.median(np.diff(t_ns))) for t_ns in (first_ns, second_ns)]
    is_swapped = periods[0] > periods[1]
    dense, sparse = (second_ns, first_ns) if is_swapped else (first_ns, second_ns)
    wanted = (sparse >= max(begin, int(dense[0]))) & (sparse <= min(end, int(dense[-1])))
    rows = np.flatnonzero(wanted)
    before = np.clip(np.searchsorted(dense, sparse[rows], side="right") - 1, 0, len(dense) - 2)
    step = dense[before + 1] - dense[before]
    near = step <= max(GAP * 1e9, 3.0 * min(periods))
    rows, before, step = rows[near], before[near], step[near]
    if len(rows) == 0:
        return None
    return Pair(sparse[rows], rows, before, (sparse[rows] - dense[before]) / step, is_swapped)
