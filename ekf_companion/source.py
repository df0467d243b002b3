"""Recorded flights of every format as one thing: events, record by record or in tables."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ekf_companion.companion import session_options
from ekf_companion.config import Config
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.logs import broad, csv, dataflash, openshoe, tlog, tlog_trajectory, ulog
from ekf_companion.logs.recording import Counted, Recording
from ekf_companion.mavlink.event import ParameterSet, PeerFound
from ekf_companion.mavlink.session import Session
from ekf_companion.nav.measurements import Events, Row
from ekf_companion.nav.state import Trajectory
from ekf_companion.report import Report
from ekf_companion.tuning import Tuning

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
        self.system_id = 0
        """Of the autopilot; 0: not heard yet."""
        report.notes += log.notes

    @property
    def reference(self) -> Trajectory | None:
        """The autopilot's own estimate."""
        return tlog_trajectory.reference(self._log)

    @property
    def truth(self) -> Trajectory | None:
        """The simulator's."""
        return tlog_trajectory.truth(self._log)

    def records(self) -> Iterator[tuple[int, bytes, list[Row], Config | None]]:
        """Give stamp, frame and what it measured, in the order of the file.

        And the configuration from there on, where somebody turned a parameter in flight.
        """
        session = self._session
        for stamp_us, raw in self._log.frames():
            measured = session.receive(raw, stamp_us * 1000)
            session.data_to_send()
            for event in session.events():
                if isinstance(event, PeerFound) and not self.system_id:
                    self.system_id = event.system_id
                    self._report.family = event.family.value
                elif isinstance(event, ParameterSet):
                    self._tuning.set(event.key, event.value)
                    self._is_turned = True
            turned = self._tuning.config if self._is_turned and self.system_id else None
            self._is_turned = self._is_turned and turned is None
            yield stamp_us, raw, [measurement.row() for measurement in measured], turned
        self._report.refused = {
            name: count for name, count in session.counters().items() if count and name != "frames"
        }


class Columns:
    """A log of columns as a source of events."""

    def __init__(self, recording: Recording, report: Report) -> None:
        """Take a recording; its notes go to the report."""
        self.events = recording.events
        self.reference = recording.reference
        self.truth = recording.truth
        self.counted = recording.counted
        self.delay = recording.gnss_delay
        self.system_id = 1
        self.size = len(recording.events)
        report.family = recording.family
        report.notes += recording.notes

    def records(self) -> Iterator[tuple[int, bytes, list[Row], Config | None]]:
        """Give each event with its stamp; there is no frame, and nobody to turn anything."""
        events = self.events
        for t_ns, kind, values in zip(
            events.t_ns.tolist(), events.kind.tolist(), events.values.tolist(), strict=True
        ):
            yield t_ns // 1000, b"", [(t_ns, kind, tuple(values))], None


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


def tables(source: Source) -> Iterator[tuple[int, Events, FilterSettings | None]]:
    """Give how many records are done, the events in chunks, and the settings from then on."""
    if isinstance(source, Columns):
        for start in range(0, source.size, CHUNK):
            chosen = np.arange(start, min(start + CHUNK, source.size))
            yield int(chosen[-1]) + 1, source.events.take(chosen), None
        return
    rows: list[Row] = []
    for done, (_, _, measured, turned) in enumerate(source.records(), 1):
        if turned is not None or len(rows) >= CHUNK:
            yield done - 1, Events.from_rows(rows), turned
            rows = []
        rows += measured
    yield source.size, Events.from_rows(rows), None
