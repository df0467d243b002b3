"""Convert a log to estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError


def convert(
    log: terminal.LogArgument,
    outs: Annotated[
        list[Path],
        typer.Option(
            "--out",
            "-o",
            help=".csv, .tlog, .mcap, .parquet, .tum, .kml, .gpx or .ulg, by its suffix; - for CSV "
            "on a pipe; may be given several times.",
        ),
    ],
    config: terminal.ConfigOption = None,
    reference: terminal.TruthOption = None,
    rate: Annotated[
        float | None, typer.Option(min=0.001, help="Largest number of rows per second.")
    ] = None,
    smooth: terminal.SmoothOption = False,
    aid: terminal.AidOption = None,
    aid_offset: terminal.AidOffsetOption = None,
    as_json: terminal.JsonOption = False,
    name: Annotated[
        str, typer.Option("--filter", help="NAME or NAME:OPTION; ? lists them.")
    ] = "eskf",
    preset: Annotated[
        str | None, typer.Option(help="For euler and ahrs: article or corrected.")
    ] = None,
    frame: Annotated[str | None, typer.Option(help="For iterated: robocentric or sphere.")] = None,
    detector: Annotated[str | None, typer.Option(help="For zupt: shoe, mv, mag or are.")] = None,
) -> None:
    """Re-run the estimator, or another filter, over a recorded flight."""
    from ekf_companion.review import convert as converter
    from ekf_companion.review.evidence import take_truth
    from ekf_companion.review.report import summary
    from ekf_companion.review.verdict import judge_log

    with terminal.exit_on_error(), progress_line(log.name) as progress:
        inputs = {
            "the log": log,
            "the configuration": config,
            "the reference": reference,
            "the poses": aid,
        }
        terminal.check_outputs(inputs, [("--out", out) for out in outs])
        truth = terminal.read_truth(reference)
        poses = terminal.pose_file(aid, aid_offset)
        is_piped = Path("-") in outs  # the summary does not follow the numbers
        chosen = _choose(name, [preset, frame, detector])
        if chosen != "eskf":
            if smooth:
                raise ConfigError("--smooth: smooths eskf only; leave it or --filter out")
            if poses is not None:
                raise ConfigError("--aid: aids eskf only; leave it or --filter out")
            solution = converter.convert_by(chosen, log, outs, terminal.load(config), rate)
            data, lines = solution.to_dict(), [f"{log}:", *solution.summary()]
        else:
            report = converter.convert(
                log, outs, terminal.load(config), rate, progress, is_smoothed=smooth, aid=poses
            )
            take_truth(report, truth)
            judgement = judge_log(report)
            data = {"verdict": judgement.sentence, "grade": judgement.grade, **report.to_dict()}
            lines = [judgement.sentence, *summary(report)]
    terminal.show(as_json, data, lines, err=is_piped)
    for out in outs:
        if out != Path("-"):
            typer.echo(f"wrote {out}", err=as_json or is_piped)


def _choose(name: str, options: list[str | None]) -> str:
    """Return a filter's name with its option, which may also have been given by itself."""
    given = [option for option in options if option is not None]
    if (count := len(given) + (":" in name)) > 1:
        raise ConfigError(f"--filter: {name} takes one option, not {count}")
    if name == "eskf" and not given:
        return name  # without importing the others
    from ekf_companion.replay.filters_by_name import parse_name

    return parse_name(":".join([name, *given]))[0]
