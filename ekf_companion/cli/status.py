"""What a daemon that runs says of itself."""

from __future__ import annotations

import json
import signal
import sys
from contextlib import nullcontext
from threading import Event
from typing import Annotated, Any, NamedTuple

import typer

from ekf_companion.cli.status_view import view

URL = "http://127.0.0.1:9331"
TIMEOUT = 3.0
"""Seconds that the daemon has to answer."""
PERIOD = 1.0
"""Seconds between two looks of ``--watch``."""
UNHEALTHY, NOBODY = 1, 4
"""Exit codes."""
_FOREIGN = "{}: what answers is no ekf-companion; name its address with --url"


class Heard(NamedTuple):
    """An answer, or why there is none."""

    code: int
    """The command's exit code."""
    words: str
    data: dict[str, Any]
    """``/status``; empty: it was not told."""


def status(
    url: Annotated[str, typer.Option(help="Where the daemon answers: http.host, http.port.")] = URL,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print it as the daemon gives it.")
    ] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Look again every second.")] = False,
) -> None:
    """Show how the daemon is: 0 healthy, 1 it answers but is not, 4 nothing answers."""
    if watch:
        heard = _watch(url, as_json)
    else:
        heard = fetch(url)
        _print(heard, as_json)
    raise typer.Exit(heard.code)


def fetch(url: str) -> Heard:
    """Ask a daemon for its status; never raises."""
    from http.client import HTTPException
    from urllib.error import HTTPError
    from urllib.request import ProxyHandler, build_opener

    where = f"{url.rstrip('/')}/status"
    if not url.startswith(("http://", "https://")):
        return Heard(NOBODY, f"--url: {url}: is no address; write it as in {URL}", {})
    try:
        # No proxy: what is asked is this board, or one beside it
        with build_opener(ProxyHandler({})).open(where, timeout=TIMEOUT) as answer:
            data = json.load(answer)
        health = data["health"]
        return Heard(0 if health["is_healthy"] else UNHEALTHY, health["words"], data)
    except HTTPError as error:
        if error.headers.get_content_type() != "text/plain":
            return Heard(NOBODY, _FOREIGN.format(where), {})
        return Heard(UNHEALTHY, error.read().decode(errors="replace").strip(), {})
    except (ValueError, LookupError, TypeError, HTTPException):
        return Heard(NOBODY, _FOREIGN.format(where), {})
    except OSError as error:
        reason = getattr(error, "reason", error)
        words = (
            f"{where}: nothing answers ({getattr(reason, 'strerror', None) or reason}); is the "
            "daemon running (systemctl status ekf-companion), with http.host and http.port of its "
            "configuration as in --url?"
        )
        return Heard(NOBODY, words, {})


def _print(heard: Heard, as_json: bool) -> None:
    from rich.console import Console

    if heard.code == NOBODY or not heard.data:
        typer.echo(f"ekf-companion: {heard.words}", err=True)
    elif as_json:
        typer.echo(json.dumps(heard.data, indent=2))
    else:
        Console().print(view(heard.data))


def _watch(url: str, as_json: bool) -> Heard:
    """Show it every second until Ctrl-C; give what was heard last."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    # No exception ends it: one that comes in a finaliser is lost
    stop = Event()
    before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    has_screen = not as_json and Console().is_terminal
    try:
        with Live(auto_refresh=False) if has_screen else nullcontext() as live:
            while True:
                heard = fetch(url)
                if live is not None:
                    live.update(view(heard.data) if heard.data else Text(heard.words), refresh=True)
                elif as_json:
                    typer.echo(json.dumps(heard.data or {"words": heard.words}))
                else:
                    _print(heard, as_json)
                    sys.stdout.flush()
                if stop.wait(PERIOD):
                    return heard
    finally:
        signal.signal(signal.SIGINT, before)
