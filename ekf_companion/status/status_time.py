"""How long the estimate of this run had each status, and why."""

from __future__ import annotations

from collections.abc import Mapping

from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.reason import LONGEST_STEP, NONE, Seconds, add_seconds, foremost
from ekf_companion.nav.state import Status


class StatusTime:
    """Adds up the time of a run by status and its foremost reason, by the samples' stamps."""

    def __init__(self) -> None:
        self._pipeline: Pipeline | None = None
        self._stamp_ns = 0
        self._seconds: Seconds = {}

    def update(self, pipeline: Pipeline) -> None:
        """Charge the time since the last call to the present status; call it every half second."""
        step = (pipeline.stamp_ns - self._stamp_ns) * 1e-9
        is_first, self._pipeline = pipeline is not self._pipeline, pipeline
        self._stamp_ns = pipeline.stamp_ns
        if is_first or not 0.0 < step <= LONGEST_STEP:
            return
        now = as_estimate(pipeline.values())
        reason = foremost(int(now.reasons))
        add_seconds(self._seconds, {Status(int(now.status)): {reason: step}})

    def by_name(self) -> Mapping[str, Mapping[str, float]]:
        """Return the seconds so far by the names of status and foremost reason; empty: none."""
        return {
            status.name.lower(): {
                "" if reason == NONE else str(reason.name).lower(): spent
                for reason, spent in by_reason.items()
            }
            for status, by_reason in sorted(self._seconds.items())
        }
