"""Recorded flights in, estimates out: the daemon's own pipeline over a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from ekf_companion.config import Config
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.filters.solution import Solution
from ekf_companion.logs.recording import Recording, one_course
from ekf_companion.logs.writer import CsvWriter, create
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav.measurements import Events, Row, merge
from ekf_companion.nav.state import Table, Trajectory, join
from ekf_companion.pipeline import Arrival, Pipeline
from ekf_companion.publisher import Publisher
from ekf_companion.report import Report, account, conclude, summary
from ekf_companion.selection import run_filter
from ekf_companion.smoothing import Smoothing
from ekf_companion.source import CHUNK, Columns, Source, open_source, tables

Progress = Callable[[int, int], None]
"""Told how much is done, of how much."""


def convert(
    path: Path,
    out: Path,
    config: Config,
    rate: float | None = None,
    progress: Progress | None = None,
    *,
    is_smoothed: bool = False,
) -> Report:
    """Re-run the estimator over a log and write what it says.

    Args:
        path: The log; its suffix says what it is: .tlog, .bin, .ulg, .csv.
        out: Where to; .csv gives a row per inertial sample, .tlog the messages that the daemon
            sends (beside the original ones, where the log is a .tlog too).
        config: The estimator's configuration.
        rate: Rows per second at most, Hz; None: all.
        progress: Told how far it is.
        is_smoothed: Each estimate knows the whole log, not only what came before it.

    Raises:
        LogError: The log cannot be read, or nothing can be estimated from it.
        ConfigError: Smoothed estimates are asked for as a .tlog.
    """
    if is_smoothed and out.suffix == ".tlog":
        raise ConfigError(
            f"{out}: a .tlog holds what the daemon sends, which knows nothing of what comes later; "
            "name a .csv for smoothed estimates"
        )
    if out.suffix not in (".csv", ".tlog"):
        raise LogError(f"{out}: unknown kind of output; name it .csv or .tlog")
    if out.resolve() == path.resolve():
        raise LogError(f"{out}: is the log itself; name another file")
    report = Report(log=str(path))
    source = open_source(path, config, report)
    if out.suffix == ".csv":
        with CsvWriter(out) as writer:
            last_ns: int | None = None
            run = _smoothed if is_smoothed else _estimates
            for table in run(source, config, report, progress):
                kept = _thin(table, rate, last_ns)
                writer.write(kept.stamp_ns, kept.values)
                last_ns = int(table.stamp_ns[-1]) if len(table) else last_ns
    else:
        if isinstance(source, Columns) and source.events.t_ns.min(initial=0) < 0:
            raise LogError(f"{path}: has times before zero, which a .tlog cannot hold; name a .csv")
        with closing(create(out)) as file:
            for stamp_us, frame in _messages(source, config, report, progress):
                file.write(stamp_us.to_bytes(8, "big") + frame)
    conclude(report, path)
    return report


def convert_by(
    name: str, path: Path, out: Path, config: Config, rate: float | None = None
) -> Solution:
    """Take a filter of :mod:`ekf_companion.selection` through a log and write what it says.

    Raises:
        LogError: As :func:`convert`, or the log lacks what the filter needs.
    """
    if out.resolve() == path.resolve():
        raise LogError(f"{out}: is the log itself; name another file")
    if out.suffix != ".csv":
        raise LogError(f"{out}: estimates of {name} are written as .csv; name such a file")
    recording = read(path, config)
    try:
        solution = run_filter(recording, name, config)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    solution = replace(solution, notes=(*solution.notes, *recording.notes))
    with CsvWriter(out) as writer:
        kept = _thin(solution.table, rate, None)
        writer.write(kept.stamp_ns, kept.values)
    return solution


def estimate(
    path: Path, config: Config, progress: Progress | None = None
) -> tuple[Table, Report, Trajectory | None, Trajectory | None]:
    """Re-run the estimator and give all estimates, the report, the log's reference and truth.

    Raises:
        LogError: As :func:`convert`.
    """
    report = Report(log=str(path))
    source = open_source(path, config, report)
    found = list(_estimates(source, config, report, progress))
    conclude(report, path)
    return join(found), report, source.reference, source.truth


def estimate_and_smooth(
    path: Path, config: Config, progress: Progress | None = None
) -> tuple[Table, Table, Report, Trajectory | None, Trajectory | None]:
    """Do the same, and give the smoothed estimates behind those of the live filter.

    Raises:
        LogError: As :func:`convert`.
    """
    report = Report(log=str(path))
    source = open_source(path, config, report)
    live: list[Table] = []
    smoothed = list(_smoothed(source, config, report, progress, live))
    conclude(report, path)
    return join(live), join(smoothed), report, source.reference, source.truth


def read(
    path: Path | str, config: Config | None = None, progress: Progress | None = None
) -> Recording:
    """Give the events of a log, whatever its format: the longest course of time without a restart.

    Args:
        path: The log.
        config: Whose ``link`` says which autopilot of a .tlog is listened to; None: the first.
        progress: Told how far it is.

    Raises:
        LogError: The log cannot be read, or holds no event at all.
    """
    path, report = Path(path), Report(log=str(path))
    source = open_source(path, config or Config(), report)
    parts = []
    for done, events, _ in tables(source):
        parts.append(events)
        if progress is not None:
            progress(done, source.size)
    if not sum(map(len, parts)):
        raise LogError(f"{path}: holds no measurement; ask the autopilot to log or stream them")
    arrival = [np.zeros(len(part), dtype=np.int64) for part in parts]
    events, notes = one_course(merge(*parts, arrival_ns=arrival))
    return Recording(
        family=report.family,
        events=events,
        reference=source.reference,
        truth=source.truth,
        counted=source.counted,
        gnss_delay=source.delay,
        notes=(*report.notes, *notes),
    )


def _estimates(
    source: Source, config: Config, report: Report, progress: Progress | None
) -> Iterator[Table]:
    pipeline: Pipeline | None = None
    for done, events, turned in tables(source):
        if pipeline is None:
            pipeline = Pipeline(config, report.family, source.delay)
        table = pipeline.run(events)
        if turned is not None:
            pipeline.retune(turned)
        account(report, events, table)
        if progress is not None:
            progress(done, source.size)
        yield table
    if pipeline is not None:
        report.health = pipeline.health()


def _smoothed(
    source: Source,
    config: Config,
    report: Report,
    progress: Progress | None,
    live: list[Table] | None = None,
) -> Iterator[Table]:
    """Give the smoothed estimates; those of the live filter go to the list, if there is one."""
    smoothing: Smoothing | None = None
    for done, events, turned in tables(source):
        if smoothing is None:
            smoothing = Smoothing(config, report.family, source.delay)
        table = smoothing.run(events)
        if turned is not None:
            smoothing.pipeline.retune(turned)
        account(report, events, table)
        if live is not None:
            live.append(table)
        if progress is not None:
            progress(done, 2 * source.size)
    if smoothing is None:
        return
    report.health = smoothing.pipeline.health()

    def halfway(done: int, total: int) -> None:
        if progress is not None:
            progress(total + done, 2 * total)

    with smoothing:
        yield from smoothing.tables(halfway)


def _messages(
    source: Source, config: Config, report: Report, progress: Progress | None
) -> Iterator[tuple[int, bytes]]:
    """Give the original frames and, behind the sample that makes them due, our messages."""
    pipeline: Pipeline | None = None
    publisher: Publisher | None = None
    sender = Sender(1, config.link.component_id)
    ours: list[bytes] = []
    taken: list[Row] = []
    made: list[tuple[int, np.ndarray]] = []
    for done, (stamp_us, frame, rows, turned) in enumerate(source.records(), 1):
        if turned is not None and pipeline is not None and publisher is not None:
            pipeline.retune(turned)
            publisher.retune(turned)
        if frame and not _is_from(frame, sender.component_id):
            yield stamp_us, frame
        for row in rows:
            if pipeline is None or publisher is None:
                family = Family(report.family)
                sender.system_id = config.link.system_id or source.system_id
                pipeline = Pipeline(config, report.family, source.delay)
                publisher = Publisher(config, pipeline, family)
            if pipeline.insert(row) is Arrival.ESTIMATED:
                publisher.publish(lambda name, payload: ours.append(sender.frame(name, payload)))
                made.append((pipeline.stamp_ns, pipeline.estimate()))
            taken.append(row)
        for message in ours:
            yield stamp_us, message
        ours.clear()
        if len(taken) >= CHUNK or done == source.size:
            account(report, Events.from_rows(taken), _stack(made))
            taken, made = [], []
            if progress is not None:
                progress(done, source.size)
    if pipeline is not None:
        report.health = pipeline.health()


def _is_from(frame: bytes, component_id: int) -> bool:
    """Whether a frame is of the component whose messages we are about to add."""
    return frame[6 if frame[0] == 0xFD else 4] == component_id


def _stack(estimates: list[tuple[int, np.ndarray]]) -> Table:
    return Table(
        stamp_ns=np.array([stamp for stamp, _ in estimates], dtype=np.int64),
        values=np.array([values for _, values in estimates]).reshape(len(estimates), -1),
    )


def _thin(table: Table, rate: float | None, last_ns: int | None) -> Table:
    """Keep the first estimate of each period; the stamp of the one before the table tells its."""
    if rate is None or len(table) == 0:
        return table
    period = np.int64(round(1e9 / rate))
    slot = table.stamp_ns // period
    before = slot[0] - 1 if last_ns is None else last_ns // period
    first = np.diff(slot, prepend=before) != 0
    return Table(stamp_ns=table.stamp_ns[first], values=table.values[first])


__all__ = ["Report", "convert", "estimate", "estimate_and_smooth", "read", "summary"]
