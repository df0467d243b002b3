"""A proxy on loopback that counts what a server sends, and may cut it off or do something then."""

import socket
import threading
from collections.abc import Callable
from contextlib import suppress


class Proxy:
    """Passes connections on to a port of this machine, until it is closed."""

    def __init__(self, port: int, on_sent: Callable[[int], bool]) -> None:
        """Call ``on_sent`` with the bytes that the server has sent so far; false: cut off."""
        self._to, self._on_sent, self._sent = port, on_sent, 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._to))
            for pair in ((client, server, False), (server, client, True)):
                threading.Thread(target=self._pass, args=pair, daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket, is_answer: bool) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 14):
                if is_answer:
                    self._sent += len(data)
                    if not self._on_sent(self._sent):
                        break
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
