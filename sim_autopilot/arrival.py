"""How an autopilot uses the stamp of a message from another computer.

ArduPilot compares no clocks: it takes the least delay between stamp and arrival in the last hundred
messages as zero, so that a constant delay of the link goes unnoticed (``JitterCorrection``), and
limits the delay beyond that to half a second. PX4 learns the other's clock by TIMESYNC, and until
then takes the time of arrival (``MavlinkTimesync::sync_stamp``).
"""

from __future__ import annotations

from typing import Protocol

_MOST_LAG_US = 500_000
_LOOPS = 100
_CONVERGED = 500
"""Answers (``CONVERGENCE_WINDOW``)."""
_FAR_US = 10_000
"""PX4 leaves out an answer that took longer (``MAX_RTT_SAMPLE``)."""
_ALPHA = 0.05
"""At the start (``ALPHA_GAIN_INITIAL``)."""


class Arrival(Protocol):
    """Turns a stamp of the companion's clock into one of the autopilot's."""

    def stamp_us(self, stamp_us: int, now_us: int) -> int:
        """Return the time of the autopilot's clock at which a message was true."""


class LeastDelay:
    """ArduPilot's rule: one instance per link, whichever computers send there."""

    def __init__(self) -> None:
        self._offset_us: int | None = None
        self._least_us = 0
        self._count = 0

    def stamp_us(self, stamp_us: int, now_us: int) -> int:
        """Return the stamp corrected by the least recent delay."""
        apart = now_us - stamp_us
        if self._offset_us is None or apart < self._offset_us:
            self._offset_us = apart
        estimate = stamp_us + self._offset_us
        if estimate + _MOST_LAG_US < now_us:
            estimate = now_us - _MOST_LAG_US
            self._offset_us = estimate - stamp_us
        self._least_us = apart if self._count == 0 else min(self._least_us, apart)
        self._count += 1
        if self._count == _LOOPS:
            self._offset_us, self._count = self._least_us, 0
        return estimate


class Timesync:
    """PX4's rule: one instance per link, updated by every answer."""

    def __init__(self) -> None:
        self.count = 0
        """Answers that counted."""
        self._offset_us = 0.0

    def answer(self, asked_us: int, theirs_us: int, now_us: int) -> None:
        """Take an answer to a question of ours; ``theirs_us`` is the other's clock at it."""
        if now_us - asked_us >= _FAR_US:
            return
        offset = 0.5 * (asked_us + now_us) - theirs_us
        self._offset_us += (1.0 if self.count == 0 else _ALPHA) * (offset - self._offset_us)
        self.count += 1

    def stamp_us(self, stamp_us: int, now_us: int) -> int:
        """Return the stamp by the learnt clock; the time of arrival until it is learnt."""
        return round(stamp_us + self._offset_us) if self.count >= _CONVERGED else now_us
