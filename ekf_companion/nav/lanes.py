"""Which of several inertial units is used, and when it is left (compiled).

Every unit is watched, one is used. Their mean rates and forces over blocks of one clock are
compared: the usual difference of two units is that of their biases and is learnt, so that each has
its own; what goes beyond it is a fault of one of the two. Of three the two that agree are right. Of
two, that one is right whose own signal has changed as little as motion does: the change of the one
is the motion if the other is at fault, and the likelier motion decides. Where both may be, nobody
is blamed.

A unit is left at once where it repeats its readings, is at the end of its range while another is
not, falls silent, or is found at fault. The next one's readings are continued by the usual
difference, so that the biases that were estimated hold on; by how much they may not, and what the
unit that is left has done until then, goes with its first sample. There is no way back but the
same.

Source: two hypotheses of one change, Basseville and Nikiforov 1993, "Detection of abrupt changes",
ch. 2 (likelihood ratio), 7 (a fault in one of several sensors).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cython
import numpy as np

from ekf_companion.nav.arrays import Array, Column, Const, Mask, Stamps, Table
from ekf_companion.nav.repetition import CHANCE, LIMITED, STUCK, ZERO, Repetition

BLOCK_NS = 40_000_000
"""ns. Two whole blocks and a part of one are over within 0.12 s, and a unit of 50 Hz has two
samples in each."""
_BLOCK = 0.04
"""The same, s."""
KEPT = 8
"""Blocks that are kept of each unit."""
SHORTEST, LONGEST = 2, 3
"""Blocks whose mean is compared: of one alone vibration makes anything. As many before them say
what was before."""
_GAP_NS = 250_000_000
"""ns: longer without a sample, a block is not whole."""
_SILENT_NS = 100_000_000
"""Silence, beside four intervals, after which a unit is left: 0.2 s at 40 Hz."""
_ENOUGH = 25
"""Blocks, one second, before the usual difference of two units is known."""
STEADY = 20
"""Samples without a gap before a unit is one to go to."""
_SHARE = 0.25
"""Of the rate of the unit in use, that another has at least: a slower one loses more than it
gains."""
_MEMORY = 750
"""Blocks over which the usual difference and its spread are learnt: 30 s, in which a bias hardly
drifts."""
_SLOW = 25
"""Blocks over which a difference counts as one of biases: below, vibration averages out."""
_WHITE = 0.1
"""Time in which a unit's white noise is learnt as it rises, s; it falls five times as slowly."""
_MOVING = 50
"""Blocks over which motion is learnt, by which a change is likely or not: 2 s."""
SIGMAS = 4.0
"""A difference beyond it is no chance, or it takes a change of one unit alone beside: of two units
in the vibration of recorded flights none was left in ten minutes (``benchmarks/accuracy``)."""
_RATE, _FORCE = 0.02, 0.2
"""rad/s and m/s^2: a smaller difference is one of biases, which the filter estimates; one sigma of
theirs at its start."""
_SCALE = 0.02
"""By which share of the motion two units may differ: 1 % of scale and a degree of mounting."""
_LATENESS = 0.005
"""And by which time, s."""
_LIKELIER = math.log(100.0)
"""Log-likelihood ratio beyond which one of two is at fault and not the other."""
_LASTING_NS = 10_000_000_000
"""A unit that failed is not gone to for so long; a difference that lasted for it is the usual one
from then on."""
_BRIEF_NS = 1_000_000_000
"""The same of one whose difference is over."""
_RECENT = 5
"""Blocks, 0.2 s, in which the unit that is left may have been wrong."""
_SUSPECT = math.log(1e-3)
"""Logarithm of the probability below which a run of equal readings speaks against a unit: it is
neither compared nor gone to until a new one comes."""
_WAITING = 32
"""Samples that are kept of a spare unit: those of 0.1 s at 250 Hz."""
_NEVER = -(2**62)

LEFT, USED, CHANGED = range(3)
"""What becomes of a sample: it is not used, it is, or the unit has changed."""
SILENT = "silent"
NOT_A_NUMBER = "not a number"
AXIS = "stuck on an axis"
STEP = "off from the others by a step"
UNHEALTHY = "unhealthy by the autopilot's own word"
CHOSEN = "not the one that the autopilot uses"
"""Why a unit is left, beside the reasons of :mod:`.repetition`."""
UNKNOWN = 1e3
"""rad/s and m/s^2: no bias is so large."""
STDS = 4
"""Numbers of a change: see :attr:`Change.std`."""
_SURE = (0.0,) * STDS

Numbers6 = tuple[float, float, float, float, float, float]
Waiting = tuple[int, float, float, float, float, float, float]
"""Stamp (ns) and numbers of a sample that was not used yet."""


class Change(NamedTuple):
    """Another unit is used from now on."""

    t_ns: int
    left: int
    """Number of the unit that was used."""
    used: int
    """Of that which is."""
    why: str
    """Why the other was left: it is that."""
    offset: Numbers6
    """To be added to the readings of the unit in use: rad/s, m/s^2."""
    std: tuple[float, float, float, float]
    """By how much its biases may differ from those that were estimated (rad/s, m/s^2; ``UNKNOWN``:
    nobody knows), and what the unit before may have turned and gained that was none (rad, m/s)."""
    ready: tuple[Waiting, ...]
    """Its samples that are later than all that were used."""


class Unit:
    """One inertial unit: its blocks, its white noise, and how it fails."""

    def __init__(self, number: int) -> None:
        if not cython.compiled:
            self._last, self._before, self._now = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self._sum, self.white, self.usual = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self.mean, self.whole = [[0.0] * 6 for _ in range(8)], [0] * 8
        self.number = number
        self.failed_ns: int = _NEVER
        self.why = ""
        """Why it failed last."""
        self.faults = 0
        """How often it has failed."""
        self.fault_ns: int = _NEVER
        """When it did first."""
        self.waiting: list[Waiting] = []
        self.begin()

    def begin(self) -> None:
        """Forget all samples."""
        self.repetition = Repetition()
        self.t_ns: int = _NEVER
        self.dt = 0.0
        self.run = 0
        self.chance = 0.0
        """Logarithm of how likely it is that each axis still measures."""
        self.blocks = 0
        self.done: int = _NEVER
        self._block: int = _NEVER
        self._covered: int = 0
        self.waiting.clear()
        for n in range(8):
            self.whole[n] = _NEVER
        for axis in range(6):
            self.white[axis] = self.usual[axis] = self._sum[axis] = 0.0

    def take(
        self, t_ns: int, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
    ) -> str | None:
        """Take a sample, later than all before; return why it was not measured, if so."""
        why = self.repetition.judge_axes(t_ns // 1000, gx, gy, gz, ax, ay, az)
        self.chance = self.repetition.chance()
        if why is not None and why != LIMITED:
            return why
        self._now[0], self._now[1], self._now[2] = gx, gy, gz
        self._now[3], self._now[4], self._now[5] = ax, ay, az
        step = t_ns - self.t_ns
        if self.t_ns == _NEVER or step > _GAP_NS:
            self.run = 0
            self._block = t_ns // BLOCK_NS
            self._begin_block()
        else:
            self._integrate(t_ns)
            dt = 1e-9 * step
            self.dt += (dt - self.dt) / min(self.run + 1, 64)
            if self.run > 1:
                self._learn_white(dt)
            self.run += 1
        for axis in range(6):
            self._before[axis] = self._last[axis]
            self._last[axis] = self._now[axis]
        self.t_ns = t_ns
        return why

    def _learn_white(self, dt: float) -> None:
        """Learn the white noise by the second difference, whose variance is six times as large."""
        rising = dt / (dt + _WHITE)
        for axis in range(6):
            second = self._now[axis] - 2.0 * self._last[axis] + self._before[axis]
            new = second * second / 6.0 - self.white[axis]
            self.white[axis] += (rising if new > 0.0 else 0.2 * rising) * new

    def _begin_block(self) -> None:
        self._covered = 0
        for axis in range(6):
            self._sum[axis] = 0.0

    def _integrate(self, t_ns: int) -> None:
        """Add the straight line from the sample before to this one to the blocks that it crosses.

        What two units measure at other times is thus compared over the same.
        """
        begin = self.t_ns
        whole = t_ns - self.t_ns
        while begin < t_ns:
            end = (self._block + 1) * BLOCK_NS
            end = t_ns if end > t_ns else end
            share = (0.5 * ((begin - self.t_ns) + (end - self.t_ns))) / whole
            length = 1e-9 * (end - begin)
            for axis in range(6):
                value = self._last[axis] + share * (self._now[axis] - self._last[axis])
                self._sum[axis] += length * value
            self._covered += end - begin
            begin = end
            if end == (self._block + 1) * BLOCK_NS:
                self._finish_block()

    def _finish_block(self) -> None:
        if self._covered == BLOCK_NS:
            place = self._block % 8
            self.whole[place] = self._block
            self.done = self._block
            self.blocks += 1
            share = 1.0 / min(self.blocks, _MEMORY)
            for axis in range(6):
                self.mean[place][axis] = self._sum[axis] / _BLOCK
                self.usual[axis] += share * (self.mean[place][axis] - self.usual[axis])
        self._block += 1
        self._begin_block()

    def has(self, first: int, last: int) -> bool:
        """Return whether these blocks are whole."""
        count = 0
        for block in range(first, last + 1):
            count += self.whole[block % 8] == block
        return count == last - first + 1

    def over(self, axis: int, first: int, last: int) -> float:
        """Return the mean of an axis over some blocks."""
        total = 0.0
        for block in range(first, last + 1):
            total += self.mean[block % 8][axis]
        return total / (last - first + 1)

    def is_steady(self) -> bool:
        """Return whether it has measured without a gap for a while."""
        return self.run >= STEADY

    def is_silent(self, now_ns: int) -> bool:
        """Return whether it has no sample for longer than is usual."""
        return now_ns - self.t_ns > _SILENT_NS + 4e9 * self.dt

    def has_failed(self, now_ns: int) -> bool:
        """Return whether it has failed lately."""
        return now_ns - self.failed_ns < (_BRIEF_NS if self.why == STEP else _LASTING_NS)


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
        self.since: int = _NEVER
        """First block of a difference that is none of the usual, until it is over."""
        self.motion[0] = self.motion[1] = 0.0
        self.blamed = 0
        """Whose fault it is: 1 the first one's, 2 the second's, 0: nobody knows."""
        for axis in range(6):
            self.usual[axis] = self.spread[axis] = 0.0
            self.slow[axis] = self.drift[axis] = self.moves[axis] = self.white[axis] = 0.0

    def is_known(self) -> bool:
        """Return whether the usual difference is known."""
        return self.count >= _ENOUGH

    def is_apart(self) -> bool:
        """Return whether the two contradict each other."""
        return self.since != _NEVER

    def judge(self, one: Unit, other: Unit, block: int) -> None:
        """Compare a block that both have whole; learn from it while the difference is the usual."""
        if not (one.has(block, block) and other.has(block, block)):
            return
        if self.is_known() and self._is_unusual(one, other, block):
            if self.since == _NEVER:
                self.since, self.blamed = block, 0
            if self.blamed == 0:
                self.blamed = self.blame(one, other, block)
            if (block - self.since) * BLOCK_NS < _LASTING_NS:
                return
            self.begin()
        self.since = _NEVER
        self._learn(one, other, block)

    def _learn(self, one: Unit, other: Unit, block: int) -> None:
        self.count += 1
        share = 1.0 / min(self.count, _MEMORY)
        place, first = block % 8, block - LONGEST + 1
        has_windows = one.has(first - LONGEST, block) and other.has(first - LONGEST, block)
        has_before = one.has(block - 1, block) and other.has(block - 1, block)
        if has_before:
            for sensor in range(2):
                moved = self._motion(one, other, block, 1, sensor)
                self.motion[sensor] += share * (moved - self.motion[sensor])
        for axis in range(6):
            off = one.mean[place][axis] - other.mean[place][axis] - self.usual[axis]
            self.usual[axis] += share * off
            white = min(one.white[axis], other.white[axis])
            self.white[axis] += share * (white - self.white[axis])
            if self.count > 1:
                self.spread[axis] += share * (off * off - self.spread[axis])
                self.slow[axis] += (off - self.slow[axis]) / min(self.count, _SLOW)
                slow = self.slow[axis]
                self.drift[axis] += share * (slow * slow - self.drift[axis])
            if has_windows:
                # What both see is motion
                a = one.over(axis, first, block) - one.over(axis, first - LONGEST, first - 1)
                b = other.over(axis, first, block) - other.over(axis, first - LONGEST, first - 1)
                self.moves[axis] += (a * b - self.moves[axis]) / min(self.count, _MOVING)

    def _is_unusual(self, one: Unit, other: Unit, block: int) -> bool:
        """Return whether the last blocks differ by what is neither usual nor noise nor motion."""
        for sensor in range(2):
            for n in range(SHORTEST, LONGEST + 1):
                if self.excess(one, other, block, n, sensor) > 0.0:
                    return True
        return False

    def excess(self, one: Unit, other: Unit, block: int, n: int, sensor: int) -> float:
        """Return by how much the means of n blocks differ beyond the limit; 0: they do not.

        ``sensor``: 0 the gyro, 1 the accelerometer.
        """
        first = block - n + 1
        if not (one.has(first - 1, block) and other.has(first - 1, block)):
            return 0.0
        motion = self._motion(one, other, block, n, sensor)
        known = self.motion[sensor]
        least = _RATE if sensor == 0 else _FORCE
        largest = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            off = one.over(axis, first, block) - other.over(axis, first, block) - self.usual[axis]
            usual = self._noise(one, other, axis) / n + self.drift[axis]
            # No more than motion of this size was found to be worth
            moved = min(motion, self.spread[axis] * motion / known) if known > 0.0 else motion
            limit = max(least, SIGMAS * math.sqrt(usual + moved))
            largest = max(largest, abs(off) - limit)
        return largest

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
        late = _LATENESS / _BLOCK
        motion = _SCALE * _SCALE * min(level_one, level_other)
        return motion + late * late * min(moved_one, moved_other)

    def _noise(self, one: Unit, other: Unit, axis: int) -> float:
        """Return the variance of the difference of a block now: it grows with the white noise.

        Of vibration both units have more, of a fault one.
        """
        white = min(one.white[axis], other.white[axis])
        known = self.white[axis]
        return self.spread[axis] * (white / known if white > known > 0.0 else 1.0)

    def blame(self, one: Unit, other: Unit, block: int) -> int:
        """Return which of the two has changed by more than motion does: 1, 2; 0: nobody knows.

        Along their difference, which has begun just now: either one's change is the motion, and the
        other's has the fault in it.
        """
        for n in range(SHORTEST, LONGEST + 1):
            first = block - n + 1
            if not (one.has(first - n, block) and other.has(first - n, block)):
                continue
            for sensor in range(2):
                if self.excess(one, other, block, n, sensor) <= 0.0:
                    continue
                x = y = length = var = 0.0
                for axis in range(3 * sensor, 3 * sensor + 3):
                    now, then = one.over(axis, first, block), one.over(axis, first - n, first - 1)
                    off = now - other.over(axis, first, block) - self.usual[axis]
                    x += off * (now - then)
                    now, then = (
                        other.over(axis, first, block),
                        other.over(axis, first - n, first - 1),
                    )
                    y += off * (now - then)
                    length += off * off
                    noise = self._noise(one, other, axis) / n
                    var += off * off * (noise + max(self.moves[axis], 0.0))
                # x and y times the length, var times its square. What differs has begun just now:
                # one of the two changes has it.
                if abs(x - y) < 0.5 * length:
                    continue
                ratio = 0.5 * (x * x - y * y) / (var + 1e-12 * length)
                if ratio > _LIKELIER and x * x > 4.0 * y * y:
                    return 1
                if ratio < -_LIKELIER and y * y > 4.0 * x * x:
                    return 2
        return 0

    def size(self, one: Unit, other: Unit, block: int, sensor: int) -> float:
        """Return by how much the last blocks differ beyond the usual."""
        total = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            off = one.over(axis, block - LONGEST + 1, block)
            off -= other.over(axis, block - LONGEST + 1, block)
            off -= self.usual[axis]
            total += off * off
        return math.sqrt(total)

    def std(self, sensor: int) -> float:
        """Return one sigma of the usual difference, of the worst axis."""
        if not self.is_known():
            return UNKNOWN
        worst = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            worst = max(worst, self.drift[axis] + self.spread[axis] / self.count)
        return math.sqrt(worst)


class Lanes:
    """All inertial units of a vehicle, by their samples in the order of their arrival."""

    def __init__(self, first: int = -1) -> None:
        """Begin without a sample; ``first`` is to be used before all others, -1: whoever speaks."""
        self.used = first
        """Number of the unit in use."""
        self.offset: Numbers6 = (0.0,) * 6
        """To be added to its readings."""
        self.is_shifted = False
        """Whether that is anything."""
        self.changes: list[Change] = []
        self.units: list[Unit] = []
        self._pairs: dict[tuple[int, int], Pair] = {}
        self.std: tuple[float, ...] = _SURE
        """What goes with the next sample that is used, as in :attr:`Change.std`: to be taken by
        :meth:`take_std`."""
        self.doubts = 0
        """How often two contradicted each other, and nobody knew which of them was wrong."""
        self._wanted: int = -1
        self._emitted_ns: int = _NEVER
        self._judged: int = _NEVER

    def want(self, number: int) -> None:
        """Use the unit that the autopilot uses from now on, as soon as it measures."""
        self._wanted = number

    def add(
        self,
        number: int,
        t_ns: int,
        gx: float,
        gy: float,
        gz: float,
        ax: float,
        ay: float,
        az: float,
        is_bad: bool = False,
    ) -> int:
        """Take a sample; return what becomes of it, one of ``LEFT``, ``USED``, ``CHANGED``.

        After ``CHANGED`` the last of :attr:`changes` says what is used now. ``is_bad``: the
        autopilot says that it is no measurement.
        """
        unit: Unit = self._unit(number)
        if self.used < 0:
            self.used = number
        is_used = number == self.used
        if t_ns <= unit.t_ns:
            if unit.t_ns - t_ns < 1_000_000_000:
                return USED if is_used else LEFT
            self._begin()
        why: str | None = None
        if not math.isfinite(gx + gy + gz + ax + ay + az):
            why = NOT_A_NUMBER
        elif is_bad:
            why = UNHEALTHY
        else:
            why = unit.take(t_ns, gx, gy, gz, ax, ay, az)
            if why is None and unit.chance < CHANCE:
                why = AXIS
        if why is not None:
            self._note(unit, why, t_ns)
        if is_used:
            if why is not None and self._leave(why, t_ns):
                return CHANGED
            if self._follows_choice(t_ns) or self._judge(t_ns):
                return CHANGED
            self._emitted_ns = t_ns
            return USED
        if why is None:
            unit.waiting.append((t_ns, gx, gy, gz, ax, ay, az))
            if len(unit.waiting) > _WAITING:
                del unit.waiting[0]
        used: Unit = self._unit(self.used)
        is_silent = used.t_ns != _NEVER and used.is_silent(t_ns)
        if (is_silent and self._leave(SILENT, t_ns)) or self._judge(t_ns):
            return CHANGED
        return LEFT

    def use(self, number: int, t_ns: int) -> None:
        """Use a unit from now on, for a reason that is not one of these; note it as a change."""
        if number == self.used:
            return
        used: Unit = self._unit(self.used)
        if used.t_ns == _NEVER:
            self.used = number
        else:
            self._change(self._unit(number), CHOSEN, t_ns)

    def take_std(self) -> tuple[float, ...]:
        """Return what goes with the sample that is used now, once."""
        std = self.std
        self.std = _SURE
        return std

    def knows(self, number: int) -> bool:
        """Return whether the usual difference of a unit from that in use is known."""
        return self._pair(self.used, number).is_known()

    def resume(self, number: int, offset: Numbers6) -> None:
        """Go on with a unit, and what is to be added to its readings, of a run before."""
        self.used, self.offset = number, offset
        self.is_shifted = offset != (0.0,) * 6

    def has_spare(self, t_ns: int) -> bool:
        """Return whether another unit speaks steadily, and often enough to be gone to."""
        used: Unit = self._unit(self.used)
        for unit in self.units:
            one: Unit = unit
            is_slow = one.dt * _SHARE > used.dt > 0.0
            if one is not used and one.is_steady() and not one.is_silent(t_ns) and not is_slow:
                return True
        return False

    def unit(self, number: int) -> Unit:
        """Return a unit by its number."""
        return self._unit(number)

    def _unit(self, number: int) -> Unit:
        place = 0
        for one in self.units:
            unit: Unit = one
            if unit.number == number:
                return unit
            place += unit.number < number
        found = Unit(number)
        self.units.insert(place, found)
        return found

    def _begin(self) -> None:
        """Begin anew with another clock; the unit in use, and its biases, stay."""
        self._judged = self._emitted_ns = _NEVER
        for unit in self.units:
            unit.begin()
            unit.failed_ns = _NEVER
        for pair in self._pairs.values():
            pair.since = _NEVER

    def _note(self, unit: Unit, why: str, t_ns: int) -> None:
        """Note that a unit fails now."""
        if not unit.has_failed(t_ns):
            unit.faults += 1
        if unit.fault_ns == _NEVER:
            unit.fault_ns = t_ns
        unit.failed_ns, unit.why = t_ns, why

    def _pair(self, one: int, other: int) -> Pair:
        """Return the pair of two units, the lower number first."""
        key = (min(one, other), max(one, other))
        found = self._pairs.get(key)
        if found is None:
            found = self._pairs[key] = Pair()
        return found

    def _judge(self, t_ns: int) -> bool:
        """Compare the newest blocks that all units have whole; return whether the unit changes."""
        newest: int = -_NEVER
        count = 0
        for unit in self.units:
            one: Unit = unit
            if one.done != _NEVER and not one.is_silent(t_ns):
                count += 1
                newest = min(newest, one.done)
        if count < 2 or newest <= self._judged:
            return False
        self._judged = newest
        live = []
        for unit in self.units:
            one = unit
            if one.done >= newest and not one.is_silent(t_ns):
                live.append(one)
        self._compare(live, newest)
        used: Unit = self._unit(self.used)
        if used not in live:
            return False
        self._doubt(live, newest)
        is_wrong = False
        for unit in live:
            one = unit
            if self._is_wrong(one, live):
                self._note(one, STEP, t_ns)
                is_wrong = is_wrong or one is used
        return is_wrong and self._leave(STEP, t_ns)

    def _compare(self, live: list[Unit], block: int) -> None:
        """Compare each two units, but for those that may be stuck."""
        for place in range(len(live)):
            one: Unit = live[place]
            for following in range(place + 1, len(live)):
                other: Unit = live[following]
                if one.chance > _SUSPECT and other.chance > _SUSPECT:
                    self._pair(one.number, other.number).judge(one, other, block)

    def _doubt(self, live: list[Unit], block: int) -> None:
        """Let the biases be found anew, where nobody knows which of two units is wrong."""
        if len(live) != 2:
            return
        low: Unit = live[0]
        high: Unit = live[1]
        pair: Pair = self._pair(low.number, high.number)
        if pair.blamed or not pair.is_apart() or block - pair.since != _RECENT:
            return
        found = [0.0, 0.0]
        for sensor in range(2):
            if pair.excess(low, high, block, LONGEST, sensor) > 0.0:
                found[sensor] = pair.size(low, high, block, sensor)
        gyro, accel = found
        self.doubts += 1
        self.std = _together(
            self.std, (gyro, accel, _RECENT * _BLOCK * gyro, _RECENT * _BLOCK * accel)
        )

    def _is_wrong(self, one: Unit, live: list[Unit]) -> bool:
        """Return whether a unit is at fault: two others agree against it, or one is likelier."""
        apart = agree = blamed = 0
        for unit in live:
            other: Unit = unit
            if other is one:
                continue
            pair: Pair = self._pair(one.number, other.number)
            if not pair.is_known():
                continue
            if not pair.is_apart():
                agree += 1
                continue
            apart += 1
            blamed += pair.blamed == (1 if one.number < other.number else 2)
        if apart > 1:
            return apart > agree and self._are_together(one, live)
        return blamed > agree

    def _are_together(self, one: Unit, live: list[Unit]) -> bool:
        """Return whether two units that contradict one agree with each other."""
        for first in range(len(live)):
            for second in range(first + 1, len(live)):
                a: Unit = live[first]
                b: Unit = live[second]
                if a is one or b is one:
                    continue
                if not (self._contradict(one, a) and self._contradict(one, b)):
                    continue
                if self._pair(a.number, b.number).is_known() and not self._contradict(a, b):
                    return True
        return False

    def _contradict(self, one: Unit, other: Unit) -> bool:
        pair: Pair = self._pair(one.number, other.number)
        return pair.is_apart()

    def _follows_choice(self, t_ns: int) -> bool:
        """Change to the unit that the autopilot uses; return whether."""
        if self._wanted < 0 or self._wanted == self.used:
            self._wanted = -1
            return False
        wanted: Unit = self._unit(self._wanted)
        if not self._may_use(wanted, t_ns):
            return False
        self._wanted = -1
        self._change(wanted, CHOSEN, t_ns)
        return True

    def _may_use(self, one: Unit, t_ns: int) -> bool:
        """Return whether a unit is one to go to."""
        if not one.is_steady() or one.is_silent(t_ns) or one.chance < _SUSPECT:
            return False
        return not one.has_failed(t_ns)

    def _leave(self, why: str, t_ns: int) -> bool:
        """Leave the unit in use for another, if one measures; return whether."""
        used: Unit = self._unit(self.used)
        best: Unit | None = None
        for unit in self.units:
            one: Unit = unit
            if one is used or not self._may_use(one, t_ns) or one.dt * _SHARE > used.dt > 0.0:
                continue
            if why not in (STUCK, ZERO) and not self.knows(one.number):
                continue
            # One that never failed before one that did
            if best is None or best.failed_ns > one.failed_ns:
                best = one
        if best is None:
            return False
        self._wanted = -1
        self._note(used, why, t_ns)
        self._change(best, why, t_ns)
        return True

    def _change(self, to: Unit, why: str, t_ns: int) -> None:
        """Use another unit, whose readings are continued by the usual difference."""
        used: Unit = self._unit(self.used)
        pair: Pair = self._pair(used.number, to.number)
        sign = 1.0 if used.number < to.number else -1.0
        offset = self.offset
        if pair.is_known():
            offset = (
                offset[0] + sign * pair.usual[0],
                offset[1] + sign * pair.usual[1],
                offset[2] + sign * pair.usual[2],
                offset[3] + sign * pair.usual[3],
                offset[4] + sign * pair.usual[4],
                offset[5] + sign * pair.usual[5],
            )
        turned, gained = (0.0, 0.0) if why == CHOSEN else self._misled(used, to, pair, sign)
        ready = tuple([one for one in to.waiting if one[0] > self._emitted_ns])
        for unit in self.units:
            unit.waiting.clear()
        std = pair.std(0), pair.std(1), turned, gained
        self.std = _together(self.std, std)
        self.changes.append(Change(t_ns, used.number, to.number, why, offset, std, ready))
        self.used, self.offset, self.is_shifted = to.number, offset, True
        if ready:
            self._emitted_ns = ready[len(ready) - 1][0]

    def _misled(self, used: Unit, to: Unit, pair: Pair, sign: float) -> tuple[float, float]:
        """Return what the unit that is left has lately turned and gained beside the other."""
        block = min(used.done, to.done)
        total = [0.0] * 6
        count = 0
        if not pair.is_known() or block == _NEVER:
            return 0.0, 0.0
        for n in range(block - _RECENT + 1, block + 1):
            if used.has(n, n) and to.has(n, n):
                count += 1
                for axis in range(6):
                    off = sign * (used.mean[n % 8][axis] - to.mean[n % 8][axis])
                    total[axis] += off - pair.usual[axis]
        if count == 0:
            return 0.0, 0.0
        # and as much in the block that is not over
        length = _BLOCK * (count + 1) / count
        turned, gained = math.hypot(*total[:3]), math.hypot(*total[3:])
        return length * turned, length * gained

    def shifted(self, sample: Numbers6) -> Numbers6:
        """Return a reading of the unit in use, continued from those before."""
        o, s = self.offset, sample
        return s[0] + o[0], s[1] + o[1], s[2] + o[2], s[3] + o[3], s[4] + o[4], s[5] + o[5]

    # Logs: many samples

    def follow(
        self,
        first: int,
        number: Const[Column[np.int64]],
        t_ns: Const[Column[np.int64]],
        values: Const[Table[np.float64]],
        is_bad: Const[Column[np.uint8]],
        is_used: Column[np.uint8],
    ) -> int:
        """Take rows from one on until the unit changes; return the row after, or their number."""
        end: int = t_ns.shape[0]
        for n in range(first, end):
            became = self.add(
                number[n],
                t_ns[n],
                values[n, 0],
                values[n, 1],
                values[n, 2],
                values[n, 3],
                values[n, 4],
                values[n, 5],
                is_bad[n] != 0,
            )
            is_used[n] = became == USED
            if became == CHANGED or self.std is not _SURE:
                return n + 1
        return end


def used_rows(
    lanes: Lanes, number: Stamps, t_ns: Stamps, values: Array, is_bad: Mask
) -> tuple[Stamps, Stamps, Array]:
    """Return the samples in use of those of all units, in the order of their arrival.

    Args:
        lanes: The units, after all rows before.
        number: Of the unit of each row, shape (n,).
        t_ns: Stamps, shape (n,).
        values: Rate (rad/s) and specific force (m/s^2), shape (n, 6).
        is_bad: Which rows are no measurement by the autopilot's own word, shape (n,).

    Returns:
        At which row each sample arrives, shape (m,), its stamp, shape (m,), and its values with
        the numbers of :attr:`Change.std`, shape (m, 10): 0 but for the first of another unit.
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    is_used, bad = np.zeros(len(t_ns), dtype=np.uint8), is_bad.view(np.uint8)
    rows: list[Stamps] = []
    times: list[Stamps] = []
    found: list[Array] = []
    first = 0
    while first < len(t_ns):
        offset, changes, std = np.array(lanes.offset), len(lanes.changes), lanes.take_std()
        end = lanes.follow(first, number, t_ns, values, bad, is_used)
        at = first + np.flatnonzero(is_used[first:end])
        rows.append(at)
        times.append(t_ns[at])
        found.append(_with_std(values[at] + offset if offset.any() else values[at], std))
        if not len(at):
            lanes.std = _together(std, lanes.std)
        if len(lanes.changes) > changes and (ready := lanes.changes[changes].ready):
            samples = np.array([one[1:] for one in ready]) + np.array(lanes.offset)
            rows.append(np.full(len(ready), end - 1, dtype=np.int64))
            times.append(np.array([one[0] for one in ready], dtype=np.int64))
            found.append(_with_std(samples, lanes.take_std()))
        first = end
    return np.concatenate(rows), np.concatenate(times), np.concatenate(found)


def _with_std(values: Array, std: tuple[float, ...]) -> Array:
    found = np.zeros((len(values), 6 + STDS))
    found[:, :6] = values
    found[:1, 6:] = std
    return found


def _together(one: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
    if one is _SURE or other is _SURE:
        return other if one is _SURE else one
    return tuple([math.hypot(a, b) for a, b in zip(one, other, strict=True)])
