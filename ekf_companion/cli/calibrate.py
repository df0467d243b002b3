"""Measure numbers of the configuration from logs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line

if TYPE_CHECKING:
    from ekf_companion.analysis.figure_file import Draw
    from ekf_companion.calibrate.result import Result

calibrate = typer.Typer(
    help="Measure numbers of the configuration from your own logs: YAML to paste, and a figure.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@calibrate.command("noise")
def calibrate_noise(
    log: terminal.LogArgument,
    config: terminal.ConfigOption = None,
    plot: terminal.PlotOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Measure noise: of the inertial sensors at rest (Allan deviation), and of the receiver."""
    from ekf_companion.analysis.calibration_figure import draw_noise
    from ekf_companion.calibrate import noise

    with terminal.open_log(log, config, plot) as (recording, settings):
        with progress_line(f"{log.name}: noise"):
            found = noise.measure(recording, settings, str(log))
        result = noise.result(found, settings).after(recording.notes)
        _report("noise", log, plot, as_json, result, partial(draw_noise, found))


@calibrate.command("delay")
def calibrate_delay(
    log: terminal.LogArgument,
    config: terminal.ConfigOption = None,
    plot: terminal.PlotOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Measure the delay of the receiver's fixes: the most likely one."""
    from ekf_companion.analysis.calibration_figure import draw_delay
    from ekf_companion.calibrate import delay

    with terminal.open_log(log, config, plot) as (recording, settings):
        with progress_line(f"{log.name}: delays") as progress:
            found = delay.measure(recording, settings, str(log), progress)
        result = delay.result(found).after(recording.notes)
        _report("delay", log, plot, as_json, result, partial(draw_delay, found))


@calibrate.command("mag")
def calibrate_mag(
    log: terminal.LogArgument,
    config: terminal.ConfigOption = None,
    plot: terminal.PlotOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Measure the vehicle's hard and soft iron, by an ellipsoid fitted to the field."""
    from ekf_companion.analysis.calibration_figure import draw_mag
    from ekf_companion.calibrate import mag

    with terminal.open_log(log, config, plot) as (recording, settings):
        with progress_line(f"{log.name}: magnetometer"):
            found = mag.measure(recording, settings, str(log))
        result = mag.result(found).after(recording.notes)
        _report("mag", log, plot, as_json, result, partial(draw_mag, found))


def _report(
    kind: str, log: Path, plot: Path | None, as_json: bool, result: Result, draw: Draw
) -> None:
    """Print the result of a calibration, and write its figure."""
    from ekf_companion.analysis import figure_file
    from ekf_companion.calibrate.result import lines

    text = lines(f"ekf-companion calibrate {kind} {log}", result)
    terminal.show(as_json, result.to_dict(str(log)), text)
    write = partial(figure_file.write, title=f"calibrate {kind} {log.name}", draw=draw)
    typer.echo(f"# {terminal.write_figure(log, kind, plot, write)}", err=as_json)
