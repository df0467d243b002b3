"""Shared parts of the commands: options, error messages, JSON, reading a log."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import CompanionError, ConfigError, LinkError, LogError, remedy, require
from ekf_companion.logs.source import real_path

if TYPE_CHECKING:
    from ekf_companion.config.config import Config
    from ekf_companion.fleet.executor import Executor
    from ekf_companion.logs.recording import Recording
    from ekf_companion.nav.state import Trajectory
    from ekf_companion.replay.pose_aid import PoseFile

LogArgument = Annotated[
    Path, typer.Argument(help=".tlog, .bin, .ulg, .csv; also .txt (OpenShoe), .mat (BROAD).")
]
FIGURES = (".png", ".pdf", ".svg")


def figure_name(path: Path | None) -> Path | None:
    """Return the file name of a figure: one without a suffix gets .png."""
    if path is None or path.suffix.strip(".") or not path.name.strip("."):
        return path
    return path.with_name(f"{path.name.rstrip('.')}.png")


PlotOption = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        help="File of the figure; by default LOG.KIND.png, beside the log.",
        callback=figure_name,
    ),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="YAML file; check-config prints every key."),
]
LinkOption = Annotated[
    str | None,
    typer.Option("--link", "--master", help="udpin:HOST:PORT, tcp:…, serial:/dev/ttyX:BAUD."),
]
TruthOption = Annotated[
    Path | None,
    typer.Option("--reference", help="Truth as .csv, to judge by; else what the log itself holds."),
]
AidOption = Annotated[
    Path | None,
    typer.Option(
        "--aid",
        help="Poses of another estimator: .csv or --rel of `lidar`, TUM, EuRoC; used as odometry.",
    ),
]
AidOffsetOption = Annotated[
    float | None,
    typer.Option(
        "--aid-offset",
        help="Added to its times, s; else found by the turns of both.",
        min=-1e10,
        max=1e10,
    ),
]
SmoothOption = Annotated[
    bool, typer.Option("--smooth", help="Smooth: each estimate uses the whole flight.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]

JobsOption = Annotated[int, typer.Option(min=1, max=256, help="Processes.")]
DaskOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask's scheduler, tcp://HOST:8786, or local."),
]


def executor(jobs: int, dask: str | None) -> Executor:
    """Return what runs the tasks of many logs.

    Raises:
        MissingPackageError: Dask is asked for and not installed.
    """
    if dask is not None:
        from ekf_companion.fleet.dask_executor import Dask

        return Dask(dask, jobs)
    from ekf_companion.fleet.executor import Processes

    return Processes(jobs)


def pose_file(path: Path | None, offset: float | None) -> PoseFile | None:
    """Return the poses that are to aid, as the options name them.

    Raises:
        ConfigError: An offset is given without a file.
    """
    if path is None:
        if offset is not None:
            raise ConfigError("--aid-offset: is of the poses that --aid names; name them")
        return None
    from ekf_companion.replay.pose_aid import PoseFile

    return PoseFile(path, offset)


def read_truth(path: Path | None) -> Trajectory | None:
    """Return the truth of a file, to judge by; None if none is named.

    Raises:
        LogError: It cannot be read, or is an estimate of ours.
    """
    if path is None:
        return None
    from ekf_companion.logs.estimate import OWN, is_estimate
    from ekf_companion.logs.estimate import read_truth as read

    if is_estimate(path):
        raise LogError(
            f"{path}: {OWN}, and no truth; name a truth, or see how far two estimates are apart: "
            f"ekf-companion compare LOG --reference {path}"
        )
    return read(path)


@contextmanager
def exit_on_error() -> Iterator[None]:
    """Print a deliberately raised error as one sentence, and exit with its code."""
    try:
        yield
    except CompanionError as error:
        typer.echo(f"ekf-companion: {error}", err=True)
        is_wrong = isinstance(error, (ConfigError, LinkError))
        code = 2 if is_wrong else 3 if isinstance(error, LogError) else 1
        raise typer.Exit(code) from error


def load(path: Path | None) -> Config:
    """Return the configuration of a file, or the defaults."""
    from ekf_companion.config.config import Config, load_config

    return Config() if path is None else load_config(path)


def show(as_json: bool, data: object, lines: Iterable[str], *, err: bool = False) -> None:
    """Print a result, on the standard error if asked: the lines, or JSON instead."""
    if as_json:
        typer.echo(json.dumps(data, indent=2, ensure_ascii=False), err=err)
    else:
        for line in lines:
            typer.echo(line, err=err)


def check_outputs(
    inputs: dict[str, Path | None], outputs: Sequence[tuple[str, Path | None]]
) -> None:
    """Refuse, before any work, an output that cannot be written or would overwrite another file.

    Inputs are named by what they are, as in ``the log``, outputs by their option.

    Raises:
        ConfigError: An output is refused.
        MissingPackageError: A figure is asked for, which cannot be drawn here.
    """
    taken = {real_path(path): name for name, path in inputs.items() if path is not None}
    for option, path in outputs:
        if path is None:
            continue
        if len(parts := path.name.split(",")) > 1 and all(_has_suffix(part) for part in parts):
            raise ConfigError(f"{option}: {path}: is one name; give {option} again for each file")
        if (other := taken.get(real_path(path))) is not None:
            raise ConfigError(f"{option}: {path}: is {other}; name another file")
        if not real_path(path).parent.is_dir():
            raise ConfigError(f"{option}: {path}: there is no such folder; make it first")
        if option == "--plot" and path.suffix.lower() not in FIGURES and not path.is_dir():
            raise ConfigError(f"--plot: {path}: a figure is a .png, .pdf or .svg; name one of them")
        if option == "--plot":
            require("plot", f"--plot: {path}", "matplotlib.figure")
        taken[real_path(path)] = f"what {option} writes"


def _has_suffix(name: str) -> bool:
    """Return whether a name ends with a suffix: a point and letters."""
    return Path(name.strip()).suffix[1:].isalpha()


def read(log: Path, config: Config) -> Recording:
    """Read a log."""
    from ekf_companion.replay.read import read as read_recording

    with progress_line(f"{log.name}: reading") as progress:
        return read_recording(log, config, progress)


@contextmanager
def open_log(
    log: Path, config: Path | None, plot: Path | None
) -> Iterator[tuple[Recording, Config]]:
    """Read a log for a command that prints what it finds, and draws it.

    Yields:
        The log and the configuration. Errors become sentences, as by ``exit_on_error``.
    """
    with exit_on_error():
        inputs = {"the log": log, "the configuration": config}
        check_outputs(inputs, [("--plot", plot)])
        settings = load(config)
        yield read(log, settings), settings


def write_figure(log: Path, kind: str, plot: Path | None, write: Callable[[Path], None]) -> str:
    """Write a figure; return a line that names its file, or says why there is none.

    By default it goes beside the log, under a new name.
    """
    from ekf_companion.analysis.figure_file import has_matplotlib

    if plot is None and not has_matplotlib():
        return f"no figure, as matplotlib is not installed: {remedy('plot')}"
    path = plot if plot is not None else beside(log, kind, ".png")
    if plot is None and not os.access(path.parent, os.W_OK):
        return f"no figure: {path.parent} cannot be written to; name a file with --plot"
    with progress_line(f"{path.name}: drawing"):
        write(path)
    return f"figure: {path}"


def beside(log: Path, kind: str, suffix: str) -> Path:
    """Return the name of a new file beside a log: LOG.KIND.png, LOG.KIND-2.png and so on."""
    for number in count(1):
        name = f"{log.stem}.{kind}{'' if number == 1 else f'-{number}'}{suffix}"
        if not (path := log.with_name(name)).exists():
            return path
    raise AssertionError("count ends")
