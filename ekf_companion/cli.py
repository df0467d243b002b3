"""The commands; the only place that prints or exits.

Exit codes: 0 done, 1 a figure cannot be drawn or a bug, 2 the command line or the configuration is
wrong, 3 the log cannot be read, or holds nothing to estimate or to calibrate from.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import yaml

from ekf_companion.config import Config, describe_config, load_config
from ekf_companion.errors import CompanionError, ConfigError, LinkError, LogError
from ekf_companion.version import __version__

if TYPE_CHECKING:
    from ekf_companion.calibrate.plot import Draw
    from ekf_companion.calibrate.report import Result
    from ekf_companion.logs.recording import Recording
    from ekf_companion.nav.state import Trajectory

app = typer.Typer(
    help="State estimation on a drone's companion computer: MAVLink in, ODOMETRY out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
calibrate = typer.Typer(
    help="Measure numbers of the configuration from your own logs: YAML to paste, and a figure.",
    no_args_is_help=True,
)
app.add_typer(calibrate, name="calibrate")
LogArgument = Annotated[Path, typer.Argument(help=".tlog, .bin, .ulg or .csv.")]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", help="The figure; by default LOG.KIND.png, here.")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", "-c", help="YAML file; config/ holds commented ones.")
]
SmoothOption = Annotated[
    bool, typer.Option("--smooth", help="Go back over the flight: each estimate knows all of it.")
]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the same as JSON.")]


@contextmanager
def _sentences() -> Iterator[None]:
    """Turn what is raised on purpose into a sentence and an exit code."""
    try:
        yield
    except CompanionError as error:
        typer.echo(f"ekf-companion: {error}", err=True)
        is_wrong = isinstance(error, (ConfigError, LinkError))
        code = 2 if is_wrong else 3 if isinstance(error, LogError) else 1
        raise typer.Exit(code) from error


def _load(path: Path | None) -> Config:
    return Config() if path is None else load_config(path)


@contextmanager
def _bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on a terminal, and nothing elsewhere."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _write_json(path: Path | None, data: object) -> None:
    if path is not None:
        try:
            path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def _show_version(value: bool) -> None:
    if value:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show it.")
    ] = False,
) -> None:
    """Hold what is common to all commands."""


@app.command()
def run(
    config: ConfigOption = None,
    link: Annotated[
        str | None,
        typer.Option("--link", "--master", help="udpin:HOST:PORT, tcp:…, serial:/dev/ttyX:BAUD."),
    ] = None,
    record: Annotated[
        str | None, typer.Option(help="Record every byte in and out to this .tlog.")
    ] = None,
    checkpoint: Annotated[
        str | None, typer.Option(help="Keep the state in this file, and go on from it.")
    ] = None,
    log_level: Annotated[str, typer.Option(help="DEBUG, INFO, WARNING or ERROR.")] = "INFO",
) -> None:
    """Run the daemon until SIGTERM."""
    from dataclasses import replace

    from ekf_companion import service

    level = logging.getLevelName(log_level.upper())
    with _sentences():
        if not isinstance(level, int):
            raise ConfigError(f"--log-level: {log_level!r}: use DEBUG, INFO, WARNING or ERROR")
        logging.basicConfig(level=level, format="%(levelname)s %(name)s: %(message)s")
        settings = _load(config)
        if record is not None:
            settings = replace(settings, record=replace(settings.record, path=record))
        if checkpoint is not None:
            settings = replace(settings, checkpoint=replace(settings.checkpoint, file=checkpoint))
        service.run(settings, link)


@app.command()
def convert(
    log: Annotated[Path, typer.Argument(help=".tlog, .bin, .ulg or .csv.")],
    out: Annotated[Path, typer.Option("--out", "-o", help=".csv or .tlog, by its suffix.")],
    config: ConfigOption = None,
    rate: Annotated[
        float | None, typer.Option(min=0.001, help="At most so many rows per second.")
    ] = None,
    smooth: SmoothOption = False,
    json_file: JsonOption = None,
    name: Annotated[
        str, typer.Option("--filter", help="NAME or NAME:OPTION; docs/FILTERS.md lists them.")
    ] = "eskf",
    preset: Annotated[str | None, typer.Option(help="Option of euler and ahrs: article.")] = None,
    frame: Annotated[str | None, typer.Option(help="Option of iterated: robocentric.")] = None,
    detector: Annotated[
        str | None, typer.Option(help="Option of zupt: shoe, mv, mag, are.")
    ] = None,
) -> None:
    """Re-run the estimator, or another filter, over a recorded flight."""
    from ekf_companion import convert as converter

    with _sentences(), _bar(log.name) as progress:
        if json_file is not None and json_file.resolve() in (log.resolve(), out.resolve()):
            raise ConfigError(f"--json: {json_file}: is the log or its output; name another file")
        chosen = _choose(name, [preset, frame, detector])
        if chosen != "eskf":
            if smooth:
                raise ConfigError("--smooth: smooths eskf only; leave it or --filter out")
            solution = converter.convert_by(chosen, log, out, _load(config), rate)
            _write_json(json_file, solution.to_dict())
            for line in solution.summary():
                typer.echo(line)
            return
        report = converter.convert(log, out, _load(config), rate, progress, is_smoothed=smooth)
        _write_json(json_file, report.to_dict())
    for line in converter.summary(report):
        typer.echo(line)


def _choose(name: str, options: list[str | None]) -> str:
    """Give a filter's name with its option, which may be said as an option of its own."""
    from ekf_companion.selection import choose

    given = [option for option in options if option is not None]
    if len(given) + (":" in name) > 1:
        raise ConfigError(f"--filter: {name} takes one option, not {len(given) + (':' in name)}")
    return choose(":".join([name, *given]))[0]


@app.command()
def compare(
    log: Annotated[Path, typer.Argument(help="A log, or an estimate that convert wrote (.csv).")],
    reference: Annotated[
        Path | None,
        typer.Option(help="Truth as .csv; else the log's own truth and the autopilot's estimate."),
    ] = None,
    config: ConfigOption = None,
    until: Annotated[
        float | None,
        typer.Option(
            help="Leave out what is later than so many seconds after the first.", min=0.0, max=1e9
        ),
    ] = None,
    skip: Annotated[
        float | None,
        typer.Option(
            help="Leave out the first seconds; by default 30 against truth, else 20.",
            min=0.0,
            max=1e9,
        ),
    ] = None,
    filters: Annotated[
        str | None,
        typer.Option(help="Several over the same log, beside each other: eskf,euler,iterated,ukf."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw all of them into a .png.")] = None,
    smooth: SmoothOption = False,
    json_file: JsonOption = None,
) -> None:
    """Measure our estimate, or several filters', against a truth or the autopilot's own."""
    if filters is not None:
        with _sentences():
            if smooth:
                raise ConfigError("--smooth: smooths eskf only; leave --filters or --smooth out")
            _compare_filters(log, filters, reference, _load(config), (skip, until), plot, json_file)
        return
    from ekf_companion import compare as comparer
    from ekf_companion import convert as converter
    from ekf_companion import figure
    from ekf_companion.logs.estimate import is_estimate, of_table, read_estimate, read_truth

    with _sentences():
        own = truth = None
        live: list[Trajectory] = []
        if is_estimate(log):
            if smooth:
                raise ConfigError(
                    f"--smooth: {log} is an estimate already; name the log that it was made from"
                )
            ours = read_estimate(log)
        else:
            with _bar(log.name) as progress:
                if smooth:
                    table, smoothed, report, own, truth = converter.estimate_and_smooth(
                        log, _load(config), progress
                    )
                    ours = of_table(smoothed, "ekf-companion, smoothed")
                    live.append(of_table(table, "ekf-companion, live"))
                else:
                    table, report, own, truth = converter.estimate(log, _load(config), progress)
                    ours = of_table(table, "ekf-companion")
            for line in converter.summary(report):
                typer.echo(line)
            typer.echo()
        if reference is not None:
            truth = read_truth(reference)
        against = truth if truth is not None else own
        if against is None:
            raise LogError(
                f"{log}: holds neither a truth nor the autopilot's own estimate; "
                "name a truth with --reference TRUTH.csv"
            )
        seconds = skip if skip is not None else 30.0 if truth is not None else 20.0
        begin = int(ours.att_t_ns[0]) if len(ours.att_t_ns) else 0
        end = None if until is None else begin + round(until * 1e9)
        scores = [comparer.score(ours, against, seconds, end_ns=end)]
        if scores[0].horizontal is None and scores[0].tilt is None:
            span = f"after the first {seconds:g} s" + (
                "; leave out fewer with --skip"
                if until is None
                else f" and before {until:g} s; leave out less with --skip and --until"
            )
            raise LogError(f"{log}: {ours.name} and {against.name} have no time in common {span}")
        others = [*live, against]
        start = scores[0].start_ns
        rivals = [*live, own] if truth is not None and own is not None else live
        for rival in rivals:
            scores.append(comparer.score(rival, against, 0.0, start_ns=start, end_ns=end))
        if truth is not None and own is not None:
            others.append(own)
        for line in comparer.table(scores):
            typer.echo(line)
        if plot is not None:
            figure.plot(plot, [ours, *others], log.name)
        _write_json(json_file, [score.to_dict() for score in scores])


def _compare_filters(
    log: Path,
    filters: str,
    reference: Path | None,
    config: Config,
    span: tuple[float | None, float | None],
    plot: Path | None,
    json_file: Path | None,
) -> None:
    """Take several filters through a log, and print how far off each is."""
    from ekf_companion import contest, figure, walk
    from ekf_companion.logs.estimate import read_truth

    recording = _read(log, config, plot, json_file)
    names = [name.strip() for name in filters.split(",")]
    try:
        with _bar(f"{log.name}: filters") as progress:
            entries = contest.hold(recording, names, config, progress)
    except LogError as error:
        raise LogError(f"{log}: {error}") from error
    against = recording.truth if recording.truth is not None else recording.reference
    against = read_truth(reference) if reference is not None else against
    solutions = [one.solution for one in entries if one.solution is not None]
    if against is not None:
        skip, until = span
        default = 30.0 if reference is not None or recording.truth is not None else 20.0
        skipped = default if skip is None else skip
        entries = contest.judge(entries, against, skipped, until, recording.counted)
    elif all(one.is_still is None for one in solutions):
        raise LogError(
            f"{log}: holds neither a truth nor the autopilot's own estimate; "
            "name a truth with --reference TRUTH.csv"
        )
    typer.echo(f"{log}" + (f" against {against.name}" if against is not None else "") + "\n")
    for line in contest.table(entries):
        typer.echo(line)
    for note in recording.notes:
        typer.echo(f"  note: {log.name}: {note}")
    _write_json(json_file, [entry.to_dict() for entry in entries])
    if plot is not None and against is not None:
        lines = [one.trajectory for one in entries if one.trajectory is not None]
        figure.plot(plot, [*lines, against], log.name, events=recording.events, with_errors=True)
    elif plot is not None:
        walk.plot(plot, solutions, log.name)


def _read(log: Path, config: Config, plot: Path | None, json_file: Path | None) -> Recording:
    """Open a log that nothing written may overwrite."""
    from ekf_companion import convert as converter

    for option, path in (("--plot", plot), ("--json", json_file)):
        if path is not None and path.resolve() == log.resolve():
            raise ConfigError(f"{option}: {path}: is the log; name another file")
    with _bar(log.name) as progress:
        return converter.read(log, config, progress)


def _tell(
    kind: str, log: Path, plot: Path | None, json_file: Path | None, result: Result, draw: Draw
) -> None:
    """Print what a calibration found, and write its JSON and its figure."""
    from ekf_companion.calibrate import plot as plotter
    from ekf_companion.calibrate.report import lines

    for line in lines(f"ekf-companion calibrate {kind} {log}", result):
        typer.echo(line)
    _write_json(json_file, result.to_dict(str(log)))
    figure = plot if plot is not None else Path(f"{log.stem}.{kind}.png")
    if plot is None and not plotter.has_matplotlib():
        typer.echo("# no figure: install ekf-companion with the extra: plot")
        return
    plotter.write(figure, f"calibrate {kind} {log.name}", draw)
    typer.echo(f"# figure: {figure}")


@calibrate.command("noise")
def calibrate_noise(
    log: LogArgument,
    config: ConfigOption = None,
    plot: PlotOption = None,
    json_file: JsonOption = None,
) -> None:
    """Noise of the inertial sensors, at rest, and of the receiver: Allan deviation, scatter."""
    from ekf_companion.calibrate import noise, noise_report

    with _sentences():
        settings = _load(config)
        recording = _read(log, settings, plot, json_file)
        found = noise.measure(recording, settings, str(log))
        result = noise_report.result(found, settings).after(recording.notes)
        _tell("noise", log, plot, json_file, result, partial(noise_report.draw, found))


@calibrate.command("delay")
def calibrate_delay(
    log: LogArgument,
    config: ConfigOption = None,
    plot: PlotOption = None,
    json_file: JsonOption = None,
) -> None:
    """Delay of the receiver's fixes: the one under which they are the likeliest."""
    from ekf_companion.calibrate import delay, delay_report

    with _sentences():
        settings = _load(config)
        recording = _read(log, settings, plot, json_file)
        with _bar(f"{log.name}: delays") as progress:
            found = delay.measure(recording, settings, str(log), progress)
        result = delay_report.result(found).after(recording.notes)
        _tell("delay", log, plot, json_file, result, partial(delay_report.draw, found))


@calibrate.command("mag")
def calibrate_mag(
    log: LogArgument,
    config: ConfigOption = None,
    plot: PlotOption = None,
    json_file: JsonOption = None,
) -> None:
    """The vehicle's own magnetism, hard and soft iron, by the ellipsoid that the field draws."""
    from ekf_companion.calibrate import mag, mag_report

    with _sentences():
        settings = _load(config)
        recording = _read(log, settings, plot, json_file)
        found = mag.measure(recording, settings, str(log))
        result = mag_report.result(found).after(recording.notes)
        _tell("mag", log, plot, json_file, result, partial(mag_report.draw, found))


@app.command()
def observability(
    log: LogArgument,
    config: ConfigOption = None,
    plot: PlotOption = None,
    json_file: JsonOption = None,
    window: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="Length of the sliding windows, s.")
    ] = 10.0,
) -> None:
    """When each bias, tilt and heading becomes observable along a flight, and why not before."""
    from ekf_companion import observability_figure
    from ekf_companion.calibrate.plot import has_matplotlib
    from ekf_companion.filters import observability as analysis
    from ekf_companion.filters import observability_report as report
    from ekf_companion.filters.course import Course

    with _sentences():
        settings = _load(config)
        recording = _read(log, settings, plot, json_file)
        try:
            course = Course(recording.events, settings, recording.family, recording.gnss_delay)
            with _bar(f"{log.name}: observability") as progress:
                found = analysis.analyse(
                    course, course.setup(), settings, window=window, progress=progress
                )
        except LogError as error:
            raise LogError(f"{log}: {error}") from error
        for line in (*recording.notes, *report.lines(found)):
            typer.echo(line)
        _write_json(json_file, {"log": str(log), **report.to_dict(found)})
        figure = plot if plot is not None else Path(f"{log.stem}.observability.png")
        if plot is None and not has_matplotlib():
            typer.echo("no figure: install ekf-companion with the extra: plot")
            return
        observability_figure.plot(figure, found, f"observability {log.name}")
        typer.echo(f"figure: {figure}")


@app.command("check-config")
def check_config(
    config: Annotated[Path, typer.Argument(help="YAML file.")],
) -> None:
    """Check a configuration and print it with all its defaults."""
    with _sentences():
        effective = describe_config(load_config(config))
    typer.echo(yaml.safe_dump(dict(effective), sort_keys=False), nl=False)


if __name__ == "__main__":
    app()
