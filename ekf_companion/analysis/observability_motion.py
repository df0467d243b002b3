"""How a flight moved, as far as motion tells biases from tilt: turns, tilts, accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

PERIOD_NS = 50_000_000
"""From one note on the motion to the next: a vehicle that turns faster than 10 times a second is
none."""
TURN = float(np.radians(20.0))
"""Least change of the heading that is a turn, rad: a level bias then goes a third of itself
elsewhere."""
TILT = float(np.radians(5.0))
"""Least change of roll and pitch that counts, rad: a tenth of a level bias goes into the vertical.
"""
ACCELERATION = 0.5
"""Least horizontal acceleration that counts, m/s^2; by less a wrong level may seem to accelerate.
"""


SETTLING = 2.0
"""Length of what the filter says of accelerations at its start and is not believed, s."""
QUIET = 5.0
"""Least length of a stretch that is called straight and steady, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motion:
    """The motion by the filter's estimate, about every 0.05 s."""

    t: Array
    """s after the first inertial sample."""
    yaw: Array
    """Unwrapped, rad."""
    tilt: Array
    """Angle between what is down in b now and at the start, rad."""
    speed: Array
    """Horizontal, m/s."""
    acceleration: Array
    """Horizontal, mean over the second before, m/s^2."""

    def until(self, t: float) -> tuple[float, float, float]:
        """Give by how much heading and tilt changed until then, rad, and the acceleration."""
        rows = self.t <= t + 1e-6
        if not rows.any():
            return 0.0, 0.0, 0.0
        yaw = self.yaw[rows]
        return (
            float(np.ptp(yaw)),
            float(self.tilt[rows].max()),
            float(self.acceleration[rows].max()),
        )

    def onsets(self) -> dict[str, float]:
        """Give when each kind of motion first was there, s; inf: never."""
        turned = np.maximum.accumulate(self.yaw) - np.minimum.accumulate(self.yaw)
        # In its first seconds a filter that finds its level seems to accelerate
        pushed = (self.acceleration >= ACCELERATION) & (self.t >= self.t[0] + SETTLING)
        # The mean of an acceleration is late by what it is the mean over
        first = float(self.t[np.argmax(pushed)]) if pushed.any() else np.inf
        return {
            "turn": self._begin_of(turned >= TURN, self._changes(self.yaw, TURN)),
            "change of tilt": self._begin_of(self.tilt >= TILT, self._changes(self.tilt, TILT)),
            "horizontal acceleration": first - 1.0,
        }

    def quiet_before(self, t: float) -> tuple[float, float] | None:
        """Give when the last straight and steady stretch before a time began and ended, s.

        It neither accelerates nor changes its heading as :meth:`onsets` says.
        """
        is_quiet = ~self._changes(self.yaw, TURN) & (self.acceleration < ACCELERATION)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_quiet.astype(int), [0]])))
        stretches = [
            (float(self.t[first]), float(self.t[end - 1]))
            for first, end in edges.reshape(-1, 2)
            if self.t[end - 1] - self.t[first] >= QUIET and self.t[end - 1] < t
        ]
        return stretches[-1] if stretches else None

    def _changes(self, angle: Array, much: float) -> npt.NDArray[np.bool_]:
        """Say where an angle changes: in the 3 s about it, by a quarter of what is much."""
        ends = [
            np.clip(np.searchsorted(self.t, self.t + shift), 0, len(self.t) - 1)
            for shift in (-1.5, 1.5)
        ]
        return np.asarray(np.abs(angle[ends[1]] - angle[ends[0]]) >= 0.25 * much)

    def _begin_of(
        self, is_there: npt.NDArray[np.bool_], is_changing: npt.NDArray[np.bool_]
    ) -> float:
        """Give when the change began that at last is there."""
        if not is_there.any():
            return np.inf
        k = int(np.argmax(is_there))
        before = np.flatnonzero(~is_changing[: k + 1])
        return float(self.t[before[-1] if len(before) else 0])


class Track:
    """Collects the motion."""

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._q_nb: list[Array] = []
        self._vel_n: list[Array] = []
        self._driven: list[Array] = []
        self._sum = np.zeros(3)

    def drive(self, change_n: Array) -> None:
        """Take what the specific force adds to the velocity, m/s."""
        self._sum = self._sum + change_n

    def add(self, t_ns: int, state: Nominal) -> None:
        """Take an estimate."""
        if not self._t_ns or t_ns - self._t_ns[-1] >= PERIOD_NS:
            self._t_ns.append(t_ns)
            self._q_nb.append(state.q_nb)
            self._vel_n.append(state.vel_n)
            self._driven.append(self._sum)

    def motion(self, zero_ns: int) -> Motion:
        """Give what was collected, by times after another."""
        t = (np.array(self._t_ns) - zero_ns) * 1e-9
        C_nb = so3.to_matrix(np.array(self._q_nb))
        down = np.clip(C_nb[:, 2] @ C_nb[0, 2], -1.0, 1.0)
        vel_n = np.array(self._vel_n)
        before = np.searchsorted(t, t - 1.0 - 1e-6)
        # In the first second, the mean over it
        after = np.maximum(np.arange(len(t)), min(np.searchsorted(t, t[0] + 1.0), len(t) - 1))
        spans = np.maximum(t[after] - t[before], 1.0)
        # Neither a step that a fix corrects nor a wrong level is an acceleration: both must say so
        told = [
            np.linalg.norm((v[after] - v[before])[:, :2], axis=1) / spans
            for v in (vel_n, np.array(self._driven))
        ]
        return Motion(
            t=t,
            yaw=np.unwrap(np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0])),
            tilt=np.arccos(down),
            speed=np.linalg.norm(vel_n[:, :2], axis=1),
            acceleration=np.minimum(*told),
        )
