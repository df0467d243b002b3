"""The difference of two inertial units: what is usual of it, and whose fault it is if it is not.

Compiled.

Source: two hypotheses of one change, Basseville and Nikiforov 1993, "Detection of abrupt changes",
ch. 2 (likelihood ratio), 7 (a fault in one of several sensors).
"""

from __future__ import annotations

import math

import cython

from ekf_companion.nav.inertial_unit import BLOCK, BLOCK_NS, LASTING_NS, MEMORY, NEVER, Unit

SHORTEST, LONGEST = 2, 3
"""Blocks whose mean is compared: of one alone vibration makes anything. As many before them say
what was before."""
_SECOND = 25
"""Blocks of a second: so many show the usual difference, and what lasts for as long is one of
biases, below which vibration averages out. Motion is learnt over as long."""
SIGMAS = 4.0
"""A difference beyond it is no chance, or it takes a likely fault beside: of two units in the
vibration of recorded flights two changes in eight minutes are false; 3 made more, and by 5 fewer
faults were left."""
_RATE, _FORCE = 0.02, 0.2
"""rad/s and m/s^2: a smaller difference is one of biases, which the filter estimates; one sigma of
theirs at its start."""
_SCALE = 0.02
"""By which share of the motion two units may differ: 1 % of scale and a degree of mounting."""
_LATENESS = 0.005
"""And by which time, s."""
UNKNOWN = math.inf
"""rad/s and m/s^2: one sigma of a difference of which nothing is known."""


class Pair:
    """The difference of two units, the first less the second."""

    def __init__(self) -> None:
        if not cython.compiled:
            self.usual, self.spread, self.slow = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self.drift, self.moves, self.white = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self.motion = [0.0] * 2
        self.begin()

    def begin(self) -> None:
        """Learn the usual difference anew."""
        self.count = 0
        self.since: int = NEVER
        """First block of a difference that is none of the usual, until it is over."""
        self.blamed = 0
        """Whose fault that is: 1 the first one's, 2 the second's, 0: nobody knows."""
        self.motion[0] = self.motion[1] = 0.0
        for axis in range(6):
            self.usual[axis] = self.spread[axis] = 0.0
            self.slow[axis] = self.drift[axis] = self.moves[axis] = self.white[axis] = 0.0

    def is_known(self) -> bool:
        """Return whether the usual difference is known."""
        return self.count >= _SECOND

    def is_apart(self) -> bool:
        """Return whether the two contradict each other."""
        return self.since != NEVER

    def judge(self, one: Unit, other: Unit, block: int) -> None:
        """Compare a block that both have whole; learn from it while the difference is the usual."""
        if not (one.has(block, block) and other.has(block, block)):
            return
        if self.is_known() and self._is_unusual(one, other, block):
            if self.since == NEVER:
                self.since, self.blamed = block, 0
            if (block - self.since) * BLOCK_NS < LASTING_NS:
                return
            self.begin()
        self.since = NEVER
        self._learn(one, other, block)

    def _learn(self, one: Unit, other: Unit, block: int) -> None:
        self.count += 1
        share, brief = 1.0 / min(self.count, MEMORY), 1.0 / min(self.count, _SECOND)
        first = block - LONGEST + 1
        has_windows = one.has(first - LONGEST, block) and other.has(first - LONGEST, block)
        if has_windows:
            for sensor in range(2):
                moved = self._motion(one, other, block, 1, sensor)
                self.motion[sensor] += share * (moved - self.motion[sensor])
        for axis in range(6):
            off = self.off(one, other, block, 1, axis)
            self.usual[axis] += share * off
            white = min(one.white[axis], other.white[axis])
            self.white[axis] += share * (white - self.white[axis])
            if self.count > 1:
                self.spread[axis] += share * (off * off - self.spread[axis])
                self.slow[axis] += brief * (off - self.slow[axis])
                slow = self.slow[axis]
                self.drift[axis] += share * (slow * slow - self.drift[axis])
            if has_windows:
                # What both see is motion
                a, b = one.change(axis, block, LONGEST), other.change(axis, block, LONGEST)
                self.moves[axis] += brief * (a * b - self.moves[axis])

    def _is_unusual(self, one: Unit, other: Unit, block: int) -> bool:
        """Return whether the last blocks differ by what is neither usual nor noise nor motion."""
        for sensor in range(2):
            for n in range(SHORTEST, LONGEST + 1):
                if self.excess(one, other, block, n, sensor) > 0.0:
                    return True
        return False

    def off(self, one: Unit, other: Unit, block: int, n: int, axis: int) -> float:
        """Return by how much the means of the last n blocks differ beyond the usual."""
        first = block - n + 1
        return one.over(axis, first, block) - other.over(axis, first, block) - self.usual[axis]

    def excess(self, one: Unit, other: Unit, block: int, n: int, sensor: int) -> float:
        """Return by how much the means of n blocks differ beyond the limit; 0: they do not.

        ``sensor``: 0 the gyro, 1 the accelerometer.
        """
        if not (one.has(block - n, block) and other.has(block - n, block)):
            return 0.0
        motion = self._motion(one, other, block, n, sensor)
        least = _RATE if sensor == 0 else _FORCE
        largest = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            sigma = math.sqrt(self._variance(one, other, n, axis, motion))
            off = abs(self.off(one, other, block, n, axis))
            largest = max(largest, off - max(least, SIGMAS * sigma))
        return largest

    def variance(self, one: Unit, other: Unit, block: int, n: int, axis: int) -> float:
        """Return the variance of :meth:`off`."""
        return self._variance(one, other, n, axis, self._motion(one, other, block, n, axis // 3))

    def _variance(self, one: Unit, other: Unit, n: int, axis: int, motion: float) -> float:
        # Of vibration both units have more white noise, of a fault one
        white, known = min(one.white[axis], other.white[axis]), self.white[axis]
        noise = self.spread[axis] * (white / known if white > known > 0.0 else 1.0)
        # No more than motion of this size was found to be worth
        known = self.motion[axis // 3]
        moved = min(motion, self.spread[axis] * motion / known) if known > 0.0 else motion
        return noise / n + self.drift[axis] + moved

    def _motion(self, one: Unit, other: Unit, block: int, n: int, sensor: int) -> float:
        """Return by how much the units may differ for the motion, squared.

        Both see it: what one alone sees is a fault.
        """
        first = block - n + 1
        level_one = level_other = moved_one = moved_other = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            now, then = one.over(axis, first, block), one.over(axis, first - 1, first - 1)
            level_one += (now - one.usual[axis]) ** 2
            moved_one += (now - then) ** 2
            now, then = other.over(axis, first, block), other.over(axis, first - 1, first - 1)
            level_other += (now - other.usual[axis]) ** 2
            moved_other += (now - then) ** 2
        late = _LATENESS / BLOCK
        motion = _SCALE * _SCALE * min(level_one, level_other)
        return motion + late * late * min(moved_one, moved_other)

    def by_change(self, one: Unit, other: Unit, block: int, n: int, sensor: int) -> float:
        """Return the log-likelihood ratio of a fault of the first against one of the second.

        By their own changes along their difference, if it has begun just now: the change of either
        is the motion if the other has the fault.
        """
        if not (one.has(block - 2 * n + 1, block) and other.has(block - 2 * n + 1, block)):
            return 0.0
        motion = self._motion(one, other, block, n, sensor)
        x = y = length = var = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            off = self.off(one, other, block, n, axis)
            x += off * one.change(axis, block, n)
            y += off * other.change(axis, block, n)
            length += off * off
            moves = max(self.moves[axis], 0.0)
            var += off * off * (self._variance(one, other, n, axis, motion) + moves)
        # x and y times the length, var times its square
        if abs(x - y) < 0.5 * length or 0.25 * y * y < x * x < 4.0 * y * y:
            return 0.0
        return 0.5 * (x * x - y * y) / (var + 1e-12 * length)

    def size(self, one: Unit, other: Unit, block: int, sensor: int) -> float:
        """Return by how much the last blocks differ beyond the usual."""
        total = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            total += self.off(one, other, block, LONGEST, axis) ** 2
        return math.sqrt(total)

    def std(self, sensor: int) -> float:
        """Return one sigma of the usual difference, of the worst axis."""
        if not self.is_known():
            return UNKNOWN
        worst = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            worst = max(worst, self.drift[axis] + self.spread[axis] / self.count)
        return math.sqrt(worst)
