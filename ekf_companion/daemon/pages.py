"""The pages: ``/healthz``, ``/status``, ``/metrics``, read by the standard library's HTTP parser.

The thread that serves imports this file, which takes a while. A page that keeps its connection, as
a WebSocket does, can take over ``connection`` in the handler.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import unquote

from prometheus_client.exposition import choose_encoder

from ekf_companion.daemon.http import PATIENCE
from ekf_companion.status.judge import judge, to_json
from ekf_companion.status.metrics import registry_of
from ekf_companion.status.snapshot import Snapshot

_log = logging.getLogger(__name__)

PAUSE = 3e-4
"""Seconds of sleep after each small piece of an answer, about 50 us of work: the loop goes first.
A shorter ``sys.setswitchinterval`` would do the loop harm: it cuts up the loop's work as well."""
_TEXT = "text/plain; charset=utf-8"
_INDEX = (
    "/healthz  is it well: 200, or 503 and why\n/status   everything, JSON\n/metrics  Prometheus\n"
)
_LOCK = threading.Lock()
"""Of many clients one at a time competes with the loop."""
Answer = tuple[HTTPStatus, str, bytes]
"""Status, content type and body."""


class Handler(BaseHTTPRequestHandler):
    """Answers the one request of a connection, from the newest snapshot."""

    server_version, sys_version = "ekf-companion", ""

    def __init__(
        self, client: socket.socket, address: Any, read: Callable[[], Snapshot | None]
    ) -> None:
        """Read the request and answer it.

        Raises:
            OSError: The client is gone, or too slow.
        """
        self._read = read
        super().__init__(client, address, None)  # type: ignore[arg-type]  # no server is asked

    def do_GET(self) -> None:
        """Send the page, for HEAD without its body."""
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
        """Log nothing: a request is not news."""

    def _page(self) -> Answer:
        path = unquote(self.path.partition("?")[0])
        if path == "/":
            return HTTPStatus.OK, _TEXT, _INDEX.encode()
        if (page := _PAGES.get(path)) is None:
            return HTTPStatus.NOT_FOUND, _TEXT, f"no such page; there are:\n{_INDEX}".encode()
        if (snapshot := self._read()) is None:
            words = f"stalled: the loop has not answered for {PATIENCE:.0f} s\n"
            return HTTPStatus.SERVICE_UNAVAILABLE, _TEXT, words.encode()
        with _LOCK:
            return page(snapshot, self.headers.get("Accept", ""))

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


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
