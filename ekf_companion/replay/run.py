"""A recorded flight through the estimator.

The frames of a .tlog go through the daemon's companion, which begins and retunes the pipelines. The
columns of other logs enter behind it, at a pipeline; they start without anything of MAVLink.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Events
from ekf_companion.replay.log_source import open_log
from ekf_companion.replay.screen import Screen
from ekf_companion.replay.worker import CHUNK, Block, Mode, Worker

if TYPE_CHECKING:
    from ekf_companion.engine.companion import Companion
    from ekf_companion.logs.tlog import Autopilot, Tlog
    from ekf_companion.mavlink.frame import Frames
    from ekf_companion.mavlink.outbox import Message
    from ekf_companion.replay.vehicles import Vehicles

Progress = Callable[[int, int], None]
"""Called with how much is done, of how much."""


Step: TypeAlias = "tuple[int, bytes, list[Message]]"
"""Stamp (us), the log's frame there, empty where it has none, and the messages that follow."""


P = TypeVar("P", bound=Pipeline)


class Run(Generic[P]):
    """One log through pipelines of one kind, a new one for each autopilot that is found in it."""

    def __init__(
        self,
        path: Path,
        config: Config,
        kind: Callable[..., P],
        mode: Mode = Mode.BLOCKS,
        log: Recording | None = None,
    ) -> None:
        """Open a log.

        Args:
            path: The log.
            config: The estimator's configuration, and the link's: which autopilot is listened to.
            kind: The class of the pipelines.
            mode: When they process what they are given; :meth:`messages` wants ``ROWS``.
            log: What is in it, if it was opened already.

        Raises:
            LogError: The log cannot be read, or is of an unknown kind.
        """
        self.log = open_log(path) if log is None else log
        self.pipelines: list[P] = []
        """Of the autopilots so far, in their order."""
        self.notes = list(self.log.notes)
        """What one should know of the log and of its vehicles, a sentence each."""
        self.refused: dict[str, int] = {}
        """Counters of the session of a .tlog that are not 0, at its end."""
        self.lost_share = 0.0
        """Of the frames of a .tlog: lost on the link, by their numbers."""
        self.elsewhere = ""
        """Whose inertial samples a .tlog holds that were not asked for, in words."""
        self.screen = Screen()
        """Counts what of columns is no measurement."""
        self._config, self._kind, self._mode = config, kind, mode
        self._worker: Worker | None = None  # of the last of the pipelines
        self._blocks: list[Block] = []  # of all pipelines, not yet yielded
        self._done = 0  # frames or measurements so far
        self._vehicles: Vehicles | None = None  # of a .tlog
        self._system_id = config.link.system_id or 1
        if isinstance(self.log, Recording):
            self.size, self.gnss_delay = len(self.log.events), self.log.gnss_delay
        else:
            self.size, self.gnss_delay = len(self.log), None

    def blocks(self, progress: Progress | None = None) -> Iterator[Block]:
        """Process the log, and yield it block by block."""
        steps = (
            self._chunks(self.log) if isinstance(self.log, Recording) else self._pieces(self.log)
        )
        for _ in steps:
            if len(self._blocks) > 1:
                yield from self._take_blocks(progress, being_processed=1)
        yield from self._take_blocks(progress)

    def messages(
        self, on_block: Callable[[Block], object], progress: Progress | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Process the log, and yield frames with their stamps (us).

        They are those of the log, and behind the sample that makes each due the messages about the
        estimates, as the daemon sends them. ``on_block`` is called with each block.
        """
        from ekf_companion.mavlink.codec import Sender

        ours = Sender(1, self._config.link.component_id)
        steps = self._rows(self.log) if isinstance(self.log, Recording) else self._frames(self.log)
        for stamp_us, frame, messages in steps:
            if frame and not _is_from(frame, ours.component_id):
                yield stamp_us, frame
            for message in messages:
                ours.system_id = self._system_id
                yield stamp_us, ours.frame(message.name, message.payload)
            for block in self._take_blocks(progress) if self._blocks else ():
                on_block(block)

    @property
    def family(self) -> str:
        """Firmware of the autopilot that is listened to; ``unknown``: none is yet."""
        return self.pipelines[-1].family if self.pipelines else "unknown"

    @property
    def autopilot(self) -> Autopilot | None:
        """The autopilot of a .tlog that was listened to for most of it; None: there is none."""
        return None if self._vehicles is None else self._vehicles.compared

    def _frames(self, log: Tlog) -> Iterator[Step]:
        """Let the companion receive each frame."""
        companion = self._open_companion()
        self._look_who_speaks(companion, log)
        for self._done, (stamp_us, frame) in enumerate(log.frames(), 1):
            if companion.session.is_of_board(stamp_us, frame):
                messages = companion.receive_from_board(frame, stamp_us * 1000)
            else:
                messages = companion.receive(frame, stamp_us * 1000)
            self._follow(companion)
            yield stamp_us, frame, messages
        self._note_refused(companion)

    def _pieces(self, log: Tlog) -> Iterator[Step]:
        """Let the companion receive the frames that may change its mind; read the others fast."""
        companion = self._open_companion()
        self._look_who_speaks(companion, log)
        reader, before = companion.reader, 0
        for frames in log.pieces():
            reader.open(frames)
            i = 0
            while i < len(frames):
                if self._worker is not None:
                    i = reader.read(i, self._worker.buffer)
                is_full = self._worker is not None and self._worker.buffer.is_full
                if i < len(frames) and not is_full:
                    self._receive(companion, frames, i)
                    i += 1
                self._done = before + i
                self._follow(companion)
                if self._blocks:
                    yield 0, b"", []
            before += len(frames)
        reader.close()
        self._note_refused(companion)

    def _receive(self, companion: Companion, frames: Frames, i: int) -> None:
        """Let the companion receive a frame that its reader has left to it."""
        now_ns, raw = int(frames.stamp_us[i]) * 1000, frames.raw(i)
        if companion.session.is_of_board(now_ns // 1000, raw):
            companion.receive_from_board(raw, now_ns)
        elif companion.reader.is_whole(i):
            companion.receive_frame(frames.frame(i), now_ns)
        else:
            companion.receive(raw, now_ns)

    def _open_companion(self) -> Companion:
        from ekf_companion.engine.companion import Companion

        return Companion(self._config, open_pipeline=self._open_pipeline)

    def _look_who_speaks(self, companion: Companion, log: Tlog) -> None:
        from ekf_companion.replay.vehicles import Vehicles

        self._vehicles = Vehicles(log, self._config.link.autopilot, self.notes)
        self._vehicles.attend(companion)

    def _follow(self, companion: Companion) -> None:
        """Do what is due after a frame that the companion has received."""
        companion.frames_to_send()  # nobody hears them
        if self._vehicles is not None and self._vehicles.follow(companion, self._worker):
            self._system_id = companion.session.outbox.ids[0]
        self._finish_full_block()

    def _note_refused(self, companion: Companion) -> None:
        if self._vehicles is not None:
            self._vehicles.finish(companion)
            self.elsewhere = self._vehicles.elsewhere
        counts = companion.session.counters()
        self.refused = {name: n for name, n in counts.items() if n and name != "frames"}
        self.lost_share = counts["lost"] / max(counts["lost"] + counts["frames"], 1)

    def _chunks(self, log: Recording) -> Iterator[Step]:
        """Let a pipeline run over the columns, a block at a time."""
        _, worker = self._open_pipeline(self._config, log.family)
        for events in self._screened(log):
            worker.run_block(events)
            yield 0, b"", []

    def _screened(self, log: Recording) -> Iterator[Events]:
        """Yield the measurements a block at a time, without what is none."""
        for start in range(0, self.size, CHUNK):
            self._done = min(start + CHUNK, self.size)
            yield self.screen.pass_on(log.events.take(np.arange(start, self._done)))

    def _rows(self, log: Recording) -> Iterator[Step]:
        """Let a pipeline process the columns row by row, and a publisher send what is due."""
        from ekf_companion.engine.publisher import Publisher
        from ekf_companion.mavlink.decode import Family

        _, worker = self._open_pipeline(self._config, log.family)
        publisher = Publisher(self._config, Family(log.family))
        for events in self._screened(log):
            before = self._done - len(events)
            t_ns, kind, values = events.t_ns, events.kind, events.values
            rows = zip(t_ns.tolist(), kind.tolist(), map(tuple, values.tolist()), strict=True)
            for self._done, row in enumerate(rows, before + 1):
                estimate = worker.process_row(row)
                messages = [] if estimate is None else publisher.due(estimate)
                self._finish_full_block()
                yield row[0] // 1000, b"", messages
        self._finish_full_block()  # nothing may be left of the last measurements

    def _open_pipeline(self, config: Config, family: str) -> tuple[Pipeline, Worker]:
        """Return a new pipeline, and what it is given its measurements by."""
        if self._worker is not None:
            self._worker.finish_block()
        pipeline = self._kind(config, family, self.gnss_delay)
        self._worker = Worker(pipeline, self._blocks.append, self._mode)
        self.pipelines.append(pipeline)
        return pipeline, self._worker

    def _finish_full_block(self) -> None:
        if self._worker is not None and (self._worker.buffer.is_full or self._done == self.size):
            self._worker.finish_block()

    def _take_blocks(self, progress: Progress | None, being_processed: int = 0) -> list[Block]:
        """Return the blocks that are due, processed, but for the last ones."""
        blocks = self._blocks[: len(self._blocks) - being_processed]
        del self._blocks[: len(blocks)]  # the workers hold on to the list
        for block in blocks:
            block.pending.result()
        if progress is not None:
            progress(self._done, self.size)
        return blocks


def _is_from(frame: bytes, component_id: int) -> bool:
    """Whether a frame is of the component whose messages are about to be added."""
    return frame[6 if frame[0] == 0xFD else 4] == component_id
