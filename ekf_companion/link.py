"""A link by its URL: serial, UDP or TCP, opened again for ever, all of one kind to the caller.

A link runs in the caller's task group and ends when that task is cancelled::

    link = open_link("udpin:0.0.0.0:14540")
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run())
        data, now_ns = await link.receive()

What is read is stamped at once and waits in a bounded queue; what cannot be sent now is dropped
(UDP, or no link) or waits in a bounded queue (serial and TCP). Everything dropped is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import re
import socket
import termios
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple, Protocol

import serial

from ekf_companion.errors import LinkError

_log = logging.getLogger(__name__)

DEFAULT_BAUD = 921600
RECEIVE_BUFFER = 1 << 20
"""Bytes asked of the kernel for a UDP socket: a second of stall at full rate."""
QUEUE_LENGTH = 1024
"""Reads that wait for the caller; the oldest is dropped beyond."""
PENDING_BYTES = 1 << 16
"""Bytes that wait for a slow serial or TCP link; the oldest message is dropped beyond."""
FIRST_DELAY, LAST_DELAY = 0.5, 5.0
"""Seconds before a link is opened again; doubled each time that nothing was heard."""
_READS_AT_ONCE = 64
_READ_SIZE = 65536


class Kind(str, Enum):
    """What a link is made of."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    UDP_BROADCAST = "udpbcast"
    TCP_OUT = "tcp"
    TCP_IN = "tcpin"
    SERIAL = "serial"


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Where a link leads."""

    kind: Kind
    host: str = ""
    """Bound (in) or reached (out)."""
    port: int = 0
    remote: tuple[str, int] | None = None
    """Whom to send to before anyone was heard (``udp://bind@remote``)."""
    device: str = ""
    baud: int = DEFAULT_BAUD
    warning: str = ""
    """What the URL left open, and how it was read."""

    def __str__(self) -> str:
        """Give the URL in its plain spelling."""
        if self.kind is Kind.SERIAL:
            return f"serial:{self.device}:{self.baud}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind.value}:{host}:{self.port}"


_SCHEMES = {
    "udpin": Kind.UDP_IN,
    "udp": Kind.UDP_IN,
    "udpout": Kind.UDP_OUT,
    "udpbcast": Kind.UDP_BROADCAST,
    "udp-b": Kind.UDP_BROADCAST,
    "tcp": Kind.TCP_OUT,
    "tcpout": Kind.TCP_OUT,
    "tcpin": Kind.TCP_IN,
    "tcp-l": Kind.TCP_IN,
    "serial": Kind.SERIAL,
}
_EXAMPLES = (
    "udpin:0.0.0.0:14540, udpout:192.168.1.2:14550, tcp:127.0.0.1:5760, tcpin:0.0.0.0:5760 "
    "or serial:/dev/ttyACM0:921600"
)


def parse_url(url: str) -> Address:
    """Read a link's URL in the spellings of pymavlink, MAVSDK, MAVROS and mavlink-router.

    Raises:
        LinkError: The URL names no link; the sentence says what would.
    """
    if url.startswith("/"):
        return _parse_serial(url, url)
    scheme, separator, rest = url.partition(":")
    kind = _SCHEMES.get(scheme)
    if kind is None or not separator:
        raise LinkError(f"{url}: not a link; write for example {_EXAMPLES}")
    rest = rest.removeprefix("//")
    if "?" in rest:
        raise LinkError(f"{url}: a link takes no options; leave out what follows the question mark")
    if kind is Kind.SERIAL:
        return _parse_serial(url, rest)
    if scheme == "udp" and "@" in rest:
        bind, remote = rest.split("@", 1)
        host, port = _parse_host(url, bind or ":14550", "0.0.0.0")
        target = _parse_host(url, remote, "127.0.0.1") if remote else None
        return Address(kind=kind, host=host, port=port, remote=target)
    if kind in (Kind.UDP_IN, Kind.TCP_IN):
        default = "0.0.0.0"
    else:
        default = "255.255.255.255" if kind is Kind.UDP_BROADCAST else ""
    host, port = _parse_host(url, rest, default)
    warning = ""
    if scheme == "udp":
        warning = f"{url}: read as udpin; write udpin: to listen, or udpout: to reach out"
    return Address(kind=kind, host=host, port=port, warning=warning)


def _parse_serial(url: str, rest: str) -> Address:
    match = re.fullmatch(r"(/.+?)(?:[:,](\d+))?", rest)
    if match is None:
        raise LinkError(f"{url}: a serial link needs a device, as in serial:/dev/ttyACM0:921600")
    baud = int(match[2]) if match[2] else DEFAULT_BAUD
    if not 1200 <= baud <= 12_000_000:
        raise LinkError(f"{url}: {baud} is no rate of a serial port; 921600 and 57600 are usual")
    return Address(kind=Kind.SERIAL, device=match[1], baud=baud)


def _parse_host(url: str, rest: str, default: str) -> tuple[str, int]:
    match = re.fullmatch(r"(?:\[([^\]]+)\]|([^:\[\]]*)):(\d+)", rest)
    if match is None:
        raise LinkError(f"{url}: needs a host and a port, as in {_EXAMPLES}")
    host, port = match[1] or match[2] or default, int(match[3])
    if not host:
        raise LinkError(f"{url}: needs the host to reach, as in {_EXAMPLES}")
    if not 0 < port < 65536:
        raise LinkError(f"{url}: {port} is no port; 14540 and 14550 are usual")
    return host, port


class Received(NamedTuple):
    """What one read gave."""

    data: bytes
    now_ns: int
    """When it was read, on the link's clock."""


class _Port(Protocol):
    """An open, non-blocking descriptor."""

    is_stream: bool
    """Whether what is written must all be written, in order."""

    def fileno(self) -> int: ...

    def read(self) -> bytes:
        """Give what there is; BlockingIOError: nothing, OSError: it is broken."""

    def write(self, data: bytes) -> int:
        """Write and give how much was; BlockingIOError: nothing now, OSError: it is broken."""

    def close(self) -> None: ...


class Link:
    """A link that is kept open."""

    def __init__(
        self,
        address: Address,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        on_state: Callable[[bool], None] | None = None,
    ) -> None:
        self.address = address
        self.dropped = 0
        """Reads that the caller was too slow for."""
        self.unsent = 0
        """Messages that found no link, or too slow a one."""
        self.opened = 0
        """How often the link has been opened."""
        self.failure: OSError | None = None
        """Why it is not open; None: it is, or nobody has tried yet."""
        self.bytes_in = 0
        self.bytes_out = 0
        self._clock = clock
        self._on_state = on_state
        self._queue: deque[Received] = deque()
        self._waiter: asyncio.Future[None] | None = None
        self._port: _Port | None = None
        self._broken: asyncio.Future[str] | None = None
        self._pending: deque[bytes] = deque()
        self._server: socket.socket | None = None
        self._last_complaint = ""

    @property
    def is_open(self) -> bool:
        """Whether the descriptor is open; over UDP that says nothing of the other end."""
        return self._port is not None

    async def run(self) -> None:
        """Keep the link open until cancelled."""
        delay = FIRST_DELAY
        try:
            while True:
                before = self.bytes_in
                reason = await self._run_once()
                if self.bytes_in > before:
                    delay = FIRST_DELAY
                if reason != self._last_complaint:
                    _log.warning("%s: %s; trying again until it opens", self.address, reason)
                    self._last_complaint = reason
                await asyncio.sleep(delay)
                delay = min(2.0 * delay, LAST_DELAY)
        finally:
            if self._server is not None:
                self._server.close()

    async def receive(self) -> Received:
        """Give the oldest read that waits, or wait for one."""
        while not self._queue:
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        return self._queue.popleft()

    def wake(self) -> None:
        """Make ``receive`` return even if nothing comes: an empty read, stamped now."""
        self._enter(b"")

    def send(self, data: bytes) -> None:
        """Send a message now, or as soon as a stream has room; never waits."""
        if self._port is None:
            self.unsent += 1
        elif self._pending:
            self._enqueue(data)
        else:
            self._write(self._port, data)

    async def _run_once(self) -> str:
        """Open, pump and close; give the reason why it is over."""
        try:
            port = await self._open()
        except asyncio.TimeoutError:
            self.failure = OSError(errno.ETIMEDOUT, "no answer")
            return "no answer"
        except OSError as error:
            self.failure = error
            return _sentence(error)
        self.failure = None
        loop = asyncio.get_running_loop()
        descriptor = port.fileno()
        self._broken = loop.create_future()
        self._port = port
        self.opened += 1
        _log.info("%s: open", self.address)
        self._last_complaint = ""
        loop.add_reader(descriptor, self._readable, port)
        if self._server is not None:
            # The newest client is the one that is alive
            loop.add_reader(self._server, self._break, "another client came")
        self._say(is_open=True)
        try:
            return await self._broken
        finally:
            if self._server is not None:
                loop.remove_reader(self._server)
            loop.remove_reader(descriptor)
            loop.remove_writer(descriptor)
            port.close()
            self._port = None
            self.unsent += len(self._pending)
            self._pending.clear()
            self._say(is_open=False)

    def _say(self, *, is_open: bool) -> None:
        if self._on_state is not None:
            self._on_state(is_open)

    def _break(self, reason: str) -> None:
        if self._broken is not None and not self._broken.done():
            self._broken.set_result(reason)

    def _readable(self, port: _Port) -> None:
        try:
            for _ in range(_READS_AT_ONCE):
                self._take(port.read())
        except BlockingIOError:
            pass
        except OSError as error:
            self._break(_sentence(error))

    def _take(self, data: bytes) -> None:
        if not data:
            return
        self.bytes_in += len(data)
        self._enter(data)

    def _enter(self, data: bytes) -> None:
        if len(self._queue) == QUEUE_LENGTH:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(Received(data, self._clock()))
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def _write(self, port: _Port, data: bytes) -> None:
        try:
            written = port.write(data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            self.unsent += 1
            self._break(_sentence(error))
            return
        self.bytes_out += written
        if written == len(data):
            return
        if not port.is_stream:
            self.unsent += 1
            return
        # The rest of a message that has begun must follow, whatever else is dropped
        self._pending.appendleft(data[written:])
        asyncio.get_running_loop().add_writer(port.fileno(), self._writable, port)

    def _enqueue(self, data: bytes) -> None:
        self._pending.append(data)
        while sum(map(len, self._pending)) > PENDING_BYTES and len(self._pending) > 1:
            del self._pending[1]
            self.unsent += 1

    def _writable(self, port: _Port) -> None:
        asyncio.get_running_loop().remove_writer(port.fileno())
        while self._pending:
            data = self._pending.popleft()
            waiting = len(self._pending)
            self._write(port, data)
            if len(self._pending) > waiting or (self._broken and self._broken.done()):
                return

    async def _open(self) -> _Port:
        address = self.address
        if address.kind is Kind.SERIAL:
            return _SerialPort(address.device, address.baud)
        if address.kind in (Kind.UDP_IN, Kind.UDP_OUT, Kind.UDP_BROADCAST):
            return await _open_udp(address)
        loop = asyncio.get_running_loop()
        if address.kind is Kind.TCP_OUT:
            family, where = await _resolve(address.host, address.port, socket.SOCK_STREAM)
            stream = socket.socket(family, socket.SOCK_STREAM)
            stream.setblocking(False)
            try:
                await asyncio.wait_for(loop.sock_connect(stream, where), LAST_DELAY)
            except (OSError, asyncio.TimeoutError, asyncio.CancelledError):
                stream.close()
                raise
            return _TcpPort(stream)
        if self._server is None:
            family, where = await _resolve(address.host, address.port, socket.SOCK_STREAM)
            self._server = _listen(family, where)
        stream, _ = await loop.sock_accept(self._server)
        return _TcpPort(stream)


def open_link(
    url: str,
    *,
    clock: Callable[[], int] = time.monotonic_ns,
    on_state: Callable[[bool], None] | None = None,
) -> Link:
    """Give the link that a URL names; it opens when ``run`` is awaited.

    Args:
        url: See ``parse_url``.
        clock: What time it is, ns, for the stamps of ``receive``.
        on_state: Called with True when the link has opened and with False when it is closed.

    Raises:
        LinkError: The URL names no link.
    """
    address = parse_url(url)
    if address.warning:
        _log.warning("%s", address.warning)
    return Link(address, clock=clock, on_state=on_state)


class _SerialPort:
    """A tty, 8N1, ours alone."""

    is_stream = True

    def __init__(self, device: str, baud: int) -> None:
        self._tty = serial.Serial(device, baud, timeout=0, exclusive=True)
        self._descriptor: int = self._tty.fileno()
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            # An FTDI chip else holds bytes back for 16 ms; not every tty has the flag
            self._tty.set_low_latency_mode(True)
        try:
            # With VMIN 0, as pyserial leaves it, a read of nothing looks like the end
            attributes = termios.tcgetattr(self._descriptor)
            attributes[6][termios.VMIN] = 1
            termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
            termios.tcflush(self._descriptor, termios.TCIOFLUSH)
        except termios.error as error:
            self._tty.close()
            raise OSError(*error.args) from None

    def fileno(self) -> int:
        return self._descriptor

    def read(self) -> bytes:
        data = os.read(self._descriptor, _READ_SIZE)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        return data

    def write(self, data: bytes) -> int:
        return os.write(self._descriptor, data)

    def close(self) -> None:
        with contextlib.suppress(OSError, termios.error):
            # What waits for a device that is gone would hold up the closing
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        self._tty.close()


class _TcpPort:
    """A connected stream."""

    is_stream = True

    def __init__(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._stream = stream

    def fileno(self) -> int:
        return self._stream.fileno()

    def read(self) -> bytes:
        data = self._stream.recv(_READ_SIZE)
        if not data:
            raise OSError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        return self._stream.send(data)

    def close(self) -> None:
        self._stream.close()


class _UdpPort:
    """Datagrams to whoever spoke last, or, connected, to one place."""

    is_stream = False

    def __init__(self, datagrams: socket.socket, remote: tuple[str, int] | None) -> None:
        self._datagrams = datagrams
        self._is_connected = False
        self._remote: tuple[str, int] | None = remote

    def connect(self, where: tuple[str, int]) -> None:
        self._datagrams.connect(where)
        self._is_connected = True

    def fileno(self) -> int:
        return self._datagrams.fileno()

    def read(self) -> bytes:
        try:
            data, sender = self._datagrams.recvfrom(_READ_SIZE)
        except ConnectionRefusedError:
            # The other end has not started yet
            return b""
        self._remote = sender
        return data

    def write(self, data: bytes) -> int:
        # Nobody listens, or no way there for now: lost like any datagram, and no reason to reopen
        with contextlib.suppress(OSError):
            if self._is_connected:
                return self._datagrams.send(data)
            if self._remote is not None:
                return self._datagrams.sendto(data, self._remote)
        return 0

    def close(self) -> None:
        self._datagrams.close()


async def _open_udp(address: Address) -> _UdpPort:
    family, where = await _resolve(address.host, address.port, socket.SOCK_DGRAM)
    remote = where if address.kind is Kind.UDP_BROADCAST else None
    if address.remote is not None:
        _, remote = await _resolve(*address.remote, socket.SOCK_DGRAM)
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    port = _UdpPort(datagrams, remote)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if address.kind is Kind.UDP_BROADCAST:
            datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        elif address.kind is Kind.UDP_OUT:
            port.connect(where)
        else:
            datagrams.bind(where)
    except OSError:
        datagrams.close()
        raise
    return port


def _listen(family: int, where: tuple[str, int]) -> socket.socket:
    server = socket.socket(family, socket.SOCK_STREAM)
    try:
        server.setblocking(False)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(where)
        server.listen(1)
    except OSError:
        server.close()
        raise
    return server


async def _resolve(host: str, port: int, kind: int) -> tuple[int, tuple[str, int]]:
    """Look a name up in a thread that nobody waits for at the end: it may hang for half a minute.

    Raises:
        OSError: There is no such name.
    """
    loop = asyncio.get_running_loop()
    found: asyncio.Future[list[Any]] = loop.create_future()

    def settle(answer: list[Any] | OSError) -> None:
        if found.done():
            return
        if isinstance(answer, OSError):
            found.set_exception(answer)
        else:
            found.set_result(answer)

    def look_up() -> None:
        answer: list[Any] | OSError
        try:
            answer = socket.getaddrinfo(host, port, type=socket.SocketKind(kind))
        except OSError as error:
            answer = error
        except UnicodeError:
            answer = OSError(errno.EINVAL, f"{host} is no name of a host")
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, answer)

    threading.Thread(target=look_up, name="resolver", daemon=True).start()
    family, _, _, _, where = (await found)[0]
    return family, (str(where[0]), int(where[1]))


def _sentence(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
