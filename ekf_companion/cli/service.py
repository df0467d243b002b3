"""The daemon, and its configuration."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
import yaml

from ekf_companion.cli.terminal import ConfigOption, load, sentences
from ekf_companion.config.config import Config, describe_config, load_config
from ekf_companion.config.file_name import why_not_writable
from ekf_companion.errors import ConfigError


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
    from ekf_companion.daemon import daemon as service
    from ekf_companion.daemon import logging as journal

    has_started = False

    def read() -> Config:
        """Give the file's configuration with what the command line says of it."""
        nonlocal has_started
        if has_started and config is None:
            raise ConfigError("the daemon was started without --config: no file could have changed")
        has_started = True
        settings = load(config)
        if link is not None:
            settings = replace(settings, link=replace(settings.link, url=link))
        if record is not None:
            settings = replace(settings, record=replace(settings.record, path=record))
        if checkpoint is not None:
            settings = replace(settings, checkpoint=replace(settings.checkpoint, file=checkpoint))
        return settings

    level = logging.getLevelName(log_level.upper())
    with sentences():
        if not isinstance(level, int):
            raise ConfigError(f"--log-level: {log_level!r}: use DEBUG, INFO, WARNING or ERROR")
        journal.set_up(level)
        service.run(read)


def check_config(
    config: Annotated[Path, typer.Argument(help="YAML file.")],
) -> None:
    """Check a configuration and print it with all its defaults."""
    with sentences():
        read = load_config(config)
        places = (("record.path", read.record.path), ("checkpoint.file", read.checkpoint.file))
        missing = [words for key, name in places if name and (words := why_not_writable(key, name))]
        effective = describe_config(read)
    for words in missing:
        typer.echo(f"ekf-companion: {words}; the daemon would run without it", err=True)
    typer.echo(yaml.safe_dump(dict(effective), sort_keys=False), nl=False)
