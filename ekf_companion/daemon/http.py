"""The state over HTTP, served beside the loop: it answers also while the loop stalls, and says so.

One thread accepts connections, and each is answered on a thread of its own. The snapshot that an
answer is made of is taken in the loop, whole and at one moment, at most five times a second.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from typing import Any

from ekf_companion.config.service import HttpConfig
from ekf_companion.status.host import Host, read_host
from ekf_companion.status.observer import Observer
from ekf_companion.status.snapshot import Snapshot

_log = logging.getLogger(__name__)

HEAD_START = 1.0
"""Seconds that the filter has before this begins: a restart in flight comes first."""
RETRY = 30.0
"""Seconds between two attempts where the port is taken."""
PATIENCE = 1.0
"""Seconds that the loop has to answer."""
FRESH = 0.2
"""Seconds for which one snapshot serves all requests."""
HOST_EVERY = 2.0
"""Seconds between two readings of the board."""
DEADLINE = 5.0
"""Seconds that one request may take in all; a slower client is disconnected."""
CONNECTIONS = 8
"""At once; others are closed unanswered."""
PACE = 0.02
"""Seconds between two connections: many clients take no more than a tenth of a processor."""
_POLL = 0.5
_TAKEN = (
    "http: %s port %d: %s; flying without status and metrics, trying again every %.0f s; "
    "give http.port another number in the configuration, or 0 for none"
)


class SnapshotSource:
    """Takes snapshots in the loop, for any thread."""

    def __init__(self, observer: Observer, loop: asyncio.AbstractEventLoop) -> None:
        self._observer, self._loop = observer, loop
        self._lock = threading.Lock()
        self._request: Future[Snapshot] | None = None
        self._last: Snapshot | None = None
        self._last_s = -FRESH
        self._host, self._host_s = Host(), -HOST_EVERY

    def read(self) -> Snapshot | None:
        """Return the newest snapshot, or None if the loop does not answer."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._last_s >= FRESH:
                self._last = self._take(now_s)
                self._last_s = time.monotonic()
            return self._last

    def _take(self, now_s: float) -> Snapshot | None:
        if now_s - self._host_s >= HOST_EVERY:
            self._host, self._host_s = read_host(), now_s
        # One request at a time: one that a stalled loop did not answer still waits there
        if self._request is None or self._request.done():
            self._request = Future()
            try:
                self._loop.call_soon_threadsafe(self._answer, self._request, self._host)
            except RuntimeError:  # the loop has ended
                self._request = None
                return None
        try:
            return self._request.result(PATIENCE)
        except LateError:
            return None

    def _answer(self, request: Future[Snapshot], host: Host) -> None:
        try:
            request.set_result(self._observer.snapshot(host))
        except Exception as error:  # noqa: BLE001  # a bug here must not end a flight
            request.set_exception(error)


class HttpServer:
    """Accepts connections on a thread, and answers each on another."""

    def __init__(self, config: HttpConfig, read: Callable[[], Snapshot | None]) -> None:
        """Begin to serve, a moment later."""
        self._config, self._read = config, read
        self._stop = threading.Event()
        self._listener: socket.socket | None = None
        self._ends_s: dict[socket.socket, float] = {}
        self._thread = threading.Thread(target=self._run, name="http", daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Stop listening; does not wait."""
        self._stop.set()
        if self._listener is not None:
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)  # ends its wait

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _run(self) -> None:
        if self._stop.wait(HEAD_START):
            return
        from ekf_companion.daemon import pages  # noqa: F401  # now, not at the first request

        has_complained = False
        while not self._stop.is_set():
            try:
                self._listener = listener = _listen(self._config.host, self._config.port)
            except OSError as error:
                if not has_complained:
                    words = error.strerror or error
                    _log.warning(_TAKEN, self._config.host, self._config.port, words, RETRY)
                has_complained = True
                self._stop.wait(RETRY)
                continue
            host, port = listener.getsockname()[:2]
            _log.info("Status on http://%s:%d/", f"[{host}]" if ":" in host else host, port)
            with listener:
                while not self._stop.is_set():
                    self._accept(listener)
                    self._stop.wait(PACE)

    def _accept(self, listener: socket.socket) -> None:
        """Begin to answer the next connection, and disconnect clients that take too long."""
        with contextlib.suppress(OSError):  # there is none, or it is gone again
            client, address = listener.accept()
            if len(self._ends_s) < CONNECTIONS:
                self._ends_s[client] = time.monotonic() + DEADLINE
                threading.Thread(target=self._answer, args=(client, address), daemon=True).start()
            else:
                client.close()
        now_s = time.monotonic()
        for client, end_s in list(self._ends_s.items()):
            if now_s > end_s:
                with contextlib.suppress(OSError):
                    client.shutdown(socket.SHUT_RDWR)

    def _answer(self, client: socket.socket, address: Any) -> None:
        from ekf_companion.daemon.pages import Handler

        try:
            client.settimeout(DEADLINE)
            Handler(client, address, self._read)
            client.shutdown(socket.SHUT_WR)
        except OSError as error:
            _log.debug("http: %s: %s", address[0], error)
        finally:
            del self._ends_s[client]
            client.close()


def _listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; OSError: there is no such host here, or the port is taken."""
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.settimeout(_POLL)
        listener.bind(address)
        listener.listen(CONNECTIONS)
    except OSError:
        listener.close()
        raise
    return listener


def open_http_server(
    config: HttpConfig, observer: Observer, loop: asyncio.AbstractEventLoop
) -> HttpServer | None:
    """Serve what an observer sees; return None if no port is wanted."""
    return HttpServer(config, SnapshotSource(observer, loop).read) if config.port else None
