"""Run the daemon, and check its configuration."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ekf_companion.cli.terminal import ConfigOption, LinkOption, exit_on_error
from ekf_companion.errors import ConfigError


def run(
    config: ConfigOption = None,
    link: LinkOption = None,
    record: Annotated[
        str | None, typer.Option(help="Record every byte in and out to this .tlog.")
    ] = None,
    checkpoint: Annotated[
        str | None, typer.Option(help="Keep the state in this file, and resume from it.")
    ] = None,
    log_level: Annotated[str, typer.Option(help="DEBUG, INFO, WARNING or ERROR.")] = "INFO",
) -> None:
    """Run the daemon until SIGTERM."""
    from ekf_companion.config.config import Config, ConfigFile
    from ekf_companion.daemon import daemon as service
    from ekf_companion.daemon import logging as journal

    has_started = False
    file = None if config is None else ConfigFile(config)

    def read() -> Config:
        """Return the file's configuration, overridden by the command line."""
        nonlocal has_started
        if has_started and file is None:
            raise ConfigError("the daemon was started without --config: no file could have changed")
        has_started = True
        settings = Config() if file is None else file.read()
        if link is not None:
            settings = replace(settings, link=replace(settings.link, url=link))
        if record is not None:
            settings = replace(settings, record=replace(settings.record, path=record))
        if checkpoint is not None:
            settings = replace(settings, checkpoint=replace(settings.checkpoint, file=checkpoint))
        return settings

    level = logging.getLevelName(log_level.upper())
    with exit_on_error():
        if not isinstance(level, int):
            raise ConfigError(f"--log-level: {log_level!r}: use DEBUG, INFO, WARNING or ERROR")
        journal.set_up(level)
        service.run(read)


def check_config(
    config: Annotated[Path, typer.Argument(help="YAML file.")],
) -> None:
    """Check a configuration and print it with all its defaults."""
    import yaml

    from ekf_companion.config.config import describe_config, load_config
    from ekf_companion.config.file_name import why_not_writable

    with exit_on_error():
        read = load_config(config)
        files = (("record.path", read.record.path), ("checkpoint.file", read.checkpoint.file))
        warnings = [why_not_writable(key, name) for key, name in files if name]
        effective = dict(describe_config(read))
        if read.http.token:
            effective["http"] = {**effective["http"], "token": "(set, and not shown)"}
    for warning in filter(None, warnings):
        typer.echo(f"ekf-companion: {warning}; the daemon would run without it", err=True)
    typer.echo(yaml.safe_dump(effective, sort_keys=False), nl=False)
