"""A link that is reopened whenever it fails."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from ekf_companion.link.address import DATAGRAMS, Address, Kind, parse_peer
from ekf_companion.link.backlog import Backlog, Waiting
from ekf_companion.link.holder import holder_of
from ekf_companion.link.peers import Peers, Sender
from ekf_companion.link.port import Port, SerialPort, TcpPort, open_server, open_tcp, open_udp

_log = logging.getLogger(__package__)

QUEUE_LENGTH = 1024
"""Reads that may wait for the caller; beyond that the oldest is dropped."""
FIRST_DELAY, LAST_DELAY = 0.5, 1.0
"""Seconds between attempts to open a link, doubled after each failure. A link that is back is
reopened within that time plus ``PATIENCE``."""
LOST = 1.0
"""Seconds without a route for our datagrams after which the socket is reopened: the local address
that it was opened with may be gone."""
SILENT = 1.0
"""Seconds without an accepted frame from a TCP client after which another may replace it: an
autopilot sends its heartbeat once a second, and others more often."""
TAKEN = (errno.EADDRINUSE, errno.EBUSY, errno.EAGAIN)
"""Why a link does not open that another program uses; the last of a serial port."""
NOT_FIRST = "another client is connected"
PATIENCE = 2.0
"""Seconds that a connection may take: the kernel tries twice in them."""


class Received(NamedTuple):
    """Bytes of one read, their sender and time of arrival."""

    data: bytes
    now_ns: int
    """When it was read, on the link's clock."""
    sender: Sender | None = None
    """Its sender; None if there is only one other end."""


class Link:
    """A link that is reopened whenever it fails."""

    def __init__(
        self,
        address: Address,
        *,
        peer: str = "",
        clock: Callable[[], int] = time.monotonic_ns,
        on_state: Callable[[bool], None] | None = None,
        on_read: Callable[[Received], None] | None = None,
        on_sent: Callable[[int], None] | None = None,
        peers: Peers | None = None,
    ) -> None:
        """Make ready; it opens when ``run`` is awaited.

        Args:
            address: See ``parse_url``.
            peer: Where datagrams must come from, see ``parse_peer``; empty: anywhere.
            clock: Returns the time, ns, for the stamps of what is read.
            on_state: Called with True when the link has opened and with False when it is closed.
            on_read: Called with what is read, at once, in place of ``receive``; an exception from
                it ends ``run``.
            on_sent: Called when a replaceable message has been written whole, with the time for
                which it waited for room, ns.
            peers: The senders to accept, which the caller pins; if None, everybody is accepted, and
                the last sender is answered.

        Raises:
            LinkError: ``peer`` is not an address.
        """
        if address.warning:
            _log.warning("%s", address.warning)
        self.address = replace(address, peer=parse_peer(peer, address))
        self.peers = peers or Peers(is_pinning=False)
        """Whose datagrams are accepted; others are counted there."""
        self.dropped = 0
        """Reads dropped because the caller was too slow."""
        self.unsent = 0
        """Messages dropped because there was no link, or too slow a one."""
        self.opened = 0
        """How often the link has been opened."""
        self.failure: OSError | None = None
        """Why it is not open; None if it is, or nobody has tried yet."""
        self.bytes_in = 0
        self.bytes_out = 0
        self._clock = clock
        self._on_state = on_state or (lambda _: None)
        self._on_read = on_read or self._enqueue
        self._on_sent = on_sent or (lambda _: None)
        self._queue: deque[Received] = deque()
        self._waiter: asyncio.Future[None] | None = None
        self._port: Port | None = None
        self._broken: asyncio.Future[str] | None = None
        self.backlog = Backlog()
        self._timer: asyncio.TimerHandle | None = None
        self._server: socket.socket | None = None
        self._next_client: socket.socket | None = None
        self._accepted_s = 0.0
        self._no_route_s: float | None = None
        self._last_complaint = ""

    @property
    def is_open(self) -> bool:
        """Whether the descriptor is open; with UDP the other end may be absent all the same."""
        return self._port is not None

    @property
    def refused(self) -> Counter[str]:
        """Datagrams and TCP clients refused, by reason."""
        return self.peers.refused

    async def run(self) -> None:
        """Keep the link open until cancelled."""
        delay = FIRST_DELAY
        loop = asyncio.get_running_loop()
        try:
            while True:
                before, begin = self.bytes_in, loop.time()
                reason = await self._run_once()
                if self.bytes_in > before:
                    delay = FIRST_DELAY
                if reason != self._last_complaint:
                    words = reason + self._holder()
                    _log.warning("%s: %s; trying again until it opens", self.address, words)
                    self._last_complaint = reason
                # The duration of the attempt counts as waiting
                await asyncio.sleep(max(begin + delay - loop.time(), 0.0))
                delay = min(2.0 * delay, LAST_DELAY)
        finally:
            for part in (self._server, self._next_client):
                if part is not None:
                    part.close()

    def _holder(self) -> str:
        """Return which process uses the port and what to do, if that is why it does not open."""
        if self.failure is None or self.failure.errno not in TAKEN:
            return ""
        if (holder := holder_of(self.address)) is None:
            return ", by another program"
        if not holder.is_daemon:
            return f", by {holder}: stop it, or take another port"
        return (
            f", by another daemon of this project, {holder}: ask that with `ekf-companion status` "
            f"(--url, where its http.port is another), or stop it with `{holder.stop}`"
        )

    async def receive(self) -> Received:
        """Return the oldest read that waits, or wait for one."""
        while True:
            while not self._queue:
                self._waiter = asyncio.get_running_loop().create_future()
                await self._waiter
            received = self._queue.popleft()
            # Another sender may have been pinned since it came
            if received.sender is None or self.peers.accepts(received.sender, received.now_ns):
                return received

    def confirm(self) -> None:
        """Note that what was just read contained an accepted frame, so that a TCP client stays.

        Without pinning, any bytes count.
        """
        if self._server is not None:
            self._accepted_s = asyncio.get_running_loop().time()

    def send(self, data: bytes, *, is_replaceable: bool = False) -> None:
        """Send a whole message now, or as soon as a stream has room; never waits.

        It is replaceable if the next of its kind makes it worthless: while the stream has no room,
        only the newest such message waits, and not for long.
        """
        port = self._port
        if port is None:
            self.unsent += 1
            return
        now_ns = self._clock()
        if self.backlog:
            self.unsent += self.backlog.add(data, now_ns, is_replaceable=is_replaceable)
        elif (written := self._write(port, data)) < len(data):
            if port.is_stream:
                self.backlog.put_back(Waiting(data, now_ns, is_replaceable), written)
                self._await_room(port)
            else:
                self.unsent += 1
        elif is_replaceable and not self._is_broken:
            self._on_sent(0)

    async def _run_once(self) -> str:
        """Open, read and write, and close; return the reason why it ended."""
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
        self._accepted_s, self._no_route_s = loop.time(), None
        self.opened += 1
        _log.info("%s: open", self.address)
        self._last_complaint = ""
        if not self.address.is_send_only:
            loop.add_reader(descriptor, self._on_readable, port)
        if self._server is not None:
            loop.add_reader(self._server, self._on_client, self._server)
        self._on_state(True)
        try:
            return await self._broken
        finally:
            if self._server is not None:
                loop.remove_reader(self._server)
            loop.remove_reader(descriptor)
            loop.remove_writer(descriptor)
            port.close()
            self._port = None
            if self._timer is not None:
                self._timer.cancel()
            self.unsent += self.backlog.clear()
            self._on_state(False)

    @property
    def _is_broken(self) -> bool:
        return self._broken is not None and self._broken.done()

    def _break(self, reason: str) -> None:
        if self._broken is not None and not self._broken.done():
            self._broken.set_result(reason)

    def _on_client(self, server: socket.socket) -> None:
        """Accept another client only if the present one is silent."""
        try:
            stream, _ = server.accept()
        except OSError:
            return  # it is gone again
        is_silent = asyncio.get_running_loop().time() - self._accepted_s >= SILENT
        if is_silent and self._next_client is None:
            self._next_client = stream
            self._break("another client replaces a silent one")
            return
        stream.close()
        if not self.refused[NOT_FIRST]:
            _log.warning("%s: another client is refused while the first one sends", self.address)
        self.refused[NOT_FIRST] += 1

    def _on_readable(self, port: Port) -> None:
        # One read: if there is more, the loop calls again at once
        try:
            data = port.read()
        except BlockingIOError:
            return
        except OSError as error:
            self._break(_sentence(error))
            return
        now_ns, sender = self._clock(), port.sender
        if not data or (sender is not None and not self.peers.accepts(sender, now_ns)):
            return
        self.bytes_in += len(data)
        if not self.peers.is_pinning:
            self.confirm()
        try:
            self._on_read(Received(data, now_ns, sender))
        except Exception as error:  # noqa: BLE001  # run raises it again
            if self._broken is not None and not self._broken.done():
                self._broken.set_exception(error)

    def _enqueue(self, received: Received) -> None:
        if len(self._queue) == QUEUE_LENGTH:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(received)
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def _write(self, port: Port, data: bytes) -> int:
        """Write; return how many bytes. If that breaks the link, it counts as all of them."""
        try:
            written = port.write(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            if port.is_stream:
                self.unsent += 1
                self._break(_sentence(error))
                return len(data)
            self._on_no_route(error)
            return 0
        self._no_route_s = None
        self.bytes_out += written
        return written

    def _on_no_route(self, error: OSError) -> None:
        """Reopen a socket whose datagrams have had no route for a while."""
        now = asyncio.get_running_loop().time()
        if self._no_route_s is None:
            self._no_route_s = now
        elif now - self._no_route_s >= LOST:
            self._break(_sentence(error))

    def _await_room(self, port: Port) -> None:
        loop = asyncio.get_running_loop()
        if wait := port.wait():
            self._timer = loop.call_later(wait, self._on_writable, port)
        else:
            loop.add_writer(port.fileno(), self._on_writable, port)

    def _on_writable(self, port: Port) -> None:
        asyncio.get_running_loop().remove_writer(port.fileno())
        self.unsent += self.backlog.expire(self._clock())
        while (first := self.backlog.take()) is not None:
            written = self._write(port, first.data)
            if self._is_broken:
                return
            if written < len(first.data):
                self.backlog.put_back(first, written)
                self._await_room(port)
                return
            if first.is_replaceable:
                self._on_sent(self._clock() - first.since_ns)

    async def _open(self) -> Port:
        address = self.address
        if address.kind is Kind.SERIAL:
            return SerialPort(address.device, address.baud)
        if address.kind in DATAGRAMS:
            return await open_udp(address, self.peers)
        if address.kind is Kind.TCP_OUT:
            return await open_tcp(address, PATIENCE)
        if self._server is None:
            self._server = await open_server(address)
        stream, self._next_client = self._next_client, None
        if stream is None:
            stream, _ = await asyncio.get_running_loop().sock_accept(self._server)
        return TcpPort(stream)


def _sentence(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
