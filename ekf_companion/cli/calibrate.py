"""The command calibrate: settings measured from logs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import typer

from ekf_companion.cli.terminal import (
    ConfigOption,
    JsonOption,
    LogArgument,
    PlotOption,
    bar,
    opened,
    write_figure,
    write_json,
)

if TYPE_CHECKING:
    from ekf_companion.analysis.figure_file import Draw
    from ekf_companion.calibrate.result import Result
    from ekf_companion.config.config import Config
    from ekf_companion.logs.recording import Recording

    Measure: TypeAlias = Callable[[Recording, Config, Path], tuple[Result, Draw]]
    """Returns the result of a calibration, and what draws its figure."""

calibrate = typer.Typer(
    help="Measure numbers of the configuration from your own logs: YAML to paste, and a figure.",
    no_args_is_help=True,
)


def _noise(recording: Recording, settings: Config, log: Path) -> tuple[Result, Draw]:
    from ekf_companion.analysis.calibration_figure import draw_noise
    from ekf_companion.calibrate import noise, noise_result

    found = noise.measure(recording, settings, str(log))
    return noise_result.result(found, settings), partial(draw_noise, found)


def _delay(recording: Recording, settings: Config, log: Path) -> tuple[Result, Draw]:
    from ekf_companion.analysis.calibration_figure import draw_delay
    from ekf_companion.calibrate import delay, delay_result

    with bar(f"{log.name}: delays") as progress:
        found = delay.measure(recording, settings, str(log), progress)
    return delay_result.result(found), partial(draw_delay, found)


def _mag(recording: Recording, settings: Config, log: Path) -> tuple[Result, Draw]:
    from ekf_companion.analysis.calibration_figure import draw_mag
    from ekf_companion.calibrate import mag, mag_result

    found = mag.measure(recording, settings, str(log))
    return mag_result.result(found), partial(draw_mag, found)


def _add(kind: str, says: str, measure: Measure) -> None:
    """Add a subcommand, which prints the result and writes its JSON and its figure."""

    @calibrate.command(kind, help=says)
    def run(
        log: LogArgument,
        config: ConfigOption = None,
        plot: PlotOption = None,
        json_file: JsonOption = None,
    ) -> None:
        from ekf_companion.analysis import figure_file
        from ekf_companion.calibrate.result import lines

        with opened(log, config, plot, json_file) as (recording, settings):
            result, draw = measure(recording, settings, log)
            result = result.after(recording.notes)
            for line in lines(f"ekf-companion calibrate {kind} {log}", result):
                typer.echo(line)
            write_json(json_file, result.to_dict(str(log)))
            title = f"calibrate {kind} {log.name}"
            write = partial(figure_file.write, title=title, draw=draw)
            typer.echo(f"# {write_figure(log, kind, plot, write)}")


_add(
    "noise",
    "Noise of the inertial sensors, at rest, and of the receiver: Allan deviation, scatter.",
    _noise,
)
_add("delay", "Delay of the receiver's fixes: the one under which they are the likeliest.", _delay)
_add(
    "mag",
    "The vehicle's own magnetism, hard and soft iron, by the ellipsoid that the field draws.",
    _mag,
)
