"""A simulated Livox Mid-360 on the network: it takes its configuration and sends in real time."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import threading
import time
from binascii import crc_hqx
from collections.abc import Callable, Iterator
from zlib import crc32

from sim_autopilot.lidar.livox import IMU_PORT, POINT_PORT, LivoxFaults, datagrams
from sim_autopilot.lidar.record import Simulated

_CONFIGURE = 0x0100
_HOSTS = {0x0006: POINT_PORT, 0x0007: IMU_PORT}
"""Parameters that say where data go."""
_WORK_MODE, _SAMPLING = 0x001A, 1
_KNOWN = (0x0000, 0x0005, *_HOSTS, _WORK_MODE, 0x001C)
_DONE, _UNKNOWN_PARAMETER = 0x00, 0x20
_PAUSE = 0.002
"""Between two looks at the clock, s."""


class Device:
    """A lidar that sends once it is told to, from the address that it is given.

    A context manager: a thread of its own until the end. What passes before it is told is gone.
    """

    def __init__(
        self,
        flown: Simulated,
        host: str,
        *,
        begin_ns: int = 20_000_000_000,
        faults: LivoxFaults | None = None,
        port: int = 0,
        is_held: bool = False,
        limit: Callable[[], float] = lambda: math.inf,
    ) -> None:
        """Make ready.

        Args:
            flown: What it measures.
            host: Its own address, such as 127.0.0.2.
            begin_ns: Its clock at the begin of what it measures.
            faults: What becomes of its datagrams.
            port: Of its commands; 0: a free one.
            is_held: Whether what it measures begins with ``begin`` only; else once it is told to
                send.
            limit: Returns up to when its clock may run for now, s since its begin: it stops there,
                so that a busy machine loses nothing of it. A real one never does.

        Raises:
            OSError: The address is none of this computer's.
        """
        self.sent = 0
        self.refused: list[int] = []
        """Parameters that it does not know."""
        self.is_done = threading.Event()
        self._rows = list(datagrams(flown, begin_ns, faults))
        self._begin_ns, self._is_held, self._limit = begin_ns, is_held, limit
        self._start: float | None = None
        self._targets: dict[int, tuple[str, int]] = {}
        self._is_sampling = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.setblocking(False)
        self.command_port = int(self._socket.getsockname()[1])
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lidar", daemon=True)

    def __enter__(self) -> Device:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()
        self._socket.close()

    def begin(self, ago: float = 0.0) -> None:
        """Begin what it measures, or have begun it some time ago, s."""
        self._start = time.monotonic() - ago

    def _run(self) -> None:
        rows = iter(self._rows)
        row = next(rows, None)
        while not self._end.is_set():
            self._answer()
            is_told = self._is_sampling and len(self._targets) == len(_HOSTS)
            if is_told and self._start is None and not self._is_held:
                self.begin()
            if self._start is not None:
                since = time.monotonic() - self._start
                over = max(since - self._limit(), 0.0)
                self._start += over
                now_ns = self._begin_ns + (since - over) * 1e9
                while row is not None and row[0] <= now_ns:
                    if is_told:
                        with contextlib.suppress(OSError):  # nobody listens there yet
                            self._socket.sendto(row[2], self._targets[row[1]])
                        self.sent += 1
                    row = next(rows, None)
                if row is None:
                    self.is_done.set()
            time.sleep(_PAUSE)

    def _answer(self) -> None:
        """Take commands, and answer each."""
        with contextlib.suppress(OSError):
            while True:
                data, sender = self._socket.recvfrom(2048)
                if (answer := self.command(data)) is not None:
                    self._socket.sendto(answer, sender)

    def command(self, data: bytes) -> bytes | None:
        """Take a command and return the answer; None: it is damaged, or none that it knows."""
        if len(data) < 24 or crc_hqx(data[:18], 0xFFFF) != int.from_bytes(data[18:20], "little"):
            return None
        body = data[24:]
        length, number, command = struct.unpack_from("<HIH", data, 2)
        if length != len(data) or crc32(body) != int.from_bytes(data[20:24], "little"):
            return None
        if command != _CONFIGURE:
            return None
        wrong = 0
        for key, value in _pairs(body):
            if key in _HOSTS:
                port = int.from_bytes(value[4:6], "little")
                self._targets[_HOSTS[key]] = (".".join(map(str, value[:4])), port)
            elif key == _WORK_MODE:
                self._is_sampling = value[0] == _SAMPLING
            elif key not in _KNOWN:
                wrong = key
                self.refused.append(key)
        told = struct.pack("<BH", _UNKNOWN_PARAMETER if wrong else _DONE, wrong)
        head = struct.pack("<BBHIHBB6x", 0xAA, 0, 24 + len(told), number, command, 1, 1)
        sums = struct.pack("<HI", crc_hqx(head, 0xFFFF), crc32(told))
        return head + sums + told


def _pairs(body: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the parameters of a configuration."""
    (count,) = struct.unpack_from("<H", body)
    at = 4
    for _ in range(count):
        key, length = struct.unpack_from("<HH", body, at)
        yield key, body[at + 4 : at + 4 + length]
        at += 4 + length
