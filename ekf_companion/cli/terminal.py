"""What the commands share: options, sentences for errors, a progress bar, JSON, a log."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekf_companion.config.config import Config, load_config
from ekf_companion.errors import CompanionError, ConfigError, LinkError, LogError

if TYPE_CHECKING:
    from ekf_companion.logs.recording import Recording

LogArgument = Annotated[
    Path, typer.Argument(help=".tlog, .bin, .ulg, .csv; also .txt (OpenShoe), .mat (BROAD).")
]
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
def sentences() -> Iterator[None]:
    """Turn what is raised on purpose into a sentence and an exit code."""
    try:
        yield
    except CompanionError as error:
        typer.echo(f"ekf-companion: {error}", err=True)
        is_wrong = isinstance(error, (ConfigError, LinkError))
        code = 2 if is_wrong else 3 if isinstance(error, LogError) else 1
        raise typer.Exit(code) from error


def load(path: Path | None) -> Config:
    """Give the configuration of a file, or the defaults."""
    return Config() if path is None else load_config(path)


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
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


def write_json(path: Path | None, data: object) -> None:
    """Write data where a path is given.

    Raises:
        ConfigError: It cannot be written there.
    """
    if path is not None:
        try:
            path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def keep_apart(inputs: dict[str, Path | None], outputs: dict[str, Path | None]) -> None:
    """Refuse to write over what is read or written besides, or where there is no folder.

    Args:
        inputs: What is read, in words: ``the log``.
        outputs: What is written, by option.

    Raises:
        ConfigError: An output is an input or another output, or has no folder to be in.
    """
    taken = {path.resolve(): name for name, path in inputs.items() if path is not None}
    for option, path in outputs.items():
        if path is None:
            continue
        if (other := taken.get(path.resolve())) is not None:
            raise ConfigError(f"{option}: {path}: is {other}; name another file")
        if not path.resolve().parent.is_dir():
            raise ConfigError(f"{option}: {path}: there is no such folder; make it first")
        taken[path.resolve()] = f"what {option} writes"


def read(log: Path, config: Config) -> Recording:
    """Open a log."""
    from ekf_companion.replay import convert as converter

    with bar(log.name) as progress:
        return converter.read(log, config, progress)


@contextmanager
def opened(
    log: Path, config: Path | None, plot: Path | None, json_file: Path | None
) -> Iterator[tuple[Recording, Config]]:
    """Give a log and the configuration to a command that draws and tells what it finds.

    What is raised on purpose in it, or because a file would be written over, is a sentence.
    """
    with sentences():
        inputs = {"the log": log, "the configuration": config}
        keep_apart(inputs, {"--plot": plot, "--json": json_file})
        settings = load(config)
        yield read(log, settings), settings


def write_figure(log: Path, kind: str, plot: Path | None, write: Callable[[Path], None]) -> str:
    """Write a figure; return a line that names its file, or says why there is none."""
    from ekf_companion.analysis.figure_file import has_matplotlib

    if plot is None and not has_matplotlib():
        return "no figure: install ekf-companion with the extra: plot"
    path = plot if plot is not None else Path(f"{log.stem}.{kind}.png")
    write(path)
    return f"figure: {path}"
