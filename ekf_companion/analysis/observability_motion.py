"""The motion of a flight as far as it separates biases from tilt: turns, tilts, accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, runs

PERIOD_NS = 50_000_000
"""Period of the recorded motion: no vehicle turns faster than 10 times a second."""
TURN = float(np.radians(20.0))
"""Least change of the heading that is a turn, rad: it moves a third of a level bias to the other
horizontal axis."""
TILT = float(np.radians(5.0))
"""Least change of roll and pitch that counts, rad: it moves a tenth of a level bias upright."""
ACCELERATION = 0.5
"""Least horizontal acceleration that counts, m/s^2; a wrong level may look like a smaller one."""
SETTLING = 2.0
"""Time from the filter's start in which its accelerations do not count, s."""
QUIET = 5.0
"""Least length of a straight and steady stretch, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motion:
    """The motion by the filter's estimate, about every 0.05 s."""

    t: Array
    """s after the first inertial sample."""
    yaw: Array
    """Unwrapped, rad."""
    tilt: Array
    """Angle in b between down now and down at the start, rad."""
    speed: Array
    """Horizontal, m/s."""
    acceleration: Array
    """Horizontal, mean over the last second, m/s^2."""

    def until(self, t: float) -> tuple[float, float, float]:
        """Return the largest changes of heading and tilt until then, rad, and acceleration."""
        rows = self.t <= t + 1e-6
        if not rows.any():
            return 0.0, 0.0, 0.0
        tilt, acceleration = self.tilt[rows].max(), self.acceleration[rows].max()
        return float(np.ptp(self.yaw[rows])), float(tilt), float(acceleration)

    def onsets(self) -> dict[str, float]:
        """Return when each kind of motion first began, s; inf: never."""
        turned = np.maximum.accumulate(self.yaw) - np.minimum.accumulate(self.yaw)
        # A filter that corrects its level at the start seems to accelerate
        pushed = (self.acceleration >= ACCELERATION) & (self.t >= self.t[0] + SETTLING)
        # The mean over a second lags the onset by that second
        first = float(self.t[np.argmax(pushed)]) if pushed.any() else np.inf
        return {
            "turn": self._begin_of(turned >= TURN, self._changes(self.yaw, TURN)),
            "change of tilt": self._begin_of(self.tilt >= TILT, self._changes(self.tilt, TILT)),
            "horizontal acceleration": first - 1.0,
        }

    def quiet_before(self, t: float) -> tuple[float, float] | None:
        """Return begin and end of the last straight and steady stretch before a time, s.

        Its acceleration and its changes of heading are below the limits of :meth:`onsets`.
        """
        is_quiet = ~self._changes(self.yaw, TURN) & (self.acceleration < ACCELERATION)
        stretches = [
            (float(self.t[first]), float(self.t[end - 1]))
            for first, end in runs(is_quiet)
            if self.t[end - 1] - self.t[first] >= QUIET and self.t[end - 1] < t
        ]
        return stretches[-1] if stretches else None

    def _changes(self, angle: Array, much: float) -> Mask:
        """Return where an angle changes by a quarter of ``much`` within the 3 s around."""
        ends = [
            np.clip(np.searchsorted(self.t, self.t + shift), 0, len(self.t) - 1)
            for shift in (-1.5, 1.5)
        ]
        return np.asarray(np.abs(angle[ends[1]] - angle[ends[0]]) >= 0.25 * much)

    def _begin_of(self, is_there: Mask, is_changing: Mask) -> float:
        """Return when the change began that first reached its limit."""
        if not is_there.any():
            return np.inf
        k = int(np.argmax(is_there))
        before = np.flatnonzero(~is_changing[: k + 1])
        return float(self.t[before[-1] if len(before) else 0])


class MotionRecorder:
    """Collects the motion, estimate by estimate."""

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._q_nb: list[Array] = []
        self._vel_n: list[Array] = []
        self._by_force: list[Array] = []
        self._sum = np.zeros(3)

    def add_specific_force(self, change_n: Array) -> None:
        """Add the change of velocity by the specific force, m/s."""
        self._sum = self._sum + change_n

    def add(self, t_ns: int, state: Nominal) -> None:
        """Add an estimate."""
        if not self._t_ns or t_ns - self._t_ns[-1] >= PERIOD_NS:
            self._t_ns.append(t_ns)
            self._q_nb.append(state.q_nb)
            self._vel_n.append(state.vel_n)
            self._by_force.append(self._sum)

    def motion(self, zero_ns: int) -> Motion:
        """Return the motion with times relative to another, ns."""
        t = (np.array(self._t_ns) - zero_ns) * 1e-9
        C_nb = so3.to_matrix(np.array(self._q_nb))
        down = np.clip(C_nb[:, 2] @ C_nb[0, 2], -1.0, 1.0)
        vel_n = np.array(self._vel_n)
        before = np.searchsorted(t, t - 1.0 - 1e-6)
        # In the first second, the mean over it
        after = np.maximum(np.arange(len(t)), min(np.searchsorted(t, t[0] + 1.0), len(t) - 1))
        spans = np.maximum(t[after] - t[before], 1.0)
        # A correction by a fix changes one of the two only, a wrong level the other: take the less
        means = [
            np.linalg.norm((v[after] - v[before])[:, :2], axis=1) / spans
            for v in (vel_n, np.array(self._by_force))
        ]
        return Motion(
            t=t,
            yaw=np.unwrap(np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0])),
            tilt=np.arccos(down),
            speed=np.linalg.norm(vel_n[:, :2], axis=1),
            acceleration=np.minimum(*means),
        )
