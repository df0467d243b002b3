"""The state over HTTP, served on threads: it answers also while the loop stalls, and reports that.

One thread accepts connections, and each is answered on a thread of its own. The snapshot for an
answer is taken in the loop, at one moment, at most five times a second. A viewer of the page keeps
its connection and its thread.
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
from typing import TYPE_CHECKING, Any, TypeVar

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon.access import Access, is_loopback
from ekf_companion.daemon.places import DEADLINE, Places
from ekf_companion.daemon.recent_events import RecentEvents
from ekf_companion.status.host import Host, read_host
from ekf_companion.status.observer import Observer
from ekf_companion.status.snapshot import Snapshot

if TYPE_CHECKING:
    from ekf_companion.daemon.pages import Site

_log = logging.getLogger(__name__)
T = TypeVar("T")

HEAD_START = 1.0
"""Seconds that the filter has before this begins: a restart in flight comes first."""
RETRY = 30.0
"""Seconds between two attempts where the port is taken."""
PATIENCE = 1.0
"""Seconds to wait for the loop."""
FRESH = 0.2
"""Seconds for which one snapshot serves all requests."""
HOST_EVERY = 2.0
"""Seconds between two readings of the board."""
PACE = 0.02
"""Seconds between two answers, so that many clients take at most a tenth of a processor."""
REFUSAL_PACE = 0.002
"""Seconds after refusing a client for which there is no place: that costs little, and others
wait."""
BACKLOG = 128
"""Connections that the kernel keeps until they are accepted."""
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
        self._live: Future[bytes] | None = None
        self._past: Future[bytes] | None = None

    def read(self) -> Snapshot | None:
        """Return the newest snapshot, or None if the loop does not answer."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._last_s >= FRESH:
                self._last = self._take(now_s)
                self._last_s = time.monotonic()
            return self._last

    def read_live(self) -> bytes | None:
        """Return the newest estimate as JSON, or None if the loop does not answer."""
        return self._ask(self._live_request())

    def read_past(self) -> bytes | None:
        """Return the estimates of the last minutes as JSON, or None if the loop does not answer."""
        with self._lock:
            if self._past is None or self._past.done():
                self._past = self._call(self._observer.past)
            return self._ask(self._past)

    def _take(self, now_s: float) -> Snapshot | None:
        if now_s - self._host_s >= HOST_EVERY:
            self._host, self._host_s = read_host(), now_s
        # One request at a time: one that a stalled loop did not answer still waits there
        if self._request is None or self._request.done():
            host = self._host
            self._request = self._call(lambda: self._observer.snapshot(host))
        return self._ask(self._request)

    def _live_request(self) -> Future[bytes] | None:
        if self._live is None or self._live.done():
            self._live = self._call(self._observer.live)
        return self._live

    def _call(self, take: Callable[[], T]) -> Future[T] | None:
        """Have a function called in the loop; return None if the loop has ended."""
        request: Future[T] = Future()

        def answer() -> None:
            try:
                request.set_result(take())
            except Exception as error:  # noqa: BLE001  # a bug here must not end a flight
                request.set_exception(error)

        try:
            self._loop.call_soon_threadsafe(answer)
        except RuntimeError:
            return None
        return request

    def _ask(self, request: Future[T] | None) -> T | None:
        try:
            return None if request is None else request.result(PATIENCE)
        except LateError:
            return None


class HttpServer:
    """Accepts connections on a thread, and answers each on another."""

    def __init__(
        self,
        config: HttpConfig,
        open_site: Callable[[], Site],
        *,
        listener: socket.socket | None = None,
    ) -> None:
        """Begin to serve: at once on a given socket, else a moment later.

        Args:
            config: Address, port and access.
            open_site: Called once, on the server's thread; returns what is served.
            listener: Of :func:`listen`; None: one is opened, with retries until it succeeds.
        """
        self._config, self._open_site = config, open_site
        self._given = listener
        self._access = Access(config)
        self._site: Site | None = None
        self._stop = threading.Event()
        self._listener: socket.socket | None = None
        self._places: Places[socket.socket] = Places()
        self._thread = threading.Thread(target=self._run, name="http", daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Stop listening; does not wait."""
        self._stop.set()
        if self._site is not None and self._site.feed is not None:
            self._site.feed.finish()
        if self._listener is not None:
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)  # ends its wait

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _run(self) -> None:
        if self._given is None and self._stop.wait(HEAD_START):
            return
        self._site = self._open_site()
        if self._given is not None:
            self._serve(self._given)
            return
        has_complained = False
        while not self._stop.is_set():
            try:
                self._listener = listener = listen(self._config.host, self._config.port)
            except OSError as error:
                if not has_complained:
                    words = error.strerror or error
                    _log.warning(_TAKEN, self._config.host, self._config.port, words, RETRY)
                has_complained = True
                self._stop.wait(RETRY)
                continue
            self._announce(*listener.getsockname()[:2])
            self._serve(listener)

    def _serve(self, listener: socket.socket) -> None:
        with listener:
            while not self._stop.is_set():
                self._stop.wait(self._accept(listener))

    def _announce(self, host: str, port: int) -> None:
        """Log the address to open; with the token if it was drawn by the daemon."""
        where = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        _log.info("Status on %s", where)
        if is_loopback(host):
            return
        token = self._access.token if self._access.is_generated else "the one of http.token"
        _log.info("From another computer: %s?token=%s", where, token)

    def _accept(self, listener: socket.socket) -> float:
        """Begin to answer the next connection, and disconnect clients that take too long.

        Returns:
            Seconds to wait before the next one.
        """
        pace = PACE
        with contextlib.suppress(OSError):  # there is none, or it is gone again
            client, address = listener.accept()
            if self._places.take(client, address[0], time.monotonic()):
                threading.Thread(target=self._answer, args=(client, address), daemon=True).start()
            else:
                client.close()
                pace = REFUSAL_PACE
        for client in self._places.late(time.monotonic()):
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
        return pace

    def _answer(self, client: socket.socket, address: Any) -> None:
        from ekf_companion.daemon.pages import Handler

        assert self._site is not None
        try:
            client.settimeout(DEADLINE)
            Handler(
                client,
                address,
                self._site,
                self._access,
                on_line=lambda: self._places.extend(client),
                on_watch=lambda: self._places.leave(client),
                config=self._config,
            )
            client.shutdown(socket.SHUT_WR)
        except OSError as error:
            _log.debug("http: %s: %s", address[0], error)
        finally:
            self._places.leave(client)
            client.close()


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; OSError: there is no such host here, or the port is taken."""
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.settimeout(_POLL)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener


def open_http_server(
    config: HttpConfig,
    observer: Observer,
    loop: asyncio.AbstractEventLoop,
    events: RecentEvents | None = None,
) -> HttpServer | None:
    """Serve an observer's state and the last lines of the log; None if no port is configured."""
    if not config.port:
        return None
    source = SnapshotSource(observer, loop)

    def open_site() -> Site:
        from ekf_companion.daemon.pages import DaemonSite  # now, not at the first request

        return DaemonSite(source, events)

    return HttpServer(config, open_site)
