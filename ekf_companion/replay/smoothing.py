"""Smoothing of a recording: estimates that also use later measurements.

The events are run through the pipeline in order of arrival. What leaves its window is final and in
order of time; it is stored in stretches of a few seconds, each with the filter's state at its
start. Then the stretches are processed from the last to the first: forward once more from that
state, with a tape, and back over the tape. So memory holds one tape, however long the recording;
many rows, states and results are stored in temporary files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ekf_companion.core.memory.enums import Mode
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.scratch import OUT, RECORD, ROW, Event
from ekf_companion.core.memory.state import BLOCK
from ekf_companion.core.rts import Smoother
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.spool import IN_MEMORY, Spool
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Table, join

_EVENT = np.dtype(Event)
STRETCH = 10_000_000 // (8 * RECORD)
"""Rows of a stretch: a tape of 10 MB or, where each row moves and changes the state, of 30; a state
for each stretch, and up to 250 kB more where the fault hypotheses decide."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Stretch:
    """A few seconds of events in order of time, the last an inertial sample."""

    clock: int
    """Number of the clock run: stretches of two runs do not follow each other."""
    epoch: int
    """Added to the rows' times, ns."""
    number: int
    """Of its state before the rows, among those stored."""
    bank: tuple[int, int]
    """First and count of the numbers of the fault hypotheses of that state."""
    first: int
    """Index of its first row among those stored."""
    count: int
    samples: int
    """Number of inertial samples among them."""


class Smoothing(Pipeline):
    """Estimator of a recorded flight: :meth:`run` all of it, then read :meth:`tables`."""

    def __init__(
        self,
        settings: FilterSettings,
        family: str = "unknown",
        gnss_delay: float | None = None,
        *,
        in_memory: int = IN_MEMORY,
    ) -> None:
        """Start without events; settings as for :class:`ekf_companion.engine.pipeline.Pipeline`.

        Beyond ``in_memory`` bytes of rows, of results and of states, a temporary file holds them.
        """
        super().__init__(settings, family, gnss_delay, keeps_history=True)
        self._smoother = Smoother(parameters(settings, family, gnss_delay))
        self._lag_ns = int(delays_ns(settings, family, gnss_delay)[Kind.IMU])
        self._final = Spool(ROW, in_memory)
        self._results = Spool(1 + OUT, in_memory)
        self._blocks = Spool(BLOCK, in_memory)
        self._banks = Spool(1, in_memory)
        self._stretches: list[_Stretch] = []
        self._waiting: list[Array] = []
        self._clock = -1
        self._epoch = 0
        self._block: Array = np.zeros(BLOCK)

    def __enter__(self) -> Smoothing:
        return self

    def __exit__(self, *_: object) -> None:
        """Delete the rows, results and states stored."""
        for spool in (self._final, self._results, self._blocks, self._banks):
            spool.__exit__()

    def run(self, events: Events) -> Table:
        """Process events in order of arrival, and return the live estimates."""
        table = super().run(events)
        self._store(is_over=False)
        return table

    def tables(self, progress: Callable[[int, int], None] | None = None) -> Iterator[Table]:
        """Yield the smoothed estimates, a row per inertial sample, in order of time; once.

        Rows before the alignment are NaN as the live filter's. The status is the live filter's: a
        stretch without GNSS is dead reckoning, though both its ends are known here. The sigmas are
        those of the smoothed estimate. ``progress`` is called with the rows done, and of all.

        Raises:
            LogError: There is no room for the temporary file.
        """
        self._store(is_over=True)
        later: Array | None = None
        after: _Stretch | None = None
        for stretch in reversed(self._stretches):
            is_last = after is None or after.clock != stretch.clock
            rows = self._final.read(stretch.first, stretch.count)
            block = self._blocks.read(stretch.number, 1)[0]
            self._smoother.set_bank(self._banks.read(*stretch.bank)[:, 0])
            blocks = self._smoother.smooth(block, rows, None if is_last else later)
            later, after = blocks[0], stretch
            self._store_results(stretch, rows, blocks[1:])
            if progress is not None:
                progress(len(self._final) - stretch.first, len(self._final))
        del self._smoother  # its tape is large, and nothing more is smoothed
        end = len(self._results)
        for stretch in self._stretches:
            end -= stretch.samples
            results = self._results.read(end, stretch.samples)
            stamps = results[:, 0].copy().view(np.int64)
            yield Table(stamp_ns=stamps, values=np.ascontiguousarray(results[:, 1:]))

    def _store_results(self, stretch: _Stretch, rows: Array, blocks: Array) -> None:
        """Store the estimates of a stretch, each after the bits of its stamp."""
        events = rows.view(_EVENT)[:, 0]
        t = events["t"][events["kind"] == Kind.IMU].astype(np.int64)
        stamps = t + stretch.epoch + self._lag_ns
        results = np.column_stack([stamps.view(np.float64), self._smoother.describe(blocks)])
        self._results.append(results)

    def _store(self, is_over: bool) -> None:
        """Store the rows that are final, in stretches that end with a sample."""
        for clock, epoch, start, rows in self.history(is_over):
            if clock != self._clock:
                self._cut(is_over=True)
                self._clock, self._epoch, self._block = clock, epoch, start
                if as_state(start).mode == Mode.INIT:  # not a clock that was set
                    self._smoother.set_bank(np.zeros(0))
            self._waiting.append(rows)
            if sum(map(len, self._waiting)) >= STRETCH:
                self._cut(is_over=False)
        if is_over:
            self._cut(is_over=True)

    def _cut(self, is_over: bool) -> None:
        """Cut the waiting rows into stretches; the last ones wait on unless all are there."""
        if not self._waiting:
            return
        rows = np.concatenate(self._waiting)
        ends = np.flatnonzero(rows.view(_EVENT)["kind"] == Kind.IMU) + 1
        first = 0
        while first < len(rows):
            index = int(np.searchsorted(ends, first + STRETCH))
            if index == len(ends) and not is_over:
                break
            end = int(ends[min(index, len(ends) - 1)])
            self._add(rows[first:end])
            first = end
        self._waiting = [rows[first:]] if first < len(rows) else []

    def _add(self, rows: Array) -> None:
        """Add a stretch, and run the filter over it."""
        bank = self._smoother.bank()
        self._stretches.append(
            _Stretch(
                clock=self._clock,
                epoch=self._epoch,
                number=len(self._blocks),
                bank=(len(self._banks), len(bank)),
                first=len(self._final),
                count=len(rows),
                samples=int(np.count_nonzero(rows.view(_EVENT)["kind"] == Kind.IMU)),
            )
        )
        self._final.append(rows)
        self._blocks.append(self._block[None])
        self._banks.append(bank[:, None])
        self._block = self._smoother.advance(self._block, rows)


def smooth(
    events: Events,
    settings: FilterSettings,
    family: str = "unknown",
    gnss_delay: float | None = None,
) -> Table:
    """Return the smoothed estimates of a whole recording, one per inertial sample.

    The events are in order of arrival, the other arguments as for :class:`Smoothing`.
    """
    with Smoothing(settings, family, gnss_delay) as smoothing:
        smoothing.run(events)
        return join(list(smoothing.tables()))
