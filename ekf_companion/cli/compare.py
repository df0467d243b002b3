"""Compare estimates with a truth, with the autopilot's, and with each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError, LogError

if TYPE_CHECKING:
    from ekf_companion.config.config import Config
    from ekf_companion.nav.state import Trajectory
    from ekf_companion.replay.pose_aid import PoseFile
    from ekf_companion.review.report import Report

_WITHOUT_REFERENCE = (
    "{}: holds neither a truth nor the autopilot's own estimate; "
    "name a truth with --reference TRUTH.csv, or of a walk --filters zupt"
)


def compare(
    log: Annotated[Path, typer.Argument(help="A log, or an estimate that convert wrote (.csv).")],
    reference: Annotated[
        Path | None,
        typer.Option(help="Truth as .csv; else the log's own truth and the autopilot's estimate."),
    ] = None,
    config: terminal.ConfigOption = None,
    until: Annotated[
        float | None,
        typer.Option(
            help="Leave out what comes later than this, s after the start.", min=0.0, max=1e9
        ),
    ] = None,
    skip: Annotated[
        float | None,
        typer.Option(
            help="Leave out the first seconds; default: 30 against a truth, else 20.",
            min=0.0,
            max=1e9,
        ),
    ] = None,
    filters: Annotated[
        str | None,
        typer.Option(
            help="Run several over the log: eskf,euler,iterated,ukf; zupt; ahrs,mahony,vqf. "
            "NAME:? lists the options of one."
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw all trajectories into a .png, .pdf or .svg.", callback=terminal.figure_name
        ),
    ] = None,
    smooth: terminal.SmoothOption = False,
    aid: terminal.AidOption = None,
    aid_offset: terminal.AidOffsetOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Compare our estimate, or several filters', with a truth or the autopilot's own."""
    with terminal.exit_on_error():
        inputs = {
            "the log": log,
            "the reference": reference,
            "the configuration": config,
            "the poses": aid,
        }
        terminal.check_outputs(inputs, [("--plot", plot)])
        poses = terminal.pose_file(aid, aid_offset)
        if filters is None:
            ours = _ours(
                log, terminal.load(config), reference, poses, is_smoothed=smooth, is_silent=as_json
            )
            _compare_ours(log, ours, reference, (skip, until), plot, as_json)
        elif poses is not None:
            raise ConfigError("--aid: aids eskf only; leave --filters or --aid out")
        elif smooth:
            raise ConfigError("--smooth: smooths eskf only; leave --filters or --smooth out")
        else:
            _compare_filters(
                log, filters, reference, terminal.load(config), (skip, until), plot, as_json
            )


class _Ours(NamedTuple):
    """Our estimate of a log, and the references in it."""

    estimate: Trajectory
    live: list[Trajectory]
    """Estimate of the live filter, where ours is smoothed."""
    report: Report | None = None
    """Report of the run; None where the estimate was read from a file."""

    @property
    def own(self) -> Trajectory | None:
        """The autopilot's."""
        return self.report.own if self.report else None

    @property
    def truth(self) -> Trajectory | None:
        """The one that the log holds."""
        return self.report.truth if self.report else None


def _ours(
    log: Path,
    config: Config,
    reference: Path | None,
    aid: PoseFile | None,
    *,
    is_smoothed: bool,
    is_silent: bool,
) -> _Ours:
    """Run the estimator over a log and print the verdict, or read an estimate that it wrote."""
    from ekf_companion.logs.estimate import is_estimate, of_table, read_estimate, read_truth
    from ekf_companion.review import convert as converter
    from ekf_companion.review.evidence import take_truth
    from ekf_companion.review.report import summary
    from ekf_companion.review.verdict import judge_log

    if is_estimate(log):
        if is_smoothed:
            raise ConfigError(
                f"--smooth: {log} is an estimate already; name the log that it was made from"
            )
        if aid is not None:
            raise ConfigError(
                f"--aid: {log} is an estimate already; name the log that it was made from"
            )
        return _Ours(read_estimate(log), [])
    live: list[Trajectory] = []
    with progress_line(log.name) as progress:
        if is_smoothed:
            table, smoothed, report = converter.estimate_and_smooth(log, config, progress, aid)
            estimate = of_table(smoothed, "ekf-companion, smoothed")
            live.append(of_table(table, "ekf-companion, live"))
        else:
            table, report = converter.estimate(log, config, progress, aid)
            estimate = of_table(table, "ekf-companion")
    if not is_silent:
        if reference is not None and not is_estimate(reference):
            take_truth(report, read_truth(reference))
        lines = [judge_log(report).sentence, *summary(report)]
        typer.echo("\n".join(lines) + "\n")
    return _Ours(estimate, live, report)


def _compare_ours(
    log: Path,
    ours: _Ours,
    reference: Path | None,
    span: tuple[float | None, float | None],
    plot: Path | None,
    as_json: bool,
) -> None:
    """Print the errors of our estimate against a truth or the autopilot's."""
    from ekf_companion.analysis import score, trajectory_figure
    from ekf_companion.logs.estimate import read_truth
    from ekf_companion.review.evidence import evidence_of

    estimate = ours.estimate
    truth = ours.truth if reference is None else read_truth(reference)
    against = truth if truth is not None else ours.own
    if against is None:
        raise LogError(_WITHOUT_REFERENCE.format(log))
    skip, until = span
    default = 30.0 if truth is not None else 20.0
    seconds = default if skip is None else skip
    begin = int(estimate.att_t_ns[0]) if len(estimate.att_t_ns) else 0
    end = None if until is None else begin + round(until * 1e9)
    scores = [score.score(estimate, against, seconds, end_ns=end)]
    has_any = scores[0].horizontal is not None or scores[0].tilt is not None
    if not has_any or scores[0].end_ns <= scores[0].start_ns:
        when = f"after the first {seconds:g} s; leave out fewer with --skip"
        if until is not None:
            before = f"before {until:g} s; leave out less with --skip and --until"
            when = f"after the first {seconds:g} s and {before}"
        raise LogError(f"{log}: {estimate.name} and {against.name} have no time in common {when}")
    own = [ours.own] if truth is not None and ours.own is not None else []
    start = scores[0].start_ns
    for rival in (*ours.live, *own):
        scores.append(score.score(rival, against, 0.0, start_ns=start, end_ns=end))
    lines = score.table(scores)
    if seconds > 0.0:
        lines.insert(2 * len(scores), _left_out(seconds))
    terminal.show(as_json, [one.to_dict() for one in scores], lines)
    if own_words := _if_own(reference, "two estimates' distance, and no error"):
        typer.echo(f"note: {own_words}", err=as_json)
    elif truth is not None and ours.report is not None:
        ours.report.truth = truth
        if doubt := evidence_of(ours.report).truth_elsewhere:
            typer.echo(f"note: {doubt}", err=as_json)
    if plot is not None:
        with progress_line(f"{plot.name}: drawing"):
            trajectory_figure.plot(plot, [estimate, *ours.live, against, *own], log.name)
        typer.echo(f"figure: {plot}", err=as_json)


def _if_own(reference: Path | None, words: str) -> str:
    """Return a note on comparing with an estimate that we wrote; empty: it is not ours."""
    from ekf_companion.logs.estimate import OWN, is_estimate

    if reference is None or not is_estimate(reference):
        return ""
    return f"{reference.name}: {OWN}, and no truth: {words}"


def _left_out(seconds: float) -> str:
    """Return the line on the start, which is left out."""
    return f"the first {seconds:g} s are left out (--skip 0 counts them)"


def _compare_filters(
    log: Path,
    filters: str,
    reference: Path | None,
    config: Config,
    span: tuple[float | None, float | None],
    plot: Path | None,
    as_json: bool,
) -> None:
    """Run several filters over a log, and print the errors of each."""
    from ekf_companion.analysis import comparison, trajectory_figure, walk_figure
    from ekf_companion.logs.estimate import is_estimate, read_truth

    if is_estimate(log):
        raise ConfigError(f"--filters: {log} is an estimate; name the log that it was made from")
    recording = terminal.read(log, config)
    names = [name.strip() for name in filters.split(",") if name.strip()]
    try:
        with progress_line(f"{log.name}: filters") as progress:
            entries = comparison.run_filters(recording, names, config, progress)
    except LogError as error:
        raise LogError(f"{log}: {error}") from error
    truth = recording.truth if reference is None else read_truth(reference)
    against = truth if truth is not None else recording.reference
    skipped = 0.0
    solutions = [one.solution for one in entries if one.solution is not None]
    if against is not None:
        skip, until = span
        default = 30.0 if truth is not None else 20.0
        skipped = default if skip is None else skip
        entries = comparison.score_filters(entries, against, skipped, until, recording.counted)
    elif all(one.is_still is None for one in solutions):
        raise LogError(_WITHOUT_REFERENCE.format(log))
    title = f"{log}" + (f" against {against.name}" if against is not None else "")
    notes = [f"  note: {log.name}: {note}" for note in recording.notes]
    notes += [f"  note: {_left_out(skipped)}"] if skipped > 0.0 else []
    data = [entry.to_dict() for entry in entries]
    terminal.show(as_json, data, [title, "", *comparison.table(entries), *notes])
    if own_words := _if_own(reference, "estimates' distances, and no errors"):
        typer.echo(f"note: {own_words}", err=as_json)
    if plot is None:
        return
    with progress_line(f"{plot.name}: drawing"):
        if against is not None:
            lines = [one.trajectory for one in entries if one.trajectory is not None]
            trajectory_figure.plot(
                plot, [*lines, against], log.name, events=recording.events, with_errors=True
            )
        else:
            walk_figure.plot(plot, solutions, log.name)
    typer.echo(f"figure: {plot}", err=as_json)
