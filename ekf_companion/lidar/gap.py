"""What is known after a time without inertial samples, and without points or long.

Tilt and velocity are found anew, by the motion over the second that follows. Heading and position
are those before it, with an error that grows by what a vehicle does meanwhile: the place in the map
is sought again (:mod:`ekf_companion.lidar.relocation`), or another map begins there, and that error
is kept apart, as of all poses since then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.motion import GAP, Samples
from ekf_companion.lidar.recording import Scan
from ekf_companion.lidar.state import ATT, DOWN, POS, POSE, VEL, N, State
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import basis, direction_by_angles, direction_minus
from ekf_companion.nav.so3 import skew

LONGEST = 0.2
"""Without points, too, the time after which the nearest pose that fits may be another, s: one sigma
of what a vehicle does meanwhile is 0.3 m. After 0.4 s a street was lost; live, a run ends then."""
ALONE = 0.7
"""Time through which points alone show the turns, s: of 9 gaps of the samples alone of up to 0.6 s
none was lost, of 20 of 0.8 to 5 s five were, one by kilometres at a sigma of hundreds of metres."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """A time without inertial samples, longer than what follows can be placed by."""

    start: float
    """s, lidar clock."""
    end: float
    is_found: bool
    """Whether the place in the map was found again."""


@dataclass(frozen=True, slots=True, eq=False)
class Lost:
    """The error of a pose at which another map began: of all poses since then."""

    C_wb: Array
    pos_w: Array
    P: Array
    """Of attitude and position, shape (6, 6)."""

    def added(self, x: State, P: Array) -> Array:
        """Return the covariance of a state with this error, shape (27, 27)."""
        J = np.zeros((N, POSE))
        J[ATT, ATT] = x.C_wb.T @ self.C_wb
        J[POS, ATT] = -skew(x.pos_w - self.pos_w) @ self.C_wb
        J[VEL, ATT] = -skew(x.vel_w) @ self.C_wb
        J[POS, POS] = np.eye(3)
        return np.asarray(P[:N, :N] + J @ self.P @ J.T)


def later(scan: Scan, begin: float) -> Scan:
    """Return the part of a scan from a time on, s, lidar clock."""
    if scan.stamp >= begin:
        return scan
    kept = scan.stamp + scan.times >= begin
    return Scan(begin, scan.points[kept], scan.times[kept] + (scan.stamp - begin))


def turn_between(a: Array, b: Array) -> Array:
    """Return the shortest rotation vector that turns one unit vector to another."""
    return np.asarray(basis(a) @ direction_minus(b, a))


def joined(C: Array, motion: State, down_w: Array) -> tuple[Array, Array]:
    """Return derivatives of the error state by that before and by that of a motion, (27, 27).

    The heading and the position are as they were; tilt and velocity are those of the motion, which
    was found in the body's axes, where gravity is as it is in w.
    """
    n, T, M = motion.down_w, np.eye(N), np.zeros((N, N))
    T[ATT, ATT] = np.outer(n, n)
    T[ATT, DOWN] = skew(n) @ C.T @ direction_by_angles(down_w)
    M[ATT, DOWN] = -skew(n) @ direction_by_angles(n)
    by_att = -C @ skew(motion.vel_w)
    T[VEL] = by_att @ T[ATT]
    M[VEL] = by_att @ M[ATT]
    M[VEL, VEL] += C
    return T, M


def resumption(samples: Samples, start: float, end: float) -> float | None:
    """Return when samples go on after the last gap between two times; None: there is none.

    A gap counts if it is longer between them than an update can bridge, or than points alone can.
    """
    first, last = np.searchsorted(samples.stamp, [start, end], side="right")
    t = samples.stamp[max(first - 1, 0) : last + 1]
    length = np.minimum(t[1:], end) - np.maximum(t[:-1], start)
    step = np.diff(t)
    is_gap = (step > GAP * samples.step) & (length > 0.0)
    gaps = np.flatnonzero(is_gap & ((length > LONGEST) | (step > ALONE)))
    return float(t[gaps[-1] + 1]) if len(gaps) else None
