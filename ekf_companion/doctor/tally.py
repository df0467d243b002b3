"""Counts of one message, and of the stamps of the inertial one, as frames pass by."""

from __future__ import annotations

from ekf_companion.doctor.evidence import Stamps
from ekf_companion.mavlink.request import ACCEPTED
from ekf_companion.mavlink.stamp import SECOND_NS

PAUSE_NS = 3 * SECOND_NS
"""A longer silence is a pause, and counts for no rate."""


class Tally:
    """How often one message comes."""

    def __init__(self) -> None:
        self.count = 0
        self.bytes = 0
        self.asked = 0.0
        """The most that was: what a refusal is followed by is less, Hz."""
        self.granted = 0.0
        """Hz; 0: nothing was."""
        self.answer = ""
        self._asking = 0.0
        self.last_ns: int | None = None
        self._is_anew = False
        self._steps = 0
        self._active_ns = 0

    def add(self, size: int, now_ns: int) -> None:
        """Count one of so many bytes."""
        self.count += 1
        self.bytes += size
        if self._is_anew:
            self._steps = self._active_ns = 0
            self.last_ns, self._is_anew = None, False
        if self.last_ns is not None and 0 <= now_ns - self.last_ns <= PAUSE_NS:
            self._steps += 1
            self._active_ns += now_ns - self.last_ns
        self.last_ns = now_ns

    def ask(self, rate: float) -> None:
        """Note that it is asked for, Hz."""
        self._asking = rate
        self.asked = max(self.asked, rate)
        self.answer = self.answer or "no answer"

    def take_answer(self, answer: str) -> None:
        """Note what was answered; the rate is measured anew."""
        self.answer = answer
        if answer == ACCEPTED:
            self.granted = self._asking
        self.restart()

    def restart(self) -> None:
        """Measure the rate anew, if more comes: somebody has just set it."""
        self._is_anew = True

    def rate(self, now_ns: int | None = None) -> float:
        """Give the rate while it came, Hz; 0: it comes no more at the time given."""
        if now_ns is not None and self.last_ns is not None and now_ns - self.last_ns > PAUSE_NS:
            return 0.0
        return self._steps / (self._active_ns * 1e-9) if self._active_ns else 0.0


class StampTally:
    """What is strange about the stamps of one message."""

    def __init__(self, message: str) -> None:
        self.message = message
        self._count = self._repeated = self._backward = self._gaps = self._zero = 0
        self._is_whole_ms = True
        self._last_us: int | None = None
        self._usual_us = 0.0

    def add(self, t_us: int) -> None:
        """Take the next stamp, in the order of arrival."""
        self._count += 1
        if t_us == 0:
            self._zero += 1
            return
        self._is_whole_ms = self._is_whole_ms and t_us % 1000 == 0
        last, self._last_us = self._last_us, t_us
        if last is None:
            return
        step = t_us - last
        if step == 0:
            self._repeated += 1
        elif step < 0:
            self._backward += 1
        elif self._usual_us and step > 10.0 * self._usual_us:
            self._gaps += 1
        else:
            self._usual_us += 0.05 * (step - self._usual_us) if self._usual_us else step

    def state(self) -> Stamps:
        """Give it frozen."""
        return Stamps(
            message=self.message,
            count=self._count,
            repeated=self._repeated,
            backward=self._backward,
            gaps=self._gaps,
            zero=self._zero,
            is_whole_ms=self._is_whole_ms and self._count > 1,
        )
