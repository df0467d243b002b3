"""The state over HTTP, served on threads: it answers also while the loop stalls, and reports that.

One thread accepts connections, and each is answered on a thread of its own. A viewer of the page
keeps its connection and its thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon.access import Access, is_loopback
from ekf_companion.daemon.places import DEADLINE, Places
from ekf_companion.daemon.recent_events import RecentEvents
from ekf_companion.daemon.snapshots import SnapshotSource
from ekf_companion.status.observer import Observer

if TYPE_CHECKING:
    from ekf_companion.daemon.pages import Site

_log = logging.getLogger(__name__)

HEAD_START = 1.0
"""Seconds that the filter has before this begins: a restart in flight comes first."""
RETRY = 30.0
"""Seconds between two attempts where the port is taken."""
PACE = 0.02
"""Seconds between two answers: many clients take no more than a tenth of a processor."""
REFUSAL_PACE = 0.002
"""Seconds after one that finds no place: closing it costs little, and others wait behind it."""
BACKLOG = 128
"""Connections that the kernel keeps until they are accepted."""
_POLL = 0.5
_TAKEN = (
    "http: %s port %d: %s; flying without status and metrics, trying again every %.0f s; "
    "give http.port another number in the configuration, or 0 for none"
)


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
            config: Where, and to whom.
            open_site: Called once, on the server's thread; returns what is served.
            listener: Of :func:`listen`; None: one is opened, again and again until it can be.
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
        """Log the address to open; with the token where that is needed and nobody knows it."""
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
    """Serve what an observer sees, and the last lines of the log; None if no port is wanted."""
    if not config.port:
        return None
    source = SnapshotSource(observer, loop)

    def open_site() -> Site:
        from ekf_companion.daemon.pages import DaemonSite  # now, not at the first request

        return DaemonSite(source, events)

    return HttpServer(config, open_site)
