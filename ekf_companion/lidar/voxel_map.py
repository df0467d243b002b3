"""A local map of planes in voxels, each with its covariance and the anchor that it is tied to.

The space is divided into voxels of several sizes, whose grids are shifted against each other so
that a wall on the face of one is inside another. A voxel keeps the sums of its points; where they
lie on a plane, it has the plane with the covariance that their noise leaves to it. Voxels belong to
the anchor (a part of the map that was put in over one second) that most of their points are of.

Compiled, as it looks at every point; the same file runs as plain Python. It is longer than others
so that the compiler sees the whole of the loop over points.

Source: Yuan et al. 2022, "Efficient and probabilistic adaptive voxel mapping for accurate online
lidar odometry", arXiv 2109.07082 (planes in voxels, with their uncertainty).
"""

from __future__ import annotations

from typing import Any

import cython
import numpy as np
from cython.cimports.libc.math import floor, sqrt

from ekf_companion.lidar.planes import Planes
from ekf_companion.lidar.settings import Settings
from ekf_companion.nav.arrays import Array, Column, Const, Indices, Table

_LEAST_SPOTS = 6
"""Of a plane: three make it; as many again say how thick it is. A lidar at rest strikes the same
ones again and again, and three lie on a plane however many points they are."""
_SPOT = 4.0
"""Size of a spot, in the noise of a range: points that are nearer may be of the same one."""
_CELLS = 8.0
"""Spots along the edge of a voxel that are told apart, at most."""
_LEAST_FANS = 3
"""Azimuths of rays by which a plane shows the velocity it was put in by: where those of one or two
go as the lidar moves is a plane too, which leans by how the lidar is thought to move."""
_FAN = 5e-3
"""Angle of a fan, rad: many times the noise of a beam's direction, and no more than there is
between the columns of a dense lidar."""
_PLACES = 61
"""Bits that mark them; a prime, so that neighbours have different ones."""
_MOST_POINTS = 100.0
"""Of a voxel: its plane is then known to a tenth of the noise of a point."""
LARGEST_SLOPE = 0.15
"""Largest sigma of a plane's slope, rad: beyond it sine and angle differ by more than noise."""
_LARGEST_SLOPE = LARGEST_SLOPE
THICKEST = 3.0
"""Largest thickness of a plane, of the noise of a range."""
LASERS = 2.0
"""Of a spinning lidar that reach one voxel, at least: with one alone there is no plane."""
_LASERS = LASERS
_PATCHES = 4.0
"""Of a rough or curved surface in one voxel that are independent of each other: its quarters."""
_SHIFT = 0.377
"""Of the grid of each size relative to the one before, of its voxels."""
_LEAST_VARIANCE = 1e-8
"""Of points along any axis, m^2: what rounding leaves."""
_LEAST_TIME = 1e-6
"""Variance of times at one place, s^2: what rounding leaves."""
_ALONG_FACE = 0.9
"""Cosine from which on a normal is that of a face."""
_SWEEPS = 12
"""Of Jacobi's rotations at most; four to six are enough."""
_CONVERGED = 1e-22
"""Squares off the diagonal, of those on it, below which the rotations end."""
_NONE = 1e30
"""Cost of a voxel without a plane."""

_BITS = 20
_LEVEL_BITS = 3
_HALF = 1 << 19
_MASK = (1 << 20) - 1
_LEVELS = (1 << 3) - 1
"""A key has 20 bits for the cell along each axis and three for the size."""

# Columns of the table of voxels
_MIDDLE = 0
_COUNT = 3
_NOISE = 4
_LEAD = 5
"""Points of the owner less those of others: the owner has the majority."""
_SUMS = 6
"""Of x, y, z, xx, yy, zz, xy, xz, yz about the middle."""
_NORMAL = 15
_CENTRE = 18
_ALONG = 21
_OFFSET = 27
_SCATTER = 28
_TIME = 29
"""Mean time of the points."""
_SWEEP = 30
"""Its gradient along the plane: where rays move with the lidar, what they strike has one."""
_DRIFT = 33
"""Variance of an error of the velocity along the normal: by how thick that would make the plane,
where times do not follow from places."""
_TIMES = 34
"""Sums of the time, of its products with x, y and z about the middle, and of its square."""
_WIDTH = 39


class VoxelMap:
    """Planes of the surroundings, in w."""

    _rows: Table[np.float64]
    """One row for each voxel, ``used`` of them."""
    _keys: Column[np.int64]
    _owners: Column[np.int64]
    _costs: Column[np.float64]
    """Variance of a point's distance from the plane, without its own noise."""
    _spots: Column[np.int64]
    """A bit for each spot of a voxel that was struck."""
    _fans: Column[np.int64]
    """A bit for each azimuth, in the lidar's frame, of the rays."""
    _marks: Column[np.int64]
    """The last insertion that changed a voxel."""
    _changed: Column[np.int64]
    _slots: Table[np.int64]
    """Key and row of each voxel, where its hash or the next free place after it is; -1: free."""
    _axes: Table[np.float64]

    def __init__(self, settings: Settings) -> None:
        """Begin without voxels."""
        self._size: float = settings.voxel
        self._levels: int = settings.levels
        self._thickest: float = (THICKEST * settings.range_noise) ** 2
        self._bias_var: float = settings.range_bias**2
        self._face: float = 3.0 * settings.range_noise
        self._spot: float = _SPOT * settings.range_noise
        self.used: int = 0
        self._insertion: int = 0
        self._rows = np.zeros((1024, _WIDTH))
        self._keys = np.zeros(1024, dtype=np.int64)
        self._owners = np.zeros(1024, dtype=np.int64)
        self._costs = np.zeros(1024)
        self._spots = np.zeros(1024, dtype=np.int64)
        self._fans = np.zeros(1024, dtype=np.int64)
        self._marks = np.zeros(1024, dtype=np.int64)
        self._changed = np.zeros(1024, dtype=np.int64)
        self._slots = np.full((2048, 2), -1, dtype=np.int64)
        self._axes = np.zeros((6, 3))

    def __len__(self) -> int:
        """Return the number of voxels of all sizes."""
        return self.used

    def insert(
        self,
        points_w: Array,
        variance: Array,
        time: Array,
        owner: int,
        points: Array | None = None,
    ) -> None:
        """Put in points.

        Args:
            points_w: m, shape (n, 3).
            variance: Of each along any axis, m^2, shape (n,).
            time: Of each, s, shape (n,).
            owner: The anchor that they are tied to.
            points: The same in the lidar's frame, m; None: it is in the origin.
        """
        self._make_room(self.used + len(points_w) * self._levels)
        self.insert_each(
            np.ascontiguousarray(points_w),
            np.ascontiguousarray(variance),
            np.ascontiguousarray(time),
            _fans(points_w if points is None else points),
            owner,
        )

    def insert_each(
        self,
        points: Const[Table[np.float64]],
        variance: Const[Column[np.float64]],
        time: Const[Column[np.float64]],
        fans: Const[Column[np.int64]],
        owner: int,
    ) -> None:
        """Do the work of :meth:`insert`, where there is room."""
        self._insertion += 1
        changed: int = 0
        size: float = self._size
        for level in range(self._levels):
            for i in range(points.shape[0]):
                row = self._row(level, size, points[i, 0], points[i, 1], points[i, 2], owner)
                count = self._rows[row, _COUNT]
                if self._marks[row] != self._insertion:
                    # Full or not at its beginning: the points of one scan all count
                    if count >= _MOST_POINTS:
                        continue
                    self._marks[row] = self._insertion
                    self._changed[changed] = row
                    changed += 1
                self._add(row, size, points[i, 0], points[i, 1], points[i, 2], variance[i], owner)
                self._add_time(row, points[i, 0], points[i, 1], points[i, 2], time[i])
                self._fans[row] |= fans[i]
            size *= 2.0
        for k in range(changed):
            self._fit(self._changed[k])

    def _row(self, level: int, size: float, x: float, y: float, z: float, owner: int) -> int:
        """Return the row of the voxel around a point, which is made if there is none."""
        shift = _SHIFT * level
        i = cython.cast(cython.longlong, floor(x / size + shift))
        j = cython.cast(cython.longlong, floor(y / size + shift))
        k = cython.cast(cython.longlong, floor(z / size + shift))
        key = _key(i, j, k, level)
        at = self._slot(key)
        if self._slots[at, 1] >= 0:
            return self._slots[at, 1]
        row = self.used
        self.used += 1
        self._slots[at, 0], self._slots[at, 1] = key, row
        self._keys[row] = key
        self._costs[row] = _NONE
        self._marks[row] = self._spots[row] = self._fans[row] = 0
        for column in range(_WIDTH):
            self._rows[row, column] = 0.0
        self._rows[row, _MIDDLE] = (i + 0.5 - shift) * size
        self._rows[row, _MIDDLE + 1] = (j + 0.5 - shift) * size
        self._rows[row, _MIDDLE + 2] = (k + 0.5 - shift) * size
        self._owners[row] = owner
        return row

    def _slot(self, key: int) -> int:
        """Return where a key is, or the free place where it would be."""
        last = self._slots.shape[0] - 1
        at: int = _hash(key) & last
        while self._slots[at, 1] >= 0 and self._slots[at, 0] != key:
            at = (at + 1) & last
        return at

    def _add(
        self, row: int, size: float, x: float, y: float, z: float, variance: float, owner: int
    ) -> None:
        """Add a point to the sums of a voxel of a size."""
        x -= self._rows[row, _MIDDLE]
        y -= self._rows[row, _MIDDLE + 1]
        z -= self._rows[row, _MIDDLE + 2]
        self._rows[row, _SUMS] += x
        self._rows[row, _SUMS + 1] += y
        self._rows[row, _SUMS + 2] += z
        self._rows[row, _SUMS + 3] += x * x
        self._rows[row, _SUMS + 4] += y * y
        self._rows[row, _SUMS + 5] += z * z
        self._rows[row, _SUMS + 6] += x * y
        self._rows[row, _SUMS + 7] += x * z
        self._rows[row, _SUMS + 8] += y * z
        self._rows[row, _COUNT] += 1.0
        self._rows[row, _NOISE] += variance
        cell: float = max(size / _CELLS, self._spot)
        i = cython.cast(cython.longlong, max(floor((x + 0.5 * size) / cell), 0.0))
        j = cython.cast(cython.longlong, max(floor((y + 0.5 * size) / cell), 0.0))
        k = cython.cast(cython.longlong, max(floor((z + 0.5 * size) / cell), 0.0))
        one: cython.longlong = 1
        self._spots[row] |= one << ((i + 11 * j + 29 * k) % _PLACES)
        # Boyer and Moore's vote: whose points are the most
        if self._owners[row] == owner:
            self._rows[row, _LEAD] += 1.0
        elif self._rows[row, _LEAD] > 0.0:
            self._rows[row, _LEAD] -= 1.0
        else:
            self._owners[row] = owner
            self._rows[row, _LEAD] = 1.0

    def _add_time(self, row: int, x: float, y: float, z: float, time: float) -> None:
        """Add the time of a point to the sums of a voxel."""
        self._rows[row, _TIMES] += time
        self._rows[row, _TIMES + 1] += time * (x - self._rows[row, _MIDDLE])
        self._rows[row, _TIMES + 2] += time * (y - self._rows[row, _MIDDLE + 1])
        self._rows[row, _TIMES + 3] += time * (z - self._rows[row, _MIDDLE + 2])
        self._rows[row, _TIMES + 4] += time * time

    def _fit(self, row: int) -> None:
        """Fit the plane of a voxel."""
        if not self._has_spots(row):
            return
        n = self._rows[row, _COUNT]
        mx = self._rows[row, _SUMS] / n
        my = self._rows[row, _SUMS + 1] / n
        mz = self._rows[row, _SUMS + 2] / n
        A = self._axes
        A[0, 0] = self._rows[row, _SUMS + 3] / n - mx * mx
        A[1, 1] = self._rows[row, _SUMS + 4] / n - my * my
        A[2, 2] = self._rows[row, _SUMS + 5] / n - mz * mz
        A[0, 1] = A[1, 0] = self._rows[row, _SUMS + 6] / n - mx * my
        A[0, 2] = A[2, 0] = self._rows[row, _SUMS + 7] / n - mx * mz
        A[1, 2] = A[2, 1] = self._rows[row, _SUMS + 8] / n - my * mz
        self._diagonalise()
        least = 0
        if A[1, 1] < A[least, least]:
            least = 1
        if A[2, 2] < A[least, least]:
            least = 2
        one = 0 if least else 1
        other = 1 if least == 2 else 2
        thick: float = max(A[least, least], _LEAST_VARIANCE) * n / (n - 3.0)
        expected = self._rows[row, _NOISE] / n
        # Few lasers reach one voxel: their biases do not average out as noise does
        # nor does what a surface is rough or curved by
        rough: float = max(thick - expected, 0.0)
        remaining: float = max(thick, expected) / n + self._bias_var / _LASERS + rough / _PATCHES
        # Noise is no extent: a ray that strikes the same spot again and again shows no plane
        first: float = remaining / max(A[one, one] - expected, _LEAST_VARIANCE)
        second: float = remaining / max(A[other, other] - expected, _LEAST_VARIANCE)
        is_plane = thick < self._thickest and max(first, second) < _LARGEST_SLOPE**2
        time = self._rows[row, _TIMES] / n
        self._rows[row, _TIME] = time
        tx = self._rows[row, _TIMES + 1] / n - time * mx
        ty = self._rows[row, _TIMES + 2] / n - time * my
        tz = self._rows[row, _TIMES + 3] / n - time * mz
        left: float = self._rows[row, _TIMES + 4] / n - time * time
        by_one: float = tx * A[3, one] + ty * A[4, one] + tz * A[5, one]
        left -= by_one * by_one / max(A[one, one], _LEAST_VARIANCE)
        by_one /= max(A[one, one] - expected, _LEAST_VARIANCE)
        by_other: float = tx * A[3, other] + ty * A[4, other] + tz * A[5, other]
        left -= by_other * by_other / max(A[other, other], _LEAST_VARIANCE)
        by_other /= max(A[other, other] - expected, _LEAST_VARIANCE)
        self._rows[row, _DRIFT] = _NONE
        if self._has_fans(row):
            self._rows[row, _DRIFT] = thick / (n * max(left, _LEAST_TIME))
        edge = self._size * (1 << (self._keys[row] & _LEVELS))
        for k in range(3):
            self._rows[row, _SWEEP + k] = by_one * A[3 + k, one] + by_other * A[3 + k, other]
            mean = self._rows[row, _SUMS + k] / n
            # A plane along a face has lost the points on its other side
            if abs(0.5 * edge - abs(mean)) < self._face and abs(A[3 + k, least]) > _ALONG_FACE:
                is_plane = False
            self._rows[row, _CENTRE + k] = self._rows[row, _MIDDLE + k] + mean
            self._rows[row, _NORMAL + k] = A[3 + k, least]
            self._rows[row, _ALONG + k] = sqrt(first) * A[3 + k, one]
            self._rows[row, _ALONG + 3 + k] = sqrt(second) * A[3 + k, other]
        self._rows[row, _OFFSET] = remaining
        self._rows[row, _SCATTER] = thick
        # At a point as far from the centre as they are on the average
        self._costs[row] = thick + 3.0 * remaining if is_plane else _NONE

    def _has_spots(self, row: int) -> bool:
        """Return whether a voxel was struck in enough places."""
        left = self._spots[row]
        for _ in range(_LEAST_SPOTS - 1):
            left &= left - 1
        return left != 0

    def _has_fans(self, row: int) -> bool:
        """Return whether rays had enough azimuths; two that are next to each other may be one."""
        seen = self._fans[row]
        count: int = 0
        while seen != 0:
            lowest = seen & -seen
            seen &= ~(3 * lowest)
            count += 1
        return count >= _LEAST_FANS

    def _diagonalise(self) -> None:
        """Rotate the first three rows of the axes to a diagonal; their columns go into the rest.

        Source: Golub and Van Loan 2013, "Matrix Computations", section 8.5 (Jacobi's method).
        """
        A = self._axes
        for i in range(3):
            for j in range(3):
                A[3 + i, j] = 1.0 if i == j else 0.0
        for _ in range(_SWEEPS):
            off = A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2]
            on = A[0, 0] * A[0, 0] + A[1, 1] * A[1, 1] + A[2, 2] * A[2, 2]
            if off <= _CONVERGED * on:
                break
            for p in range(2):
                for q in range(p + 1, 3):
                    if A[p, q] == 0.0:
                        continue
                    tau = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                    root = sqrt(1.0 + tau * tau)
                    t = 1.0 / (tau + root) if tau >= 0.0 else 1.0 / (tau - root)
                    c = 1.0 / sqrt(1.0 + t * t)
                    s = t * c
                    for k in range(6):
                        u = A[k, p]
                        v = A[k, q]
                        A[k, p] = c * u - s * v
                        A[k, q] = s * u + c * v
                    for k in range(3):
                        u = A[p, k]
                        v = A[q, k]
                        A[p, k] = c * u - s * v
                        A[q, k] = s * u + c * v

    def match(self, points_w: Array) -> Planes:
        """Match points with the plane of the voxel around each that predicts it best."""
        row = np.empty(len(points_w), dtype=np.int64)
        self.match_each(np.ascontiguousarray(points_w), row)
        index = np.flatnonzero(row >= 0)
        voxel = row[index]
        found = np.asarray(self._rows)[voxel]
        return Planes(
            index,
            found[:, _NORMAL:_CENTRE].copy(),
            found[:, _CENTRE:_ALONG].copy(),
            found[:, _ALONG:_OFFSET].copy().reshape(-1, 2, 3),
            found[:, _OFFSET:_TIME].copy(),
            found[:, _TIME].copy(),
            found[:, _SWEEP:_DRIFT].copy(),
            found[:, _DRIFT].copy(),
            np.asarray(self._owners)[voxel],
            voxel,
        )

    def match_each(self, points: Const[Table[np.float64]], row: Column[np.int64]) -> None:
        """Write the row of the voxel of least cost around each point, or -1."""
        for i in range(points.shape[0]):
            least: float = _NONE
            size: float = self._size
            row[i] = -1
            for level in range(self._levels):
                shift = _SHIFT * level
                key = _key(
                    cython.cast(cython.longlong, floor(points[i, 0] / size + shift)),
                    cython.cast(cython.longlong, floor(points[i, 1] / size + shift)),
                    cython.cast(cython.longlong, floor(points[i, 2] / size + shift)),
                    level,
                )
                found = self._slots[self._slot(key), 1]
                if found >= 0 and self._costs[found] < least:
                    least = self._costs[found]
                    row[i] = found
                size *= 2.0

    def forget_far(self, centre_w: Array, radius: float) -> None:
        """Forget the voxels beyond a radius."""
        x, y, z = centre_w.tolist()
        self.forget_each(x, y, z, radius * radius)

    def forget_each(self, x: float, y: float, z: float, square: float) -> None:
        """Do the work of :meth:`forget_far`."""
        for row in range(self.used - 1, -1, -1):
            key = self._keys[row]
            shift = _SHIFT * (key & _LEVELS)
            size = self._size * (1 << (key & _LEVELS))
            dx = (((key >> (2 * _BITS + _LEVEL_BITS)) & _MASK) - _HALF + 0.5 - shift) * size - x
            dy = (((key >> (_BITS + _LEVEL_BITS)) & _MASK) - _HALF + 0.5 - shift) * size - y
            dz = (((key >> _LEVEL_BITS) & _MASK) - _HALF + 0.5 - shift) * size - z
            if dx * dx + dy * dy + dz * dz >= square:
                self._remove(row)

    def forget_owner(self, owner: int) -> None:
        """Forget the voxels that are tied to an anchor."""
        for row in range(self.used - 1, -1, -1):
            if self._owners[row] == owner:
                self._remove(row)

    def _remove(self, row: int) -> None:
        """Forget a voxel; the last row takes its place."""
        last = self._slots.shape[0] - 1
        free: int = self._slot(self._keys[row])
        at: int = (free + 1) & last
        # What was put behind it for want of a place moves up
        while self._slots[at, 1] >= 0:
            home = _hash(self._slots[at, 0]) & last
            if ((at - home) & last) >= ((at - free) & last):
                self._slots[free, 0], self._slots[free, 1] = self._slots[at, 0], self._slots[at, 1]
                free = at
            at = (at + 1) & last
        self._slots[free, 1] = -1
        self.used -= 1
        if row == self.used:
            return
        self._slots[self._slot(self._keys[self.used]), 1] = row
        self._keys[row], self._owners[row] = self._keys[self.used], self._owners[self.used]
        self._costs[row], self._marks[row] = self._costs[self.used], self._marks[self.used]
        self._spots[row] = self._spots[self.used]
        self._fans[row] = self._fans[self.used]
        for column in range(_WIDTH):
            self._rows[row, column] = self._rows[self.used, column]

    def _make_room(self, size: int) -> None:
        """Let so many voxels be made."""
        if size <= len(self._keys):
            return
        size = max(size, 2 * self.used)
        before = self._columns()
        self._rows = np.zeros((size, _WIDTH))
        self._keys, self._owners = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
        self._costs, self._marks = np.zeros(size), np.zeros(size, dtype=np.int64)
        self._spots = np.zeros(size, dtype=np.int64)
        self._fans = np.zeros(size, dtype=np.int64)
        for new, old in zip(self._columns(), before, strict=True):
            new[: self.used] = old[: self.used]
        self._changed = np.zeros(size, dtype=np.int64)
        self._slots = np.full((1 << (2 * size).bit_length(), 2), -1, dtype=np.int64)
        self.place_each()

    def _columns(self) -> list[Any]:
        """Return what is kept of each voxel."""
        columns = [np.asarray(self._rows), np.asarray(self._costs), np.asarray(self._keys)]
        columns += [np.asarray(self._owners), np.asarray(self._marks), np.asarray(self._spots)]
        columns.append(np.asarray(self._fans))
        return columns

    def place_each(self) -> None:
        """Put all voxels to their places, which are free."""
        for row in range(self.used):
            at = self._slot(self._keys[row])
            self._slots[at, 0], self._slots[at, 1] = self._keys[row], row

    def owners(self) -> set[int]:
        """Return the anchors that voxels are tied to."""
        return set(np.flatnonzero(np.bincount(np.asarray(self._owners)[: self.used])).tolist())

    def points(self) -> Array:
        """Return the mean of the points of each smallest voxel, m, shape (n, 3)."""
        rows = np.asarray(self._rows)[: self.used]
        smallest = rows[np.asarray(self._keys)[: self.used] & _LEVELS == 0]
        return np.asarray(
            smallest[:, _MIDDLE:_COUNT] + smallest[:, _SUMS : _SUMS + 3] / smallest[:, [_COUNT]]
        )


def _fans(points: Array) -> Indices:
    """Return the bit of the azimuth of each point in the lidar's frame, shape (n,)."""
    cell = np.floor(np.arctan2(points[:, 1], points[:, 0]) / _FAN).astype(np.int64)
    return np.asarray(np.int64(1) << (cell % _PLACES))


def _key(i: int, j: int, k: int, level: int) -> int:
    """Return the number of a cell; cells that are 131 km apart have the same."""
    i, j, k = (i + _HALF) & _MASK, (j + _HALF) & _MASK, (k + _HALF) & _MASK
    return (((((i << _BITS) | j) << _BITS) | k) << _LEVEL_BITS) | level


def _hash(key: int) -> int:
    """Return a number of a cell that neighbours do not have in its last digits."""
    h = ((key >> (2 * _BITS + _LEVEL_BITS)) & _MASK) * 73856093
    h = h ^ (((key >> (_BITS + _LEVEL_BITS)) & _MASK) * 19349663)
    h = h ^ (((key >> _LEVEL_BITS) & _MASK) * 83492791)
    h = h ^ ((key & _LEVELS) * 40503)
    return h ^ (h >> 15)
