"""Counters of one message, and of the time stamps of the inertial one."""

from __future__ import annotations

from dataclasses import dataclass

from ekf_companion.mavlink.request import ACCEPTED
from ekf_companion.mavlink.stamp import SECOND_NS

PAUSE_NS = 3 * SECOND_NS
"""A longer silence is a pause, and does not count for the rate."""
LEAP_NS = SECOND_NS
"""Difference between stamps and arrivals that no link causes: a delay is never negative."""


class MessageCounter:
    """Counts one message: its rate, and what was asked for and answered."""

    def __init__(self) -> None:
        self.count = 0
        self.asked = 0.0
        """Rate asked for last, Hz, and before any refusal: what is asked after one is lower."""
        self.granted = 0.0
        """Hz; 0 if none was."""
        self.answer = ""
        self._requested = 0.0
        self._last_ns: int | None = None
        self._is_restarting = False
        self._intervals = 0
        self._active_ns = 0

    def add(self, now_ns: int) -> None:
        """Count one that came now."""
        self.count += 1
        if self._is_restarting:
            self._intervals = self._active_ns = 0
            self._last_ns, self._is_restarting = None, False
        if self._last_ns is not None and 0 <= now_ns - self._last_ns <= PAUSE_NS:
            self._intervals += 1
            self._active_ns += now_ns - self._last_ns
        self._last_ns = now_ns

    def request(self, rate: float) -> None:
        """Note that a rate is asked for, Hz."""
        # Another rate than the one that was granted: a reload has changed it
        is_changed = self.answer == ACCEPTED and rate != self._requested
        self.asked = rate if is_changed else max(self.asked, rate)
        self._requested = rate
        self.answer = self.answer or "no answer"

    def receive_answer(self, answer: str) -> None:
        """Note the answer; the rate is measured anew."""
        self.answer = answer
        if answer == ACCEPTED:
            self.granted = self._requested
        self.restart()

    def restart(self) -> None:
        """Measure the rate anew with the next one: somebody has just set it."""
        self._is_restarting = True

    def rate(self, now_ns: int | None = None) -> float:
        """Return the rate while it came, Hz; 0 if it no longer comes at ``now_ns``."""
        if now_ns is not None and self._last_ns is not None and now_ns - self._last_ns > PAUSE_NS:
            return 0.0
        return self._intervals / (self._active_ns * 1e-9) if self._active_ns else 0.0


@dataclass(slots=True, kw_only=True)
class Stamps:
    """Counts what is wrong with the time stamps of one inertial message."""

    message: str = ""
    """Empty if none has come."""
    count: int = 0
    repeated: int = 0
    backward: int = 0
    gaps: int = 0
    """Steps more than ten times the usual one."""
    leaps: int = 0
    """Stamps that leave the time of arrival by more than ``LEAP_NS``, ahead or back."""
    largest_leap: float = 0.0
    """s, without a sign."""
    zero: int = 0
    is_whole_ms: bool = False
    """Whether all of several are whole milliseconds."""
    _is_whole: bool = True
    _last_us: int | None = None
    _usual_us: float = 0.0
    _earliest_ns: int | None = None

    def add(self, t_us: int, now_ns: int | None = None) -> None:
        """Count the next stamp, in the order of arrival; ``now_ns`` is that time, if known."""
        self.count += 1
        self._is_whole &= t_us % 1000 == 0
        self.is_whole_ms = self._is_whole and self.count > 1
        if t_us == 0:
            self.zero += 1
            return
        last, self._last_us = self._last_us, t_us
        if now_ns is not None:
            self._compare(t_us, last, now_ns)
        if last is None:
            return
        step = t_us - last
        if step == 0:
            self.repeated += 1
        elif step < 0:
            self.backward += 1
        elif self._usual_us and step > 10.0 * self._usual_us:
            self.gaps += 1
        else:
            self._usual_us += 0.05 * (step - self._usual_us) if self._usual_us else step

    def _compare(self, t_us: int, last_us: int | None, now_ns: int) -> None:
        """Count a leap: more ahead of the arrivals than any stamp before, or back."""
        ahead_ns = t_us * 1000 - now_ns
        if self._earliest_ns is None or last_us is None:
            self._earliest_ns = ahead_ns
            return
        by_ns = max(ahead_ns - self._earliest_ns, (last_us - t_us) * 1000)
        if by_ns > LEAP_NS:
            self.leaps += 1
            self.largest_leap = max(self.largest_leap, by_ns * 1e-9)
            self._earliest_ns = ahead_ns
        self._earliest_ns = max(self._earliest_ns, ahead_ns)
