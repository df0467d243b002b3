"""What the answers to TIMESYNC take, and the autopilot's parameter that takes a delay off."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.stamp import SECOND_NS

_SPAN_NS = 30 * SECOND_NS
"""The fastest answer of so long counts, and of as long before."""
_WINDOW_NS = 10 * SECOND_NS
_FEW = 5
_EVEN = 0.05
"""s. Of answers that come more evenly than that a constant delay can be set."""
_NEAR_MS = 30.0
"""A setting so near to what is measured is right."""
CROWDED = "see what else takes its processor (top)"
"""What to do about a board that does not let our loop run."""


class Lag:
    """Round trips, and by how much they and the way there are longer than the fastest."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all: the link or the autopilot is another."""
        self.answered_ns: int | None = None
        """When the last answer came, our clock; None: none has."""
        self.last_ns = 0
        """What it took there and back."""
        self.slowed_ns = 0
        """By how much it was slowed on the way there, at most."""
        self.queue_ns = 0
        """How long of that it waited in the line, at most: what our loop explains is none."""
        self.loop_ns = 0
        """How long our own loop has stalled of late, at most; whoever runs it sets that."""
        self._recent: deque[tuple[int, int]] = deque()
        self._least: list[tuple[int, int] | None] = [None, None]
        """Least round trip, and least time of the autopilot's clock after ours, of this span and of
        the one before."""
        self._span_end_ns = 0
        self.fastest_ns: int | None = None
        """The shortest round trip of late; None: no answer has come."""

    def add(self, now_ns: int, ts1: int, tc1: int) -> None:
        """Note an answer: when it came, when it was asked, and when that was read, its clock."""
        rtt, there = now_ns - ts1, tc1 - ts1
        if now_ns >= self._span_end_ns:
            self._least = [None, self._least[0]]
            self._span_end_ns = now_ns + _SPAN_NS
        least = self._least[0]
        self._least[0] = (
            (rtt, there) if least is None else (min(least[0], rtt), min(least[1], there))
        )
        known = [one for one in self._least if one is not None]
        fastest, earliest = (min(column) for column in zip(*known, strict=True))
        self.answered_ns, self.last_ns, self.fastest_ns = now_ns, rtt, fastest
        # A clock that runs slower, or has jumped, shows in the one and not in the other
        self.slowed_ns = min(rtt - fastest, there - earliest)
        self.queue_ns = max(self.slowed_ns - self.loop_ns, 0)
        self._recent.append((now_ns, rtt))
        while now_ns - self._recent[0][0] > _WINDOW_NS:
            self._recent.popleft()

    def is_loop(self, seconds: float) -> bool:
        """Return whether a delay, s, is rather that of our own loop than of the line."""
        return 2.0 * self.loop_ns * 1e-9 > seconds

    @property
    def is_few(self) -> bool:
        """Whether too few have come to say anything."""
        return len(self._recent) < _FEW

    def rebase(self) -> None:
        """Forget the fastest: the way is another one."""
        self._least, self.fastest_ns = [None, None], None

    def typical(self, now_ns: int) -> tuple[float, float]:
        """Return median and spread (from a tenth to nine tenths) of ten seconds, s; or NaN."""
        rtts = sorted(rtt for came_ns, rtt in self._recent if now_ns - came_ns <= _WINDOW_NS)
        if len(rtts) < _FEW:
            return math.nan, math.nan
        low, high = rtts[len(rtts) // 10], rtts[len(rtts) * 9 // 10]
        return rtts[len(rtts) // 2] * 1e-9, (high - low) * 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class DelaySetting:
    """The autopilot's parameter that takes a constant delay off what we send."""

    name: str = ""
    """Empty: there is none."""
    largest: float = 0.0
    """ms."""
    value: float | None = None
    """As read, ms; None: not read yet."""

    @staticmethod
    def of(family: Family) -> DelaySetting:
        """Return the parameter of a family of autopilots.

        Source: ArduPilot, ``AP_VisualOdom.cpp``; PX4, ``ekf2/params_external_vision.yaml``.
        """
        if family is Family.ARDUPILOT:
            return DelaySetting(name="VISO_DELAY_MS", largest=250.0)
        if family is Family.PX4:
            return DelaySetting(name="EKF2_EV_DELAY", largest=300.0)
        return DelaySetting()

    def read(self, value: float | None) -> DelaySetting:
        """Return it with a value that was read."""
        return replace(self, value=value)

    @property
    def compensated_ns(self) -> float:
        """What the autopilot takes off, as far as that is known."""
        return (self.value or 0.0) * 1e6

    def _target(self, lag: Lag, now_ns: int) -> float:
        """Return the value that fits what was measured, ms, to 5 ms."""
        return round(lag.typical(now_ns)[0] * 1e3 / 5.0) * 5.0

    def advice(self, lag: Lag, now_ns: int) -> str:
        """Return what to set, or why nothing helps; empty: nothing need be."""
        typical, spread = lag.typical(now_ns)
        if not self.name or math.isnan(typical) or typical * 1e3 <= _NEAR_MS:
            return ""
        if spread > _EVEN:
            remedy = f"no value of {self.name} covers that; take a faster link"
            if lag.is_loop(spread):
                remedy = (
                    f"this board lets the daemon wait for {lag.loop_ns * 1e-6:.0f} ms; {CROWDED}"
                )
            return (
                f"answers take {typical * 1e3:.0f} ms there and back, and {spread * 1e3:.0f} ms "
                f"more or less: {remedy}"
            )
        target = self._target(lag, now_ns)
        if target > self.largest:
            return (
                f"answers take {typical * 1e3:.0f} ms there and back, more than {self.name} can "
                f"cover ({self.largest:g}): take a faster link"
            )
        if self.value is not None and abs(self.value - target) <= _NEAR_MS:
            return ""
        return f"set {self.name} to {target:.0f}, the constant delay that is measured"

    def text(self, lag: Lag, now_ns: int) -> str:
        """Return the same for the pilot."""
        typical, spread = lag.typical(now_ns)
        if spread > _EVEN or self._target(lag, now_ns) > self.largest:
            return f"link {typical * 1e3:.0f} ms late"
        return f"set {self.name} {self._target(lag, now_ns):.0f}"
