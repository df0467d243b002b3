"""Open descriptors: a tty, a stream, a socket of datagrams, all non-blocking and all alike."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
import struct
import termios
import threading
from typing import Any, Protocol

import serial

from ekf_companion.link.address import Address, Kind
from ekf_companion.link.peers import Peers, Sender

RECEIVE_BUFFER = 1 << 20
"""Bytes asked of the kernel for a UDP socket: a second of stall at full rate."""
UNANSWERED_MS = 3000
"""Bytes of ours that a TCP peer has not confirmed for so long: the network has lost it. Without
this the kernel would go on trying, ever more seldom, for a quarter of an hour."""
BITS = 10
"""On the wire for each byte: 8N1."""
QUEUED = 0.05
"""Seconds of sending that the system may hold for a tty: what waits there cannot be taken back,
and without a bound that is 4 KiB, 0.7 s at 57600 baud."""
UNSENT = 4096
"""Bytes that the system may hold for a TCP peer before they are sent."""
_READ_SIZE = 65536


class Port(Protocol):
    """An open, non-blocking descriptor."""

    is_stream: bool
    """Whether what is written must all be written, in order."""
    sender: Sender | None
    """Who sent what was read last; None: there is but one other end."""

    def fileno(self) -> int:
        """Give the descriptor, to wait on."""

    def read(self) -> bytes:
        """Give what there is; BlockingIOError: nothing, OSError: it is broken."""

    def write(self, data: bytes) -> int:
        """Write and give how much was; BlockingIOError: nothing now, OSError: it is broken."""

    def wait(self) -> float:
        """Give the seconds until there is room, once there was none; 0: the descriptor tells."""

    def close(self) -> None:
        """Give the descriptor back."""


class SerialPort:
    """A tty, 8N1, ours alone."""

    is_stream = True
    sender: Sender | None = None

    def __init__(self, device: str, baud: int) -> None:
        self._tty = serial.Serial(device, baud, timeout=0, exclusive=True)
        self._descriptor: int = self._tty.fileno()
        self._rate = baud / BITS
        self._most = max(QUEUED * self._rate, 64.0)
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
        """Give the descriptor, to wait on."""
        return self._descriptor

    def read(self) -> bytes:
        """Give what there is."""
        data = os.read(self._descriptor, _READ_SIZE)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        return data

    def write(self, data: bytes) -> int:
        """Write as much as there is room for, while little waits to leave."""
        if self._queued() >= self._most:
            raise BlockingIOError(errno.EAGAIN, "the line is slow")
        return os.write(self._descriptor, data)

    def wait(self) -> float:
        """Give how long half of what may wait takes to leave, s; 0: less waits."""
        queued = self._queued()
        return 0.0 if queued < self._most else (queued - self._most / 2) / self._rate

    def _queued(self) -> int:
        """Give the bytes that the system holds; 0 too where the driver does not say."""
        try:
            answer = fcntl.ioctl(self._descriptor, termios.TIOCOUTQ, bytes(4))
        except OSError:
            return 0
        return int(struct.unpack("=i", answer)[0])

    def close(self) -> None:
        """Give the descriptor back."""
        with contextlib.suppress(OSError, termios.error):
            # What waits for a device that is gone would hold up the closing
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        self._tty.close()


class TcpPort:
    """A connected stream."""

    is_stream = True
    sender: Sender | None = None

    def __init__(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)
        self._stream = stream

    def fileno(self) -> int:
        """Give the descriptor, to wait on."""
        return self._stream.fileno()

    def read(self) -> bytes:
        """Give what there is."""
        data = self._stream.recv(_READ_SIZE)
        if not data:
            raise OSError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        """Write as much as there is room for."""
        return self._stream.send(data)

    def wait(self) -> float:
        """Leave it to the descriptor."""
        return 0.0

    def close(self) -> None:
        """Give the descriptor back."""
        self._stream.close()


class UdpPort:
    """Datagrams to whom the peers name or, connected, to one place."""

    is_stream = False

    def __init__(self, datagrams: socket.socket, peers: Peers) -> None:
        self.sender: Sender | None = None
        self._datagrams = datagrams
        self._peers = peers
        self._is_connected = False

    def connect(self, where: Sender) -> None:
        """Hear this place alone, and send there."""
        self._datagrams.connect(where)
        self._is_connected = True

    def fileno(self) -> int:
        """Give the descriptor, to wait on."""
        return self._datagrams.fileno()

    def read(self) -> bytes:
        """Give the next datagram, and who sent it in ``sender``."""
        try:
            if self._is_connected:
                return self._datagrams.recv(_READ_SIZE)
            data, self.sender = self._datagrams.recvfrom(_READ_SIZE)
        except ConnectionRefusedError:
            # The other end has not started yet
            return b""
        return data

    def write(self, data: bytes) -> int:
        """Send one; give 0 where there is nobody to send to.

        A connected socket keeps the address of ours that it was opened with: that there is no way
        from it is raised, since only another socket may find one.
        """
        if self._is_connected:
            with contextlib.suppress(ConnectionRefusedError):  # nobody listens there yet
                return self._datagrams.send(data)
            return 0
        # No way there for now: lost like any datagram, and no reason to reopen
        with contextlib.suppress(OSError):
            if (target := self._peers.target) is not None:
                return self._datagrams.sendto(data, target)
        return 0

    def wait(self) -> float:
        """Never: a datagram does not wait."""
        return 0.0

    def close(self) -> None:
        """Give the descriptor back."""
        self._datagrams.close()


async def open_udp(address: Address, peers: Peers) -> UdpPort:
    """Open a socket of datagrams; tell the peers who is meant by the address.

    Raises:
        OSError: A name is none, or the port is taken.
    """
    family, (where, *_) = await resolve(address.host, address.port, socket.SOCK_DGRAM)
    if address.peer is not None:
        _, allowed = await resolve(*address.peer, socket.SOCK_DGRAM, family)
        peers.allow({host for host, *_ in allowed}, address.peer[1])
    if address.remote is not None:
        _, (remote, *_) = await resolve(*address.remote, socket.SOCK_DGRAM, family)
        peers.aim(remote)
    elif address.kind is Kind.UDP_BROADCAST:
        peers.aim(where)
    elif address.peer is not None and address.peer[1]:
        peers.aim(allowed[0])
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    port = UdpPort(datagrams, peers)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if address.kind is Kind.UDP_BROADCAST:
            datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if address.kind is Kind.UDP_OUT or address.is_deaf:
            port.connect(where)
        else:
            datagrams.bind(where)
    except OSError:
        datagrams.close()
        raise
    return port


async def open_tcp(address: Address, patience: float) -> TcpPort:
    """Connect a stream.

    Raises:
        OSError: The name is none, or nobody listens there.
        asyncio.TimeoutError: No answer within ``patience``, s.
    """
    family, (where, *_) = await resolve(address.host, address.port, socket.SOCK_STREAM)
    stream = socket.socket(family, socket.SOCK_STREAM)
    stream.setblocking(False)
    try:
        loop = asyncio.get_running_loop()
        await asyncio.wait_for(loop.sock_connect(stream, where), patience)
        return TcpPort(stream)
    except (OSError, asyncio.TimeoutError, asyncio.CancelledError):
        stream.close()
        raise


async def open_server(address: Address) -> socket.socket:
    """Listen for a client.

    Raises:
        OSError: The name is none, or the port is taken.
    """
    family, (where, *_) = await resolve(address.host, address.port, socket.SOCK_STREAM)
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


async def resolve(
    host: str, port: int, kind: int, family: int = socket.AF_UNSPEC
) -> tuple[int, list[Sender]]:
    """Look a name up in a thread that nobody waits for at the end: it may hang for half a minute.

    Returns:
        The family of the first address, and all addresses.

    Raises:
        OSError: There is no such name.
    """
    loop = asyncio.get_running_loop()
    found: asyncio.Future[list[Any]] = loop.create_future()
    # A socket that hears both families says IPv4 senders in the words of IPv6
    flags = socket.AI_V4MAPPED if family == socket.AF_INET6 else 0

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
            answer = socket.getaddrinfo(
                host, port, family, type=socket.SocketKind(kind), flags=flags
            )
        except OSError as error:
            answer = error
        except UnicodeError:
            answer = OSError(errno.EINVAL, f"{host} is no name of a host")
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, answer)

    threading.Thread(target=look_up, name="resolver", daemon=True).start()
    entries = await found
    return entries[0][0], [entry[4] for entry in entries]
