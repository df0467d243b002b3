"""Show the state of a running daemon."""

from __future__ import annotations

import json
import re
import signal
import sys
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ekf_companion.cli.status_view import view

if TYPE_CHECKING:
    from rich.console import RenderableType

URL = "http://127.0.0.1:9331"
UrlOption = Annotated[
    str,
    typer.Option(
        "--url", help="Where the daemon answers: http.host, http.port; ?token=... from elsewhere."
    ),
]
TIMEOUT = 3.0
"""Longest wait for an answer, s."""
PERIOD = 1.0
"""Seconds between two requests of ``--watch``."""
NOT_OK, NO_DAEMON = 1, 4
"""Exit codes."""
_HOST_AND_PORT = re.compile(r"([\w.-]+|\[[0-9a-fA-F:.]+\]):\d+")
"""Start of an address without ``http://``."""
_LINKS = ("serial:", "udpin:", "udpout:", "udpbcast:", "udp:", "tcp:", "tcpin:", "/dev/")
"""Prefixes of links."""
_FOREIGN = "{}: what answers is no ekf-companion; name its address with --url"


class Answer(NamedTuple):
    """An answer, or why there is none."""

    code: int
    """The command's exit code."""
    sentence: str
    data: dict[str, Any]
    """Of ``/status``; empty if it did not come."""
    url: str = ""
    """Of the daemon that answered, without a token."""


def status(
    url: UrlOption = URL,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print /status as JSON, and nothing else.")
    ] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Repeat every second; arrows scroll, q ends.")
    ] = False,
    brief: Annotated[
        bool, typer.Option("--brief", help="Only the verdicts, the vehicle and its aids: 80 x 24.")
    ] = False,
) -> None:
    """Show the daemon's state. Exit code: 0 ok, 1 no current estimate or invalid, 4 no answer."""
    if watch:
        answer = _watch(url, as_json, is_brief=brief)
    else:
        answer = fetch(url)
        _print(answer, as_json, is_brief=brief)
    raise typer.Exit(answer.code)


def fetch(url: str) -> Answer:
    """Ask a daemon for its status; raises nothing."""
    from http.client import HTTPException
    from urllib.error import HTTPError
    from urllib.request import ProxyHandler, Request, build_opener

    is_link = url.startswith(_LINKS)
    if _HOST_AND_PORT.match(url) and not is_link:
        url = f"http://{url}"
    base, _, token = url.partition("?token=")
    base = base.rstrip("/")
    where = f"{base}/status"
    if not url.startswith(("http://", "https://")):
        other = " (a link is named with --link)" if is_link else ""
        return Answer(NO_DAEMON, f"--url: {url}: is no address; write it as in {URL}{other}", {})
    try:
        # No proxy: the daemon is on this board, or on one beside it
        request = Request(where, headers={"Authorization": f"Bearer {token}"} if token else {})
        with build_opener(ProxyHandler({})).open(request, timeout=TIMEOUT) as answer:
            data = json.load(answer)
        health = data["health"]
        # A daemon that was not restarted after an upgrade does not say is_ok
        is_ok = health["is_ok" if "is_ok" in health else "is_healthy"]
        return Answer(0 if is_ok else NOT_OK, health["words"], data, base)
    except HTTPError as error:
        if error.headers.get_content_type() != "text/plain":
            return Answer(NO_DAEMON, _FOREIGN.format(where), {})
        return Answer(NOT_OK, error.read().decode(errors="replace").strip(), {})
    except (ValueError, LookupError, TypeError, RecursionError, HTTPException):
        return Answer(NO_DAEMON, _FOREIGN.format(where), {})
    except OSError as error:
        reason = getattr(error, "reason", error)
        sentence = (
            f"{where}: nothing answers ({getattr(reason, 'strerror', None) or reason}); is the "
            "daemon running (systemctl status ekf-companion), with http.host and http.port of its "
            "configuration as in --url?"
        )
        return Answer(NO_DAEMON, sentence, {})


def _print(answer: Answer, as_json: bool, *, is_brief: bool) -> None:
    from rich.console import Console

    if answer.code == NO_DAEMON or not answer.data:
        typer.echo(f"ekf-companion: {answer.sentence}", err=True)
    elif as_json:
        typer.echo(json.dumps(answer.data, indent=2))
    else:
        Console().print(view(answer.data, answer.url, is_brief=is_brief))


def _watch(url: str, as_json: bool, *, is_brief: bool) -> Answer:
    """Show the state every second until Ctrl-C, or ``q``; return the last answer."""
    from rich.console import Console

    if as_json or not Console().is_terminal:
        return _repeat(url, as_json, is_brief=is_brief)
    from rich.text import Text

    from ekf_companion.cli.watch import watch

    answer = Answer(NO_DAEMON, "", {})

    def page() -> RenderableType:
        nonlocal answer
        answer = fetch(url)
        if not answer.data:
            return Text(answer.sentence)
        return view(answer.data, answer.url, is_brief=is_brief)

    watch(page, PERIOD)
    return answer


def _repeat(url: str, as_json: bool, *, is_brief: bool) -> Answer:
    """Print the state every second until Ctrl-C; return the last answer."""
    # No exception ends it: one that comes in a finaliser is lost
    stop = Event()
    before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        while True:
            answer = fetch(url)
            if as_json:
                typer.echo(json.dumps(answer.data or {"words": answer.sentence}))
            else:
                _print(answer, as_json, is_brief=is_brief)
                sys.stdout.flush()
            if stop.wait(PERIOD):
                return answer
    finally:
        signal.signal(signal.SIGINT, before)
