"""Inertial samples that repeat themselves: of a sensor that hangs, or is at the end of its range.

A sensor's noise makes its readings differ. How often two in a row are equal to the bit all the same
is learnt for each axis; a run of equal ones that is too long to be chance says that the axis
measures nothing any more. It is learnt because whole numbers in disguise, and simulators without
noise, repeat themselves all the time: there no run is long enough.
"""

from __future__ import annotations

import math

from ekf_companion.nav.earth import STANDARD_GRAVITY

Sample = tuple[float, float, float, float, float, float]
"""Rate, rad/s, and specific force, m/s^2, in the body."""

_CHANCE = math.log(1e-12)
"""Of a run: one false alarm in some years of samples at 250 Hz, were they independent."""
_MEMORY = 2048
"""Pairs, after which what has been counted weighs half."""
_FEWEST = 64
"""Pairs that anything is concluded from."""
_RATE = 0.1
"""rad/s; no range ends so soon. No gyro of today has such a bias, so it says that it turns, too."""
_FORCE = 2.0
"""m/s^2; neither does an accelerometer's."""
_LANDED_US = 5_000_000
"""What reads as standing still would, for so long, may be a simulator's vehicle that does."""

STUCK = "stuck"
LIMITED = "at the end of its range"


class Repetition:
    """One sensor's samples, one after the other."""

    __slots__ = ("_equal", "_last", "_pairs", "_runs", "_since_us")

    def __init__(self) -> None:
        self._last: Sample = (math.nan,) * 6
        self._runs = [0] * 6
        self._equal = [0] * 6
        self._pairs = 0
        self._since_us = 0

    def judge(self, t_us: int, sample: Sample) -> str | None:
        """Say why a sample, newer than all before, measures nothing; None: it does."""
        last, self._last = self._last, sample
        self._pairs += 1
        is_any = False
        for axis in range(6):
            if sample[axis] == last[axis]:
                is_any = True
                self._runs[axis] += 1
                self._equal[axis] += 1
            else:
                self._runs[axis] = 0
        if not is_any:
            self._since_us = t_us
            if self._pairs >= 2 * _MEMORY:
                self._pairs //= 2
                self._equal = [count // 2 for count in self._equal]
            return None
        silent = [axis for axis in range(6) if self._is_silent(axis)]
        if len(silent) == 6 and not self._may_stand(t_us, sample):
            return STUCK
        largest = (_RATE,) * 3 + (_FORCE,) * 3
        if len(silent) < 6 and any(abs(sample[axis]) > largest[axis] for axis in silent):
            return LIMITED
        return None

    def _is_silent(self, axis: int) -> bool:
        """Whether an axis has been the same for longer than chance explains."""
        run = self._runs[axis]
        known = self._pairs - run
        if not run or known < _FEWEST:
            return False
        return run * math.log((self._equal[axis] - run + 1) / (known + 2)) < _CHANCE

    def _may_stand(self, t_us: int, sample: Sample) -> bool:
        rate, force = math.hypot(*sample[:3]), math.hypot(*sample[3:])
        is_still = rate < _RATE and abs(force - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
        return is_still and t_us - self._since_us > _LANDED_US
