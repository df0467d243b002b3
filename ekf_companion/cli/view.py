"""Show a recorded flight in the browser, on the page that the daemon serves live."""

from __future__ import annotations

import signal
import threading
from typing import Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError

HOST = "127.0.0.1"


def view(
    log: terminal.LogArgument,
    config: terminal.ConfigOption = None,
    reference: terminal.TruthOption = None,
    browser: Annotated[bool, typer.Option(help="Open the browser.")] = True,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of this computer; 0: a free one.")
    ] = 0,
) -> None:
    """Show a flight in the browser: a slider over time, both estimates; until Ctrl-C."""
    from ekf_companion.analysis import flight_review, log_view
    from ekf_companion.config.service import HttpConfig
    from ekf_companion.daemon.http import HttpServer, listen
    from ekf_companion.daemon.log_site import LogSite

    with terminal.exit_on_error():
        truth = terminal.read_truth(reference)
        loaded = terminal.load(config)
        try:
            listener = listen(HOST, port)
        except OSError as error:
            raise ConfigError(
                f"--port: {port}: {error.strerror}; name another, or none for a free one"
            ) from error
        with listener:
            with progress_line(log.name) as progress:
                found = flight_review.review(log, loaded, progress, truth)
                data = log_view.to_json(found)
            taken = listener.getsockname()[1]
            settings = HttpConfig(
                host=HOST,
                port=taken,
                tiles=loaded.http.tiles,
                tiles_credit=loaded.http.tiles_credit,
            )
            server = HttpServer(settings, lambda: LogSite(data), listener=listener)
            typer.echo(found.judgement.sentence)
            typer.echo(f"http://{HOST}:{taken}/ shows {log.name}; Ctrl-C ends it")
            if browser:
                _open(f"http://{HOST}:{taken}/")
            _wait()
            server.finish()


def _open(url: str) -> None:
    """Open the browser, if there is one."""
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def _wait() -> None:
    """Wait for Ctrl-C or SIGTERM."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    while not stop.wait(0.5):
        pass
