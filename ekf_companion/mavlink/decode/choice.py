"""Which source of one thing to use, and how often."""

from __future__ import annotations

SECOND_NS = 1_000_000_000
ABSENT_NS = 3 * SECOND_NS
"""So long the better source must be silent before the next one is used."""


class Preference:
    """Of several sources of one thing, the best that has been heard in the last three seconds."""

    __slots__ = ("_heard_ns", "rank")

    def __init__(self) -> None:
        self.rank = 0
        """Of the source in use: 0 is the best."""
        self._heard_ns: int | None = None

    def admit(self, rank: int, t_ns: int) -> bool:
        """Whether to use a source now, by its rank and its own stamp; the best is waited for."""
        if self._heard_ns is None:
            self._heard_ns = t_ns
        if rank > self.rank and t_ns - self._heard_ns <= ABSENT_NS:
            return False
        self.rank, self._heard_ns = rank, t_ns
        return True


class Pace:
    """Thins a stream to a rate by its own stamps."""

    __slots__ = ("_last_ns", "_period_ns")

    def __init__(self, rate: float) -> None:
        self._period_ns = round(SECOND_NS / rate * 0.99)  # stamps jitter
        self._last_ns: int | None = None

    def admit(self, t_ns: int) -> bool:
        """Whether a period has passed since the last that was admitted."""
        if self._last_ns is not None and 0 <= t_ns - self._last_ns < self._period_ns:
            return False
        self._last_ns = t_ns
        return True
