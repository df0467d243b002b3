"""The autopilot's clock compared with ours: TIMESYNC both ways.

We ask at a time of ours, the autopilot answers with its own, and half of the round trip is taken
for the way back. Of the answers in a window the faster half are used, as the slower ones waited
somewhere on one way only; a line through them gives the autopilot's clock by ours.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.timebase import LAST_US


@dataclass(frozen=True, slots=True, kw_only=True)
class TimesyncOptions:
    """How to compare the clocks."""

    respond: bool = True
    """Whether the autopilot's own requests are answered (in its own time, once locked)."""
    request: bool = True
    """Whether we ask."""
    largest_rtt_ms: float = 10.0
    """Longer round trips are refused; PX4's bound."""


_FAST_NS = SECOND_NS // 10
_SLOW_NS = SECOND_NS
_OUTSTANDING = 16
_LOCK = 20
"""Good answers to lock on: 2 s at 10 Hz."""
_WINDOW = 100
_LOST_NS = 10 * SECOND_NS
"""The lock is lost without a good answer for so long: at 100 ppm the clocks are 1 ms apart then."""
_JUMPS = 5
"""After so many answers in a row that contradict it, the clock is another; PX4's number."""
_SKEW_SPAN_NS = 10 * SECOND_NS
"""A skew is fitted over no shorter span: at 0.1 ms of jitter it would be worse than none."""
_CRYSTAL = 500e-6
"""Crystals are better than 100 ppm; more is jitter, unless many answers prove it."""
_PROOF = 10.0
"""Sigmas of a skew beyond which it is proved."""
_PROVING = 4
"""Answers that may prove one: at 2 % the tenth would be taken for a jump otherwise."""
_LARGEST_SKEW = 0.2
"""A simulator on a busy machine runs a per cent or two slower than time."""
_SAME_NS = 2 * SECOND_NS
"""A request whose time is further from the autopilot's clock waited long, or has another's."""

FOREIGN, NO_TIME = "foreign", "no time"
"""Why an answer is refused: it is to no open request of ours; it holds no time."""


class Timesync(Service):
    """Estimates the offset of the autopilot's clock from ours; answers in the autopilot's time."""

    def __init__(self, outbox: Outbox, options: TimesyncOptions | None = None) -> None:
        self.handles = {"TIMESYNC": self._take}
        self._outbox = outbox
        self._target: dict[str, int] = {}
        self.options = options or TimesyncOptions()
        self.refused: Counter[str] = Counter()
        """Answers refused: ``foreign`` (not asked for by us), ``no time``, ``slow`` (a round trip
        too long), ``jump`` (another clock than before)."""
        self.watch_ns: int | None = None
        """The longest time between two requests while the answers also tell how late our messages
        arrive (:mod:`.delivery`); None: they do not matter."""
        self.on_request: Callable[[int], None] = lambda _: None
        """Called with the ``ts1`` of each request that is sent."""
        self._outstanding: deque[int] = deque(maxlen=_OUTSTANDING)
        self.reset()

    @property
    def _largest_rtt_ns(self) -> float:
        return self.options.largest_rtt_ms * 1e6

    def reset(self) -> None:
        """Forget the peer's clock: it rebooted or was lost."""
        self._outstanding.clear()
        self._next_ns: int | None = None
        self._rtts: deque[int] = deque(maxlen=_WINDOW)
        self.answers = 0
        """Good ones."""
        self._begin_waiting()
        self._forget()

    def _begin_waiting(self) -> None:
        """Count anew what was asked and refused since the last good answer."""
        self._unanswered = 0
        self._useless: Counter[str] = Counter()

    def _forget(self) -> None:
        """Forget the clock."""
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=_WINDOW)  # middle, offset, rtt
        self._jumps = 0
        self._has_jumped = False
        """Whether the clock was forgotten as it jumped."""
        self._fit: tuple[int, int, float] | None = None  # at, offset then, skew
        self.residual_ns = math.nan
        """RMS distance of the answers that are used from the line through them; NaN: too few."""

    @property
    def is_idle(self) -> bool:
        """Whether nothing was requested and nothing is known: no message changes that."""
        return not self._outstanding and not self._samples and self._fit is None

    @property
    def is_locked(self) -> bool:
        """Whether the offset is known well enough to answer with it."""
        # An offset is wrong by half a round trip at most; a scatter as wide as that tells no more
        # than the bound
        return len(self._samples) >= _LOCK and self.residual_ns <= 0.25 * self._largest_rtt_ns

    @property
    def trouble(self) -> str:
        """Why the offset is not known; empty: it is, or too few answers have come to say."""
        if self.is_locked or not self.options.request:
            return ""
        if len(self._samples) >= _LOCK:
            return (
                f"answers scatter by {self.residual_ns * 1e-6:.1f} ms: the clock runs unevenly, as "
                "a simulator's does on a busy machine"
            )
        if self.rtt_ns(50) > self._largest_rtt_ns:
            return f"answers take {self.rtt_ns(50) * 1e-6:.0f} ms there and back"
        if self._jumps:
            return "the clock jumps"
        if self._unanswered >= _LOCK:
            return self._silence()
        if self._has_jumped:
            return f"the clock jumped; {len(self._samples)} of {_LOCK} good answers since"
        return ""

    def _silence(self) -> str:
        """Return why no good answer has come for a while."""
        if self._useless[FOREIGN]:
            return (
                f"{self._useless[FOREIGN]} answers came, none to one of our last "
                f"{_OUTSTANDING} requests"
            )
        if self._useless[NO_TIME]:
            return f"{self._useless[NO_TIME]} answers came that hold no time"
        return f"{self._unanswered} requests without an answer"

    @property
    def skew(self) -> float:
        """How much faster the autopilot's clock runs than ours, s/s; 0 until known."""
        return self._fit[2] if self._fit else 0.0

    def rtt_ns(self, percent: int) -> float:
        """Return a percentile of the round trips, slow ones included; NaN: nothing was answered."""
        rtts = sorted(self._rtts)
        return rtts[len(rtts) * percent // 100] if rtts else math.nan

    def begin(self, peer: PeerFound) -> None:
        """Forget what was learned of the autopilot's clock."""
        self._target = peer.target
        self.reset()

    def tick(self, now_ns: int) -> None:
        """Send a request if one is due."""
        ts1 = self.request(now_ns)
        if ts1 is not None:
            self.on_request(ts1)
            self._send(0, ts1, now_ns)

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.tc1 != 0:
            self.receive(message.tc1, message.ts1, now_ns)
        elif (tc1 := self.answer(message.ts1, now_ns)) is not None:
            self._send(tc1, message.ts1, now_ns)

    def _send(self, tc1: int, ts1: int, now_ns: int) -> None:
        payload = pack("TIMESYNC", tc1=tc1, ts1=ts1, **self._target)
        self._outbox.send("TIMESYNC", payload, now_ns)

    def peer_ns(self, now_ns: int) -> int | None:
        """Return the autopilot's clock at a time of ours; None until locked."""
        self._notice_silence(now_ns)
        if self._fit is None or not self.is_locked:
            return None
        at, offset, skew = self._fit
        return now_ns + offset + round(skew * (now_ns - at))

    def request(self, now_ns: int) -> int | None:
        """Return the ``ts1`` of a request if one is due.

        They are at 10 Hz until locked, then at 1 Hz, unless the answers are watched.
        """
        self._notice_silence(now_ns)
        if not self.options.request or (self._next_ns is not None and now_ns < self._next_ns):
            return None
        is_settled = self.is_locked and not self._jumps
        self._next_ns = now_ns + (self.watch_ns or (_SLOW_NS if is_settled else _FAST_NS))
        self.note_request(now_ns)
        return now_ns

    def note_request(self, ts1: int) -> None:
        """Wait for the answer to a request of ours: one that is sent, or stands in a recording."""
        self._outstanding.append(ts1)
        self._unanswered += 1

    def answer(self, ts1: int, now_ns: int) -> int | None:
        """Return the ``tc1`` for a request; None if it is not to be answered (yet).

        A request says what time it was there when it left: half a usual round trip later it comes.
        That holds also for a clock that runs unevenly, as a simulator's on a busy machine, whose
        time by ours is soon off by tens of ms; the asker would take these off our stamps.
        """
        peer_ns = self.peer_ns(now_ns) if self.options.respond else None
        if peer_ns is not None and abs(peer_ns - ts1) < _SAME_NS:
            peer_ns = ts1 + round(self.rtt_ns(50) / 2)
        # 0 would ask again
        return peer_ns or None

    def receive(self, tc1: int, ts1: int, now_ns: int) -> None:
        """Use an answer of the autopilot, if it is to an open request of ours."""
        if ts1 not in self._outstanding:
            self._refuse(FOREIGN)
            return
        self._outstanding.remove(ts1)
        rtt = now_ns - ts1
        if rtt < 0 or abs(tc1) > LAST_US * 1000:
            self._refuse(NO_TIME)
            return
        self._rtts.append(rtt)
        if rtt > self._largest_rtt_ns:
            self.refused["slow"] += 1
            return

        middle = ts1 + rtt // 2
        offset = tc1 - middle
        if self._is_jump(middle, offset):
            self.refused["jump"] += 1
            self._jumps += 1
            self._next_ns = now_ns  # to know soon
            if self._jumps < _JUMPS:
                return
            self._forget()
            self._has_jumped = True
        self._jumps = 0
        self.answers += 1
        self._begin_waiting()
        self._samples.append((middle, offset, rtt))
        self._refit()

    def _refuse(self, why: str) -> None:
        self.refused[why] += 1
        self._useless[why] += 1

    def _is_jump(self, middle: int, offset: int) -> bool:
        """Whether an offset is further from the line than any way and any crystal explain."""
        if self._fit is None:
            return False
        at, known, skew = self._fit
        elapsed = middle - at
        explained = self._largest_rtt_ns + _CRYSTAL * abs(elapsed)
        return abs(offset - known - skew * elapsed) > explained

    def _notice_silence(self, now_ns: int) -> None:
        """Lose the lock where the last good answer is too long ago."""
        if self._samples and now_ns - self._samples[-1][0] > _LOST_NS:
            self._forget()

    def _refit(self) -> None:
        """Fit a line through the faster half of the answers: the slow ones waited one way."""
        limit = sorted(sample[2] for sample in self._samples)[len(self._samples) // 2]
        fast = [sample for sample in self._samples if sample[2] <= limit]
        at, base, _ = fast[-1]
        points = [(middle - at, offset - base) for middle, offset, _ in fast]
        mean_age, mean = (sum(column) / len(fast) for column in zip(*points, strict=True))
        skew = _skew(points, mean_age, mean)
        constant = mean - skew * mean_age
        self._fit = (at, base + round(constant), skew)
        self.residual_ns = _scatter(points, constant, skew)


def _skew(points: list[tuple[int, int]], mean_age: float, mean: float) -> float:
    """Return the slope of offsets over their ages, ns: 0 over a short span, unless it is proved."""
    square = sum((age - mean_age) ** 2 for age, _ in points)
    if len(points) < _PROVING or square == 0.0:
        return 0.0
    slope = sum((age - mean_age) * offset for age, offset in points) / square
    freedom = len(points) / (len(points) - 2) / square
    sigma = _scatter(points, mean - slope * mean_age, slope) * math.sqrt(freedom)
    if abs(slope) > max(_CRYSTAL, _PROOF * sigma):
        return min(max(slope, -_LARGEST_SKEW), _LARGEST_SKEW)
    is_long = points[-1][0] - points[0][0] >= _SKEW_SPAN_NS
    return min(max(slope, -_CRYSTAL), _CRYSTAL) if is_long else 0.0


def _scatter(points: list[tuple[int, int]], constant: float, skew: float) -> float:
    """Return the RMS distance of offsets from a line, ns."""
    squares = sum((offset - constant - skew * age) ** 2 for age, offset in points)
    return math.sqrt(squares / len(points))
