"""A position controller on the autopilot's estimate, with ArduCopter's EKF failsafe.

Position, velocity and acceleration are cascaded as in ArduCopter, with its gains. A reset of the
estimate moves the target along in a mode where a pilot holds the stick (LOITER: the vehicle stays
where it is), and not in one that flies to positions (AUTO, GUIDED, RTL: the vehicle goes there).

Sources: ArduPilot, ``AC_PosControl`` (PSC_*, ``NE_handle_ekf_reset``), ``ekf_check.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array
from sim_autopilot.follower import Motion
from sim_autopilot.navigator import CRITICAL, Navigator

_POSITION_GAIN = np.array([1.0, 1.0, 1.0])
"""1/s (PSC_NE_POS_P, PSC_D_POS_P)."""
_VELOCITY_GAIN = np.array([2.0, 2.0, 5.0])
"""1/s (PSC_NE_VEL_P, PSC_D_VEL_P)."""
_INTEGRAL_GAIN = np.array([1.0, 1.0, 1.0])
"""1/s^2 (PSC_NE_VEL_I; down assumed)."""
_MOST_INTEGRAL = 2.0
"""m/s^2."""
_MOST_ACCEL = np.array([4.0, 4.0, 4.0])
"""m/s^2."""
_LANDING, _BLIND_LANDING = 0.7, 0.5
"""m/s down."""
_IDLE = np.array([0.0, 0.0, 20.0])
"""The motors are off."""
_ARRIVED, _SLOW = 0.5, 0.5
"""Distance, m, and speed, m/s, at which home is reached."""
_CHECK = 0.1
"""s."""
_MOST_FAILS, _LANE = 10, 9
_THRESHOLD = 0.8
"""FS_EKF_THRESH."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """Output of the controller."""

    accel_n: Array
    """m/s^2."""
    yaw: float
    """rad."""


class Pilot:
    """Takes off, holds, flies to positions and returns home."""

    def __init__(self, navigator: Navigator) -> None:
        """Stand disarmed."""
        self.own = navigator
        self.mode = "DISARMED"
        """DISARMED, GUIDED, LOITER, RTL, LAND (blind, by a failsafe)."""
        self.target_n = np.zeros(3)
        """In the autopilot's metres."""
        self.speed = 5.0
        """m/s, over ground at most."""
        self.climb = 2.0
        """m/s at most, up and down."""
        self._sum = np.zeros(3)
        self._shift_n = np.zeros(3)
        self._check_t = self._fails = 0.0
        self._is_bad = self._has_passed = False
        self._lane = 0

    def arm(self) -> None:
        """Set home to the present position, and hold there."""
        self.own.set_home()
        self.target_n, self.mode = self.own.motion().pos_n.copy(), "GUIDED"
        self._shift_n = self.own.shift_n.copy()

    def go(self, north: float, east: float, height: float) -> None:
        """Fly to a position: metres from home, by the estimate."""
        assert self.own.home is not None
        self.target_n, self.mode = self.own.home + np.array([north, east, -height]), "GUIDED"

    def loiter(self) -> None:
        """Hold the true position, as a pilot does who does not use the estimate."""
        self.mode = "LOITER"

    def return_home(self) -> None:
        """Fly home at this height, and land there."""
        self.mode = "RTL"

    def demand(self, dt: float, motion: Motion, *, is_landed: bool) -> Demand:
        """Return the demand for a time step, by the present estimate."""
        self._watch(motion.t)
        moved_n, self._shift_n = self.own.shift_n - self._shift_n, self.own.shift_n.copy()
        if self.mode == "LOITER":
            self.target_n = self.target_n + moved_n
        if self.mode == "DISARMED":
            return Demand(accel_n=_IDLE, yaw=0.0)
        if self.mode == "LAND":
            if is_landed:
                self.mode = "DISARMED"
            down = _VELOCITY_GAIN[2] * (_BLIND_LANDING - motion.vel_n[2])
            return Demand(accel_n=np.array([0.0, 0.0, np.clip(down, -4.0, 4.0)]), yaw=0.0)
        vel_n = _POSITION_GAIN * (self._wanted() - motion.pos_n)
        over = float(np.hypot(vel_n[0], vel_n[1]))
        vel_n[:2] *= min(1.0, self.speed / max(over, 1e-9))
        vel_n[2] = np.clip(vel_n[2], -self.climb, self.climb)
        if self.mode == "RTL" and self._is_home(motion):
            vel_n[2] = _LANDING
            if is_landed:
                self.mode = "DISARMED"
        error = vel_n - motion.vel_n
        self._sum = np.clip(
            self._sum + _INTEGRAL_GAIN * error * dt, -_MOST_INTEGRAL, _MOST_INTEGRAL
        )
        if is_landed:
            self._sum = np.zeros(3)
        accel_n = np.clip(_VELOCITY_GAIN * error + self._sum, -_MOST_ACCEL, _MOST_ACCEL)
        return Demand(accel_n=accel_n, yaw=0.0)

    def _wanted(self) -> Array:
        if self.mode == "RTL" and self.own.home is not None:
            return np.array([*self.own.home[:2], self.target_n[2]])
        return self.target_n

    def _is_home(self, motion: Motion) -> bool:
        assert self.own.home is not None
        away = motion.pos_n[:2] - self.own.home[:2]
        return bool(np.hypot(*away) < _ARRIVED and np.hypot(*motion.vel_n[:2]) < _SLOW)

    # ArduCopter's watch on its EKF

    def _watch(self, t: float) -> None:
        if t - self._check_t < _CHECK or self.own.origin is None:
            return
        self._check_t = t
        if (status := self.own.status()) is None:
            return
        is_passed = not _is_over(status) and bool(int(status["flags"]) & 24)
        self._has_passed |= is_passed
        if not self._has_passed:
            return
        self._fails = max(self._fails - 1, 0) if is_passed else min(self._fails + 1, _MOST_FAILS)
        if not is_passed and self._fails == _LANE:
            # Assumed: the other lane is no worse
            self._lane = 1 - self._lane
            self.own.send_text(CRITICAL, f"EKF3 lane switch {self._lane}")
        if self._fails >= _MOST_FAILS and not self._is_bad:
            self._is_bad = True
            self.own.send_text(CRITICAL, "EKF variance")
            if self.mode != "DISARMED":
                self.mode = "LAND"
                self.own.send_text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
        elif self._fails == 0 and self._is_bad:
            self._is_bad = False
            self.own.send_text(CRITICAL, "EKF Failsafe Cleared")


def _is_over(status: dict[str, float]) -> bool:
    """Whether two of compass, velocity and position are over the threshold."""
    velocity = status["velocity_variance"]
    count = int(status["compass_variance"] >= _THRESHOLD)
    count += 2 if velocity >= 2.0 * _THRESHOLD else int(velocity >= _THRESHOLD)
    return count >= 2 or (status["pos_horiz_variance"] >= _THRESHOLD and count >= 1)
