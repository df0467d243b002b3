"""Age of an estimate when it is about to be sent.

After a stall, the samples that waited in the system's buffers are read all at once, and an estimate
follows from each. The filter needs every sample, but old estimates harm an autopilot that flies on
them. The age of an estimate is its delay, by its stamp, beyond the smallest delay of the last
seconds. That needs no common clock.
"""

from __future__ import annotations

_SPAN_NS = 2_000_000_000
"""Span of the smallest delay: that of this span and of the one before counts. Crystals drift by
less than a millisecond in that time; a simulator that runs 2 % slow on a busy machine by 80 ms."""
_UNKNOWN_NS = 1 << 62


class Freshness:
    """Compares the stamps of estimates with our clock."""

    def __init__(self) -> None:
        self._t_ns = 0
        self._forget()

    def _forget(self) -> None:
        self._quickest_ns = self._quickest_before_ns = _UNKNOWN_NS
        """Least lag of our clock behind the stamps, in this span and in the one before."""
        self._span_end_ns = 0

    def on_estimate(self, t_ns: int, now_ns: int) -> None:
        """Note the newest estimate: its stamp on the autopilot's clock, and our time."""
        if t_ns == self._t_ns:
            return
        if t_ns < self._t_ns:
            self._forget()  # the clock is another
        self._t_ns = t_ns
        if now_ns >= self._span_end_ns:
            self._quickest_before_ns, self._quickest_ns = self._quickest_ns, _UNKNOWN_NS
            self._span_end_ns = now_ns + _SPAN_NS
        self._quickest_ns = min(self._quickest_ns, now_ns - t_ns)

    def is_fresh(self, t_ns: int, now_ns: int, limit: float) -> bool:
        """Return whether an estimate of this stamp is no older than the limit, s."""
        quickest_ns = min(self._quickest_ns, self._quickest_before_ns)
        return now_ns - t_ns - quickest_ns <= limit * 1e9
