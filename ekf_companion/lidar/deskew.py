"""Points of a scan in w, each from where the body was at its own time.

A point depends on the state at the end of the scan, and on what the path before it was made of:
velocity, gyro bias, mounting and delay. The derivatives by all of them are rows of the update.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.motion import Path
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
    """Body at the point's time to body at the end, shape (n, 3, 3)."""
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

    def levers(self, x: State) -> Array:
        """Return the points from the body at the end, rotated only, m, in b, shape (n, 3)."""
        b = self.points @ x.C_bl.T + x.pos_b
        bias = x.gyro_bias - self.prior.gyro_bias
        if bias.any():
            b = b + self.before[:, None] * np.cross(bias, b)
        return np.asarray(np.einsum("nij,nj->ni", self.turn, b))

    def in_w(self, x: State) -> Array:
        """Return the points in w at a state, m, shape (n, 3)."""
        y = self.levers(x)
        q = y @ x.C_wb.T + self.moved_w + x.pos_w
        q -= self.before[:, None] * (x.vel_w - self.prior.vel_w)
        if late := x.delay - self.prior.delay:
            q += late * (x.vel_w + np.cross(self.rate_b, y) @ x.C_wb.T)
        return np.asarray(q)

    def derivatives(self, x: State, normal: Array, *, has_mounting: bool) -> Array:
        """Return the derivative of normal' q by the error state's seen part, shape (n, 12 or 19).

        Attitude, position, velocity, gyro bias; then, if asked, mounting and delay.
        """
        y = self.levers(x)
        n_b = normal @ x.C_wb
        H = np.empty((len(normal), 19 if has_mounting else 12))
        H[:, 0:3] = np.cross(y, n_b)
        H[:, 3:6] = normal
        H[:, 6:9] = -self.before[:, None] * normal
        n_there = np.einsum("nji,nj->ni", self.turn, n_b)
        b = self.points @ x.C_bl.T + x.pos_b
        H[:, 9:12] = self.before[:, None] * np.cross(b, n_there)
        if has_mounting:
            H[:, 12:15] = np.cross(self.points, n_there @ x.C_bl)
            H[:, 15:18] = n_there
            H[:, 18] = normal @ x.vel_w + np.einsum("ni,ni->n", n_b, np.cross(self.rate_b, y))
        return H


def deskew(points: Array, stamp: Array, path: Path, end: State, prior: State) -> Deskewed:
    """Find the motion from each point, at its time on the inertial clock, to the end of a path.

    ``end`` is the state there in the path's frame; ``prior`` the same one in w.
    """
    C, pos = path.at(stamp)
    to_w = prior.C_wb @ end.C_wb.T
    return Deskewed(
        points,
        path.stamp[-1] - stamp,
        end.C_wb.T @ C,
        (pos - end.pos_w) @ to_w.T,
        prior,
        path.rate_b[-1],
    )
