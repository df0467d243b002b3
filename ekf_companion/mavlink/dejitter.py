"""Stamps taken when a message was sent, brought back to when its sample was taken.

ArduPilot stamps an inertial message as it sends it. The sample is of the beginning of the turn of
its main loop; by what else the loop did first, the stamp is late: up to a turn, and never early.
Which turns send is uneven, as whole milliseconds decide it, but every sample lies on the grid of
the loop's turns. So the period of the loop is looked for among those that there are; the line that
all stamps are above, and some on, is the grid; and a stamp goes back to the turn before it. The
line is let up to the least late of every 8 stamps, which costs an eighth of the mean lateness and
finds a loop that overran within some 0.1 s; what it had to move corrects the period.

Elsewhere whole milliseconds cut a sample's stamp down. They are set on the line of their own
period, in the middle of their millisecond.

Lateness of sending has no memory: one stamp's says nothing of the next's. Where it has (a loop
that overruns its turns), where it fills the whole turn, and where there is nothing to gain, stamps
are left as they are.

The lower envelope as an estimator of one-way delays: Moon, Skelly and Towsley, "Estimation and
removal of clock skew from network delay measurements", INFOCOM 1999; of a sensor's stamps: Olson,
"A passive solution to the sensor synchronization problem", IROS 2010.
"""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

LOOPS_US = (2500.0, 1e4 / 3.0, 2000.0, 1250.0)
"""Turns of ArduPilot's loop, from the commonest: SCHED_LOOP_RATE of 400, 300, 500 and 800 Hz. No
stamp is moved by more than a turn. Longer ones are left out: two or four turns look like one where
every second or fourth sends, until another does."""
LINE = 8
"""Stamps between two corrections of the line."""
BLOCK = 4 * LINE
"""Stamps between two corrections of the period, and looks at the lateness."""
LEARNING = 128
"""Stamps that the period is looked for in."""
SETTLED = 24
"""Blocks until line, period and lateness are known well enough."""
_AGAIN = 64
"""Blocks without a use, after which the period is looked for anew."""
_CONCENTRATED = 0.55
"""Length of the mean of unit vectors, the turn a full circle: how well stamps must keep to a turn.
Exponential lateness of 0.24 turns, 0.6 ms of a 400 Hz loop, gives as much."""
_COARSE = 2.5
"""Resolutions; to a shorter turn stamps cannot be seen to keep."""
_EVEN = 20_000.0
"""ns, mean change of lateness: below, nothing is to be gained."""
_WIDE = 0.2
"""Of a turn, standard deviation of lateness: spread evenly over a turn it is 0.29."""
_MEMORY = 0.12
"""Mean square of the change of lateness over one step, and two, each by twice the variance, is 1
without memory. By so much it may be off: three sigma of the mean over some forty blocks."""
_HYSTERESIS = 1.2
_EARLY = 0.1
"""Turns; a stamp may be so much before the line, which is then brought down to it."""
_CUT = 1.2
"""Resolutions; lateness within it is that of the cutting alone."""
_CORRECTION = 0.3
"""Share of what the line moved that is put down to the period."""
_SLIP = 0.2
"""Turns; a line that moves more within a block follows a loop that overran."""
_FORGETTING = 0.05
"""Weight of the newest block in what is known of the lateness."""
_LONGEST = 2_000_000_000
"""ns; after such a gap all is learnt anew."""


class Dejitter:
    """The stamps of one stream of messages, one after the other. No time of arrival enters."""

    __slots__ = (
        *("is_active", "period", "spread", "_blocks", "_far", "_grid", "_half", "_is_loop"),
        *("_last", "_lates", "_least", "_left", "_most", "_moved", "_near", "_out"),
        *("_per_turn", "_stamps", "_turns", "_variance"),
    )

    def __init__(self, resolution_us: int = 1) -> None:
        """Begin with nothing known.

        Args:
            resolution_us: Of the stamps, which are cut down to it.
        """
        self._half = resolution_us * 500 if resolution_us > 1 else 0
        self._last = self._out = -1
        self._grid = 0
        self._learn_anew()

    def _learn_anew(self) -> None:
        self.is_active = False
        """Whether stamps are being moved."""
        self.period = 0.0
        """Of the grid, ns; 0: it is being learnt."""
        self.spread = 0.0
        """Mean change of lateness from one stamp to the next, ns."""
        self._stamps: list[int] = []
        self._near = self._far = self._variance = 0.0
        self._blocks = 0

    def _begin_block(self) -> None:
        self._lates: list[float] = []  # by the line as it was at the block's begin
        self._least = math.inf
        self._moved = 0.0
        self._turns = 0
        self._left = LINE

    def smooth(self, stamp_us: int) -> int | None:
        """Give the time of a sample, ns, later than all before; None: it came out of order.

        Out of order is a stamp, while stamps are being moved, that is not after the one before.
        """
        now = stamp_us * 1000
        if now <= self._last:
            return None if self.is_active else now
        if now - self._last > _LONGEST:
            self._learn_anew()
        self._last = now
        if self.period == 0.0:
            self._learn(now)
            self._out = now
            return now

        # Which turn was it, and how late in it?
        ahead = now - self._grid
        turns = int(ahead * self._per_turn + _EARLY)
        if turns < 1:
            late = math.inf  # no turn of its own
        else:
            self._turns += turns
            late = ahead - turns * self.period
            if late < 0.0:
                self._moved += late
                late = 0.0
            if late < self._least:
                self._least = late
            self._grid = now - int(late)
            self._lates.append(late + self._moved)
            self._left -= 1
            if self._left == 0:
                late = self._let_up(late)

        out = self._grid + self._half if self.is_active and late < math.inf else now
        if out <= self._out:
            out = max(self._out + 1, now)
        self._out = out
        return out

    def _learn(self, now: int) -> None:
        """Look for a period whose turns the stamps keep to."""
        self._stamps.append(now)
        if len(self._stamps) < LEARNING:
            return
        stamps, self._stamps = self._stamps, []
        first = stamps[0]
        for loop in (loop_us * 1e3 for loop_us in LOOPS_US):
            circle = sum(cmath.exp(2j * math.pi / loop * (stamp - first)) for stamp in stamps)
            if abs(circle) > _CONCENTRATED * LEARNING and loop >= _COARSE * 2 * self._half:
                self._take_period(loop, now, is_loop=True)
                return
        if self._half:
            steps = sorted(b - a for a, b in pairwise(stamps))
            middle = steps[len(steps) // 2]
            usual = [step for step in steps if 0.5 * middle < step < 1.5 * middle]
            self._take_period(sum(usual) / len(usual), now, is_loop=False)

    def _take_period(self, period: float, now: int, *, is_loop: bool) -> None:
        self.period, self._per_turn = period, 1.0 / period
        self._is_loop = is_loop
        self._grid = now
        self._most = 0.0
        self._begin_block()

    def _let_up(self, late: float) -> float:
        """Let the line up to the least late; give how late the newest stamp is by that."""
        self._grid += int(self._least)
        self._moved += self._least
        late -= self._least
        self._least, self._left = math.inf, LINE
        if len(self._lates) == BLOCK:
            self._settle()
        return late

    def _settle(self) -> None:
        """Correct the period by what the line had to move, and look at the lateness."""
        if abs(self._moved) < _SLIP * self.period:
            self.period += _CORRECTION * self._moved / self._turns
            self._per_turn = 1.0 / self.period
        self._blocks += 1
        self._account(self._lates)
        self.is_active = self._blocks >= SETTLED and self._is_to_be_moved()
        self._begin_block()
        if self._blocks % _AGAIN == 0 and not self.is_active:
            self._learn_anew()

    def _account(self, lates: list[float]) -> None:
        """Keep what the block says of the lateness."""
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
        """Whether the lateness is that of sending, or of cutting."""
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
