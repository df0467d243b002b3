"""Recorded flights of every format as one thing: events, record by record or in tables."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.engine.companion import guard_options, session_options
from ekf_companion.engine.tuning import Tuning
from ekf_companion.errors import LogError
from ekf_companion.logs import broad, csv, dataflash, openshoe, tlog, tlog_trajectory, ulog
from ekf_companion.logs.recording import Counted, Recording
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import ParameterSet, PeerFound
from ekf_companion.mavlink.session import Session
from ekf_companion.nav.measurements import Events, Row
from ekf_companion.nav.state import Trajectory
from ekf_companion.replay.report import Report

CHUNK = 20_000
"""Events between two words on progress."""
READERS = {
    ".bin": dataflash.read,
    ".ulg": ulog.read,
    ".csv": csv.read,
    ".txt": openshoe.read,
    ".mat": broad.read,
}
FORMATS = ".tlog, .bin, .ulg, .csv, .txt (OpenShoe), .mat (BROAD)"


class Record(NamedTuple):
    """One step of a log."""

    stamp_us: int
    frame: bytes
    """Empty: the log has none."""
    rows: list[Row]
    """What it measured."""
    turned: Config | None
    """The configuration from here on, where somebody turned a parameter in flight."""
    peer: PeerFound | None
    """Whose it is; None: nobody's yet."""


class Part(NamedTuple):
    """Events of one autopilot, up to where something changes."""

    done: int
    """Records up to here."""
    events: Events
    turned: Config | None
    """The configuration from their end on."""
    peer: PeerFound | None

    @property
    def family(self) -> str:
        """The autopilot's; settles what is ``auto``."""
        return (Family.UNKNOWN if self.peer is None else self.peer.family).value


class Telemetry:
    """A .tlog as a source of events: the daemon's own session over its frames."""

    def __init__(self, log: tlog.Tlog, config: Config, report: Report) -> None:
        """Begin before the first frame; notes and counts go to the report."""
        self._log = log
        self._session = Session(session_options(config, is_recording=False))
        self._tuning = Tuning(config)
        self._is_turned = False
        self._report = report
        self.size = len(log)
        self.delay: float | None = None
        self.counted: Counted | None = None
        self._peer: PeerFound | None = None
        report.notes += log.notes

    @property
    def reference(self) -> Trajectory | None:
        """The autopilot's own estimate."""
        return tlog_trajectory.reference(self._log)

    @property
    def truth(self) -> Trajectory | None:
        """The simulator's."""
        return tlog_trajectory.truth(self._log)

    def records(self) -> Iterator[Record]:
        """Give each frame and what it measured, in the order of the file."""
        session = self._session
        for stamp_us, raw in self._log.frames():
            measured = session.receive(raw, stamp_us * 1000)
            session.data_to_send()
            for event in session.events():
                if isinstance(event, PeerFound):
                    self._meet(event)
                elif isinstance(event, ParameterSet):
                    session.guard.retune(guard_options(self._tuning.set(event.key, event.value)))
                    self._is_turned = True
            turned = self._tuning.config if self._is_turned and self._peer else None
            self._is_turned = self._is_turned and turned is None
            rows = [measurement.row() for measurement in measured]
            yield Record(stamp_us, raw, rows, turned, self._peer)
        self._report.refused = {
            name: count for name, count in session.counters().items() if count and name != "frames"
        }

    def _meet(self, peer: PeerFound) -> None:
        if self._peer not in (None, peer):
            self._report.notes.append(
                f"the autopilot is another from some time on: system {peer.system_id}, component "
                f"{peer.component_id}, {peer.family.value}; the estimate begins anew there"
            )
        self._peer = peer
        self._report.family = peer.family.value


class Columns:
    """A log of columns as a source of events."""

    def __init__(self, recording: Recording, report: Report) -> None:
        """Take a recording; its notes go to the report."""
        self.events = recording.events
        self.reference = recording.reference
        self.truth = recording.truth
        self.counted = recording.counted
        self.delay = recording.gnss_delay
        self._peer = PeerFound(1, 1, Family(recording.family))
        self.size = len(recording.events)
        report.family = recording.family
        report.notes += recording.notes

    def records(self) -> Iterator[Record]:
        """Give each event with its stamp; there is no frame, and nobody to turn anything."""
        events = self.events
        for t_ns, kind, values in zip(
            events.t_ns.tolist(), events.kind.tolist(), events.values.tolist(), strict=True
        ):
            yield Record(t_ns // 1000, b"", [(t_ns, kind, tuple(values))], None, self._peer)

    def part(self, chosen: np.ndarray) -> Part:
        """Give some of the events."""
        return Part(int(chosen[-1]) + 1, self.events.take(chosen), None, self._peer)


Source = Telemetry | Columns


def open_source(path: Path, config: Config, report: Report) -> Source:
    """Open a log as a source of events.

    Raises:
        LogError: It cannot be read, or is of an unknown kind.
    """
    suffix = path.suffix.lower()
    if suffix == ".tlog":
        return Telemetry(tlog.read(path), config, report)
    if suffix not in READERS:
        raise LogError(f"{path}: unknown kind of log; known are {FORMATS}")
    return Columns(READERS[suffix](path), report)


def parts(source: Source) -> Iterator[Part]:
    """Give the events in chunks, a new one also where something changes."""
    if isinstance(source, Columns):
        for start in range(0, source.size, CHUNK):
            yield source.part(np.arange(start, min(start + CHUNK, source.size)))
        return
    rows: list[Row] = []
    peer: PeerFound | None = None
    for done, record in enumerate(source.records(), 1):
        is_other = peer not in (None, record.peer)
        if record.turned is not None or is_other or len(rows) >= CHUNK:
            yield Part(done - 1, Events.from_rows(rows), record.turned, peer)
            rows = []
        peer = record.peer
        rows += record.rows
    yield Part(source.size, Events.from_rows(rows), None, peer)
