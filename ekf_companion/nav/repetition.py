"""Samples of an inertial sensor that repeat: whether it is stuck, or at the end of its range.

Compiled, since it looks at every sample; the same file runs as plain Python.
"""

from __future__ import annotations

import math

import cython
import numpy as np
from cython.cimports.libc.math import log

from ekf_companion.nav.arrays import Array, Column, Const, Mask, Stamps, Table
from ekf_companion.nav.earth import STANDARD_GRAVITY

Sample = tuple[float, float, float, float, float, float]
"""Rate, rad/s, and specific force, m/s^2, in the body."""

CHANCE = math.log(1e-12)
"""Logarithm of the probability below which a run is not chance: with independent samples one false
alarm in some years at 250 Hz."""
_MEMORY = 2048
"""Pairs after which the counts are halved."""
_FEWEST = 64
"""Fewest pairs to conclude anything from."""
_RATE = 0.1
"""rad/s: no range ends so low and no gyro has such a bias, so a constant rate beyond it is the end
of the range."""
_FORCE = 2.0
"""m/s^2: the same for an accelerometer."""
_LANDED_US = 5_000_000
"""Identical samples of a vehicle at rest come from a simulator if they last so long, us."""

_BEFORE_ALL_US = -(2**62)
"""Earlier than any stamp."""

STUCK = "stuck"
LIMITED = "at the end of its range"
AXIS = "stuck on an axis"
"""One axis says the same, as 0, while the sensor turns about two others."""
MEASURED = (LIMITED, AXIS)
"""What is used all the same, for the other axes."""
ZERO = "absent: all six numbers are zero"


class Repetition:
    """Finds in the samples of one sensor that it is stuck, or at the end of its range.

    A sensor's noise makes its readings differ. How often two in a row are equal to the bit is
    counted for each axis: a run of equal ones that is too long for chance means that the axis no
    longer measures. Sensors with coarse digits, and simulators without noise, repeat themselves all
    the time: for them no run is too long.
    """

    def __init__(self) -> None:
        if not cython.compiled:
            self._last, self._runs, self._equal = [0.0] * 6, [0] * 6, [0] * 6
            self._turned, self._then = [0] * 6, [0.0] * 18
        for axis in range(6):
            self._last[axis] = math.nan
            self._runs[axis] = self._equal[axis] = self._turned[axis] = 0
        self._pairs = 0
        self._since_us = 0
        self._newest_us = _BEFORE_ALL_US
        self.refused: dict[str, int] = {}

    def judge(self, t_us: int, sample: Sample) -> str | None:
        """Return why a sample, newer than all before, was not measured; None if it was."""
        return self.judge_axes(t_us, *sample)

    def judge_axes(
        self, t_us: int, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
    ) -> str | None:
        """Judge a sample by its numbers."""
        # In free fall there would be noise
        if gx == 0.0 and gy == 0.0 and gz == 0.0 and ax == 0.0 and ay == 0.0 and az == 0.0:
            return ZERO
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
        rates = forces = 0
        is_large = False
        for axis in range(6):
            if self._is_silent(axis):
                if axis < 3:
                    rates += 1
                else:
                    forces += 1
                is_large |= abs(self._last[axis]) > (_RATE if axis < 3 else _FORCE)
        count = rates + forces
        if count == 6:
            return None if self._may_stand(t_us) else STUCK
        if not is_large:
            return AXIS if self._has_stuck_axis() else None
        # No motion is at the end of three ranges
        return STUCK if rates == 3 or forces == 3 else LIMITED if count else None

    def judge_rows(self, t_ns: Stamps, values: Array) -> Mask:
        """Judge samples in the order of their arrival; return which of them were measured.

        A sample at the end of the range, or with an axis that is stuck, counts as measured, with a
        larger noise, which the filter finds.

        Args:
            t_ns: Stamps, shape (n,).
            values: Rows that begin with rate and specific force, shape (n, 6 or more).
        """
        is_good = np.ones(len(t_ns), dtype=np.uint8)
        self.judge_each(t_ns, np.ascontiguousarray(values), is_good)
        return is_good.view(np.bool_)

    def judge_each(
        self,
        t_ns: Const[Column[np.int64]],
        values: Const[Table[np.float64]],
        is_good: Column[np.uint8],
    ) -> None:
        """Do the work of :meth:`judge_rows`."""
        for n in range(t_ns.shape[0]):
            t_us = t_ns[n] // 1000
            # What came late or twice says nothing of what is new
            if t_us <= self._newest_us:
                continue
            self._newest_us = t_us
            why = self.judge_axes(
                t_us,
                values[n, 0],
                values[n, 1],
                values[n, 2],
                values[n, 3],
                values[n, 4],
                values[n, 5],
            )
            if why is not None:
                is_good[n] = why in MEASURED
                self.refused[why] = self.refused.get(why, 0) + 1

    def _count(self, axis: int, value: float) -> bool:
        """Count whether an axis repeats its last value; return whether it does."""
        if value != self._last[axis]:
            self._last[axis] = value
            self._runs[axis] = self._turned[axis] = 0
            return False
        self._runs[axis] += 1
        self._equal[axis] += 1
        return True

    def chance(self) -> float:
        """Return the logarithm of how likely it is that each axis still measures: of the least."""
        least = 0.0
        for axis in range(6):
            least = min(least, self._chance(axis))
        return least

    def _chance(self, axis: int) -> float:
        """Return the logarithm of the probability of so long a run; 0 while nothing is known."""
        run = self._runs[axis]
        known = self._pairs - run
        if not run or known < _FEWEST:
            return 0.0
        return run * log((self._equal[axis] - run + 1.0) / (known + 2.0))

    def _is_silent(self, axis: int) -> bool:
        """Whether an axis has been constant for longer than chance explains."""
        return self._chance(axis) < CHANCE

    def _has_stuck_axis(self) -> bool:
        """Whether an axis is silent, or always was, and the sensor then turns about two others.

        At rest an axis of coarse digits may be, and of a vehicle in a plane all but one are.
        """
        is_any = False
        for axis in range(6):
            run = self._runs[axis]
            is_first = self._pairs - run < _FEWEST <= run
            if not is_first and not self._is_silent(axis):
                continue
            turned = self._turned[axis]
            for other in range(3):
                place = 3 * axis + other
                if turned == 0:
                    self._then[place] = self._last[other]
                elif other != axis and abs(self._last[other] - self._then[place]) > _RATE:
                    turned |= 2 << other
            self._turned[axis] = turned | 1
            # Two bits or more, beside the lowest: that there is a rate to compare with
            is_any |= (turned >> 1) & ((turned >> 1) - 1) > 0
        return is_any

    def _may_stand(self, t_us: int) -> bool:
        rate = math.hypot(self._last[0], self._last[1], self._last[2])
        force = math.hypot(self._last[3], self._last[4], self._last[5])
        is_still = rate < _RATE and abs(force - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
        return is_still and t_us - self._since_us > _LANDED_US
