"""Closure of a walk that ends where it began: the distance from its first to its last position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.solution import Solution
from ekf_companion.nav.arrays import runs
from ekf_companion.nav.state import POSITION

SHORTEST_NS = 50_000_000
"""Still phases closer together than this are one stance, during which the foot rolls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure:
    """Closure of a solution, from its first position to its last."""

    horizontal: float
    """m."""
    distance: float
    """In space, m."""
    path: float
    """Length of the path over the ground, m."""
    stances: int
    """Phases in which the sensor stood still, including the rests at both ends."""


def closure(solution: Solution) -> Closure:
    """Measure the closure of a solution that is not empty."""
    pos = solution.table.columns(POSITION)
    gap = pos[-1] - pos[0]
    return Closure(
        horizontal=float(np.hypot(gap[0], gap[1])),
        distance=float(np.linalg.norm(gap)),
        path=float(np.linalg.norm(np.diff(pos[:, :2], axis=0), axis=1).sum()),
        stances=len(stances(solution)),
    )


def stances(solution: Solution) -> list[tuple[int, int]]:
    """Return the first index of each stance, and the index past its last."""
    if solution.is_still is None:
        return []
    stamps = solution.table.stamp_ns
    found: list[tuple[int, int]] = []
    for first, last in runs(solution.is_still):
        if found and stamps[first] - stamps[found[-1][1] - 1] < SHORTEST_NS:
            found[-1] = (found[-1][0], last)
        else:
            found.append((first, last))
    return found
