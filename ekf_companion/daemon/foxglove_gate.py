"""A proxy before a WebSocket server that answers everybody: it checks the origin of requests.

A browser lets any page open a WebSocket to this computer, and the server of the Foxglove SDK does
not check where a request comes from. So the public port is the proxy's, and the server listens at
an address that no page can guess.
"""

from __future__ import annotations

import contextlib
import http.client
import io
import logging
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable
from email.message import Message
from typing import NamedTuple

from ekf_companion.daemon.access import Refusal
from ekf_companion.daemon.http import listen
from ekf_companion.daemon.places import DEADLINE, Places

_log = logging.getLogger(__name__)

MOST = 8
"""Largest number of clients at once."""
LARGEST_HEAD = 1 << 14
"""Bytes of a request with its headers."""
SLOW = 5.0
"""Seconds that a client may take nothing; then it is disconnected."""
_CHUNK = 1 << 16
_POLL = 0.5
_END = b"\r\n\r\n"


class Address(NamedTuple):
    """Where a server listens."""

    host: str
    port: int


def hidden_host() -> str:
    """Return a random address of this computer, of 127.0.0.0/8, that nobody else can guess."""
    a, b, c = (1 + secrets.randbelow(254) for _ in range(3))
    return f"127.{a}.{b}.{c}"


class Gate:
    """Listens for a server, on a thread, and admits requests that ``refuse`` does not refuse."""

    def __init__(
        self, port: int, server: Address, refuse: Callable[[Message], Refusal | None]
    ) -> None:
        """Listen on a port of this computer.

        Args:
            port: Where clients connect.
            server: Where their bytes are passed on to.
            refuse: Returns why a request with these headers is refused, or None.

        Raises:
            OSError: The port is taken.
        """
        self._server, self._refuse = server, refuse
        self._listener = listen("127.0.0.1", port)
        self._places: Places[socket.socket] = Places()
        self._inside = threading.Semaphore(MOST)
        self._stop = threading.Event()
        threading.Thread(target=self._run, name="gate", daemon=True).start()

    def close(self) -> None:
        """Admit nobody any more, and disconnect all clients."""
        self._stop.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)

    def _run(self) -> None:
        with self._listener:
            while not self._stop.is_set():
                with contextlib.suppress(OSError):  # there is none, or it is gone again
                    client, address = self._listener.accept()
                    if self._places.take(client, address[0], time.monotonic()):
                        threading.Thread(target=self._answer, args=(client,), daemon=True).start()
                    else:
                        client.close()
                for late in self._places.late(time.monotonic()):
                    with contextlib.suppress(OSError):
                        late.shutdown(socket.SHUT_RDWR)

    def _answer(self, client: socket.socket) -> None:
        with client:
            try:
                client.settimeout(DEADLINE)
                head = self._read_head(client)
                if head and (refusal := self._refuse(_headers(head))) is None:
                    self._places.leave(client)
                    self._let_in(client, head)
                elif head and refusal is not None:
                    client.sendall(_answer(refusal))
            except (OSError, http.client.HTTPException) as error:
                _log.debug("live.foxglove_port: %s", error)
            finally:
                self._places.leave(client)

    def _read_head(self, client: socket.socket) -> bytes:
        """Return a request with its headers and what follows; empty: none has come."""
        head = b""
        while _END not in head:
            data = client.recv(4096)
            if not data or len(head) > LARGEST_HEAD:
                return b""
            head += data
            if b"\r\n" in head:
                self._places.extend(client)
        return head

    def _let_in(self, client: socket.socket, head: bytes) -> None:
        if not self._inside.acquire(blocking=False):
            return
        try:
            with socket.create_connection(self._server, SLOW) as server:
                server.sendall(head)
                self._pass(client, server)
        finally:
            self._inside.release()

    def _pass(self, client: socket.socket, server: socket.socket) -> None:
        client.settimeout(SLOW)
        other = {client: server, server: client}
        while not self._stop.is_set():
            for one in select.select([client, server], [], [], _POLL)[0]:
                if not (data := one.recv(_CHUNK)):
                    return
                other[one].sendall(data)


def _headers(head: bytes) -> Message:
    lines = head.partition(_END)[0].partition(b"\r\n")[2]
    return http.client.parse_headers(io.BytesIO(lines + _END))


def _answer(refusal: Refusal) -> bytes:
    body = refusal.words.encode()
    head = (
        f"HTTP/1.1 {refusal.status.value} {refusal.status.phrase}\r\n"
        "Content-Type: text/plain; charset=utf-8\r\nConnection: close\r\n"
        f"Content-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body
