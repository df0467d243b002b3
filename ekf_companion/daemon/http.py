"""Where our state can be asked for over HTTP: ``/healthz``, ``/status``, ``/metrics``.

The standard library's server runs in a thread of its own. A snapshot is made in the loop, whole and
at one moment, when somebody asks and not more than five times a second; what becomes of it is made
in the thread, in steps so short that the loop need not wait. That the loop does not answer is what
``/healthz`` then says.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from functools import partial
from typing import TYPE_CHECKING, Any

from ekf_companion.config.service import HttpConfig
from ekf_companion.status.host import Host, read_host
from ekf_companion.status.judge import judge, to_json
from ekf_companion.status.observer import Observer
from ekf_companion.status.snapshot import Snapshot

if TYPE_CHECKING:
    from wsgiref.simple_server import WSGIServer

_log = logging.getLogger(__name__)

HEAD_START = 1.0
"""Seconds that the filter has before this begins: a restart in flight comes first."""
RETRY = 30.0
"""Seconds between two attempts where the port is taken."""
PATIENCE = 1.0
"""Seconds that the loop has to answer."""
FRESH = 0.2
"""Seconds for which one snapshot serves all who ask."""
BOARD = 2.0
"""Seconds between two readings of the board."""
DEADLINE = 5.0
"""Seconds that one request may take, all in all: a slow client is cut off."""
CONNECTIONS = 8
"""At once; others are closed unheard."""
PACE = 0.02
"""Seconds between two requests: no crowd of clients takes more than a tenth of a processor."""
BREATH = 3e-4
"""Seconds of sleep after each small piece of an answer, about 50 us of work: the loop goes first.
A shorter ``sys.setswitchinterval`` would do the loop harm: it cuts up the loop's work as well."""
_POLL = 0.5
_TEXT = "text/plain; charset=utf-8"
_PAGES = (
    "/healthz  is it well: 200, or 503 and why\n/status   everything, JSON\n/metrics  Prometheus\n"
)

Answer = tuple[str, str, bytes]
"""HTTP status, content type and body."""


class Desk:
    """Fetches snapshots out of the loop for any thread."""

    def __init__(self, observer: Observer, loop: asyncio.AbstractEventLoop) -> None:
        self._observer, self._loop = observer, loop
        self._lock = threading.Lock()
        self._asked: Future[Snapshot] | None = None
        self._last: Snapshot | None = None
        self._last_s = -FRESH
        self._board, self._board_s = Host(), -BOARD

    def ask(self) -> Snapshot | None:
        """Give the newest snapshot; None: the loop does not answer."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._last_s >= FRESH:
                self._last = self._fetch(now_s)
                self._last_s = time.monotonic()
            return self._last

    def _fetch(self, now_s: float) -> Snapshot | None:
        if now_s - self._board_s >= BOARD:
            self._board, self._board_s = read_host(), now_s
        # One question at a time: what a stuck loop did not answer still waits there
        if self._asked is None or self._asked.done():
            self._asked = Future()
            try:
                self._loop.call_soon_threadsafe(self._answer, self._asked, self._board)
            except RuntimeError:  # the loop has ended
                self._asked = None
                return None
        try:
            return self._asked.result(PATIENCE)
        except LateError:
            return None

    def _answer(self, asked: Future[Snapshot], board: Host) -> None:
        try:
            asked.set_result(self._observer.snapshot(board))
        except Exception as error:  # noqa: BLE001  # a bug here is the asker's, and stops no flight
            asked.set_exception(error)


class Pages:
    """The pages, as a WSGI application."""

    def __init__(self, ask: Callable[[], Snapshot | None]) -> None:
        self._ask = ask
        # Of many clients one at a time competes with the loop
        self._making = threading.Lock()

    def __call__(self, environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        """Answer one request."""
        method, path = environ["REQUEST_METHOD"], environ.get("PATH_INFO", "/")
        extra: list[tuple[str, str]] = []
        if method not in ("GET", "HEAD"):
            status, kind, body = "405 Method Not Allowed", _TEXT, b"only GET and HEAD\n"
            extra = [("Allow", "GET, HEAD")]
        else:
            status, kind, body = self._page(path, environ.get("HTTP_ACCEPT", ""))
        head = [("Content-Type", kind), ("Content-Length", str(len(body)))]
        start(status, [*head, ("Cache-Control", "no-store"), *extra])
        return [] if method == "HEAD" else [body]

    def _page(self, path: str, accept: str) -> Answer:
        if path == "/":
            return "200 OK", _TEXT, _PAGES.encode()
        pages: dict[str, Callable[[Snapshot], Answer]] = {
            "/healthz": _healthz,
            "/status": _status,
            "/metrics": partial(_metrics, accept),
        }
        if path not in pages:
            return "404 Not Found", _TEXT, f"no such page; there are:\n{_PAGES}".encode()
        snapshot = self._ask()
        if snapshot is None:
            words = f"stalled: the loop has not answered for {PATIENCE:.0f} s\n"
            return "503 Service Unavailable", _TEXT, words.encode()
        with self._making:
            return pages[path](snapshot)


def _healthz(snapshot: Snapshot) -> Answer:
    is_healthy, words = judge(snapshot)
    return "200 OK" if is_healthy else "503 Service Unavailable", _TEXT, f"{words}\n".encode()


def _status(snapshot: Snapshot) -> Answer:
    return "200 OK", "application/json", to_json(snapshot, _breathe)


def _metrics(accept: str, snapshot: Snapshot) -> Answer:
    from prometheus_client.exposition import choose_encoder

    from ekf_companion.status.metrics import registry_of

    encode, kind = choose_encoder(accept)
    return "200 OK", kind, encode(registry_of(snapshot, _breathe))


def _breathe() -> None:
    time.sleep(BREATH)


class Endpoint:
    """The server's thread."""

    def __init__(self, config: HttpConfig, ask: Callable[[], Snapshot | None]) -> None:
        """Begin to serve, a moment later."""
        self._config, self._pages = config, Pages(ask)
        self._stop = threading.Event()
        self._server: WSGIServer | None = None
        self._thread = threading.Thread(target=self._run, name="http", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self.finish()
        self.join(time.monotonic() + _POLL)

    def finish(self) -> None:
        """Stop listening; does not wait."""
        self._stop.set()
        if self._server is not None:
            with contextlib.suppress(OSError):
                self._server.socket.shutdown(socket.SHUT_RDWR)  # ends its wait

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _run(self) -> None:
        if self._stop.wait(HEAD_START):
            return
        import ekf_companion.status.metrics  # noqa: F401  # now, not at the first scrape

        has_complained = False
        while not self._stop.is_set():
            try:
                self._server = open_server(self._config.host, self._config.port, self._pages)
            except OSError as error:
                if not has_complained:
                    self._complain(error)
                has_complained = True
                self._stop.wait(RETRY)
                continue
            self._serve(self._server)

    def _serve(self, server: WSGIServer) -> None:
        host, port = server.server_address[:2]
        _log.info("Status on http://%s:%d/", f"[{host!s}]" if ":" in str(host) else host, port)
        with server:
            while not self._stop.is_set():
                server.handle_request()
                server.service_actions()
                self._stop.wait(PACE)

    def _complain(self, error: OSError) -> None:
        _log.warning(
            "http: %s port %d: %s; flying without status and metrics, trying again every %.0f s; "
            "give http.port another number in the configuration, or 0 for none",
            self._config.host,
            self._config.port,
            error.strerror or error,
            RETRY,
        )


def open_server(host: str, port: int, pages: Pages) -> WSGIServer:
    """Listen; requests are heard when ``handle_request`` is called.

    Raises:
        OSError: There is no such host here, or the port is taken.
    """
    from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

    class Handler(WSGIRequestHandler):
        timeout = DEADLINE

        def log_message(self, format: str, *args: Any) -> None:
            """Say nothing: who asks is not news."""

    class Server(socketserver.ThreadingMixIn, WSGIServer):
        daemon_threads = True
        request_queue_size = CONNECTIONS
        timeout = _POLL

        def __init__(self) -> None:
            self._ends: dict[Any, float] = {}
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self.address_family = found[0]
            super().__init__(found[4][:2], Handler)  # type: ignore[arg-type]

        def server_bind(self) -> None:
            """Bind without asking for our own name, which may take half a minute."""
            socketserver.TCPServer.server_bind(self)
            self.server_name, self.server_port = host, port
            self.setup_environ()

        def verify_request(self, request: Any, client_address: Any) -> bool:
            """Admit so many at once."""
            return len(self._ends) < CONNECTIONS

        def process_request(self, request: Any, client_address: Any) -> None:
            """Begin a request, and say when it must be over."""
            self._ends[request] = time.monotonic() + DEADLINE
            super().process_request(request, client_address)

        def shutdown_request(self, request: Any) -> None:
            """End it."""
            self._ends.pop(request, None)
            super().shutdown_request(request)

        def service_actions(self) -> None:
            """Cut off who takes too long."""
            now_s = time.monotonic()
            for request, end in list(self._ends.items()):
                if now_s > end:
                    with contextlib.suppress(OSError):
                        request.shutdown(socket.SHUT_RDWR)

        def handle_error(self, request: Any, client_address: Any) -> None:
            """Take a client that went away for what it is."""
            _log.debug("http: %s: %s", client_address[0], sys.exc_info()[1])

    server = Server()
    server.set_app(pages)
    return server


def open_endpoint(
    config: HttpConfig, observer: Observer, loop: asyncio.AbstractEventLoop
) -> Endpoint | None:
    """Serve what an observer sees; None: it is not wanted."""
    return Endpoint(config, Desk(observer, loop).ask) if config.port else None
