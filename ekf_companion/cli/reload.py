"""A daemon that runs, told to read its configuration again."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from ekf_companion.cli.status import NOBODY, URL, fetch

PATIENCE = 5.0
"""Seconds that reading a configuration may take."""
FAILED, WRONG = 1, 2
"""Exit codes: it was not done, or the configuration is wrong."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LISTENS = "0A"


def reload(
    url: Annotated[str, typer.Option(help="Where the daemon answers: http.host, http.port.")] = URL,
) -> None:
    """Have the daemon take a changed configuration: rates, gates and noise, in flight."""
    before = fetch(url)
    if not before.data:
        _end(NOBODY, before.words)
    pid = int(before.data["process"]["pid"])
    try:
        if not _answers(pid, url):
            _end(
                NOBODY,
                f"{url}: the daemon that answers there is no process of this machine (it runs on "
                "another, or in a container); run this command there",
            )
        os.kill(pid, signal.SIGHUP)
    except PermissionError:
        _end(
            FAILED,
            f"process {pid} is another user's; run: sudo systemctl reload ekf-companion",
        )
    except ProcessLookupError:
        _end(NOBODY, f"{url}: process {pid} has just ended")
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        now = fetch(url).data
        if now and now["reload"]["count"] > before.data["reload"]["count"]:
            words = str(now["reload"]["words"])
            _end(WRONG if words.endswith("as it was") else 0, words)
        time.sleep(0.1)
    _end(FAILED, f"process {pid} has not reloaded within {PATIENCE:g} s; see its log")


def _answers(pid: int, url: str) -> bool:
    """Whether a process of this machine is the one that listens where the URL leads.

    A number that came over the network may be any process here.

    Raises:
        PermissionError: It is another user's.

    Source: proc(5), /proc/net/tcp and /proc/pid/fd.
    """
    place = urlsplit(url)
    if place.hostname not in _LOOPBACK:
        return False
    try:
        sockets = {f"socket:[{inode}]" for inode in _listening(place.port or 80)}
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            try:
                if str(entry.readlink()) in sockets:
                    return True
            except FileNotFoundError:  # closed meanwhile
                continue
    except FileNotFoundError:
        pass
    return False


def _listening(port: int) -> set[str]:
    """Give the inodes of this machine's sockets that listen at a TCP port."""
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == _LISTENS and int(local.rpartition(":")[2], 16) == port:
                found.add(rest[5])
    return found


def _end(code: int, words: str) -> None:
    typer.echo(words if code == 0 else f"ekf-companion: {words}", err=code != 0)
    raise typer.Exit(code)
