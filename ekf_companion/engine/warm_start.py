"""From one run of the daemon to the next: a checkpoint is written, and gone on from.

Each part of it is judged as soon as it can be: the bytes at once, the vehicle when the autopilot is
found, the age by the first inertial sample.
"""

from __future__ import annotations

import logging

from ekf_companion.engine.checkpoint import (
    LIMIT,
    STEADY_NS,
    Checkpoint,
    Clocks,
    Refusal,
    Sources,
    Vehicle,
    Why,
    decode,
    encode,
    foreign,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.decode import Decoder

_log = logging.getLogger(__name__)

USUAL = (Why.ALIGNING, Why.REBOOTED, Why.STALE)
"""Refusals that come with every start of the day, so that nobody need look."""


class WarmStart:
    """The checkpoints of one run: the one found at its start, and those that it leaves."""

    def __init__(
        self,
        data: bytes | None = None,
        clocks: Clocks | None = None,
        now_ns: int = 0,
        limit: float = LIMIT,
    ) -> None:
        """Judge the bytes that were found.

        Args:
            data: What the last run left; None: nothing was looked for or found.
            clocks: The companion's clocks now.
            now_ns: The same moment by the session's clock, ns.
            limit: Age by the autopilot's clock beyond which a checkpoint is stale, s.
        """
        self._clocks, self._now_ns, self._limit = clocks or Clocks(0), now_ns, limit
        self._starts = 0
        self._steady_from_ns: int | None = None
        self._vehicle: Vehicle | None = None
        self._found: Checkpoint | None = None
        self._start, self._resets = "cold", 0
        if data is not None:
            found = decode(data)
            if isinstance(found, Refusal):
                self._refuse(found)
            else:
                self._found = found

    @property
    def expected(self) -> Vehicle | None:
        """The vehicle whose state was found; None: no state was."""
        return None if self._found is None else self._found.vehicle

    def on_vehicle(self, vehicle: Vehicle, pipeline: Pipeline, decoder: Decoder) -> None:
        """Learn which vehicle it is; if it is the checkpoint's, its sources are known at once.

        It may turn out to be another later, when its heartbeat contradicts what was expected.
        """
        if self._vehicle is not None:
            was = self._vehicle
            if self._found is not None or self._steady_from_ns is not None:
                self._refuse(foreign(was, vehicle))
            else:
                self._start, self._resets = f"cold: another autopilot, was {was}", 0
            self._steady_from_ns = None
        self._vehicle = vehicle
        if (found := self._found) is not None:
            refusal = found.refuse_vehicle(vehicle, pipeline.fingerprint)
            if refusal is None:
                decoder.prefer(*found.sources)
            else:
                self._refuse(refusal)
        pipeline.start, pipeline.sent_before = self._start, self._resets

    def resume(self, pipeline: Pipeline, stamp_ns: int, now_ns: int) -> None:
        """Go on from what was found, before the first inertial sample is taken."""
        if (found := self._found) is None:
            return
        now = self._clocks.later(now_ns - self._now_ns)
        refusal = found.refuse_time(stamp_ns, now, self._limit)
        if refusal is not None:
            self._refuse(refusal)
            pipeline.start, pipeline.sent_before = self._start, self._resets
            return
        pipeline.restore(found.state)
        lost = (stamp_ns - found.state.stamp_ns) * 1e-9
        pipeline.start = f"warm: {lost:.2f} s lost"
        _log.info("Going on from a checkpoint that is %.2f s old", lost)
        self._starts = found.starts + 1
        self._steady_from_ns = stamp_ns + STEADY_NS
        self._found = None

    def checkpoint(self, pipeline: Pipeline, decoder: Decoder, clocks: Clocks) -> bytes | None:
        """Return what the next run could go on from; None if nothing has been estimated yet."""
        if self._vehicle is None or self._found is not None or pipeline.stamp_ns == 0:
            return None
        if self._steady_from_ns is not None and pipeline.stamp_ns > self._steady_from_ns:
            self._starts = 0
        return encode(
            Checkpoint(
                state=pipeline.state(),
                vehicle=self._vehicle,
                clocks=clocks,
                sources=Sources(*decoder.ranks),
                starts=self._starts,
            )
        )

    def _refuse(self, refusal: Refusal) -> None:
        level = logging.INFO if refusal.why in USUAL else logging.WARNING
        _log.log(level, "The checkpoint is not used: %s", refusal.words)
        self._start, self._resets = f"cold: {refusal.words}", refusal.resets
        self._found = None
