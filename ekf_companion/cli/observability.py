"""Show which states a flight makes observable, and when."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import LogError


def observability(
    log: terminal.LogArgument,
    config: terminal.ConfigOption = None,
    plot: terminal.PlotOption = None,
    as_json: terminal.JsonOption = False,
    window: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="Length of the sliding windows, s.")
    ] = 10.0,
) -> None:
    """Show when each bias, tilt and heading becomes observable in a flight, and why not before."""
    from ekf_companion.analysis import observability as analysis
    from ekf_companion.analysis import observability_figure
    from ekf_companion.analysis import observability_report as report
    from ekf_companion.filters.sequence import MeasurementSequence

    with terminal.open_log(log, config, plot) as (recording, settings):
        try:
            course = MeasurementSequence(
                recording.events, settings, recording.family, recording.gnss_delay
            )
            with progress_line(f"{log.name}: observability") as progress:
                found = analysis.analyse(
                    course, course.setup(), settings, window=window, progress=progress
                )
        except LogError as error:
            raise LogError(f"{log}: {error}") from error
        data = {"log": str(log), **report.to_dict(found)}
        terminal.show(as_json, data, (*recording.notes, *report.lines(found)))
        draw = partial(observability_figure.plot, found=found, title=f"observability {log.name}")
        typer.echo(terminal.write_figure(log, "observability", plot, draw), err=as_json)
