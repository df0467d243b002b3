"""Numbers of the configuration, measured from logs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ekf_companion.cli.terminal import (
    ConfigOption,
    JsonOption,
    LogArgument,
    PlotOption,
    bar,
    figure_path,
    opened,
    write_json,
)

if TYPE_CHECKING:
    from ekf_companion.calibrate.plot import Draw
    from ekf_companion.calibrate.report import Result

calibrate = typer.Typer(
    help="Measure numbers of the configuration from your own logs: YAML to paste, and a figure.",
    no_args_is_help=True,
)


@calibrate.command("noise")
def calibrate_noise(
    log: LogArgument,
    config: ConfigOption = None,
    plot: PlotOption = None,
    json_file: JsonOption = None,
) -> None:
    """Noise of the inertial sensors, at rest, and of the receiver: Allan deviation, scatter."""
    from ekf_companion.calibrate import noise, noise_report

    with opened(log, config, plot, json_file) as (recording, settings):
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

    with opened(log, config, plot, json_file) as (recording, settings):
        with bar(f"{log.name}: delays") as progress:
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

    with opened(log, config, plot, json_file) as (recording, settings):
        found = mag.measure(recording, settings, str(log))
        result = mag_report.result(found).after(recording.notes)
        _tell("mag", log, plot, json_file, result, partial(mag_report.draw, found))


def _tell(
    kind: str, log: Path, plot: Path | None, json_file: Path | None, result: Result, draw: Draw
) -> None:
    """Print what a calibration found, and write its JSON and its figure."""
    from ekf_companion.calibrate import plot as plotter
    from ekf_companion.calibrate.report import lines

    for line in lines(f"ekf-companion calibrate {kind} {log}", result):
        typer.echo(line)
    write_json(json_file, result.to_dict(str(log)))
    if (figure := figure_path(log, kind, plot)) is None:
        typer.echo("# no figure: install ekf-companion with the extra: plot")
        return
    plotter.write(figure, f"calibrate {kind} {log.name}", draw)
    typer.echo(f"# figure: {figure}")
