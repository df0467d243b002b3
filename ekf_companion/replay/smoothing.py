"""The pipeline over a recording and back: estimates that use what came later too.

The events go through the pipeline as they came. What leaves its window is final and in order of
time; it is put aside in stretches of a few seconds, each with the filter's state at its start. Then
the stretches are processed from the last to the first: forward once more from that state, which
writes a tape, and back over the tape. So memory holds one tape, however long the recording; rows
and results are put aside in temporary files where there are many.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType

import numpy as np
import numpy.typing as npt

from ekf_companion.core import state as at
from ekf_companion.core.settings import FilterSettings, delays_ns, parameters
from ekf_companion.core.smooth import Smoother
from ekf_companion.logs.spool import IN_MEMORY, Spool
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Table, join
from ekf_companion.replay.run import BlockPipeline

Array = npt.NDArray[np.float64]

STRETCH = 512
"""Rows between two kept states: 4 kB of state for 60 kB of rows, a tape of 10 MB."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Stretch:
    """Some seconds of events in order of time, the last an inertial sample."""

    clock: int
    """Which run of the autopilot's clock: stretches of two do not follow each other."""
    epoch: int
    """Added to the rows' times, ns."""
    block: Array
    """The filter's state before them, shape (BLOCK,)."""
    first: int
    """Of the rows put aside."""
    count: int
    samples: int
    """Inertial ones among them."""


class Smoothing(BlockPipeline):
    """Estimator of a recorded flight in two passes: :meth:`run` it all, then ask for the tables.

    They are as precise as the whole recording allows; the live estimates are those of :meth:`run`.
    """

    def __init__(
        self,
        settings: FilterSettings,
        family: str = "unknown",
        gnss_delay: float | None = None,
        *,
        in_memory: int = IN_MEMORY,
    ) -> None:
        """Begin with nothing known.

        Args:
            settings: The estimator's settings.
            family: As for :class:`ekf_companion.engine.pipeline.Pipeline`.
            gnss_delay: Likewise.
            in_memory: Bytes of rows, and of results, beyond which a temporary file takes them.
        """
        super().__init__(settings, family, gnss_delay, keeps_history=True)
        self._smoother = Smoother(parameters(settings, family, gnss_delay))
        self._lag_ns = int(delays_ns(settings, family, gnss_delay)[Kind.IMU])
        self._final = Spool(at.ROW, in_memory)
        self._results = Spool(1 + at.OUT, in_memory)
        self._stretches: list[_Stretch] = []
        self._waiting: list[Array] = []
        self._clock = -1
        self._epoch = 0
        self._block: Array = np.zeros(at.BLOCK)

    def __enter__(self) -> Smoothing:
        """Return the estimator itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Forget what was put aside."""
        self._final.__exit__(kind, error, trace)
        self._results.__exit__(kind, error, trace)

    def run(self, events: Events) -> Table:
        """Process events in the order of their arrival; return the live estimates."""
        table = super().run(events)
        self._put_aside(is_over=False)
        return table

    def tables(self, progress: Callable[[int, int], None] | None = None) -> Iterator[Table]:
        """Yield the smoothed estimates, a row per inertial sample, in order of time; only once.

        Rows are as the pipeline's: before the alignment nothing is known here either. The status is
        that of the live filter: a stretch without GNSS is called dead reckoning, though here it is
        known from both its ends. One sigma is that of the smoothed estimate.

        Args:
            progress: Called with how many rows are done, of how many.

        Raises:
            LogError: There is no room for the temporary file.
        """
        self._put_aside(is_over=True)
        later: Array | None = None
        after: _Stretch | None = None
        for stretch in reversed(self._stretches):
            is_last = after is None or after.clock != stretch.clock
            rows = self._final.read(stretch.first, stretch.count)
            blocks = self._smoother.smooth(stretch.block, rows, None if is_last else later)
            later, after = blocks[0], stretch
            self._keep(stretch, rows, blocks[1:])
            if progress is not None:
                progress(len(self._final) - stretch.first, len(self._final))
        end = len(self._results)
        for stretch in self._stretches:
            end -= stretch.samples
            results = self._results.read(end, stretch.samples)
            stamps = results[:, 0].copy().view(np.int64)
            yield Table(stamp_ns=stamps, values=np.ascontiguousarray(results[:, 1:]))

    def _keep(self, stretch: _Stretch, rows: Array, blocks: Array) -> None:
        """Put the estimates of a stretch aside, each behind the bits of its stamp."""
        t = rows[rows[:, at.ROW_KIND] == Kind.IMU, at.ROW_T].astype(np.int64)
        stamps = t + stretch.epoch + self._lag_ns
        results = np.column_stack([stamps.view(np.float64), self._smoother.describe(blocks)])
        self._results.append(results)

    def _put_aside(self, is_over: bool) -> None:
        """Put aside the rows that can change no more, in stretches that end with a sample."""
        for clock, epoch, start, rows in self.history(is_over):
            if clock != self._clock:
                self._cut(is_over=True)
                self._clock, self._epoch, self._block = clock, epoch, start
            self._waiting.append(rows)
            if sum(map(len, self._waiting)) >= STRETCH:
                self._cut(is_over=False)
        if is_over:
            self._cut(is_over=True)

    def _cut(self, is_over: bool) -> None:
        """Cut the waiting rows into stretches; those at the end keep waiting unless it is over."""
        if not self._waiting:
            return
        rows = np.concatenate(self._waiting)
        ends = np.flatnonzero(rows[:, at.ROW_KIND] == Kind.IMU) + 1
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
        self._stretches.append(
            _Stretch(
                clock=self._clock,
                epoch=self._epoch,
                block=self._block,
                first=len(self._final),
                count=len(rows),
                samples=int(np.count_nonzero(rows[:, at.ROW_KIND] == Kind.IMU)),
            )
        )
        self._final.append(rows)
        self._block = self._smoother.advance(self._block, rows)


def smooth(
    events: Events,
    settings: FilterSettings,
    family: str = "unknown",
    gnss_delay: float | None = None,
) -> Table:
    """Return the smoothed estimates of a whole recording, one per inertial sample.

    Args:
        events: In the order of their arrival.
        settings: As for :class:`Smoothing`.
        family: Likewise.
        gnss_delay: Likewise.
    """
    with Smoothing(settings, family, gnss_delay) as smoothing:
        smoothing.run(events)
        return join(list(smoothing.tables()))
