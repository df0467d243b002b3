"""The page, ``/healthz``, ``/status``, ``/metrics``, on the standard library's HTTP parser.

Imported on the serving thread, since that takes a while. ``/live`` is a WebSocket: it keeps its
connection.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any, Protocol
from urllib.parse import parse_qs, unquote

from prometheus_client.exposition import choose_encoder

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon import websocket
from ekf_companion.daemon.access import Access, Refusal
from ekf_companion.daemon.feed import Feed
from ekf_companion.daemon.recent_events import RecentEvents
from ekf_companion.daemon.snapshots import PATIENCE, SnapshotSource
from ekf_companion.status.assets import asset, index
from ekf_companion.status.judge import judge, to_json
from ekf_companion.status.metrics import registry_of
from ekf_companion.status.snapshot import Snapshot

_log = logging.getLogger(__name__)

PAUSE = 3e-4
"""Seconds of sleep after each small piece of an answer, about 50 us of work: the loop comes first.
A shorter ``sys.setswitchinterval`` would harm the loop: it interrupts the loop's work as well."""
_TEXT = "text/plain; charset=utf-8"
_INDEX = (
    "/healthz  is it well: 200, or 503 and why\n/status   everything, JSON\n/metrics  Prometheus\n"
)
_CSP = "default-src 'self'; img-src 'self' data:{}; frame-ancestors 'none'"
"""Pictures may also come from the server of a map's tiles."""
_FULL = "too many watch already: close the page elsewhere\n"
_LOCK = threading.Lock()
"""Only one client at a time competes with the loop."""
Answer = tuple[HTTPStatus, str, bytes]
"""Status, content type and body."""


class Site(Protocol):
    """What a server serves."""

    feed: Feed | None
    """Of ``/live``; None: there is none."""
    source: str
    """Source of the page's data: ``live`` or ``log``."""

    def page(self, path: str, accept: str) -> Answer | None:
        """Return a page; None: there is none at that path."""


class Handler(BaseHTTPRequestHandler):
    """Answers the one request of a connection."""

    server_version, sys_version = "ekf-companion", ""
    protocol_version = "HTTP/1.1"

    def __init__(
        self,
        client: socket.socket,
        address: Any,
        site: Site,
        access: Access,
        *,
        on_line: Callable[[], object],
        on_watch: Callable[[], object],
        config: HttpConfig,
    ) -> None:
        """Read the request and answer it.

        Args:
            client: The connection.
            address: Of the client, as ``accept`` returns it.
            site: What is served.
            access: Decides who is answered.
            on_line: Called when the request line has come.
            on_watch: Called when the connection becomes a viewer's, which may take longer.
            config: Names the map under the track.

        Raises:
            OSError: The client is gone, or too slow.
        """
        self._site, self._access, self._config = site, access, config
        self._on_line, self._on_watch = on_line, on_watch
        self._headers: list[tuple[str, str]] = []
        super().__init__(client, address, None)  # type: ignore[arg-type]  # no server is asked

    def parse_request(self) -> bool:
        """Read the headers after the request line."""
        self._on_line()
        return super().parse_request()

    def do_GET(self) -> None:
        """Send the page, for HEAD without its body."""
        feed = self._site.feed
        if feed is not None and self.path.partition("?")[0] == "/live" and self.command == "GET":
            self._watch(feed)
            return
        try:
            answer = self._page()
        except Exception:  # noqa: BLE001  # a bug here must not end a flight
            _log.exception("http: %s", self.path)
            answer = HTTPStatus.INTERNAL_SERVER_ERROR, _TEXT, b"a bug; the log has its traceback\n"
        self._send(*answer)

    do_HEAD = do_GET  # noqa: N815

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what is not a request, and any other method."""
        if code == HTTPStatus.NOT_IMPLEMENTED:
            self._send(HTTPStatus.METHOD_NOT_ALLOWED, _TEXT, b"only GET and HEAD\n")
        else:
            super().send_error(code, message, explain)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a request is not worth a line."""

    def _page(self) -> Answer:
        path, _, query = self.path.partition("?")
        path, accept = unquote(path), self.headers.get("Accept", "")
        if (refusal := self._refusal(query)) is not None:
            return refusal.status, _TEXT, refusal.words.encode()
        if path == "/" and "text/html" in accept:
            return self._front(query)
        if path == "/":
            return HTTPStatus.OK, _TEXT, _INDEX.encode()
        if path.startswith("/page/") and (found := asset(path.removeprefix("/page/"))):
            return HTTPStatus.OK, found.kind, found.body
        if (page := self._site.page(path, accept)) is not None:
            return page
        return HTTPStatus.NOT_FOUND, _TEXT, f"no such page; there are:\n{_INDEX}".encode()

    def _refusal(self, query: str, *, is_socket: bool = False) -> Refusal | None:
        """Return why the request is refused, or None; a wrong token is refused after a delay."""
        refusal = self._access.refuse(
            self.headers, query, self.client_address[0], is_socket=is_socket
        )
        if refusal is not None and refusal.wait:
            time.sleep(refusal.wait)
        return refusal

    def _front(self, query: str) -> Answer:
        """Return the page; a token in its address is moved into a cookie."""
        for word in parse_qs(query).get("token", []):
            if self._access.is_token(word):
                cookie = f"{self._access.cookie}={word}; Path=/; HttpOnly; SameSite=Strict"
                self._headers = [("Set-Cookie", cookie), ("Location", "./")]
                return HTTPStatus.SEE_OTHER, _TEXT, b""
        page = index(self._site.source, self._config.tiles, self._config.tiles_credit)
        return HTTPStatus.OK, "text/html; charset=utf-8", page

    def _watch(self, feed: Feed) -> None:
        """Serve ``/live``, if the request is admitted."""
        self.close_connection = True  # what follows on it is no request
        if (refusal := self._refusal(self.path.partition("?")[2], is_socket=True)) is not None:
            self._send(refusal.status, _TEXT, refusal.words.encode())
            return
        with feed.watch() as viewer:
            if viewer is None:
                self._send(HTTPStatus.SERVICE_UNAVAILABLE, _TEXT, _FULL.encode())
                return
            self._on_watch()
            websocket.serve(self.connection, self.path, self.headers, viewer)

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", _CSP.format(_origin(self._config.tiles)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        for name, value in self._headers:
            self.send_header(name, value)
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


class DaemonSite:
    """Serves the daemon's state."""

    source = "live"

    def __init__(self, snapshots: SnapshotSource, events: RecentEvents | None) -> None:
        self._snapshots, self._events = snapshots, events
        self._sent = -1
        """How many events there were when they were last sent."""
        self._feed = Feed(self._messages)
        self.feed: Feed | None = self._feed

    def page(self, path: str, accept: str) -> Answer | None:
        """Return a page for programs, from the newest snapshot."""
        if path == "/past":
            past = self._snapshots.read_past()
            return _stalled() if past is None else (HTTPStatus.OK, "application/json", past)
        if (page := _PAGES.get(path)) is None:
            return None
        if (snapshot := self._snapshots.read()) is None:
            return _stalled()
        with _LOCK:
            return page(snapshot, accept)

    def _messages(self, is_status_due: bool) -> dict[str, bytes | None]:
        """Return the current messages for the viewers."""
        if (live := self._snapshots.read_live()) is None:
            return {"stalled": b"%.1f" % PATIENCE}
        messages: dict[str, bytes | None] = {"live": live}
        if not is_status_due:
            return messages
        if (snapshot := self._snapshots.read()) is not None:
            with _LOCK:
                messages["status"] = to_json(snapshot, _pause)
        if (events := self._events) is None:
            return messages
        # The feed forgets them with its last viewer: the next one wants them again
        if events.count != self._sent or not self._feed.has("events"):
            self._sent = events.count
            messages["events"] = events.to_json()
        return messages


def _origin(address: str) -> str:
    """Return the origin of an address, after a space, for a list of them; empty: no address."""
    return f" {'/'.join(address.split('/')[:3])}" if address else ""


def _stalled() -> Answer:
    words = f"stalled: the loop has not answered for {PATIENCE:.0f} s\n"
    return HTTPStatus.SERVICE_UNAVAILABLE, _TEXT, words.encode()


def _healthz(snapshot: Snapshot, _: str) -> Answer:
    check = judge(snapshot)
    status = HTTPStatus.OK if check.is_healthy else HTTPStatus.SERVICE_UNAVAILABLE
    return status, _TEXT, f"{check.line}\n".encode()


def _status(snapshot: Snapshot, _: str) -> Answer:
    return HTTPStatus.OK, "application/json", to_json(snapshot, _pause)


def _metrics(snapshot: Snapshot, accept: str) -> Answer:
    encode, kind = choose_encoder(accept)
    return HTTPStatus.OK, kind, encode(registry_of(snapshot, _pause))


def _pause() -> None:
    time.sleep(PAUSE)


_PAGES: dict[str, Callable[[Snapshot, str], Answer]] = {
    "/healthz": _healthz,
    "/status": _status,
    "/metrics": _metrics,
}
