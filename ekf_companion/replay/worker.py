"""The measurements of a recording through a pipeline, block by block."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from enum import Enum
from typing import NamedTuple

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Estimate, Pipeline
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.measurements import Events, Row
from ekf_companion.nav.state import COLUMNS, Table

CHUNK = 20_000
"""Measurements in a block."""


class Mode(Enum):
    """When measurements are processed; the bits are the same."""

    BLOCKS = "blocks"
    """A block at a time, which is much faster."""
    ROWS = "rows"
    """At once, one by one, as in flight: for what is sent of them."""
    NEVER = "never"
    """For the measurements alone."""


class Block(NamedTuple):
    """Consecutive measurements of one autopilot, and the estimates of their inertial samples."""

    pipeline: Pipeline
    events: Events
    pending: Future[Table]

    @property
    def table(self) -> Table:
        """The estimates, once they have been made."""
        return self.pending.result()


class Worker:
    """Lets one pipeline process measurements.

    Whole blocks are processed on a thread, one after the other: the kernel leaves the interpreter
    free, for the next measurements to be read and the last estimates to be written meanwhile.
    """

    def __init__(
        self, pipeline: Pipeline, finish: Callable[[Block], None], mode: Mode = Mode.BLOCKS
    ) -> None:
        """Begin without measurements; ``finish`` is called with each block when it is complete."""
        self.pipeline = pipeline
        self.buffer = EventBuffer(CHUNK)
        """Measurements of the block that is not finished yet."""
        self.measured = 0
        """Measurements of all blocks."""
        self._finish, self._mode = finish, mode
        self._thread: Executor = ThreadPoolExecutor(max_workers=1)
        self._stamps: list[int] = []
        self._values: list[np.ndarray] = []

    def process_row(self, row: Row) -> Estimate | None:
        """Keep a measurement for its block; return its estimate where it is processed at once."""
        self.buffer.append(row)
        if self._mode is not Mode.ROWS or (estimate := self.pipeline.process_row(row)) is None:
            return None
        self._stamps.append(estimate.t_ns)
        self._values.append(estimate.values)
        return estimate

    def finish_block(self) -> Block:
        """Let the measurements that were kept be processed."""
        return self.run_block(self.buffer.take())

    def run_block(self, events: Events) -> Block:
        """Let measurements be processed as a block of their own."""
        self.measured += len(events)
        if self._mode is Mode.BLOCKS:
            pending = self._thread.submit(self.pipeline.run, events)
        else:
            pending = Future()
            pending.set_result(self._take_estimates())
        block = Block(self.pipeline, events, pending)
        self._finish(block)
        return block

    def retune(self, settings: FilterSettings) -> None:
        """Finish the block by the settings so far, and go on with others."""
        self.finish_block().pending.result()
        self.pipeline.retune(settings)

    def _take_estimates(self) -> Table:
        """Return the estimates of what has been processed already."""
        values = np.array(self._values).reshape(-1, len(COLUMNS) - 1)
        table = Table(stamp_ns=np.array(self._stamps, dtype=np.int64), values=values)
        self._stamps, self._values = [], []
        return table
