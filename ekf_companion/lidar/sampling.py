"""Which points of a scan are taken, and which share a voxel."""

from __future__ import annotations

import numpy as np

from ekf_companion.lidar.settings import Settings
from ekf_companion.nav.arrays import Array, Indices


def within_range(points: Array, settings: Settings) -> Indices:
    """Return the index of the points that are neither of the vehicle nor too far."""
    square = np.einsum("ni,ni->n", points, points)
    return np.flatnonzero((square > settings.least_range**2) & (square < settings.most_range**2))


def thin(points: Array, size: float, most: int) -> Indices:
    """Return the index of one point in each voxel, and at most so many, spread evenly."""
    order, first, _ = grouped(np.floor(points / size).astype(np.int64))
    return evenly(np.sort(order[first]), most)


def evenly(index: Indices, most: int) -> Indices:
    """Return at most so many of an index, spread evenly."""
    if len(index) <= most:
        return index
    return index[np.linspace(0, len(index) - 1, most).astype(np.int64)]


def grouped(cell: Indices) -> tuple[Indices, Indices, Indices]:
    """Return points by their cells, shape (n, 3).

    Returns:
        The order in which points of the same cell follow each other, where each cell begins in it,
        and how many points it has.
    """
    i, j, k = (cell + (1 << 20)).T
    key = (i << 42) | (j << 21) | k
    order = np.argsort(key, kind="stable")
    key = key[order]
    is_first = np.ones(len(key), dtype=np.bool_)
    is_first[1:] = key[1:] != key[:-1]
    first = np.flatnonzero(is_first)
    return order, first, np.diff(first, append=len(key))
