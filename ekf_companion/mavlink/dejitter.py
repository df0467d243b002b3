"""Stamps taken when a message was sent, corrected to when its sample was taken.

ArduPilot stamps an inertial message when it sends it. The sample was taken at the beginning of that
cycle of its main loop; the stamp is late by what else the loop did first: up to a cycle, and never
early. Whole milliseconds decide which cycles send, so these are uneven, but every sample lies on
the grid of the cycles. So the period of the loop is sought among the known ones; the line below all
stamps, which some touch, is the grid; and a stamp is moved back to the cycle before it. The line is
raised to the least late of every 8 stamps, which costs an eighth of the mean lateness and finds a
loop that overran within some 0.1 s; how far it had to move corrects the period.

Other autopilots truncate a sample's stamp to whole milliseconds. Those stamps are set on the line
of their own period, in the middle of their millisecond.

The lateness of sending has no memory: that of one stamp does not depend on the one before. Where it
does (a loop that overruns its cycles), where it fills the whole cycle, and where nothing is to be
gained, stamps are left as they are.

The lower envelope as an estimator of one-way delays: Moon, Skelly and Towsley, "Estimation and
removal of clock skew from network delay measurements", INFOCOM 1999; of a sensor's stamps: Olson,
"A passive solution to the sensor synchronization problem", IROS 2010.
"""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import cython

LOOPS_US = (2500.0, 1e4 / 3.0, 2000.0, 1250.0)
"""Cycles of ArduPilot's loop, the commonest first: SCHED_LOOP_RATE of 400, 300, 500 and 800 Hz. No
stamp is moved by more than a cycle. Longer ones are left out: two or four cycles look like one
where only every other or fourth sends."""
LINE = 8
"""Stamps between two corrections of the line."""
BLOCK = 4 * LINE
"""Stamps between two corrections of the period, and of the statistics of the lateness."""
LEARNING = 128
"""Stamps in which the period is sought."""
SETTLED = 24
"""Blocks until line, period and lateness are known well enough."""
_AGAIN = 64
"""Blocks without any use, after which the period is sought again."""
_CONCENTRATED = 0.55
"""Length of the mean of unit vectors, a cycle being a full circle: how well stamps must keep to it.
Exponential lateness of 0.24 cycles, 0.6 ms of a 400 Hz loop, gives as much."""
_COARSE = 2.5
"""Resolutions; whether stamps keep to a shorter cycle cannot be seen."""
_EVEN = 20_000.0
"""ns, mean change of lateness; below it nothing is to be gained."""
_WIDE = 0.2
"""Of a cycle, standard deviation of lateness: spread evenly over a cycle it is 0.29."""
_MEMORY = 0.12
"""Without memory the mean square of the change of lateness, over one step or two, is twice the
variance. It may differ by this share: three sigma of the mean over some forty blocks."""
_HYSTERESIS = 1.2
_EARLY = 0.1
"""Cycles; a stamp may be so much before the line, which is then brought down to it."""
_CUT = 1.2
"""Resolutions; a lateness within it comes from the truncation alone."""
_CORRECTION = 0.3
"""Share of the line's movement that is attributed to the period."""
_SLIP = 0.2
"""Cycles; a line that moves more within a block follows a loop that overran."""
_FORGETTING = 0.05
"""Weight of the newest block in the statistics of the lateness."""
_LONGEST = 2_000_000_000
"""ns; after such a gap everything is estimated anew."""


class Dejitter:
    """Corrects the stamps of one stream of messages, without any time of arrival."""

    def __init__(self, resolution_us: int = 1) -> None:
        """Begin with nothing known, for stamps that are truncated to a resolution."""
        self._half: int = resolution_us * 500 if resolution_us > 1 else 0
        self.last = -1
        """Stamp of the last sample, ns."""
        self._out = -1
        self._grid = 0
        self._learn_anew()

    def _learn_anew(self) -> None:
        self.is_active = False
        """Whether stamps are being corrected."""
        self.period = 0.0
        """Of the grid, ns; 0: not known yet."""
        self.spread = 0.0
        """Mean change of lateness from one stamp to the next, ns."""
        self._stamps: list[int] = []
        self._near = self._far = self._variance = 0.0
        self._blocks = 0

    def _begin_block(self) -> None:
        self._lates: list[float] = []  # by the line as it was at the block's begin
        self._least: float = math.inf
        self._moved = 0.0
        self._cycles = 0
        self._left = LINE

    def smooth(self, stamp_us: int) -> int:
        """Return the time of a sample, ns: later than all before, unless its stamp is not."""
        now = stamp_us * 1000
        if now <= self.last:
            return self._smooth_late(now)
        if now - self.last > _LONGEST:
            self._learn_anew()
        self.last = now
        if self.period == 0.0:
            self._learn(now)
            self._out = now
            return now

        # Which cycle was it, and how late in it?
        ahead = now - self._grid
        cycles = cython.cast(cython.longlong, ahead * self._per_cycle + _EARLY)
        if cycles < 1:
            late: float = math.inf  # no cycle of its own
        else:
            self._cycles += cycles
            late = ahead - cycles * self.period
            if late < 0.0:
                self._moved += late
                late = 0.0
            if late < self._least:
                self._least = late
            self._grid = now - cython.cast(cython.longlong, late)
            self._lates.append(late + self._moved)
            self._left -= 1
            if self._left == 0:
                late = self._let_up(late)

        out = self._grid + self._half if self.is_active and late < math.inf else now
        if out <= self._out:
            out = max(self._out + 1, now)
        self._out = out
        return out

    def _smooth_late(self, now: int) -> int:
        """Return the time of a sample that comes after later ones: its cycle by the line of now."""
        if not self.is_active:
            return now
        cycles = math.floor((now - self._grid) * self._per_cycle + _EARLY)
        return self._grid + round(cycles * self.period) + self._half

    def _learn(self, now: int) -> None:
        """Seek a period to which the stamps keep."""
        self._stamps.append(now)
        if len(self._stamps) < LEARNING:
            return
        stamps, self._stamps = self._stamps, []
        first = stamps[0]
        for loop in (loop_us * 1e3 for loop_us in LOOPS_US):
            circle = sum(cmath.exp(2j * math.pi / loop * (stamp - first)) for stamp in stamps)
            if abs(circle) > _CONCENTRATED * LEARNING and loop >= _COARSE * 2 * self._half:
                self._take_period(loop, now, True)
                return
        if self._half:
            steps = sorted(b - a for a, b in pairwise(stamps))
            middle = steps[len(steps) // 2]
            usual = [step for step in steps if 0.5 * middle < step < 1.5 * middle]
            self._take_period(sum(usual) / len(usual), now, False)

    def _take_period(self, period: float, now: int, is_loop: bool) -> None:
        self.period = period
        self._per_cycle: float = 1.0 / period
        self._is_loop = is_loop
        self._grid = now
        self._most = 0.0
        self._begin_block()

    def _let_up(self, late: float) -> float:
        """Raise the line to the least late stamp; return how late the newest one is by it."""
        self._grid += int(self._least)
        self._moved += self._least
        late -= self._least
        self._least, self._left = math.inf, LINE
        if len(self._lates) == BLOCK:
            self._settle()
        return late

    def _settle(self) -> None:
        """Correct the period by the line's movement; decide by the lateness whether to go on."""
        if abs(self._moved) < _SLIP * self.period:
            self.period += _CORRECTION * self._moved / self._cycles
            self._per_cycle = 1.0 / self.period
        self._blocks += 1
        self._update_statistics(self._lates)
        self.is_active = self._blocks >= SETTLED and self._is_to_be_moved()
        self._begin_block()
        if self._blocks % _AGAIN == 0 and not self.is_active:
            self._learn_anew()

    def _update_statistics(self, lates: list[float]) -> None:
        """Update the statistics of the lateness by a block."""
        near = [b - a for a, b in pairwise(lates)]
        far = [b - a for a, b in zip(lates, lates[2:], strict=False)]
        mean = sum(lates) / BLOCK
        variance = sum((late - mean) ** 2 for late in lates) / (BLOCK - 1)
        weight = max(_FORGETTING, 1.0 / self._blocks)
        self.spread += weight * (sum(map(abs, near)) / len(near) - self.spread)
        self._near += weight * (sum(d * d for d in near) / len(near) - self._near)
        self._far += weight * (sum(d * d for d in far) / len(far) - self._far)
        self._variance += weight * (variance - self._variance)
        self._most = max(max(lates) - min(lates), 0.95 * self._most)

    def _is_to_be_moved(self) -> bool:
        """Whether the lateness is that of sending, or of truncation."""
        wider = _HYSTERESIS if self.is_active else 1.0
        if self.spread * wider < _EVEN:
            return False
        if not self._is_loop:
            return self._most < 2 * self._half * _CUT * wider
        memory = max(abs(self._near - 2 * self._variance), abs(self._far - 2 * self._variance))
        return (
            math.sqrt(self._variance) < _WIDE * wider * self.period
            and memory < _MEMORY * wider * 2 * self._variance
        )
