"""Ask a running daemon whether the vehicle may take off on its estimate."""

from __future__ import annotations

import time
from typing import Annotated, Any

import typer

from ekf_companion.cli.status import NO_DAEMON, URL, Answer, UrlOption, fetch
from ekf_companion.cli.terminal import JsonOption, show
from ekf_companion.cli.vehicle_view import named

NOT_READY, ARMED = 5, 6
"""Exit codes."""
PERIOD = 1.0
"""Seconds between two requests of ``--wait``."""
_OLD = (
    "the daemon is older than this command and knows no verdict: restart it "
    "(systemctl restart ekf-companion)"
)


def preflight(
    url: UrlOption = URL,
    as_json: JsonOption = False,
    wait: Annotated[
        float, typer.Option(min=0.0, help="Seconds to wait for a vehicle that is not ready yet.")
    ] = 0.0,
) -> None:
    """Report if the vehicle may take off. Exit code: 0 ready, 5 not, 6 armed, 4 no answer."""
    end_s, said = time.monotonic() + wait, [""]
    while True:
        code, verdict = _ask(url)
        left_s = end_s - time.monotonic()
        if code in (0, ARMED) or left_s <= 0.0 or not url.startswith(("http://", "https://")):
            break
        # What is waited for, on the standard error: the result alone goes to the other
        if verdict["causes"] != said:
            said = verdict["causes"]
            typer.echo(f"{verdict['sentence']} (waiting)", err=True)
        time.sleep(min(PERIOD, left_s))
    if code == NO_DAEMON:
        typer.echo(f"ekf-companion: {verdict['sentence']}", err=True)
    else:
        lines = [verdict["sentence"]]
        if verdict["vehicle"]:
            lines.append(f"{verdict['vehicle']}; {verdict['daemon']}")
        show(as_json, verdict, lines)
    raise typer.Exit(code)


def _ask(url: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code, and the verdict as ``/status`` contains it, with what it is of."""
    answer = fetch(url)
    if answer.code == NO_DAEMON:
        return NO_DAEMON, _unknown(answer)
    if (verdict := answer.data.get("preflight")) is not None:
        is_armed = "armed" in verdict["causes"]
        verdict |= {"vehicle": named(answer.data), "daemon": answer.url}
        return 0 if verdict["ready"] else ARMED if is_armed else NOT_READY, verdict
    # A daemon whose loop is stuck answers with a sentence alone
    words = answer._replace(sentence=_OLD) if answer.data else answer
    return NOT_READY, _unknown(words)


def _unknown(answer: Answer) -> dict[str, Any]:
    """Return a verdict for a daemon that sent none."""
    words = answer.sentence if answer.code == NO_DAEMON else f"not ready: {answer.sentence}"
    verdict = {"ready": False, "sentence": words, "reasons": [answer.sentence]}
    return {**verdict, "notes": [], "causes": [], "vehicle": "", "daemon": answer.url}
