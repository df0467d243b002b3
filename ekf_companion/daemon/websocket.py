"""A WebSocket on a connection whose request has been read: sends messages to a viewer.

The library implements the protocol (RFC 6455), and this thread moves the bytes. What the client
sends is dropped, except a close.
"""

from __future__ import annotations

import logging
import select
import socket
from email.message import Message

from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from ekf_companion.daemon.feed import Viewer

_log = logging.getLogger(__name__)
_log.setLevel(logging.WARNING)  # a viewer who comes or goes is not news

SLOW = 2.0
"""Seconds that a client may take nothing; then it is disconnected."""
BUFFER = 1 << 16
"""Bytes that wait in the kernel for a slow client: five seconds of the page."""
_WAIT = 0.5
_LARGEST = 1024
"""Bytes of a message from a client, which need not send any."""


def serve(client: socket.socket, path: str, headers: Message, viewer: Viewer) -> None:
    """Open the WebSocket that a request asks for, and send until either end closes.

    :func:`ekf_companion.daemon.access.refuse_site` has decided whether the request may.

    Raises:
        OSError: The client is gone, or too slow.
    """
    protocol = ServerProtocol(max_size=_LARGEST, logger=_log)
    head = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    protocol.receive_data(f"GET {path} HTTP/1.1\r\n{head}\r\n".encode("latin-1"))
    for request in protocol.events_received():
        if isinstance(request, Request):
            protocol.send_response(protocol.accept(request))
    client.settimeout(SLOW)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
    _flush(client, protocol)
    while protocol.state is State.OPEN:
        for message in viewer.take(_WAIT):
            protocol.send_text(message)
        if viewer.is_over:
            protocol.send_close(1001)
        _receive(client, protocol)
        _flush(client, protocol)


def _receive(client: socket.socket, protocol: ServerProtocol) -> None:
    """Read what has come, without waiting."""
    if select.select([client], [], [], 0.0)[0]:
        if data := client.recv(4096):
            protocol.receive_data(data)
        else:
            protocol.receive_eof()
        protocol.events_received()


def _flush(client: socket.socket, protocol: ServerProtocol) -> None:
    for data in protocol.data_to_send():
        if data:
            client.sendall(data)
