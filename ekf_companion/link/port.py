"""Open descriptors with one interface: a tty, a stream, a datagram socket, all non-blocking."""

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
from abc import ABC, abstractmethod
from concurrent.futures import Future
from typing import Any

import serial

from ekf_companion.link.address import Address, Kind
from ekf_companion.link.peers import Peers, Sender

RECEIVE_BUFFER = 1 << 20
"""Bytes asked of the kernel for a UDP socket: a second of stall at full rate."""
UNANSWERED_MS = 3000
"""Longest time for which a TCP peer may not confirm our bytes, before it counts as lost. Without
this limit the kernel tries again, less and less often, for a quarter of an hour."""
BITS = 10
"""Bits on the wire for each byte: 8N1."""
QUEUED = 0.05
"""Seconds of sending that the system may buffer for a tty: it cannot be withdrawn, and without a
limit that is 4 KiB, 0.7 s at 57600 baud."""
UNSENT = 4096
"""Bytes that the system may buffer for a TCP peer before they are sent."""
_READ_SIZE = 65536


class Port(ABC):
    """An open, non-blocking descriptor."""

    is_stream = True
    """Whether the rest of a partly written message must be written too."""

    def __init__(self, resource: serial.Serial | socket.socket) -> None:
        self._resource = resource
        self.sender: Sender | None = None
        """Sender of what was read last; None if there is only one other end."""

    def fileno(self) -> int:
        """Return the descriptor, to wait on."""
        return int(self._resource.fileno())

    @abstractmethod
    def read(self) -> bytes:
        """Return what there is; BlockingIOError: nothing, OSError: it is broken."""

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Write; return how many bytes. BlockingIOError: none now, OSError: it is broken."""

    def wait(self) -> float:
        """Return the seconds until there is room again; 0: the descriptor becomes writable."""
        return 0.0

    def close(self) -> None:
        """Close the descriptor."""
        self._resource.close()


class SerialPort(Port):
    """A tty, 8N1, opened exclusively."""

    def __init__(self, device: str, baud: int) -> None:
        tty = serial.Serial(device, baud, timeout=0, exclusive=True)
        super().__init__(tty)
        self._descriptor: int = tty.fileno()
        self._rate = baud / BITS
        self._most = max(QUEUED * self._rate, 64.0)
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            # An FTDI chip otherwise delays bytes by 16 ms; not every tty has the flag
            tty.set_low_latency_mode(True)
        try:
            # With VMIN 0, which pyserial sets, a read of nothing looks like the end
            attributes = termios.tcgetattr(self._descriptor)
            attributes[6][termios.VMIN] = 1
            termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
            termios.tcflush(self._descriptor, termios.TCIOFLUSH)
        except termios.error as error:
            tty.close()
            raise OSError(*error.args) from None

    def read(self) -> bytes:
        """Return what there is; no bytes are the end."""
        data = os.read(self._descriptor, _READ_SIZE)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        return data

    def write(self, data: bytes) -> int:
        """Write as much as there is room for, while little is buffered."""
        if self._queued() >= self._most:
            raise BlockingIOError(errno.EAGAIN, "the line is slow")
        return os.write(self._descriptor, data)

    def wait(self) -> float:
        """Return the time until half of the buffer is sent, s; 0 if less is buffered."""
        queued = self._queued()
        return 0.0 if queued < self._most else (queued - self._most / 2) / self._rate

    def _queued(self) -> int:
        """Return the bytes that the system has buffered; 0 too if the driver does not report it."""
        try:
            answer = fcntl.ioctl(self._descriptor, termios.TIOCOUTQ, bytes(4))
        except OSError:
            return 0
        return int(struct.unpack("=i", answer)[0])

    def close(self) -> None:
        """Discard what is buffered, which would delay the closing of a lost device, and close."""
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        super().close()


class TcpPort(Port):
    """A connected stream."""

    def __init__(self, stream: socket.socket) -> None:
        super().__init__(stream)
        self._stream = stream
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)

    def read(self) -> bytes:
        """Return what there is; no bytes are the end."""
        data = self._stream.recv(_READ_SIZE)
        if not data:
            raise OSError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        """Write as much as there is room for."""
        return self._stream.send(data)


class UdpPort(Port):
    """Datagrams, to the target that the peers name or, if connected, to one address."""

    is_stream = False

    def __init__(self, datagrams: socket.socket, peers: Peers) -> None:
        super().__init__(datagrams)
        self._datagrams = datagrams
        self._peers = peers
        self._is_connected = False

    def connect(self, address: Sender) -> None:
        """Accept this address only, and send there."""
        self._datagrams.connect(address)
        self._is_connected = True

    def read(self) -> bytes:
        """Return the next datagram, and set ``sender``."""
        try:
            if self._is_connected:
                return self._datagrams.recv(_READ_SIZE)
            data, self.sender = self._datagrams.recvfrom(_READ_SIZE)
        except ConnectionRefusedError:
            # The other end has not started yet
            return b""
        return data

    def write(self, data: bytes) -> int:
        """Send one; return 0 if there is nobody to send to.

        A connected socket keeps the local address that it was opened with. That there is no route
        from it is raised, since only a new socket may find one.
        """
        if self._is_connected:
            with contextlib.suppress(ConnectionRefusedError):  # nobody listens there yet
                return self._datagrams.send(data)
            return 0
        # No route for now: the datagram is lost, which is no reason to reopen
        with contextlib.suppress(OSError):
            if (target := self._peers.target) is not None:
                return self._datagrams.sendto(data, target)
        return 0


async def open_udp(address: Address, peers: Peers) -> UdpPort:
    """Open a datagram socket, and set the peers by the address.

    Raises:
        OSError: There is no such host, or the port is taken.
    """
    family, (where, *_) = await resolve(address.host, address.port, socket.SOCK_DGRAM)
    if address.peer is not None:
        _, allowed = await resolve(*address.peer, socket.SOCK_DGRAM, family)
        peers.allow({host for host, *_ in allowed}, address.peer[1])
    if address.remote is not None:
        _, (remote, *_) = await resolve(*address.remote, socket.SOCK_DGRAM, family)
        peers.set_default_target(remote)
    elif address.kind is Kind.UDP_BROADCAST:
        peers.set_default_target(where)
    elif address.peer is not None and address.peer[1]:
        peers.set_default_target(allowed[0])
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    port = UdpPort(datagrams, peers)
    try:
        datagrams.setblocking(False)
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if address.kind is Kind.UDP_BROADCAST:
            datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if address.kind is Kind.UDP_OUT or address.is_send_only:
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
        OSError: There is no such host, or nobody listens there.
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
        OSError: There is no such host, or the port is taken.
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
    """Look a name up on a thread that nobody waits for at the end: it may hang for half a minute.

    Returns:
        The family of the first address, and all addresses.

    Raises:
        OSError: There is no such name.
    """
    # A socket of both families has IPv4 senders as mapped IPv6 addresses
    flags = socket.AI_V4MAPPED if family == socket.AF_INET6 else 0
    found: Future[list[Any]] = Future()
    found.set_running_or_notify_cancel()  # it can no longer be cancelled, only be left

    def look_up() -> None:
        try:
            found.set_result(
                socket.getaddrinfo(host, port, family, type=socket.SocketKind(kind), flags=flags)
            )
        except OSError as error:
            found.set_exception(error)
        except ValueError:  # no text for the resolver, or a NUL in it
            found.set_exception(OSError(errno.EINVAL, f"{host} is no name of a host"))

    threading.Thread(target=look_up, name="resolver", daemon=True).start()
    entries = await asyncio.wrap_future(found)
    return entries[0][0], [entry[4] for entry in entries]
