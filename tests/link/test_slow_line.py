"""ODOMETRY over real ports with a slow line behind them, which takes in whatever is sent.

Real time: the ages are those of this machine, so that this belongs to the campaigns.
"""

import asyncio
import contextlib
import socket
import threading
import time

import pytest

from ekf_companion.daemon.bandwidth import capacity
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from ekf_companion.mavlink.codec import pack, unpack
from ekf_companion.mavlink.event import HoldChanged
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.outbox import Message
from ekf_companion.mavlink.session import Session, SessionOptions
from tests.link.slow_line import Kind, SlowLine
from tests.mavlink.conversation import ARDUPILOT, Voice
from tests.mavlink.line import FUSED

pytestmark = pytest.mark.campaign


class Autopilot(threading.Thread):
    """Listens at a TCP port, flies on ODOMETRY, and answers."""

    def __init__(self):
        super().__init__(daemon=True)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._voice = Voice(family=ARDUPILOT)
        self.is_ended = False
        self.start()

    def run(self):
        stream, _ = self._server.accept()
        with self._server, stream, contextlib.suppress(ConnectionError):  # the other end is gone
            self._serve(stream)

    def _serve(self, stream):
        stream.settimeout(0.01)
        splitter, next_beat, next_sample = Splitter(), 0.0, 0.0
        while not self.is_ended:
            now = time.monotonic()
            if now >= next_beat:
                next_beat = now + 1.0
                stream.sendall(self._voice.heartbeat(base_mode=128) + self._voice.place())
            if now >= next_sample:
                next_sample = now + 0.02
                sample = self._voice.say("RAW_IMU", time_usec=time.monotonic_ns() // 1000)
                stream.sendall(sample)
            try:
                data = stream.recv(4096)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                return
            for frame in splitter.feed(data):
                self._answer(stream, unpack(frame))

    def _answer(self, stream, message):
        name = type(message).__name__
        if name == "TIMESYNC" and message.tc1 == 0:
            said = self._voice.say("TIMESYNC", tc1=time.monotonic_ns(), ts1=message.ts1)
            stream.sendall(said)
        elif name == "PARAM_REQUEST_READ" and message.param_id.decode() in FUSED:
            value = FUSED[message.param_id.decode()]
            said = self._voice.say(
                "PARAM_VALUE",
                param_id=message.param_id,
                param_value=value,
                param_type=9,
                param_count=1,
            )
            stream.sendall(said)


async def fly(line, seconds, change=None):
    """Send ODOMETRY at 30 Hz for so long; return the session and what was told of holds."""
    session = Session(SessionOptions(rates={}, guard=GuardOptions()))
    address = parse_url(line.url)
    session.delivery.pacing.capacity = capacity(address)
    link = Link(
        address,
        clock=time.monotonic_ns,
        on_read=lambda read: session.receive(read.data, read.now_ns),
    )
    running = asyncio.create_task(link.run())
    holds, begin, next_one, is_changed = [], time.monotonic(), 0.0, False
    while (age := time.monotonic() - begin) < seconds:
        if change is not None and age > change[0] and not is_changed:
            line.there.rate, is_changed = change[1], True
        now_ns = time.monotonic_ns()
        if age >= next_one:
            next_one = age + 1 / 30
            payload = pack("ODOMETRY", time_usec=now_ns // 1000, quality=100)
            session.publish(Message("ODOMETRY", payload, is_replaceable=True), now_ns)
        session.tick(now_ns)
        for frame in session.outbox.take():
            link.send(frame.data, is_replaceable=frame.is_replaceable)
        holds += [event.hold for event in session.events() if isinstance(event, HoldChanged)]
        await asyncio.sleep(0.01)
    running.cancel()
    await asyncio.wait([running])
    return session, holds


@pytest.fixture
def autopilot():
    one = Autopilot()
    yield one
    one.is_ended = True
    one.join(5.0)


@pytest.mark.parametrize("kind", ["tcp", "udp", "pty"])
@pytest.mark.parametrize("bytes_s", [5760, 3840])
def test_a_slow_line_gets_as_many_as_it_carries(autopilot, kind, bytes_s):
    line = SlowLine(Kind(rate=bytes_s), kind=kind, target=autopilot.port)
    try:
        asyncio.run(fly(line, 12.0))
    finally:
        line.close()
    ages = [age for at, age in line.arrivals if at > 3.0]
    assert max(ages) < 0.6
    assert 5 <= len(ages) / 9.0 < 22


def test_a_line_that_jams_gets_nothing_more(autopilot):
    line = SlowLine(Kind(), target=autopilot.port)
    try:
        session, holds = asyncio.run(fly(line, 12.0, change=(6.0, 300)))
    finally:
        line.close()
    assert holds
    assert session.hold is not None
    assert len([at for at, _ in line.arrivals if at > 8.5]) < 12


def test_a_plain_line_gets_all(autopilot):
    line = SlowLine(Kind(), target=autopilot.port)
    try:
        _, holds = asyncio.run(fly(line, 8.0))
    finally:
        line.close()
    assert holds == []
    assert len(line.arrivals) > 0.8 * 30 * 6
