"""A daemon that runs, told to read its configuration again."""

from __future__ import annotations

import os
import signal
import time
from typing import Annotated

import typer

from ekf_companion.cli.status import NOBODY, URL, fetch

PATIENCE = 5.0
"""Seconds that reading a configuration may take."""
REFUSED = 1
"""Exit code."""


def reload(
    url: Annotated[str, typer.Option(help="Where the daemon answers: http.host, http.port.")] = URL,
) -> None:
    """Have the daemon take a changed configuration: rates, gates and noise, in flight."""
    before = fetch(url)
    if not before.data:
        _end(NOBODY, before.words)
    pid = int(before.data["process"]["pid"])
    try:
        os.kill(pid, signal.SIGHUP)
    except ProcessLookupError:
        _end(NOBODY, f"{url}: the daemon runs on another machine; run this command there")
    except PermissionError:
        _end(
            REFUSED,
            f"process {pid} is another user's; run: sudo systemctl reload ekf-companion",
        )
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        now = fetch(url).data
        if now and now["reload"]["count"] > before.data["reload"]["count"]:
            words = str(now["reload"]["words"])
            _end(REFUSED if words.endswith("as it was") else 0, words)
        time.sleep(0.1)
    _end(REFUSED, f"process {pid} has not reloaded within {PATIENCE:g} s; see its log")


def _end(code: int, words: str) -> None:
    typer.echo(words if code == 0 else f"ekf-companion: {words}", err=code != 0)
    raise typer.Exit(code)
