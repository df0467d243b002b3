"""Find the stage that loses the data, and what to set."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekf_companion.cli.progress import progress_line
from ekf_companion.cli.terminal import ConfigOption, LinkOption, exit_on_error, load
from ekf_companion.errors import ConfigError

if TYPE_CHECKING:
    from ekf_companion.config.config import Config
    from ekf_companion.doctor.evidence import Evidence
    from ekf_companion.doctor.stage import StageResult

STAGE_FAILED = 5
"""Exit code if a stage fails."""


def doctor(
    config: ConfigOption = None,
    link: LinkOption = None,
    log: Annotated[Path | None, typer.Option(help="Examine this .tlog instead of a link.")] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=3600.0, help="Longest time to listen.")
    ] = 15.0,
    listen: Annotated[
        bool, typer.Option("--listen", help="Send nothing: no heartbeat and no request.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the findings as JSON, and nothing else.")
    ] = False,
) -> None:
    """Find the stage that loses the data, and the parameter to change."""
    from ekf_companion.doctor.diagnosis import diagnose, first_failure

    with exit_on_error():
        if log is not None and (link is not None or listen):
            raise ConfigError("--log: a recording has no link; leave out --link and --listen")
        if log is not None and log.suffix.lower() != ".tlog":
            raise ConfigError(f"--log: {log}: only a .tlog has the stages; name one, or a --link")
        with _quiet():
            evidence = _examine(load(config), link, log, seconds, listen=listen)
    findings = diagnose(evidence)
    if as_json:
        _print_json(evidence, findings, log)
    else:
        _print(findings)
    if first_failure(findings) is not None:
        raise typer.Exit(STAGE_FAILED)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the daemon's warnings: the findings repeat them, with the remedy."""
    logger, nothing = logging.getLogger("ekf_companion"), logging.NullHandler()
    before, logger.propagate = logger.propagate, False
    logger.addHandler(nothing)
    try:
        yield
    finally:
        logger.removeHandler(nothing)
        logger.propagate = before


def _examine(
    config: Config, link: str | None, log: Path | None, seconds: float, *, listen: bool
) -> Evidence:
    from dataclasses import replace

    from ekf_companion.doctor.examination import examine_link, examine_log

    if log is not None:
        with progress_line(log.name) as progress:
            return examine_log(log, config, progress)
    if link is not None:
        config = replace(config, link=replace(config.link, url=link))
    with progress_line(f"listening on {config.link.url}", in_seconds=True) as progress:
        return examine_link(config, seconds, listen=listen, progress=progress)


def _print_json(evidence: Evidence, findings: list[StageResult], log: Path | None) -> None:
    peer, names = evidence.peer, ("system_id", "component_id", "family", "version")
    report = {
        "examined": str(log) if log else evidence.config.link.url,
        "means": evidence.means.value,
        "seconds": round(evidence.seconds, 1),
        "autopilot": peer and {name: getattr(peer, name) for name in names},
        "stages": [finding.to_dict() for finding in findings],
    }
    typer.echo(json.dumps(report, indent=2, ensure_ascii=False))


def _print(findings: list[StageResult]) -> None:
    import shutil

    from ekf_companion.doctor.report import lines
    from ekf_companion.doctor.stage import Outcome

    colours = {Outcome.WARNING: typer.colors.YELLOW, Outcome.FAILED: typer.colors.RED}
    for mark, line in lines(findings, min(shutil.get_terminal_size().columns, 100)):
        typer.secho(line, fg=colours.get(mark))
