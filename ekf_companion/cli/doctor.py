"""Find the stage that loses the data, and what to set."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
_PEER = ("system_id", "component_id", "family", "version")
"""Template of the line about the autopilot."""


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
    url: Annotated[
        str | None,
        typer.Option("--url", help="Ask a daemon that runs, and has the link, as status does."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the findings as JSON, and nothing else.")
    ] = False,
) -> None:
    """Find the stage that loses the data, and the parameter to change."""
    from ekf_companion.doctor.diagnosis import diagnose, first_failure
    from ekf_companion.logs.source import suffix_of

    with exit_on_error():
        if log is not None and (link is not None or listen):
            raise ConfigError("--log: a recording has no link; leave out --link and --listen")
        if log is not None and suffix_of(log) != ".tlog":
            raise ConfigError(
                f"--log: {log}: only a .tlog holds what came over a link; `ekf-companion report` "
                "says what any log is good for"
            )
        if url is not None and (log is not None or link is not None or listen or config):
            raise ConfigError("--url: a daemon has its own link; leave the other options out")
        if url is not None:
            findings, report = _ask(url)
        else:
            with _quiet():
                evidence = _examine(load(config), link, log, seconds, listen=listen)
            findings = diagnose(evidence)
            report = _about(evidence, log)
    if as_json:
        report["stages"] = [finding.to_dict() for finding in findings]
        typer.echo(json.dumps(report, indent=2, ensure_ascii=False))
    else:
        _print(findings)
    if first_failure(findings) is not None:
        raise typer.Exit(STAGE_FAILED)


def _ask(url: str) -> tuple[list[StageResult], dict[str, Any]]:
    """Return the stages by a running daemon's status, and a line about the daemon."""
    from ekf_companion.cli.status import NO_DAEMON, fetch
    from ekf_companion.doctor.running import diagnose_running

    answer = fetch(url)
    if answer.code == NO_DAEMON or not answer.data:
        typer.echo(f"ekf-companion: {answer.sentence}", err=True)
        raise typer.Exit(answer.code)
    process, peer = answer.data["process"], answer.data["peer"]
    report = {"examined": url, "means": "daemon", "seconds": round(process["uptime_s"], 1)}
    return diagnose_running(answer.data), {**report, "autopilot": _named(peer)}


def _named(peer: Mapping[str, Any] | None) -> dict[str, Any] | None:
    return {name: peer[name] for name in _PEER} if peer else None


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


def _about(evidence: Evidence, log: Path | None) -> dict[str, Any]:
    """Return a line on what was examined, and how."""
    peer = evidence.peer
    return {
        "examined": str(log) if log else evidence.config.link.url,
        "means": evidence.means.value,
        "seconds": round(evidence.seconds, 1),
        "autopilot": peer and {name: getattr(peer, name) for name in _PEER},
    }


def _print(findings: list[StageResult]) -> None:
    import shutil

    from ekf_companion.doctor.report import lines
    from ekf_companion.doctor.stage import Outcome

    colours = {Outcome.WARNING: typer.colors.YELLOW, Outcome.FAILED: typer.colors.RED}
    for mark, line in lines(findings, min(shutil.get_terminal_size().columns, 100)):
        typer.secho(line, fg=colours.get(mark))
