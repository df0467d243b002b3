"""Whether the filter makes estimates of the inertial samples that it is given."""

from __future__ import annotations

from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.stamp import SECOND_NS

BARREN_S = 3.0
"""Samples for so long, and no estimate: the filter is stuck, and only beginning anew helps."""
_PAUSE_NS = 2 * SECOND_NS
"""Without a sample for so long, none is owed an estimate: the link is silent."""


class Progress:
    """Compares what the filter is given with what it gives, every half second."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._given = 0
        self._given_ns = 0
        self._since_ns: int | None = None

    def look(self, pipeline: Pipeline, now_ns: int) -> None:
        """See what has come, and what was made of it, since the last look."""
        stamp_ns, given = pipeline.stamp_ns, pipeline.given
        if stamp_ns != self._stamp_ns:
            self._since_ns = None
        if given != self._given:
            is_answered = stamp_ns != self._stamp_ns
            is_first = self._since_ns is None or now_ns - self._given_ns > _PAUSE_NS
            if not is_answered and is_first:
                self._since_ns = now_ns
            self._given_ns = now_ns
        self._stamp_ns, self._given = stamp_ns, given

    def barren_s(self, now_ns: int) -> float:
        """Give for how long samples have come of which no estimate was made, s; 0: none do."""
        if self._since_ns is None or now_ns - self._given_ns > _PAUSE_NS:
            return 0.0
        return (self._given_ns - self._since_ns) * 1e-9
