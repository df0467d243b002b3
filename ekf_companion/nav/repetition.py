"""Samples of an inertial sensor that repeat: whether it is stuck, or at the end of its range.

Compiled, since it looks at every sample; the same file runs as plain Python.
"""

from __future__ import annotations

import math

import cython
import numpy as np
from cython.cimports.libc.math import exp, isfinite, isnan, log

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
_RATES, _FORCES, _NOTED, _SEEN, _TURNED = 0o7, 0o70, 0o100, 0o200, 0o400
"""Bits of the axes; that there is a reading to compare with, and a field; that this has turned."""
_LANDED_US = 5_000_000
"""Identical samples of a vehicle at rest come from a simulator if they last so long, us."""

_BEFORE_ALL_US = -(2**62)
"""Earlier than any stamp."""

STUCK = "stuck"
LIMITED = "at the end of its range"
AXIS = "stuck on an axis"
"""One axis says the same, as 0, while the others show that it cannot."""
MEASURED = (LIMITED, AXIS)
"""What is used all the same, for the other axes."""
ZERO = "absent: all six numbers are zero"
LEAP = _LEAP = 10.0
"""rad/s from one sample to the next: no flight but a crash is so rough, and then it goes on."""
_RANGE = 16.0 * STANDARD_GRAVITY
"""m/s^2, of most sensors. From one end to the other a sample may leap that clips."""
_FORCE_LEAP = 2.0 * _RANGE
SPIKE = "leaping by more than 10 rad/s or 32 g, and back"
"""As a damaged word of the sensor's bus is, or the end of 16 bits of mrad/s or milli-g."""
_LONG_LEAP = 5
"""Samples in a row after which even the same one, to the bit, is where the rate has leapt to."""


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
            self._steady, self._leapt = [0.0] * 6, [0.0] * 6
            self._moved, self._then, self._field = [0] * 6, [0.0] * 54, [0.0] * 3
            self._beside = [0] * 6
        for axis in range(6):
            self._last[axis] = self._leapt[axis] = self._steady[axis] = math.nan
            self._runs[axis] = self._equal[axis] = self._moved[axis] = self._beside[axis] = 0
        for axis in range(3):
            self._field[axis] = 0.0
        self._leaps = 0
        self._pairs = 0
        self._since_us = 0
        self._newest_us = _BEFORE_ALL_US
        self.refused: dict[str, int] = {}

    def judge(self, t_us: int, sample: Sample) -> str | None:
        """Return why a sample, newer than all before, was not measured; None if it was."""
        return self.judge_axes(t_us, *sample)

    def see(self, x: float, y: float, z: float) -> None:
        """Take the magnetic field in the body, of any unit, that goes with the next samples."""
        self._field[0], self._field[1], self._field[2] = x, y, z

    def judge_axes(
        self, t_us: int, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
    ) -> str | None:
        """Judge a sample by its numbers."""
        # In free fall there would be noise
        if gx == 0.0 and gy == 0.0 and gz == 0.0 and ax == 0.0 and ay == 0.0 and az == 0.0:
            return ZERO
        if self._is_spike(gx, gy, gz, ax, ay, az):
            return SPIKE
        equal = self._count(0, gx) + self._count(1, gy) + self._count(2, gz)
        equal += self._count(3, ax) + self._count(4, ay) + self._count(5, az)
        self._pairs += 1
        if equal == 0:
            self._since_us = t_us
            if self._pairs >= 2 * _MEMORY:
                self._pairs //= 2
                for axis in range(6):
                    self._equal[axis] //= 2
            return None
        rates = forces = 0
        is_large = False
        for axis in range(6):
            if self._runs[axis] > 0:
                self._beside[axis] += equal - 1
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
            return self._stuck_axes()
        # No motion is at the end of three ranges
        return STUCK if rates == 3 or forces == 3 else LIMITED if count else None

    def judge_rows(self, t_ns: Stamps, values: Array, fields: Array) -> Mask:
        """Judge samples in the order of their arrival; return which of them were measured.

        A sample at the end of the range, or with an axis that is stuck, counts as measured, with a
        larger noise, which the filter finds.

        Args:
            t_ns: Stamps, shape (n,).
            values: Rows that begin with rate and specific force, shape (n, 6 or more).
            fields: The magnetic field, in any unit, that came last before each; zeros: none,
                shape (n, 3).
        """
        is_good = np.ones(len(t_ns), dtype=np.uint8)
        rows, fields = np.ascontiguousarray(values), np.ascontiguousarray(fields)
        self.judge_each(t_ns, rows, fields, is_good)
        return is_good.view(np.bool_)

    def judge_each(
        self,
        t_ns: Const[Column[np.int64]],
        values: Const[Table[np.float64]],
        fields: Const[Table[np.float64]],
        is_good: Column[np.uint8],
    ) -> None:
        """Do the work of :meth:`judge_rows`."""
        for n in range(t_ns.shape[0]):
            t_us = t_ns[n] // 1000
            # What came late or twice says nothing of what is new
            if t_us <= self._newest_us:
                continue
            self._newest_us = t_us
            self.see(fields[n, 0], fields[n, 1], fields[n, 2])
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

    def _is_spike(self, gx: float, gy: float, gz: float, ax: float, ay: float, az: float) -> bool:
        """Whether a rate or a force has leapt, and nothing says yet that it goes on so.

        No sensor is started in such a turn; where the force is none of a vehicle either, the units
        are wrong.
        """
        is_far = is_same = False
        if isnan(self._steady[0]) and max(abs(ax), abs(ay), abs(az)) <= _RANGE:
            for axis in range(3):
                self._steady[axis] = 0.0
        is_near = True
        for axis in range(6):
            value = gx if axis == 0 else gy if axis == 1 else gz
            if axis > 2:
                value = ax if axis == 3 else ay if axis == 4 else az
            leap = _LEAP if axis < 3 else _FORCE_LEAP
            is_near = is_near and abs(value - self._leapt[axis]) <= leap
            if isfinite(value) and abs(value - self._steady[axis]) > leap:
                is_far = True
                is_same = is_same or value == self._leapt[axis]
        if is_far:
            self._leaps = self._leaps + 1 if is_near else 1
            self._leapt[0], self._leapt[1], self._leapt[2] = gx, gy, gz
            self._leapt[3], self._leapt[4], self._leapt[5] = ax, ay, az
            if self._leaps < 2 or (is_same and self._leaps < _LONG_LEAP):
                return True
        self._leaps = 0
        self._steady[0], self._steady[1], self._steady[2] = gx, gy, gz
        self._steady[3], self._steady[4], self._steady[5] = ax, ay, az
        return False

    def _count(self, axis: int, value: float) -> int:
        """Count whether an axis repeats its last value; return 1 if it does."""
        if value != self._last[axis]:
            self._last[axis] = value
            self._runs[axis] = self._moved[axis] = self._beside[axis] = 0
            return 0
        self._runs[axis] += 1
        self._equal[axis] += 1
        return 1

    def chance(self) -> float:
        """Return the logarithm of how likely it is that each axis still measures: of the least.

        At rest, with coarse digits, an axis repeats itself as often as the others do meanwhile,
        beside those that have not changed at all: they may be stuck too. One that is more often
        equal than not has digits too coarse to tell.
        """
        least = 0.0
        for axis in range(6):
            chance = self._chance(axis)
            if chance < least:
                run = self._runs[axis]
                usual = exp(chance / run)
                if usual > 0.5:
                    continue
                equal, pairs = self._beside[axis], 5 * run
                for other in range(6):
                    if other != axis and self._runs[other] >= run:
                        equal, pairs = equal - run, pairs - run
                beside = (equal + usual) / (pairs + 1.0)
                least = min(least, max(chance, run * log(beside)))
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

    def _stuck_axes(self) -> str | None:
        """Judge axes that are silent, or always were, near 0, by what the others show.

        At rest an axis of coarse digits may be, and of a vehicle in a plane all but one are.
        """
        silent = known = stuck = 0
        for axis in range(6):
            run = self._runs[axis]
            is_silent = self._is_silent(axis)
            if is_silent or self._pairs - run < _FEWEST <= run:
                silent |= 1 << axis
                if is_silent:
                    known |= 1 << axis
                self._note_motion(axis)
        # The axis of the one rate that is left, 3: of none
        left = 3
        for axis in range(3):
            if silent & _RATES == _RATES & ~(1 << axis):
                left = axis
        is_all = silent & _RATES == _RATES
        for axis in range(6):
            if not silent & 1 << axis:
                continue
            moved = self._moved[axis]
            # Two rates: their bits without the lowest are not 0
            is_stuck: bool = moved & _RATES & ((moved & _RATES) - 1) > 0
            if axis < 3 and not is_stuck:
                # A force tells of turns where none of its axes lies in a plane
                is_shaken: bool = moved & _FORCES > 0 and silent & _FORCES == 0
                # Two that have measured before do so while the third does
                is_one_of_two: bool = left < 3 and known & 1 << axis > 0 and moved & 1 << left > 0
                is_stuck = is_shaken or is_one_of_two or (is_all and moved & _TURNED > 0)
            if is_stuck:
                stuck |= 1 << axis
        is_sensor = stuck & _RATES == _RATES or stuck & _FORCES == _FORCES
        return STUCK if is_sensor else AXIS if stuck else None

    def _note_motion(self, axis: int) -> None:
        """Note which of the other axes have moved since this one fell silent."""
        moved = self._moved[axis]
        if moved == 0:
            for other in range(6):
                self._then[9 * axis + other] = self._last[other]
        if not moved & _SEEN and self._strength() > 0.0:
            moved |= _SEEN
            for other in range(3):
                self._then[9 * axis + 6 + other] = self._field[other]
        for other in range(6):
            change = abs(self._last[other] - self._then[9 * axis + other])
            if change > (_RATE if other < 3 else _FORCE):
                moved |= 1 << other
        if moved & _SEEN and self._has_field_turned(axis):
            moved |= _TURNED
        self._moved[axis] = moved | _NOTED

    def _has_field_turned(self, axis: int) -> bool:
        """Whether the field has changed by half its strength since an axis fell silent.

        So it does in a turn by 29 degrees across it; no current of a vehicle disturbs it so.
        """
        change = 0.0
        for other in range(3):
            by = self._field[other] - self._then[9 * axis + 6 + other]
            change += by * by
        return 0.0 < 0.25 * self._strength() < change

    def _strength(self) -> float:
        """Return the square of the field's strength."""
        x, y, z = self._field[0], self._field[1], self._field[2]
        return x * x + y * y + z * z

    def _may_stand(self, t_us: int) -> bool:
        rate = math.hypot(self._last[0], self._last[1], self._last[2])
        force = math.hypot(self._last[3], self._last[4], self._last[5])
        is_still = rate < _RATE and abs(force - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
        return is_still and t_us - self._since_us > _LANDED_US
