"""A slow or bad line between the autopilot and the daemon.

``Throttle`` runs this module as a process of its own, so that the pilot's work does not disturb it.
What the autopilot's simulator sends goes out by TCP, UDP or a pseudo terminal, and what comes back
goes in, each way at the rate of the line, after its delay, with its losses and stalls. On the
daemon's side of a line of a rate a serial server holds ``QUEUE`` bytes; whoever sends more has to
wait. On the autopilot's side its port holds ``PORT`` bytes, and a message that finds no room there
is not sent, as in ``GCS_MAVLINK::txspace``: the simulator's own ports take all that is written.
"""

from __future__ import annotations

import argparse
import os
import random
import selectors
import socket
import subprocess
import sys
import time
import tty
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType

from benchmarks.sitl.process import end
from ekf_companion.errors import CompanionError

QUEUE = 65536
"""Bytes that wait for a line at most on the daemon's side."""
PORT = 2048
"""Bytes that wait for a line of a rate at most on the autopilot's side."""
_PATIENCE = 20.0
"""s for the simulator to listen."""
_HEAD, _TAIL, _SIGNATURE = 10, 2, 13
"""Bytes of a MAVLink 2 frame beside its payload."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """Properties of a line."""

    kind: str = "udp"
    """``tcp``, ``udp`` or ``pty``: what the daemon sees."""
    baud: int = 0
    """Bits a second, ten to a byte; 0: no limit."""
    delay: float = 0.0
    """One way, s."""
    jitter: float = 0.0
    """Added to the delay, evenly from 0 to this, s; order is kept."""
    loss: float = 0.0
    """Share of the frames that are lost, each way."""
    stall: float = 0.0
    """s for which nothing goes through, every five seconds."""


class Throttle:
    """The process of one line."""

    def __init__(self, simulator: str, line: Line, folder: Path) -> None:
        """Prepare it.

        Args:
            simulator: Where the daemon would find the simulator: ``tcp:HOST:PORT`` or
                ``udpin:HOST:PORT``.
            line: What it does.
            folder: For its words.
        """
        self._simulator, self._line, self._folder = simulator, line, folder
        self._process: subprocess.Popen[str] | None = None
        self.link = ""
        """The daemon's end, once it has started."""

    def __enter__(self) -> Throttle:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        end(self._process)
        if self._process is not None and self._process.stdout is not None:
            self._process.stdout.close()

    def start(self) -> None:
        """Start it, and learn the daemon's end."""
        words = [f"--{name}={value}" for name, value in asdict(self._line).items()]
        command = [sys.executable, "-m", "benchmarks.sitl.throttle", self._simulator, *words]
        with (self._folder / "throttle.log").open("wb") as log:
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, stdin=subprocess.DEVNULL, text=True
            )
        assert self._process.stdout is not None
        self.link = self._process.stdout.readline().strip()
        if not self.link:
            raise CompanionError("the line did not start; see throttle.log")


class Way:
    """One direction: frames that wait for their time, then bytes that wait for the line."""

    def __init__(
        self, line: Line, chance: random.Random, *, is_datagram: bool, is_port: bool = False
    ) -> None:
        """Prepare it.

        Args:
            line: What it does.
            chance: For jitter and losses.
            is_datagram: Frames go out one by one and may be lost; else bytes, as they come.
            is_port: Frames that find no room are dropped, if the line has a rate.
        """
        self._line, self._chance, self._is_datagram = line, chance, is_datagram
        self._drops = is_port and line.baud > 0
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._rest = b""
        self._free = 0.0
        self._size = 0

    @property
    def is_full(self) -> bool:
        """Whether it takes no more: its sender has to wait."""
        return self._size >= QUEUE

    def put(self, data: bytes, now: float) -> None:
        """Take bytes at a time, s."""
        pieces = [data] if data else []
        if self._is_datagram or self._drops:
            pieces, self._rest = frames(self._rest + data)
        for piece in pieces:
            if self._drops and self._size + len(piece) > PORT:
                continue
            if self._line.loss and self._chance.random() < self._line.loss:
                continue
            due = now + self._line.delay + self._chance.uniform(0.0, self._line.jitter)
            last = self._waiting[-1][0] if self._waiting else 0.0
            self._waiting.append((max(due, last), piece))
            self._size += len(piece)

    def take(self, now: float) -> list[bytes]:
        """Return what has come through at a time, s."""
        if self._line.stall and now % 5.0 < self._line.stall:
            return []
        out = []
        while self._waiting and self._waiting[0][0] <= now and self._free <= now:
            due, piece = self._waiting.popleft()
            if self._line.baud and not self._is_datagram and len(piece) > 64:
                self._waiting.appendleft((due, piece[64:]))  # A line knows no messages
                piece = piece[:64]
            self._size -= len(piece)
            if self._line.baud:
                # An idle line saves no time, a busy one loses none between two looks
                self._free = max(self._free, now - 0.01) + 10.0 * len(piece) / self._line.baud
            out.append(piece)
        return out


def frames(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the MAVLink frames of a stream, and the rest that is not whole yet."""
    found, at = [], 0
    while at < len(data):
        if data[at] == 0xFD and at + 3 <= len(data):
            size = _HEAD + data[at + 1] + _TAIL + (_SIGNATURE if data[at + 2] & 1 else 0)
        elif data[at] == 0xFE and at + 2 <= len(data):
            size = 6 + data[at + 1] + _TAIL
        elif data[at] in (0xFD, 0xFE):
            break
        else:
            at += 1
            continue
        if at + size > len(data):
            break
        found.append(data[at : at + size])
        at += size
    return found, data[at:]


class _End:
    """One end of the line: a file descriptor that bytes are read from and written to."""

    def __init__(self, file: socket.socket | int, peer: tuple[str, int] | None = None) -> None:
        self._file, self._peer = file, peer
        self._late = b""
        self.is_datagram = isinstance(file, socket.socket) and file.type == socket.SOCK_DGRAM

    @property
    def number(self) -> int:
        """The file descriptor."""
        return self._file if isinstance(self._file, int) else self._file.fileno()

    def read(self) -> bytes:
        """Return what is there; raise ``EOFError`` at the end."""
        try:
            if isinstance(self._file, int):
                return os.read(self._file, 4096)
            if self.is_datagram:
                data, self._peer = self._file.recvfrom(4096)
                return data
            data = self._file.recv(4096)
        except (BlockingIOError, ConnectionRefusedError):
            return b""
        except OSError:
            # The other end of a pseudo terminal is not open yet
            return b""
        if not data:
            raise EOFError
        return data

    def write(self, data: bytes) -> None:
        """Write, or keep what does not go out at once."""
        self._late += data
        try:
            if isinstance(self._file, int):
                self._late = self._late[os.write(self._file, self._late) :]
            elif self.is_datagram:
                if self._peer is not None:
                    self._file.sendto(self._late, self._peer)
                self._late = b""
            else:
                self._late = self._late[self._file.send(self._late) :]
        except (BlockingIOError, ConnectionRefusedError):
            self._late = self._late[-QUEUE:]


def _upstream(link: str) -> _End:
    """Open the simulator's end."""
    kind, host, port = link.split(":")
    if kind == "udpin":
        bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        bound.bind((host, int(port)))
        bound.setblocking(False)
        return _End(bound)
    begin = time.monotonic()
    while True:
        try:
            joined = socket.create_connection((host, int(port)))
        except OSError:
            if time.monotonic() - begin > _PATIENCE:
                raise
            time.sleep(0.2)
            continue
        joined.setblocking(False)
        joined.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return _End(joined)


def _downstream(line: Line) -> _End:
    """Open the daemon's end and print its link."""
    if line.kind == "pty":
        mine, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(mine, False)
        print(f"serial:{os.ttyname(theirs)}:{line.baud or 921600}", flush=True)
        return _End(mine)
    if line.kind == "udp":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        file = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        file.bind(("127.0.0.1", 0))
        file.setblocking(False)
        print(f"udpin:127.0.0.1:{port}", flush=True)
        return _End(file, ("127.0.0.1", port))
    server = socket.create_server(("127.0.0.1", 0))
    print(f"tcp:127.0.0.1:{server.getsockname()[1]}", flush=True)
    file, _ = server.accept()
    file.setblocking(False)
    # A serial server has little room of its own
    file.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    return _End(file)


def _run(simulator: str, line: Line) -> None:
    """Carry bytes both ways until one end closes."""
    below = _downstream(line)
    above = _upstream(simulator)
    chance = random.Random(1)
    down = Way(line, chance, is_datagram=below.is_datagram, is_port=True)
    up = Way(line, chance, is_datagram=below.is_datagram)
    chooser = selectors.DefaultSelector()
    ways = ((above, down, below), (below, up, above))
    while True:
        for source, way, _ in ways:
            is_watched = source.number in {key.fd for key in chooser.get_map().values()}
            if way.is_full and is_watched:
                chooser.unregister(source.number)
            elif not way.is_full and not is_watched:
                chooser.register(source.number, selectors.EVENT_READ, (source, way))
        for key, _ in chooser.select(0.002):
            source, way = key.data
            data = source.read()
            if data:
                way.put(data, time.monotonic())
            else:
                time.sleep(0.001)  # A pseudo terminal whose other end is closed is always ready
        now = time.monotonic()
        for _, way, sink in ways:
            for piece in way.take(now):
                sink.write(piece)


def main() -> None:
    """Run one line: ``python -m benchmarks.sitl.throttle tcp:127.0.0.1:5762 --kind=pty``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("simulator")
    for name, value in asdict(Line()).items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    arguments = vars(parser.parse_args())
    simulator = arguments.pop("simulator")
    try:
        _run(simulator, Line(**arguments))
    except (EOFError, KeyboardInterrupt, ConnectionError):
        return


if __name__ == "__main__":
    main()
