"""Relative poses with their covariance: what an odometry shows best.

The pose that the next relative one counts from is marked: its errors stay in the covariance beside
those of the present one, and what both have in common leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.state import ATT, MOUNT_ATT, MOUNT_POS, POS, POSE, VEL, N, State
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.so3 import skew

MARKED = slice(N, N + POSE)
"""Errors of the marked pose in the covariance."""
POSES = np.concatenate([np.arange(POSE), np.arange(N, N + POSE)])
"""Those of the present and of the marked one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RelativePose:
    """Pose of the body at one time in the body at another."""

    start: float
    end: float
    C: Array
    pos: Array
    P: Array
    """Of position (body at the start) and attitude (rotation vector in the body at the end)."""


class Marked:
    """The pose that the next relative one counts from; its errors stay in the covariance."""

    def __init__(self, spacing: float, alignment: float = 0.0) -> None:
        """Begin without one; ``spacing``: between two, s; ``alignment``: see ``Odometry``."""
        self._spacing, self._alignment = spacing, alignment
        self._at: tuple[float, State] | None = None

    @property
    def is_none(self) -> bool:
        """Return whether none is marked yet: the first pose is the world."""
        return self._at is None

    def travelled(self, stamp: float, x: State, P: Array) -> RelativePose | None:
        """Return the present pose relative to the marked one; None: none is."""
        if self._at is None:
            return None
        return relative_pose(*self._at, stamp, x, P, self._alignment)

    def as_exact(self, x: State, P: Array) -> Array:
        """Return the covariance of the marked pose as if the present one were exact, (6, 6)."""
        if self._at is None:
            return np.zeros((POSE, POSE))
        J = by_poses(self._at[1], x)
        to_marked = np.linalg.solve(J[:, POSE:], J)
        return np.asarray(to_marked @ P[np.ix_(POSES, POSES)] @ to_marked.T)

    def renew(self, stamp: float, x: State, P: Array) -> bool:
        """Mark the pose, in P too, where the marked one is old enough; return whether it is."""
        if self._at is not None and stamp - self._at[0] < self._spacing - 0.01:
            return False
        P[MARKED] = P[:POSE]
        P[:, MARKED] = P[:, :POSE]
        self._at = stamp, x
        return True


def relative_pose(
    start: float, then: State, end: float, x: State, P: Array, alignment: float
) -> RelativePose:
    """Return the present pose relative to a marked one.

    Args:
        start: Of the marked pose, s.
        then: The state there.
        end: Of the present pose, s.
        x: The present state.
        P: Of its error state, and from N on of the marked pose.
        alignment: Sigma of the body's axes relative to the gyro's, rad.
    """
    C = then.C_wb.T @ x.C_wb
    pos = then.C_wb.T @ (x.pos_w - then.pos_w)
    J = by_poses(then, x)
    P = J @ P[np.ix_(POSES, POSES)] @ J.T
    turned = np.vstack([skew(pos), np.eye(3) - C.T])
    P += alignment**2 * square(turned)
    return RelativePose(start=start, end=end, C=C, pos=pos, P=0.5 * (P + P.T))


def by_poses(then: State, x: State) -> Array:
    """Return the derivative of a relative pose by the errors of the later and the earlier pose."""
    C = then.C_wb.T @ x.C_wb
    J = np.zeros((POSE, 2 * POSE))
    J[:3, POS] = then.C_wb.T
    J[:3, 9:12] = -then.C_wb.T
    J[:3, 6:9] = skew(then.C_wb.T @ (x.pos_w - then.pos_w))
    J[3:, ATT] = np.eye(3)
    J[3:, 6:9] = -C.T
    return J


def by_axes(x: State) -> Array:
    """Return the derivative of the error state by a rotation of the body's axes, (27, 3).

    The world is the body at the first pose, and turns with them.
    """
    J = np.zeros((N, 3))
    J[ATT] = np.eye(3) - x.C_wb.T
    J[POS], J[VEL] = skew(x.pos_w), skew(x.vel_w)
    J[MOUNT_ATT], J[MOUNT_POS] = -x.C_bl.T, skew(x.pos_b)
    return J


def square(J: Array) -> Array:
    """Return a matrix times its transpose."""
    return np.asarray(J @ J.T)
