"""From one run of the daemon to the next: a checkpoint is written, and gone on from.

Each part of it is judged as soon as it can be: the bytes at once, the vehicle when the autopilot is
found, the age by the inertial samples. The first of them may have waited in a buffer: a port that
was open, a radio or a router gives out what is old, faster than it was measured. So what one stamp
speaks against is refused only when the stamps go on as our clock does.

Where the state is refused, the estimate begins anew, but in the same frame: see :class:`.Remains`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

from ekf_companion.engine.checkpoint import (
    LIMIT,
    STEADY_NS,
    UNSENT,
    Checkpoint,
    Clocks,
    Refusal,
    Remains,
    SentFrame,
    Sources,
    Vehicle,
    Why,
    decode,
    encode,
    foreign,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.decode import Decoder
from ekf_companion.mavlink.stamp import SECOND_NS

_log = logging.getLogger(__name__)

USUAL = (Why.ALIGNING, Why.REBOOTED, Why.STALE)
"""Refusals that come with every start of the day, so that nobody need look."""
_OTHERS = (Why.FOREIGN, Why.REBOOTED)
"""Refusals of what is of another flight: nothing of it would be right."""
PACE_NS = SECOND_NS // 2
"""When stamps have kept pace with our clock for so long, nothing old is in front of them."""
_JITTER_NS = SECOND_NS // 50
"""By which a stamp may come sooner than those before it, and keep pace."""
PATIENCE_NS = 3 * SECOND_NS
"""So long the stamps are looked at; a second later an autopilot may end its flight."""


class Outcome(NamedTuple):
    """How a run began."""

    lost: float | None = None
    """It goes on from a state so old, s; None: it begins anew."""
    why: Why | None = None
    """Why a checkpoint was refused; None: none was, or there was none."""
    is_origin_kept: bool = False
    """Whether it counts from the origin of the run before."""
    sent: SentFrame = UNSENT
    """What the autopilot was sent positions by then."""


class _Pace:
    """Watches inertial stamps until they keep pace with our clock."""

    def __init__(self) -> None:
        self._begin_ns: int | None = None
        self._late_ns = 0
        self._since_ns = 0

    def is_steady(self, stamp_ns: int, now_ns: int) -> bool:
        """Return whether stamps keep pace by now, or have been waited for long enough."""
        late_ns = now_ns - stamp_ns
        if self._begin_ns is None:
            self._begin_ns, self._late_ns, self._since_ns = now_ns, late_ns, now_ns
        elif abs(late_ns - self._late_ns) > _JITTER_NS:
            # Either way: what follows is of another time than what came before
            self._late_ns, self._since_ns = late_ns, now_ns
        is_over = now_ns - self._begin_ns >= PATIENCE_NS
        return is_over or now_ns - self._since_ns >= PACE_NS


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
        self._remains: Remains | None = None
        self._pace = _Pace()
        self._start, self._resets = "cold", 0
        self.outcome = Outcome()
        """How this run began, or will by what is known yet."""
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

    @property
    def is_empty(self) -> bool:
        """Whether nothing was found that a start could go on from."""
        return self._found is None and self._remains is None

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
                self._remains = None
            self._steady_from_ns = None
        self._vehicle = vehicle
        if (found := self._found) is not None:
            refusal = found.refuse_vehicle(vehicle, pipeline.fingerprint)
            if refusal is None:
                decoder.prefer(*found.sources)
                decoder.inertial.resume(found.unit, found.unit_offset)
            else:
                self._refuse(refusal)
        if self._remains is not None and self._remains.vehicle != vehicle:
            self._remains = None
        pipeline.start, pipeline.sent_before = self._start, self._resets

    def is_judged(self, stamp_ns: int, now_ns: int) -> bool:
        """Return whether it is known, by an inertial stamp that came now, what to begin with.

        If not, the samples are to wait for the next; see :meth:`resume`.
        """
        if self._found is not None:
            now = self._clocks_at(now_ns)
            if self._found.refuse_time(stamp_ns, now, self._limit) is None:
                return True
        elif self._remains is None or stamp_ns > self._remains.stamp_ns:
            return True
        return self._pace.is_steady(stamp_ns, now_ns)

    def resume(self, pipeline: Pipeline, stamps_ns: Sequence[int], now_ns: int) -> Outcome:
        """Go on from what was found, before the first inertial sample is taken.

        ``stamps_ns`` are those of the samples that have come, the newest last.
        """
        if (found := self._found) is not None:
            now = self._clocks_at(now_ns)
            refusal = found.refuse_time(stamps_ns[-1], now, self._limit)
            if refusal is None:
                return self._go_on(found, pipeline, stamps_ns)
            self._refuse(refusal)
            pipeline.start, pipeline.sent_before = self._start, self._resets
        remains, self._remains = self._remains, None
        if remains is not None and remains.origin is not None:
            if stamps_ns[-1] > remains.stamp_ns:
                age = self._clocks_at(now_ns).since(remains.clocks) * 1e-9
                pipeline.set_origin(remains.origin, age)
                kept = self.outcome._replace(is_origin_kept=True, sent=remains.sent)
                self.outcome = kept
                _log.info("The estimate begins anew, and counts from the origin as before")
            else:
                self.outcome = self.outcome._replace(why=Why.REBOOTED)
        return self.outcome

    def _go_on(self, found: Checkpoint, pipeline: Pipeline, stamps_ns: Sequence[int]) -> Outcome:
        pipeline.restore(found.state)
        first_ns = min(stamp_ns for stamp_ns in stamps_ns if stamp_ns > found.state.stamp_ns)
        lost = (first_ns - found.state.stamp_ns) * 1e-9
        pipeline.start = f"warm: {lost:.2f} s lost"
        _log.info("Going on from a checkpoint that is %.2f s old", lost)
        self._starts = found.starts + 1
        self._steady_from_ns = first_ns + STEADY_NS
        self._found = None
        self.outcome = Outcome(lost, is_origin_kept=True, sent=found.sent)
        return self.outcome

    def checkpoint(
        self,
        pipeline: Pipeline,
        decoder: Decoder,
        clocks: Clocks,
        sent: SentFrame = UNSENT,
    ) -> bytes | None:
        """Return what the next run could go on from; None if nothing has been estimated yet.

        ``sent`` is what the autopilot is sent positions by.
        """
        if self._vehicle is None or self._found is not None or pipeline.stamp_ns == 0:
            return None
        if self._steady_from_ns is not None and pipeline.stamp_ns > self._steady_from_ns:
            self._starts = 0
        return encode(
            Checkpoint(
                state=pipeline.state(),
                vehicle=self._vehicle,
                clocks=clocks,
                sent=sent,
                sources=Sources(*decoder.ranks),
                unit=decoder.inertial.unit,
                unit_offset=decoder.inertial.lanes.offset,
                starts=self._starts,
            )
        )

    def _clocks_at(self, now_ns: int) -> Clocks:
        """Return the companion's clocks at a time of the session's."""
        return self._clocks.later(now_ns - self._now_ns)

    def _refuse(self, refusal: Refusal) -> None:
        level = logging.INFO if refusal.why in USUAL else logging.WARNING
        _log.log(level, "The checkpoint is not used: %s", refusal.words)
        self._start, self._resets = f"cold: {refusal.words}", refusal.resets
        self._remains = None if refusal.why in _OTHERS else refusal.remains
        self.outcome = Outcome(why=refusal.why)
        self._found = None
