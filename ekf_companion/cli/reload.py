"""Make a running daemon read its configuration again."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import typer

from ekf_companion.cli.status import NO_DAEMON, URL, UrlOption, fetch
from ekf_companion.link.holder import sockets_at

PATIENCE = 5.0
"""Longest time for the daemon to read it, s."""
FAILED, WRONG = 1, 2
"""Exit codes: not reloaded; the configuration is wrong."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


def reload(url: UrlOption = URL) -> None:
    """Reload the daemon's configuration; rates, gates and noise change in flight."""
    before = fetch(url)
    if not before.data:
        _end(NO_DAEMON, before.sentence)
    pid = int(before.data["process"]["pid"])
    try:
        if not _listens(pid, url):
            _end(
                NO_DAEMON,
                f"{url}: the daemon that answers there is no process of this machine (it runs on "
                "another, or in a container); run this command there",
            )
        os.kill(pid, signal.SIGHUP)
    except PermissionError:
        _end(FAILED, f"process {pid} is another user's; run: sudo systemctl reload ekf-companion")
    except ProcessLookupError:
        _end(NO_DAEMON, f"{url}: process {pid} has just ended")
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        now = fetch(url).data
        if now and now["reload"]["count"] > before.data["reload"]["count"]:
            sentence = str(now["reload"]["words"])
            _end(WRONG if sentence.endswith("as it was") else 0, sentence)
        time.sleep(0.1)
    _end(FAILED, f"process {pid} has not reloaded within {PATIENCE:g} s; see its log")


def _listens(pid: int, url: str) -> bool:
    """Return whether a process of this machine listens at the URL.

    A process id that came over the network may belong to any process here.

    Raises:
        PermissionError: It is another user's.

    Source: proc(5), /proc/net/tcp and /proc/pid/fd.
    """
    address = urlsplit(url)
    if address.hostname not in _LOOPBACK:
        return False
    sockets = sockets_at("tcp", address.port or 80)
    with suppress(FileNotFoundError):  # it has ended
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(FileNotFoundError):  # closed meanwhile
                if str(entry.readlink()) in sockets:
                    return True
    return False


def _end(code: int, sentence: str) -> None:
    typer.echo(sentence if code == 0 else f"ekf-companion: {sentence}", err=code != 0)
    raise typer.Exit(code)
