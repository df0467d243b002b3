"""The local map, and the errors of its parts in the covariance.

A part is put in over one second, and has an anchor: an error of its own, six states after those of
the present and of the marked pose. The number of voxels and of anchors is bounded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ekf_companion.lidar.deskew import Deskewed
from ekf_companion.lidar.rows import noise_of_points
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import POSE, N, State
from ekf_companion.lidar.update import Anchor, first, shift_by_state
from ekf_companion.lidar.voxel_map import VoxelMap
from ekf_companion.nav.arrays import Array

FIRST_PART = 3.0
"""Time over which the first part of the map is put in, of that of the others, after a start in
motion: what one second shows between trees holds nothing by itself."""


class LocalMap:
    """Planes of the surroundings, and the anchors that they are tied to."""

    def __init__(self, settings: Settings, *, is_moving: bool = False) -> None:
        """Begin without voxels; ``is_moving``: the vehicle is in motion."""
        self.settings, self._is_moving = settings, is_moving
        self.voxels = VoxelMap(settings)
        self.anchors: list[Anchor] = []
        self._usage: dict[int, float] = {}
        self._count = 0
        self._begin: float | None = None
        """Stamp of the first scan, s, lidar clock."""

    def time_of(self, stamp: float) -> float:
        """Return the time since the first scan, s."""
        return 0.0 if self._begin is None else stamp - self._begin

    def note(self, usage: dict[int, float]) -> None:
        """Take into account which share each anchor had in an update."""
        for number, share in usage.items():
            self._usage[number] = self._usage.get(number, 0.0) * 0.9 + 0.1 * share

    def insert(self, scan: Deskewed, x: State, P: Array, stamp: float) -> Array:
        """Put in the points of a scan at a state; return the covariance with the anchors' errors.

        Args:
            scan: The points.
            x: State at the end of the scan.
            P: Of its error state, of the marked pose and of the anchors.
            stamp: s, lidar clock.
        """
        if self.settings.anchors == 0:
            self._forget_far(x.pos_w)
            self._put(scan, x, 0, stamp)
            return P
        if self.settings.is_scan_to_scan and len(scan.points):
            self.voxels = VoxelMap(self.settings)
            self.anchors, self._usage = [], {}
            P = P[: first(0), : first(0)]
        if not self.anchors or stamp - self.anchors[-1].stamp > self._part() - 0.01:
            P = self._begin_anchor(x, P, stamp)
        if not len(scan.points):
            return P
        # The error of this part is the mean of those of the states by which it was made
        k = len(self.anchors) - 1
        T = shift_by_state(x, self.anchors[k].about_w, scan.rate_b)
        self._put(scan, x, self.anchors[k].number, stamp)
        count = self.anchors[k].scans + 1
        share = 1.0 / count
        P, at = P.copy(), slice(first(k), first(k + 1))
        P[at] += share * (T @ P[:N] - P[at])
        P[:, at] += share * (P[:, :N] @ T.T - P[:, at])
        time = self.time_of(stamp) - self.anchors[k].time
        self.anchors[k] = replace(
            self.anchors[k], scans=count, time=self.anchors[k].time + share * time
        )
        return P

    def _part(self) -> float:
        """Return how long the part of the map that is being made is put in, s."""
        is_first = len(self.anchors) == 1
        return self.settings.spacing * (FIRST_PART if is_first and self._is_moving else 1.0)

    def _put(self, scan: Deskewed, x: State, owner: int, stamp: float) -> None:
        """Put the points of a scan into the map where the state says they are."""
        variance = noise_of_points(scan.points, self.settings)
        if self._begin is None:
            self._begin = stamp
        time = self.time_of(stamp) - scan.before
        self.voxels.insert(scan.placed(x)[1], variance, time, owner, scan.points)

    def _begin_anchor(self, x: State, P: Array, stamp: float) -> Array:
        """Begin another part of the map, whose error is not that of the ones before."""
        n = len(P)
        wider = np.zeros((n + POSE, n + POSE))
        wider[:n, :n] = P
        self.anchors.append(Anchor(self._count, stamp, x.pos_w))
        self._usage[self._count] = 1.0
        self._count += 1
        self._forget_far(x.pos_w)
        return self._drop_anchors(wider)

    def _forget_far(self, pos_w: Array) -> None:
        """Keep the map within its radius and its number of voxels."""
        radius = self.settings.map_radius
        self.voxels.forget_far(pos_w, radius)
        while len(self.voxels) > self.settings.most_voxels:
            radius *= 0.8
            self.voxels.forget_far(pos_w, radius)

    def _drop_anchors(self, P: Array) -> Array:
        """Forget the anchors that no plane is tied to and those that are used least."""
        owned = self.voxels.owners()
        last = self.anchors[-2:]
        gone = [one for one in self.anchors if one.number not in owned and one not in last]
        most = max(self.settings.anchors, 2)
        rest = [one for one in self.anchors if one not in gone and one not in last]
        rest.sort(key=lambda one: self._usage[one.number])
        gone += rest[: max(len(self.anchors) - len(gone) - most, 0)]
        for one in gone:
            k = self.anchors.index(one)
            columns = slice(first(k), first(k + 1))
            P = np.delete(np.delete(P, columns, 0), columns, 1)
            del self.anchors[k], self._usage[one.number]
            if one.number in owned:
                self.voxels.forget_owner(one.number)
        return P
