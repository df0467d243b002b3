"""Points of a scan in w, each from where the body was at its own time.

A point depends on the state at the end of the scan, and on what the path before it was made of:
velocity, gyro bias, mounting and delay. The derivatives by all of them are rows of the update.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar import loops
from ekf_companion.lidar.motion import Path
from ekf_companion.lidar.pose import pack
from ekf_companion.lidar.state import State
from ekf_companion.nav.arrays import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class Deskewed:
    """Points of one scan, and the motion of the body from each to the end of the scan."""

    points: Array
    """m, in the lidar's frame, shape (n, 3)."""
    before: Array
    """Time from each point to the end, s, shape (n,)."""
    turn: Array
    """Body at the point's time to body at the end, shape (n, 9)."""
    moved_w: Array
    """Position at the point's time less that at the end, m, shape (n, 3)."""
    prior: State
    """By which they were computed."""
    rate_b: Array
    """At the end, rad/s."""

    def chosen(self, index: Indices) -> Deskewed:
        """Return some of the points."""
        return Deskewed(
            self.points[index],
            self.before[index],
            self.turn[index],
            self.moved_w[index],
            self.prior,
            self.rate_b,
        )

    def placed(self, x: State) -> tuple[Array, Array]:
        """Return the points from the body at the end, rotated only, in b, and in w, m, (n, 3)."""
        y, q = np.empty(self.points.shape), np.empty(self.points.shape)
        loops.place(self.points, self.before, self.turn, self.moved_w, self.pose(x), y, q)
        return y, q

    def pose(self, x: State) -> Array:
        """Return a state as the loops over points take it."""
        return pack(x, self.prior, self.rate_b)

    def derivatives(self, x: State, normal: Array, *, has_mounting: bool) -> Array:
        """Return the derivative of normal' q by the error state's seen part, shape (n, 18 or 25).

        Attitude, position, velocity, gyro bias; then, if asked, mounting and delay; at the end
        shift and rotation of the scan as a whole about the body, in w.
        """
        y, q = self.placed(x)
        return self.rows(x, y, q, normal, has_mounting=has_mounting)

    def rows(self, x: State, y: Array, q: Array, normal: Array, *, has_mounting: bool) -> Array:
        """Return the same of points that were placed."""
        made = np.empty((len(normal), 25 if has_mounting else 18))
        loops.differentiate(self.points, self.before, self.turn, y, q, normal, self.pose(x), made)
        return made


def deskew(points: Array, stamp: Array, path: Path, end: State, prior: State) -> Deskewed:
    """Find the motion from each point, at its time on the inertial clock, to the end of a path.

    ``end`` is the state there in the path's frame; ``prior`` the same one in w.
    """
    turn, pos = path.at(stamp, end.C_wb.T)
    to_w = prior.C_wb @ end.C_wb.T
    return Deskewed(
        np.ascontiguousarray(points, dtype=np.float64),
        path.stamp[-1] - stamp,
        turn,
        np.ascontiguousarray((pos - end.pos_w) @ to_w.T),
        prior,
        # Of the last half, as samples vibrate
        path.rate_b[len(path.rate_b) // 2 :].mean(axis=0),
    )
