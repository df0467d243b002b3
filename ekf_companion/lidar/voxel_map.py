"""A local map of planes in voxels, each with its covariance and the pose that it is tied to.

The space is divided into voxels of several sizes, whose grids are shifted against each other so
that a wall on the face of one is inside another. A voxel keeps the sums of its points; where they
lie on a plane, it has the plane with the covariance that their noise leaves to it. Voxels belong to
the anchor (a pose of the past) that was current when the first of their points was put in.

Source: Yuan et al. 2022, "Efficient and probabilistic adaptive voxel mapping for accurate online
lidar odometry", arXiv 2109.07082 (planes in voxels, with their uncertainty).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.settings import Settings
from ekf_companion.nav.arrays import Array, Indices, Mask

LEAST_POINTS = 6
"""Three make a plane; as many again say how thick it is."""
MOST_POINTS = 100
"""Of a voxel: its plane is then known to a tenth of the noise of a point."""
LARGEST_SLOPE = 0.15
"""Largest sigma of a plane's slope, rad: beyond it sine and angle differ by more than noise."""
THICKEST = 3.0
"""Largest thickness of a plane, of the noise of a range."""
LASERS = 2
"""Of a spinning lidar that reach one voxel, at least: with one alone there is no plane."""
PATCHES = 4
"""Of a rough or curved surface in one voxel that are independent of each other: its quarters."""
_SHIFT = 0.377
"""Of the grid of each size relative to the one before, of its voxels."""
_BITS, _HALF = 21, 1 << 20


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
    offset: Array
    """Variance of the plane's offset at its centre, m^2, shape (k,)."""
    scatter: Array
    """Mean square distance of the points from it, m^2, shape (k,)."""
    owner: Indices
    """Anchor that the plane is tied to, shape (k,)."""
    voxel: Indices
    """Number of the voxel: the same for points on the same plane, shape (k,)."""


class VoxelMap:
    """Planes of the surroundings, in w."""

    def __init__(self, settings: Settings) -> None:
        self._levels = [
            _Level(settings.voxel * 2**k, _SHIFT * k, settings) for k in range(settings.levels)
        ]
        self._least_var = settings.range_noise**2

    def __len__(self) -> int:
        """Return the number of voxels of all sizes."""
        return sum(level.used for level in self._levels)

    def insert(self, points_w: Array, variance: Array, owner: int) -> None:
        """Put in points, shape (n, 3), with the variance of each along any axis, shape (n,)."""
        for level in self._levels:
            level.insert(points_w, variance, owner)

    def match(self, points_w: Array, variance: Array) -> Planes:
        """Match points with the plane of the voxel around each that predicts it best."""
        n = len(points_w)
        best = np.full(n, np.inf)
        at = np.full(n, -1)
        which = np.zeros(n, dtype=np.int64)
        for number, level in enumerate(self._levels):
            slot, found = level.find(points_w)
            cost = np.where(found, level.cost[slot] + variance, np.inf)
            is_better = cost < best
            best[is_better] = cost[is_better]
            at[is_better] = slot[is_better]
            which[is_better] = number
        index = np.flatnonzero(at >= 0)
        at, which = at[index], which[index]
        k = len(index)
        planes = Planes(
            index,
            np.empty((k, 3)),
            np.empty((k, 3)),
            np.empty((k, 2, 3)),
            np.empty(k),
            np.empty(k),
            np.empty(k, dtype=np.int64),
            at * len(self._levels) + which,
        )
        for number, level in enumerate(self._levels):
            chosen = np.flatnonzero(which == number)
            level.take(at[chosen], planes, chosen)
        return planes

    def forget_far(self, centre_w: Array, radius: float) -> None:
        """Forget the voxels beyond a radius."""
        for level in self._levels:
            gap = level.middle[: level.used] - centre_w
            level.keep(np.einsum("ij,ij->i", gap, gap) < radius * radius)

    def forget_owner(self, owner: int) -> None:
        """Forget the voxels that are tied to an anchor."""
        for level in self._levels:
            level.keep(level.owner[: level.used] != owner)

    def owned(self) -> Indices:
        """Return the owner of each voxel."""
        return np.concatenate([level.owner[: level.used] for level in self._levels])

    def points(self) -> Array:
        """Return the mean of the points of each smallest voxel, m, shape (n, 3)."""
        level = self._levels[0]
        used = level.used
        return level.middle[:used] + level.sums[:used, :3] / level.count[:used, None]


class _Level:
    """Voxels of one size."""

    def __init__(self, size: float, shift: float, settings: Settings) -> None:
        self.size, self._shift = size, shift
        self._thickest = (THICKEST * settings.range_noise) ** 2
        self._bias_var = settings.range_bias**2
        self._face = 3.0 * settings.range_noise
        self.used = 0
        self._keys = np.empty(0, dtype=np.int64)
        self._slots = np.empty(0, dtype=np.int64)
        self._allocate(1024)

    def _allocate(self, size: int) -> None:
        shapes = {
            "key": ((size,), np.int64),
            "middle": ((size, 3), np.float64),
            "count": ((size,), np.float64),
            "sums": ((size, 9), np.float64),
            "noise": ((size,), np.float64),
            "owner": ((size,), np.int64),
            "lead": ((size,), np.float64),
            "cost": ((size,), np.float64),
            "normal": ((size, 3), np.float64),
            "centre": ((size, 3), np.float64),
            "along": ((size, 2, 3), np.float64),
            "offset": ((size,), np.float64),
            "scatter": ((size,), np.float64),
        }
        for name, (shape, kind) in shapes.items():
            made = np.zeros(shape, dtype=kind)
            if self.used:
                made[: self.used] = getattr(self, name)[: self.used]
            setattr(self, name, made)

    key: Indices
    middle: Array
    count: Array
    sums: Array
    """Of x, y, z, xx, yy, zz, xy, xz, yz about the middle."""
    noise: Array
    owner: Indices
    lead: Array
    """Points of the owner less those of others: the owner has the majority."""
    cost: Array
    """Variance of a point's distance from the plane, without its own noise; infinite: no plane."""
    normal: Array
    centre: Array
    along: Array
    offset: Array
    scatter: Array

    def _key(self, points_w: Array) -> tuple[Indices, Indices]:
        cell = np.floor(points_w / self.size + self._shift).astype(np.int64)
        packed = cell + _HALF
        return (packed[:, 0] << 2 * _BITS) | (packed[:, 1] << _BITS) | packed[:, 2], cell

    def find(self, points_w: Array) -> tuple[Indices, Mask]:
        """Return the voxel of each point, and whether there is one."""
        if not self.used:
            return np.zeros(len(points_w), dtype=np.int64), np.zeros(len(points_w), dtype=np.bool_)
        key, _ = self._key(points_w)
        place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return self._slots[place], self._keys[place] == key

    def insert(self, points_w: Array, variance: Array, owner: int) -> None:
        """Add points to their voxels, as far as these are not full."""
        key, cell = self._key(points_w)
        slot, found = self.find(points_w)
        missing = np.flatnonzero(~found)
        if len(missing):
            fresh, first, back = np.unique(key[missing], return_index=True, return_inverse=True)
            start, end = self.used, self.used + len(fresh)
            if end > len(self.count):
                self._allocate(2 * end)
            self.key[start:end] = fresh
            self.middle[start:end] = (cell[missing[first]] + 0.5 - self._shift) * self.size
            self.count[start:end] = self.noise[start:end] = 0.0
            self.sums[start:end] = 0.0
            self.owner[start:end] = owner
            self.lead[start:end] = 0.0
            self.cost[start:end] = np.inf
            self.used = end
            slot = slot.copy()
            slot[missing] = start + back
            where = np.searchsorted(self._keys, fresh)
            self._keys = np.insert(self._keys, where, fresh)
            self._slots = np.insert(self._slots, where, np.arange(start, end))
        room = self.count[slot] < MOST_POINTS
        slot, points_w, variance = slot[room], points_w[room], variance[room]
        if not len(slot):
            return
        changed, back = np.unique(slot, return_inverse=True)
        q = points_w - self.middle[slot]
        columns = [q[:, 0], q[:, 1], q[:, 2]]
        columns += [q[:, 0] ** 2, q[:, 1] ** 2, q[:, 2] ** 2]
        columns += [q[:, 0] * q[:, 1], q[:, 0] * q[:, 2], q[:, 1] * q[:, 2]]
        for j, column in enumerate(columns):
            self.sums[changed, j] += np.bincount(back, column, len(changed))
        count = np.bincount(back, minlength=len(changed))
        self.count[changed] += count
        # Boyer and Moore's vote: whose points are the most
        lead = self.lead[changed] + np.where(self.owner[changed] == owner, count, -count)
        self.owner[changed[lead < 0.0]] = owner
        self.lead[changed] = np.abs(lead)
        self.noise[changed] += np.bincount(back, variance, len(changed))
        self._fit(changed)

    def _fit(self, slot: Indices) -> None:
        """Fit the planes of voxels."""
        slot = slot[self.count[slot] >= LEAST_POINTS]
        if not len(slot):
            return
        n = self.count[slot]
        s = self.sums[slot] / n[:, None]
        mean = s[:, :3]
        C = s[:, [3, 6, 7, 6, 4, 8, 7, 8, 5]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None]
        size, axes = np.linalg.eigh(C)
        size = np.maximum(size, 1e-8)
        thick = size[:, 0] * n / (n - 3.0)
        expected = self.noise[slot] / n
        var = np.maximum(thick, expected)
        # Few lasers reach one voxel: their biases do not average out as noise does
        # nor does what a surface is rough or curved by
        rough = np.maximum(thick - expected, 0.0)
        remaining = var / n + self._bias_var / LASERS + rough / PATCHES
        slope = remaining[:, None] / size[:, 1:]
        normal = axes[:, :, 0]
        is_plane = (thick < self._thickest) & (slope[:, 0] < LARGEST_SLOPE**2)
        # A plane along a face has lost the points on its other side
        face = np.abs(0.5 * self.size - np.abs(mean)) < self._face
        is_plane &= ~(face & (np.abs(normal) > 0.9)).any(axis=1)
        self.normal[slot] = normal
        self.centre[slot] = self.middle[slot] + mean
        self.along[slot] = np.sqrt(slope)[:, :, None] * axes[:, :, 1:].transpose(0, 2, 1)
        self.offset[slot] = remaining
        self.scatter[slot] = thick
        # At a point as far from the centre as they are on the average
        self.cost[slot] = np.where(is_plane, thick + 3.0 * remaining, np.inf)

    def take(self, slot: Indices, planes: Planes, where: Indices) -> None:
        """Write the planes of voxels to their places."""
        planes.normal[where] = self.normal[slot]
        planes.centre[where] = self.centre[slot]
        planes.along[where] = self.along[slot]
        planes.offset[where] = self.offset[slot]
        planes.scatter[where] = self.scatter[slot]
        planes.owner[where] = self.owner[slot]

    def keep(self, is_kept: Mask) -> None:
        """Forget all voxels but some."""
        if is_kept.all():
            return
        kept = np.flatnonzero(is_kept)
        for name in ("key", "middle", "count", "sums", "noise", "owner", "lead", "cost"):
            getattr(self, name)[: len(kept)] = getattr(self, name)[kept]
        for name in ("normal", "centre", "along", "offset", "scatter"):
            getattr(self, name)[: len(kept)] = getattr(self, name)[kept]
        self.used = len(kept)
        order = np.argsort(self.key[: self.used])
        self._keys, self._slots = self.key[order], order
