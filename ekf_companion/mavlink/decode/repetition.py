"""Samples of an inertial sensor that repeat themselves: whether it is stuck, or at its range's end.

Compiled, for it looks at every sample; the same file runs as plain Python.
"""

from __future__ import annotations

import math

import cython
from cython.cimports.libc.math import log

from ekf_companion.nav.earth import STANDARD_GRAVITY

Sample = tuple[float, float, float, float, float, float]
"""Rate, rad/s, and specific force, m/s^2, in the body."""

_CHANCE = cython.declare(cython.double, math.log(1e-12))
"""Logarithm of the probability of a run at which it is no chance: if samples were independent, one
false alarm in some years at 250 Hz."""
_MEMORY = cython.declare(cython.longlong, 2048)
"""Pairs after which the counts are halved."""
_FEWEST = cython.declare(cython.longlong, 64)
"""Fewest pairs to conclude anything from."""
_RATE = cython.declare(cython.double, 0.1)
"""rad/s; no range ends so low, and no gyro has such a bias, so the sensor turns."""
_FORCE = cython.declare(cython.double, 2.0)
"""m/s^2; nor does an accelerometer's range."""
_LANDED_US = 5_000_000
"""Equal samples as of standing still may come from a simulator if they last so long."""

STUCK = "stuck"
LIMITED = "at the end of its range"


class Repetition:
    """Finds in the samples of one sensor that it is stuck, or at the end of its range.

    A sensor's noise makes its readings differ. How often two in a row are equal to the bit all the
    same is counted for each axis; a run of equal ones that is too long to be chance means that the
    axis measures nothing any more. It is counted because whole numbers in disguise, and simulators
    without noise, repeat themselves all the time: there no run is long enough.
    """

    def __init__(self) -> None:
        if not cython.compiled:
            self._last, self._runs, self._equal = [0.0] * 6, [0] * 6, [0] * 6
        for axis in range(6):
            self._last[axis] = math.nan
            self._runs[axis] = self._equal[axis] = 0
        self._pairs = 0
        self._since_us = 0

    def judge(self, t_us: int, sample: Sample) -> str | None:
        """Return why a sample, newer than all before, measures nothing; None if it does."""
        return self.judge_axes(t_us, *sample)

    def judge_axes(
        self, t_us: int, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
    ) -> str | None:
        """Judge a sample by its numbers."""
        is_any = self._count(0, gx)
        is_any |= self._count(1, gy)
        is_any |= self._count(2, gz)
        is_any |= self._count(3, ax)
        is_any |= self._count(4, ay)
        is_any |= self._count(5, az)
        self._pairs += 1
        if not is_any:
            self._since_us = t_us
            if self._pairs >= 2 * _MEMORY:
                self._pairs //= 2
                for axis in range(6):
                    self._equal[axis] //= 2
            return None
        count = 0
        is_large = False
        for axis in range(6):
            if self._is_silent(axis):
                count += 1
                is_large |= abs(self._last[axis]) > (_RATE if axis < 3 else _FORCE)
        if count == 6 and not self._may_stand(t_us):
            return STUCK
        return LIMITED if 0 < count < 6 and is_large else None

    def _count(self, axis: int, value: float) -> bool:
        """Count whether an axis says the same again; return whether it does."""
        if value != self._last[axis]:
            self._last[axis] = value
            self._runs[axis] = 0
            return False
        self._runs[axis] += 1
        self._equal[axis] += 1
        return True

    def _is_silent(self, axis: int) -> bool:
        """Whether an axis has been constant for longer than chance explains."""
        run = self._runs[axis]
        known = self._pairs - run
        if not run or known < _FEWEST:
            return False
        return run * log((self._equal[axis] - run + 1.0) / (known + 2.0)) < _CHANCE

    def _may_stand(self, t_us: int) -> bool:
        rate = math.hypot(self._last[0], self._last[1], self._last[2])
        force = math.hypot(self._last[3], self._last[4], self._last[5])
        is_still = rate < _RATE and abs(force - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
        return is_still and t_us - self._since_us > _LANDED_US
