"""Rule 35: what was unplugged or restarted is taken up again within three seconds of its return.

A few cycles of each; ``RECONNECT_CYCLES=100`` (``make reconnect``) makes a campaign of it.
"""

import asyncio
import contextlib
import logging
import os
import random
import socket
import time
import tty

import pytest

from ekf_companion.daemon.reception import deliver
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from ekf_companion.link.peers import Peers
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.session import Session
from tests.daemon.test_daemon import Daemon

pytestmark = pytest.mark.campaign

_log = logging.getLogger("reconnect")

CYCLES = int(os.environ.get("RECONNECT_CYCLES", "3"))
RESUMES = 3.0
"""Seconds from the return of the other end until bytes have gone both ways."""
HEARTBEAT = IDS["HEARTBEAT"]
LIMIT = RESUMES if "RECONNECT_CYCLES" in os.environ else 10.0 * RESUMES
"""Seconds: a campaign has the machine for itself, a test has not."""
LONG = pytest.mark.timeout(900 + 6 * CYCLES)


def descriptors(process="self"):
    return len(os.listdir(f"/proc/{process}/fd"))


class Autopilot:
    """The other end: sends heartbeats, and hears whether anything comes back."""

    def __init__(self):
        self._sender = Sender(1, 1)

    def meet(self, write, read):
        """Speak until a heartbeat comes back; give how long that took, s."""
        splitter, begin = Splitter(), time.monotonic()
        while time.monotonic() < begin + 2 * LIMIT:
            with contextlib.suppress(OSError):
                write(self._sender.message("HEARTBEAT", type=2, autopilot=12))
            with contextlib.suppress(OSError):
                if any(frame.message_id == HEARTBEAT for frame in splitter.feed(read())):
                    return time.monotonic() - begin
            time.sleep(0.01)
        return time.monotonic() - begin


class Tty(Autopilot):
    """A device that comes and goes behind one name."""

    def __init__(self, place):
        super().__init__()
        self.place = place
        self._master = -1

    def plug(self):
        """Come back, as another device; give when, until bytes went both ways, s."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.place.symlink_to(os.ttyname(slave))
        try:
            return self.meet(
                lambda data: os.write(self._master, data), lambda: os.read(self._master, 4096)
            )
        finally:
            os.close(slave)

    def unplug(self):
        self.place.unlink()
        os.close(self._master)


class Program(Autopilot):
    """A program that speaks over UDP, from another port each time that it starts."""

    def __init__(self, port):
        super().__init__()
        self._port = port
        self._socket = None

    def plug(self):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self._port))
        self._socket.setblocking(False)
        return self.meet(self._socket.send, lambda: self._socket.recv(4096))

    def unplug(self):
        self._socket.close()


class Server(Autopilot):
    """A program that listens on TCP."""

    def __init__(self, port):
        super().__init__()
        self._port = port
        self._server = self._stream = None

    def plug(self):
        self._server = socket.create_server(("127.0.0.1", self._port))
        self._server.setblocking(False)
        return self.meet(self._write, self._read)

    def _write(self, data):
        if self._stream is None:
            self._stream, _ = self._server.accept()
            self._stream.setblocking(False)
        self._stream.send(data)

    def _read(self):
        return b"" if self._stream is None else self._stream.recv(4096)

    def unplug(self):
        for part in (self._stream, self._server):
            if part is not None:
                part.close()
        self._stream = self._server = None


class Client(Server):
    """A program that connects over TCP."""

    def plug(self):
        return self.meet(self._write, self._read)

    def _write(self, data):
        if self._stream is None:
            self._stream = socket.create_connection(("127.0.0.1", self._port))
            self._stream.setblocking(False)
        self._stream.send(data)


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def ends(tmp_path, kind):
    """Return the URL of our end, and the other end."""
    if kind == "serial":
        return f"serial:{tmp_path}/ttyFC:57600", Tty(tmp_path / "ttyFC")
    port = free_port(socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM)
    other = {"udpin": Program, "tcp": Server, "tcpin": Client}[kind](port)
    return f"{kind}:127.0.0.1:{port}", other


async def serve(link):
    """Answer as the daemon does: hear whom the session believes, and let time pass."""
    session = Session()
    pump = asyncio.create_task(link.run())
    try:
        while True:
            received = await link.receive()
            deliver(received, session.receive, session, link)
            session.tick(received.now_ns)
            for frame in session.data_to_send():
                link.send(frame)
    finally:
        pump.cancel()
        await asyncio.gather(pump, return_exceptions=True)


def report(kind, times, counts):
    middle = sorted(times)[len(times) // 2]
    _log.info(
        "%s: %d cycles, resumed after %.2f s at the median and %.2f s at the longest; "
        "%d to %d descriptors",
        kind,
        len(times),
        middle,
        max(times),
        min(counts),
        max(counts),
    )


@LONG
@pytest.mark.parametrize("kind", ["serial", "udpin", "tcp", "tcpin"])
def test_a_link_resumes_whenever_the_other_end_returns_rule_35(tmp_path, kind, caplog):
    caplog.set_level(logging.ERROR, logger="ekf_companion")
    url, other = ends(tmp_path, kind)
    rng = random.Random(7)

    async def scenario():
        link = Link(parse_url(url), peers=Peers())
        task = asyncio.create_task(serve(link))
        times, counts = [], []
        for _ in range(CYCLES):
            times.append(await asyncio.to_thread(other.plug))
            counts.append(descriptors())
            other.unplug()
            # Away for up to longer than from one attempt to the next
            await asyncio.sleep(rng.choice([0.0, rng.uniform(0.0, 1.2)]))
        assert not task.done()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return times, counts

    times, counts = asyncio.run(scenario())
    report(kind, times, counts)
    assert max(times) < LIMIT, times
    assert len(set(counts[1:])) == 1, counts  # the first starts the thread that plugs


@LONG
@pytest.mark.parametrize("kind", ["serial", "udpin"])
def test_the_daemon_resumes_and_leaks_no_descriptor_rule_35(tmp_path, kind):
    url, other = ends(tmp_path, kind)
    with Daemon(tmp_path, "--link", url, config="http: {port: 0}\n") as daemon:
        daemon.wait_for("No such file" if kind == "serial" else ": open")
        pid = daemon._process.pid
        other.plug()
        before = descriptors(pid)
        times, counts = [], []
        for _ in range(max(2, CYCLES // 5)):
            other.unplug()
            times.append(other.plug())
            counts.append(descriptors(pid))
        assert daemon._process.poll() is None
        assert daemon.stop() == 0
        other.unplug()
    report(kind, times, counts)
    assert max(times) < LIMIT, times
    assert set(counts) == {before}
