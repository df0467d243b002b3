"""Planes of the map, as points are compared with them."""

from __future__ import annotations

from dataclasses import dataclass

from ekf_companion.nav.arrays import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """The planes that points were matched with, one for each of k points."""

    index: Indices
    """Which of the points."""
    normal: Array
    """Shape (k, 3)."""
    centre: Array
    """m, shape (k, 3)."""
    along: Array
    """Two axes in the plane, times the sigma of its slope along each, shape (k, 2, 3)."""
    spread: Array
    """Variance of its offset at its centre, and of the points about it, m^2, shape (k, 2)."""
    time: Array
    """Mean time of its points, s since the first scan of the map, shape (k,)."""
    sweep: Array
    """Gradient of that time along the plane, s/m, shape (k, 3)."""
    drift: Array
    """Variance of the velocity across it as it was put in, by its points, m^2/s^2, shape (k,)."""
    owner: Indices
    """Anchor that the plane is tied to, shape (k,)."""
    voxel: Indices
    """Number of the voxel: the same for points on the same plane, shape (k,)."""
