"""Which of several inertial units is used, and when it is left (compiled).

Every unit is watched, one is used. Their mean rates and forces over blocks of one clock are
compared: the usual difference of two units is that of their biases and is learnt, so that each has
its own; what goes beyond it is a fault of one of the two (:mod:`.inertial_pair`). Whose it is, a
third unit says, and their own changes: that of the one is the motion if the other is at fault, and
the likelier motion decides. Where both may be, nobody is blamed, and the biases are found anew.

A unit is left at once where it repeats its readings, is at the end of its range while another is
not, falls silent, or is found at fault. The next one's readings are continued by the usual
difference, so that the biases that were estimated hold on; by how much they may not, and what the
unit that is left has done until then, goes with its first sample. There is no way back but the
same.

The units, their pairs and which one is used only ever change together: so one class holds them,
in a long file.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekf_companion.nav.arrays import Array, Column, Const, Mask, Stamps, Table
from ekf_companion.nav.inertial_pair import LONGEST, SHORTEST, Pair
from ekf_companion.nav.inertial_unit import (
    BLOCK,
    BLOCK_NS,
    KEPT,
    NEVER,
    STEP,
    SUSPECT,
    Unit,
    Waiting,
)
from ekf_companion.nav.repetition import AXIS, CHANCE, SPIKE, STUCK, ZERO

MOST = 4
"""Units that are watched: autopilots have three, and others four."""
SHARE = 0.25
"""Of the rate of the unit in use, that another has at least: a finer or better one at less than a
quarter of the rate loses more than it gains."""
_LIKELIER = math.log(100.0)
"""Log-likelihood ratio beyond which one of two is at fault and not the other."""
_RECENT = 5
"""Blocks, 0.2 s, in which the unit that is left may have been wrong."""
_WAITING = 32
"""Samples that are kept of a spare unit: those of 0.1 s at 250 Hz."""

LEFT, USED, CHANGED = range(3)
"""What becomes of a sample: it is not used, it is, or the unit has changed."""
SILENT = "silent"
NOT_A_NUMBER = "not a number"
UNHEALTHY = "unhealthy by the autopilot's own word"
CHOSEN = "not the one that the autopilot uses"
"""Why a unit is left, beside ``STEP`` and the reasons of :mod:`.repetition`."""
STDS = 4
"""Numbers of a change: see :attr:`Change.std`."""
_SURE = (0.0,) * STDS

Numbers6 = tuple[float, float, float, float, float, float]


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
        self._emitted_ns: int = NEVER
        self._judged: int = NEVER

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
        if not self.has_room(number):
            return LEFT
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
            if why == SPIKE:
                # One sample that is left out where it is read is no reason to leave the unit
                return USED if is_used else LEFT
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
        is_silent = used.t_ns != NEVER and used.is_silent(t_ns)
        if (is_silent and self._leave(SILENT, t_ns)) or self._judge(t_ns):
            return CHANGED
        return LEFT

    def use(self, number: int, t_ns: int) -> None:
        """Use a unit from now on, for a reason that is not one of these; note it as a change."""
        if number == self.used:
            return
        used: Unit = self._unit(self.used)
        if used.t_ns == NEVER:
            self.used = number
        else:
            self._change(self._unit(number), CHOSEN, t_ns)

    def take_std(self) -> tuple[float, ...]:
        """Return what goes with the sample that is used now, once."""
        std = self.std
        self.std = _SURE
        return std

    def is_plain(self) -> bool:
        """Return whether a sample of the unit in use is used as it is, with nothing beside it."""
        return not self.is_shifted and self.std is _SURE

    def knows(self, number: int) -> bool:
        """Return whether the usual difference of a unit from that in use is known."""
        return self.pair(self.used, number).is_known()

    def has_room(self, number: int) -> bool:
        """Return whether a unit is watched, or may be."""
        for unit in self.units:
            one: Unit = unit
            if one.number == number:
                return True
        return len(self.units) < MOST or number == self.used

    def resume(self, number: int, offset: Numbers6) -> None:
        """Go on with a unit, and what is to be added to its readings, of a run before."""
        self.used, self.offset = number, offset
        self.is_shifted = offset != (0.0,) * 6

    def has_spare(self, t_ns: int) -> bool:
        """Return whether another unit speaks steadily, and often enough to be gone to."""
        used: Unit = self._unit(self.used)
        for unit in self.units:
            one: Unit = unit
            is_slow = one.dt * SHARE > used.dt > 0.0
            if one is not used and one.is_steady() and not one.is_silent(t_ns) and not is_slow:
                return True
        return False

    def is_starving(self, number: int, t_ns: int) -> bool:
        """Return whether the unit in use is much slower than another that measures."""
        used: Unit = self._unit(self.used)
        one: Unit = self._unit(number)
        return used.dt * SHARE > one.dt and self._may_use(one, CHOSEN, t_ns)

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
        self._judged = self._emitted_ns = NEVER
        for unit in self.units:
            unit.begin()
            unit.failed_ns = NEVER
        for pair in self._pairs.values():
            pair.since = NEVER

    def _note(self, unit: Unit, why: str, t_ns: int) -> None:
        """Note that a unit fails now."""
        if not unit.has_failed(t_ns):
            unit.faults += 1
        elif why == AXIS and unit.why == STUCK:
            why = STUCK  # its axes are as they were
        if unit.fault_ns == NEVER:
            unit.fault_ns = t_ns
        unit.failed_ns, unit.why = t_ns, why

    def pair(self, one: int, other: int) -> Pair:
        """Return the pair of two units, the lower number first."""
        key = (min(one, other), max(one, other))
        found = self._pairs.get(key)
        if found is None:
            found = self._pairs[key] = Pair()
        return found

    def _judge(self, t_ns: int) -> bool:
        """Compare the newest blocks that all units have whole; return whether the unit changes."""
        newest: int = -NEVER
        count = 0
        for unit in self.units:
            one: Unit = unit
            if self._is_live(one, t_ns):
                count += 1
                newest = min(newest, one.done)
        if count < 2 or newest <= self._judged:
            return False
        self._judged = newest
        live = []
        for unit in self.units:
            one = unit
            if self._is_live(one, t_ns):
                live.append(one)
        self._compare(live, newest)
        used: Unit = self._unit(self.used)
        if used not in live:
            return False
        self._doubt(used, live, newest)
        is_wrong = False
        for unit in live:
            one = unit
            if self._is_wrong(one, live):
                self._note(one, STEP, t_ns)
                is_wrong = is_wrong or one is used
        return is_wrong and self._leave(STEP, t_ns)

    def _is_live(self, one: Unit, t_ns: int) -> bool:
        """Return whether a unit has blocks to be compared."""
        return t_ns // BLOCK_NS - one.done < KEPT and not one.is_silent(t_ns)

    def _compare(self, live: list[Unit], block: int) -> None:
        """Compare each two units, but for those that may be stuck."""
        for place in range(len(live)):
            one: Unit = live[place]
            for following in range(place + 1, len(live)):
                other: Unit = live[following]
                if one.chance > SUSPECT and other.chance > SUSPECT:
                    self.pair(one.number, other.number).judge(one, other, block)
        for place in range(len(live)):
            one = live[place]
            for following in range(place + 1, len(live)):
                other = live[following]
                pair: Pair = self.pair(one.number, other.number)
                if pair.is_apart() and pair.blamed == 0:
                    self._blame(one, other, live, block)

    def _blame(self, one: Unit, other: Unit, live: list[Unit], block: int) -> None:
        """Find which of two that contradict each other is at fault, if one is likelier."""
        pair: Pair = self.pair(one.number, other.number)
        for sensor in range(2):
            for n in range(SHORTEST, LONGEST + 1):
                if pair.excess(one, other, block, n, sensor) <= 0.0:
                    continue
                ratio = pair.by_change(one, other, block, n, sensor)
                for unit in live:
                    third: Unit = unit
                    if third is not one and third is not other:
                        ratio += self._by_third(one, other, third, block, n, sensor)
                if abs(ratio) > _LIKELIER:
                    pair.blamed = 1 if ratio > 0.0 else 2
                    return

    def _by_third(
        self, one: Unit, other: Unit, third: Unit, block: int, n: int, sensor: int
    ) -> float:
        """Return the log-likelihood ratio of a fault of one against one of the other, by a third.

        The third agrees with the one that is right: what the faulty one differs by from it is the
        difference of the two.
        """
        pair: Pair = self.pair(one.number, other.number)
        first: Pair = self.pair(one.number, third.number)
        second: Pair = self.pair(other.number, third.number)
        is_known = first.is_known() and second.is_known()
        if not (is_known and third.has(block - n, block)):
            return 0.0
        ratio = 0.0
        for axis in range(3 * sensor, 3 * sensor + 3):
            off = pair.off(one, other, block, n, axis)
            if one.number < third.number:
                beside = first.off(one, third, block, n, axis)
                var = first.variance(one, third, block, n, axis)
            else:
                beside = -first.off(third, one, block, n, axis)
                var = first.variance(third, one, block, n, axis)
            if other.number < third.number:
                var += second.variance(other, third, block, n, axis)
            else:
                var += second.variance(third, other, block, n, axis)
            ratio += off * (2.0 * beside - off) / (var + 1e-12)
        return ratio

    def _doubt(self, used: Unit, live: list[Unit], block: int) -> None:
        """Let the biases be found anew, where nobody knows whether the unit in use is wrong."""
        for unit in live:
            other: Unit = unit
            # One that has failed before is likelier to fail again
            if other is used or other.failed_ns > used.failed_ns:
                continue
            low = used if used.number < other.number else other
            high = other if low is used else used
            pair: Pair = self.pair(low.number, high.number)
            if pair.blamed or not pair.is_apart() or block - pair.since != _RECENT:
                continue
            found = [0.0, 0.0]
            for sensor in range(2):
                if pair.excess(low, high, block, LONGEST, sensor) > 0.0:
                    found[sensor] = pair.size(low, high, block, sensor)
            gyro, accel = found
            self.doubts += 1
            since = _RECENT * BLOCK
            self.std = _together(self.std, (gyro, accel, since * gyro, since * accel))

    def _is_wrong(self, one: Unit, live: list[Unit]) -> bool:
        """Return whether a unit is at fault by its difference from another."""
        for unit in live:
            other: Unit = unit
            pair: Pair = self.pair(one.number, other.number)
            blamed = 1 if one.number < other.number else 2
            if other is not one and pair.is_apart() and pair.blamed == blamed:
                return True
        return False

    def _follows_choice(self, t_ns: int) -> bool:
        """Change to the unit that the autopilot uses; return whether."""
        if self._wanted < 0 or self._wanted == self.used:
            self._wanted = -1
            return False
        wanted: Unit = self._unit(self._wanted)
        if not self._may_use(wanted, CHOSEN, t_ns):
            return False
        self._wanted = -1
        self._change(wanted, CHOSEN, t_ns)
        return True

    def _may_use(self, one: Unit, why: str, t_ns: int) -> bool:
        """Return whether a unit is one to go to from one that is left for a reason.

        Better than one that measures nothing is one that was off by a step.
        """
        if not one.is_steady() or one.is_silent(t_ns) or one.chance < SUSPECT:
            return False
        return not one.has_failed(t_ns) or (one.why == STEP and why not in (STEP, CHOSEN))

    def _leave(self, why: str, t_ns: int) -> bool:
        """Leave the unit in use for another, if one measures; return whether."""
        used: Unit = self._unit(self.used)
        best: Unit | None = None
        for unit in self.units:
            one: Unit = unit
            if one is used or not self._may_use(one, why, t_ns) or one.dt * SHARE > used.dt > 0.0:
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
        pair: Pair = self.pair(used.number, to.number)
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
        if not pair.is_known() or block == NEVER:
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
        length = BLOCK * (count + 1) / count
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
