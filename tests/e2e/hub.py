"""What a router does: whatever comes from one end goes to all the others."""

import contextlib
import selectors
import socket
import threading


class Hub:
    """Sockets on loopback, one for each end; an end is known by whoever first speaks to its port.

    An end that waits to be spoken to is given by its own port.
    """

    def __init__(self, *waiting):
        self._sockets = [self._open() for _ in range(2 + len(waiting))]
        self._peers = [None, None, *(("127.0.0.1", port) for port in waiting)]
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @staticmethod
    def _open():
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind(("127.0.0.1", 0))
        opened.setblocking(False)
        return opened

    @property
    def ports(self):
        """Of the two ends that speak first: the autopilot's and the daemon's."""
        return [end.getsockname()[1] for end in self._sockets[:2]]

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._is_over.set()
        self._thread.join(5.0)
        for end in self._sockets:
            end.close()

    def _run(self):
        with selectors.DefaultSelector() as selector:
            for index, end in enumerate(self._sockets):
                selector.register(end, selectors.EVENT_READ, index)
            while not self._is_over.is_set():
                for key, _ in selector.select(0.1):
                    self._pass_on(key.data)

    def _pass_on(self, source):
        with contextlib.suppress(OSError):
            data, self._peers[source] = self._sockets[source].recvfrom(65536)
            for index, end in enumerate(self._sockets):
                if index != source and self._peers[index] is not None:
                    with contextlib.suppress(OSError):
                        end.sendto(data, self._peers[index])
