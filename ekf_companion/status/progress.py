"""Notice a filter that is given inertial samples and makes no estimates."""

from __future__ import annotations

from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.stamp import SECOND_NS

BARREN_S = 3.0
"""Samples for so long without an estimate: the filter is stuck, and only a restart helps."""
_PAUSE_NS = 2 * SECOND_NS
"""Without a sample for so long no estimate is expected: the link is silent."""


class Progress:
    """Compares the samples that the filter takes with its estimates, every half second."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._given = 0
        self._given_ns = 0
        self._since_ns: int | None = None

    def update(self, pipeline: Pipeline, now_ns: int) -> None:
        """Note the samples and estimates since the last call."""
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
        """Return for how long samples have come without an estimate, s; 0 if none do."""
        if self._since_ns is None or now_ns - self._given_ns > _PAUSE_NS:
            return 0.0
        return (self._given_ns - self._since_ns) * 1e-9
