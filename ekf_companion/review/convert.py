"""Convert recorded flights to estimates, as files or tables, and report on each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.logs.map_time import Label
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.source import real_path
from ekf_companion.logs.writer import RATES, STDOUT, WRITERS, Thinning, create, open_writer
from ekf_companion.nav.state import Table, join
from ekf_companion.replay.log_source import open_log, utc_zero_ns
from ekf_companion.replay.read import read
from ekf_companion.replay.run import Progress
from ekf_companion.replay.smoothing import Smoothing
from ekf_companion.replay.worker import Mode
from ekf_companion.review.report import Report
from ekf_companion.review.review import Review

if TYPE_CHECKING:
    from ekf_companion.filters.solution import Solution
    from ekf_companion.replay.pose_aid import PoseFile


def convert(
    path: Path,
    outs: Path | Sequence[Path],
    config: Config,
    rate: float | None = None,
    progress: Progress | None = None,
    *,
    is_smoothed: bool = False,
    aid: PoseFile | None = None,
) -> Report:
    """Re-run the estimator over a log and write its estimates.

    Args:
        path: The log, its format told by its suffix: .tlog, .bin, .ulg, .csv.
        outs: The files to write, by their suffixes: a .tlog gets the messages that the daemon sends
            (beside the original ones, where the log is a .tlog too), the kinds of
            :data:`.writer.WRITERS` an estimate per inertial sample; ``-`` is CSV on the standard
            output.
        config: The estimator's configuration.
        rate: Estimates per second at most, Hz; None: all, but on maps.
        progress: Called with how much is done.
        is_smoothed: Whether each estimate uses the whole log, not only what came before it.
        aid: Poses of another estimator, which are merged into the log.

    Raises:
        LogError: The log cannot be read, or nothing can be estimated from it.
        ConfigError: An output is the log itself, or of no known kind; smoothed estimates are
            asked for as a .tlog.
    """
    outs = [outs] if isinstance(outs, Path) else list(outs)
    for out in outs:
        _check_output(path, out, is_smoothed=is_smoothed)
    files = [out for out in outs if out.suffix != ".tlog"]
    report = None
    if files:
        report = _convert_to_files(path, files, config, rate, progress, is_smoothed, aid)
    for out in outs:
        if out.suffix == ".tlog":
            report = _convert_to_messages(path, out, config, progress, aid)
    assert report is not None, "no output"
    return report


def _check_output(path: Path, out: Path, *, is_smoothed: bool) -> None:
    if is_smoothed and out.suffix == ".tlog":
        raise ConfigError(
            f"{out}: a .tlog holds what the daemon sends, which knows nothing of what comes later; "
            "name a .csv for smoothed estimates"
        )
    if out != STDOUT and out.suffix not in (*WRITERS, ".tlog"):
        known = ", ".join([*WRITERS, ".tlog"])
        raise ConfigError(f"{out}: unknown kind of output; known are {known}, and - for CSV")
    if real_path(out) == real_path(path):
        raise ConfigError(f"{out}: is the log itself; name another file")


def _convert_to_files(
    path: Path,
    outs: Sequence[Path],
    config: Config,
    rate: float | None,
    progress: Progress | None,
    is_smoothed: bool,
    aid: PoseFile | None,
) -> Report:
    review: Review[Smoothing] | Review[Pipeline]
    with ExitStack() as stack:
        if is_smoothed:
            review = Review(path, config, Smoothing, aid=aid)
            tables = _smoothed(review, progress)
        else:
            review = Review(path, config, Pipeline, aid=aid)
            tables = (block.table for block in review.blocks(progress))
        run = review.run
        label = cache(lambda: Label(path.name, utc_zero_ns(run.log, run.autopilot)))
        writers = [
            (stack.enter_context(open_writer(out, label)), Thinning(rate or RATES.get(out.suffix)))
            for out in outs
        ]
        for table in tables:
            for writer, thinning in writers:
                writer.write(thinning.thin(table))
        report = review.finish()  # raises where nothing was estimated: then no file is left
        pairs = zip(outs, writers, strict=True)
        empty = [out.name for out, (writer, _) in pairs if writer.points == 0]
        report.notes += [f"{name}: holds no point, for no position was estimated" for name in empty]
        return report


def _convert_to_messages(
    path: Path, out: Path, config: Config, progress: Progress | None, aid: PoseFile | None
) -> Report:
    review = Review(path, config, Pipeline, Mode.ROWS, aid)
    log = review.run.log
    if isinstance(log, Recording) and log.events.t_ns.min(initial=0) < 0:
        raise LogError(f"{path}: has times before zero, which a .tlog cannot hold; name a .csv")
    with create(out) as file:
        for stamp_us, frame in review.messages(progress):
            file.write(stamp_us.to_bytes(8, "big") + frame)
    return review.finish()


def convert_by(
    name: str,
    path: Path,
    outs: Path | Sequence[Path],
    config: Config,
    rate: float | None = None,
) -> Solution:
    """Run a filter of :mod:`.filters_by_name` over a log and write its estimates.

    Raises:
        LogError: As :func:`convert`, or the log lacks what the filter needs.
        ConfigError: As :func:`convert`; a .tlog is asked for.
    """
    from ekf_companion.replay.filters_by_name import run_filter

    outs = [outs] if isinstance(outs, Path) else list(outs)
    for out in outs:
        _check_output(path, out, is_smoothed=False)
        if out.suffix == ".tlog":
            raise ConfigError(f"{out}: estimates of {name} are no messages; name a .csv")
    recording = read(path, config)
    try:
        solution = run_filter(recording, name, config)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    label = cache(lambda: Label(path.name, utc_zero_ns(open_log(path))))
    for out in outs:
        with open_writer(out, label) as writer:
            writer.write(Thinning(rate or RATES.get(out.suffix)).thin(solution.table))
    return replace(solution, notes=(*solution.notes, *recording.notes))


def estimate(
    path: Path, config: Config, progress: Progress | None = None, aid: PoseFile | None = None
) -> tuple[Table, Report]:
    """Re-run the estimator; return all estimates, and the report, with what the log says itself.

    Raises:
        LogError: As :func:`convert`.
    """
    review = Review(path, config, Pipeline, aid=aid)
    tables = [block.table for block in review.blocks(progress)]
    report = review.finish()  # raises where there is no table
    return join(tables), report


def estimate_and_smooth(
    path: Path, config: Config, progress: Progress | None = None, aid: PoseFile | None = None
) -> tuple[Table, Table, Report]:
    """Do the same, and return the smoothed estimates behind those of the live filter.

    Raises:
        LogError: As :func:`convert`.
    """
    review = Review(path, config, Smoothing, aid=aid)
    live: list[Table] = []
    smoothed = list(_smoothed(review, progress, live))
    report = review.finish()
    return join(live), join(smoothed), report


def _smoothed(
    review: Review[Smoothing], progress: Progress | None, live: list[Table] | None = None
) -> Iterator[Table]:
    """Yield the smoothed estimates; append those of the live filter to ``live``."""

    def forward(done: int, total: int) -> None:
        if progress is not None:
            progress(done, 2 * total)

    def backward(done: int, total: int) -> None:
        if progress is not None:
            progress(total + done, 2 * total)

    for block in review.blocks(forward):
        if live is not None:
            live.append(block.table)
    review.compare_sensors()
    for smoothing in review.run.pipelines:
        with smoothing:
            yield from smoothing.tables(backward)
