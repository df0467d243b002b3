"""The autopilot's clock: one time base out of its messages' stamps, and TIMESYNC both ways.

Stamps are microseconds since boot or since 1970, told apart by their size, or milliseconds since
boot that wrap after 49.7 days. The base is the one that the inertial messages use; what is
stamped on the other is moved over by SYSTEM_TIME, which names both.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

UNIX_FROM_US = 1_234_567_890_000_000
"""A stamp above is unix time; the bound that PX4 and MAVROS use (a day in 2009)."""
LAST_US = 4_000_000_000_000_000
"""The year 2096: what is stamped later holds no time."""
_WRAP_MS = 1 << 32
_BACK_US = 1_000_000
"""A clock that goes back by more has begun anew; by less, packets overtook one another."""
_AHEAD_US = (_WRAP_MS // 4) * 1000
"""A leap of 12 days is another clock, not a gap."""


class TimeBase:
    """One clock, from the stamps of one autopilot."""

    def __init__(self) -> None:
        self.latest_us: int | None = None
        """The newest stamp, on the base of the inertial messages."""
        self._unix_minus_boot_us: int | None = None
        self._latest_boot_ms: int | None = None  # of SYSTEM_TIME, where the base is unix

    @property
    def latest_ns(self) -> int | None:
        """The newest stamp as a time of validity for what has no stamp of its own."""
        return None if self.latest_us is None else self.latest_us * 1000

    def advance(self, stamp_us: int) -> bool:
        """Take a stamp that the base follows; True: the clock began anew with it."""
        if self.latest_us is None:
            self.latest_us = stamp_us
            return False
        step = stamp_us - self.latest_us
        if -_BACK_US <= step <= _AHEAD_US:
            if step > 0:
                self.latest_us = stamp_us
            return False
        self.latest_us = stamp_us
        self._unix_minus_boot_us = None  # it was that of the old clock
        return True

    def advance_boot_ms(self, boot_ms: int) -> bool:
        """Take a stamp in milliseconds since boot; True: the clock began anew with it."""
        if self.is_unix:
            return False
        if self.advance(self._unwrapped_us(boot_ms)):
            self.latest_us = boot_ms * 1000
            return True
        return False

    def relate(self, unix_us: int, boot_ms: int) -> bool:
        """Take a SYSTEM_TIME (unix 0: not known yet); True: the clock began anew with it."""
        is_new = self.advance_boot_ms(boot_ms)
        if self.is_unix:
            last = self._latest_boot_ms
            self._latest_boot_ms = boot_ms
            is_new = last is not None and _BACK_US // 1000 < (last - boot_ms) < _WRAP_MS // 2
        if UNIX_FROM_US < unix_us <= LAST_US:
            boot_us = boot_ms * 1000 if self.is_unix else self._unwrapped_us(boot_ms)
            self._unix_minus_boot_us = unix_us - boot_us
        return is_new

    @property
    def is_unix(self) -> bool:
        """Whether the inertial messages are stamped in unix time."""
        return self.latest_us is not None and self.latest_us > UNIX_FROM_US

    def from_us(self, stamp_us: int) -> int | None:
        """Give a stamp of either base in ns on ours; None: nothing relates the two yet."""
        if (stamp_us > UNIX_FROM_US) == self.is_unix:
            return stamp_us * 1000
        if self._unix_minus_boot_us is None:
            return None
        moved = self._unix_minus_boot_us if self.is_unix else -self._unix_minus_boot_us
        return (stamp_us + moved) * 1000

    def from_boot_ms(self, boot_ms: int) -> int | None:
        """Give a stamp in milliseconds since boot in ns; None: nothing relates it to ours yet."""
        return self.from_us(boot_ms * 1000 if self.is_unix else self._unwrapped_us(boot_ms))

    def _unwrapped_us(self, boot_ms: int) -> int:
        if self.latest_us is None:
            return boot_ms * 1000
        latest_ms = self.latest_us // 1000
        step = (boot_ms - latest_ms + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
        return max(latest_ms + step, 0) * 1000


class TimesyncMessage(NamedTuple):
    """TIMESYNC as it is sent: a request has ``tc1 == 0``."""

    tc1: int
    """Time of the one who answers, ns; 0 asks."""
    ts1: int
    """Time of the one who asked, ns."""
    target_system: int
    target_component: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TimesyncOptions:
    """How the clocks are compared."""

    respond: bool = True
    """Whether the autopilot's own requests are answered (in its own time, once locked)."""
    request: bool = True
    """Whether we ask."""
    largest_rtt_ms: float = 10.0
    """An answer that took longer says too little; PX4's bound."""


_FAST_NS = 100_000_000
_SLOW_NS = 1_000_000_000
_OUTSTANDING = 16
_LOCK = 20
"""Good answers to lock on: 2 s at 10 Hz."""
_WINDOW = 100
_JUMP_NS = 100_000_000
"""An offset further away than this, five times over, is another clock; PX4's bound."""
_JUMPS = 5
_SKEW_SPAN_NS = 10_000_000_000
"""A rate is fitted over no shorter span: at 0.1 ms of jitter it would be worse than none."""
_LARGEST_SKEW = 500e-6
"""Crystals are better than 100 ppm; more is jitter."""


class Timesync:
    """Learns the offset of the autopilot's clock from ours, and answers in the autopilot's time."""

    def __init__(self, options: TimesyncOptions | None = None) -> None:
        self.options = options or TimesyncOptions()
        self.foreign = 0
        """Answers to what we had not asked, or that hold no time."""
        self.slow = 0
        """Answers with too long a round trip."""
        self.reset()

    def reset(self) -> None:
        """Forget the peer's clock: it rebooted or was lost."""
        self._outstanding: deque[int] = deque(maxlen=_OUTSTANDING)
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=_WINDOW)  # middle, offset, rtt
        self._next_ns: int | None = None
        self._jumps = 0
        self._fit: tuple[int, int, float] | None = None  # at, offset then, skew

    @property
    def is_locked(self) -> bool:
        """Whether the offset is known well enough to be told."""
        return len(self._samples) >= _LOCK

    @property
    def skew(self) -> float:
        """How much faster the autopilot's clock runs than ours, s/s; 0 until known."""
        return self._fit[2] if self._fit else 0.0

    def peer_ns(self, now_ns: int) -> int | None:
        """Give the autopilot's clock at a time of ours; None until locked."""
        if self._fit is None or not self.is_locked:
            return None
        at, offset, skew = self._fit
        return now_ns + offset + round(skew * (now_ns - at))

    def request(self, now_ns: int) -> int | None:
        """Give the ``ts1`` of a request if one is due: at 10 Hz until locked, then at 1 Hz."""
        if not self.options.request or (self._next_ns is not None and now_ns < self._next_ns):
            return None
        self._next_ns = now_ns + (_SLOW_NS if self.is_locked else _FAST_NS)
        self._outstanding.append(now_ns)
        return now_ns

    def answer(self, ts1: int, now_ns: int) -> int | None:
        """Give the ``tc1`` for a request; None: not to be answered (yet)."""
        peer_ns = self.peer_ns(now_ns) if self.options.respond else None
        # 0 would ask again
        return peer_ns or None

    def receive(self, tc1: int, ts1: int, now_ns: int) -> None:
        """Take an answer that was addressed to us or to nobody."""
        if ts1 not in self._outstanding or abs(tc1) > LAST_US * 1000:
            self.foreign += 1
            return
        self._outstanding.remove(ts1)
        rtt = now_ns - ts1
        if not 0 <= rtt <= self.options.largest_rtt_ms * 1e6:
            self.slow += 1
            return

        middle = ts1 + rtt // 2
        offset = tc1 - middle
        if self._fit and abs(offset - self._fit[1]) > _JUMP_NS:
            self._jumps += 1
            if self._jumps < _JUMPS:
                return
            self._samples.clear()
        self._jumps = 0
        self._samples.append((middle, offset, rtt))
        self._refit()

    def _refit(self) -> None:
        """Draw a line through the faster half of the answers: the slow ones waited one way."""
        limit = sorted(sample[2] for sample in self._samples)[len(self._samples) // 2]
        fast = [sample for sample in self._samples if sample[2] <= limit]
        at, base = fast[-1][0], fast[-1][1]
        age = np.array([float(sample[0] - at) for sample in fast])
        offset = np.array([float(sample[1] - base) for sample in fast])
        skew = 0.0
        if age[-1] - age[0] >= _SKEW_SPAN_NS:
            centred = age - age.mean()
            skew = float(centred @ (offset - offset.mean()) / (centred @ centred))
            skew = min(max(skew, -_LARGEST_SKEW), _LARGEST_SKEW)
        self._fit = (at, base + round(float(offset.mean() - skew * age.mean())), skew)
