"""A line with a will of its own between two real ports: slow, late, uneven, lossy, standing still.

It listens where a daemon connects (TCP, UDP or a pty), and connects to the autopilot by TCP or UDP.
What it takes in at one end it gives out at the other when a line of that kind would have. It takes
in without limit, as a bridge to a serial port does: the sender never sees that it is full.
"""

from __future__ import annotations

import heapq
import os
import random
import select
import socket
import threading
import time
import tty
from dataclasses import dataclass, field

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS

_STAMPED = {IDS[name] for name in ("RAW_IMU", "HIGHRES_IMU")}
_ODOMETRY = IDS["ODOMETRY"]


@dataclass
class Kind:
    """One way of a line."""

    rate: float = 1e9
    """Bytes/s."""
    delay: float = 0.0
    """s."""
    jitter: float = 0.0
    """s, evenly spread on top; of datagrams only, the bytes of a stream keep their order anyway."""
    loss: float = 0.0
    """Of datagrams."""
    stalls: tuple[tuple[float, float], ...] = ()
    """Begins and ends, s since the line was opened."""


@dataclass
class _Way:
    kind: Kind
    free: float = 0.0
    last: float = 0.0
    queue: list[tuple[float, int, bytes]] = field(default_factory=list)
    count: int = 0

    def put(self, data: bytes, now: float, begin: float, rng: random.Random) -> None:
        kind = self.kind
        if rng.random() < kind.loss:
            return
        # In pieces as small as a serial port's, so that a long one does not wait for its own end
        for k in range(0, len(data), 64) if kind.rate < 1e6 else (0,):
            piece = data[k : k + 64] if kind.rate < 1e6 else data
            self.free = max(self.free, now) + len(piece) / kind.rate
            at = self.free + kind.delay + rng.random() * kind.jitter
            for first, last in kind.stalls:
                if begin + first <= at < begin + last:
                    at = begin + last
            self.last = at = max(at, self.last)
            self.count += 1
            heapq.heappush(self.queue, (at, self.count, piece))

    def due(self, now: float) -> list[bytes]:
        out = []
        while self.queue and self.queue[0][0] <= now:
            out.append(heapq.heappop(self.queue)[2])
        return out


class SlowLine:
    """A line from a port of ours to an autopilot's TCP port."""

    def __init__(
        self, there: Kind, back: Kind | None = None, *, kind: str = "tcp", target: int = 0
    ) -> None:
        """Open the near end; ``target`` is the TCP port of 127.0.0.1 to connect the far end to."""
        self._there, self._back = _Way(there), _Way(back or Kind())
        self._near_kind, self._target = kind, target
        self._begin = time.monotonic()
        self._is_ended = False
        self.arrivals: list[tuple[float, float]] = []
        """When each ODOMETRY arrived, s since the line was opened, and how old it was then by the
        newest stamp that the autopilot had sent, s."""
        self._newest_us = 0
        self._split_there, self._split_back = Splitter(), Splitter()
        self._near: socket.socket | int | None = None
        self._server: socket.socket | None = None
        self._slave: int | None = None
        self._peer: tuple[str, int] | None = None
        if kind == "tcp":
            self._server = socket.create_server(("127.0.0.1", 0))
            self.url = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        elif kind == "udp":
            self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._near.bind(("127.0.0.1", 0))
            self.url = f"udpout:127.0.0.1:{self._near.getsockname()[1]}"
        else:
            self._near, self._slave = os.openpty()
            tty.setraw(self._slave)
            self.url = f"serial:{os.ttyname(self._slave)}:{int(there.rate * 10)}"
        self._far = socket.create_connection(("127.0.0.1", target))
        self._far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def there(self) -> Kind:
        """The way to the autopilot; it may be changed."""
        return self._there.kind

    @property
    def age(self) -> float:
        """Since it was opened, s."""
        return time.monotonic() - self._begin

    def close(self) -> None:
        """End it."""
        self._is_ended = True
        self._thread.join(5.0)
        for one in (self._server, self._near, self._far, self._slave):
            if isinstance(one, int):
                os.close(one)
            elif one is not None:
                one.close()

    def _run(self) -> None:
        rng = random.Random(5)
        while not self._is_ended:
            ends = [one for one in (self._server, self._near, self._far) if one is not None]
            readable, _, _ = select.select(ends, [], [], 0.002)
            now = time.monotonic()
            if self._server is not None and self._server in readable:
                self._near, _ = self._server.accept()
            if self._near is not None and self._near in readable and (data := self._read_near()):
                self._there.put(data, now, self._begin, rng)
            if self._far in readable and (data := self._far.recv(65536)):
                self._note_stamps(data)
                self._back.put(data, now, self._begin, rng)
            for piece in self._there.due(now):
                self._note_arrivals(piece)
                self._far.sendall(piece)
            for piece in self._back.due(now):
                self._write_near(piece)

    def _read_near(self) -> bytes:
        try:
            if isinstance(self._near, int):
                return os.read(self._near, 65536)
            if self._near_kind == "udp":
                data, self._peer = self._near.recvfrom(65536)
                return data
            data = self._near.recv(65536)
        except OSError:
            return b""
        if not data:
            self._near.close()
            self._near = None
        return data

    def _write_near(self, piece: bytes) -> None:
        try:
            if isinstance(self._near, int):
                os.write(self._near, piece)
            elif self._near_kind == "udp" and self._peer is not None:
                self._near.sendto(piece, self._peer)
            elif self._near_kind == "tcp" and self._near is not None:
                self._near.sendall(piece)
        except OSError:
            pass

    def _note_stamps(self, data: bytes) -> None:
        for frame in self._split_back.feed(data):
            if frame.message_id in _STAMPED:
                self._newest_us = int.from_bytes(frame.payload[:8], "little")

    def _note_arrivals(self, piece: bytes) -> None:
        for frame in self._split_there.feed(piece):
            if frame.message_id == _ODOMETRY:
                age = (self._newest_us - unpack(frame).time_usec) * 1e-6
                self.arrivals.append((self.age, age))
