"""A report on a recorded flight, to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError, require


def report(
    log: terminal.LogArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The .html; by default LOG.report.html, beside the log."),
    ] = None,
    config: terminal.ConfigOption = None,
    reference: terminal.TruthOption = None,
    aid: terminal.AidOption = None,
    aid_offset: terminal.AidOffsetOption = None,
    png: Annotated[bool, typer.Option("--png", help="Draw a .png beside it too.")] = False,
    as_json: terminal.JsonOption = False,
) -> None:
    """Show a flight in one HTML file: a verdict, tracks, innovations, biases, spectra."""
    from ekf_companion.analysis import flight_review, report_page, trajectory_figure

    with terminal.exit_on_error(), progress_line(log.name) as progress:
        inputs = {
            "the log": log,
            "the configuration": config,
            "the reference": reference,
            "the poses": aid,
        }
        terminal.check_outputs(inputs, [("--out", out)])
        if out is not None and out.suffix.lower() not in (".html", ".htm"):
            raise ConfigError(
                f"--out: {out}: a report is a .html; --png draws a picture beside it, --json "
                "prints its numbers, and convert writes tracks (.kml, .gpx)"
            )
        require("report", "report", "bokeh")
        if png:
            require("plot", "--png", "matplotlib.figure")
        truth = terminal.read_truth(reference)
        poses = terminal.pose_file(aid, aid_offset)
        found = flight_review.review(log, terminal.load(config), progress, truth, poses)
        progress.stage(f"{log.name}: writing the report")
        path = out if out is not None else terminal.beside(log, "report", ".html")
        report_page.write(path, found)
        files = [path]
        if png:
            files.append(path.with_suffix(".png"))
            lines = [found.ours, *found.others]
            trajectory_figure.plot(
                files[-1], lines, f"{log.name}\n{found.judgement.sentence}", jumps_ns=found.jumps_ns
            )
    terminal.show(as_json, found.to_dict(), [found.judgement.sentence])
    typer.echo(f"report: {', '.join(map(str, files))}", err=as_json)
