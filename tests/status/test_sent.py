"""ODOMETRY counted as the link took it: what it threw away was not sent."""

import asyncio
import contextlib
import os
import time
import tty

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.link.backlog import FRESH_NS
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.status.judge import judge
from tests.daemon.waiting import LIMIT
from tests.engine.conversation import cycles
from tests.status.test_observer import Watched

ALWAYS = Config(output=OutputConfig(odometry=OdometryConfig(mode="always")))


def odometries(data):
    return sum(frame.message_id == IDS["ODOMETRY"] for frame in Splitter().feed(data))


@contextlib.contextmanager
def wire():
    """Return a line, and its other end, which nobody reads."""
    theirs, ours = os.openpty()
    tty.setraw(ours)
    os.set_blocking(theirs, False)
    try:
        yield f"serial:{os.ttyname(ours)}:57600", theirs
    finally:
        os.close(theirs)
        os.close(ours)


async def flown(url, body):
    watched = Watched(config=ALWAYS, url=url)
    pump = asyncio.create_task(watched.link.run())
    end = time.monotonic() + LIMIT
    while not watched.link.is_open:
        assert time.monotonic() < end
        await asyncio.sleep(0.002)
    try:
        return await body(watched)
    finally:
        pump.cancel()
        await asyncio.gather(pump, return_exceptions=True)


def read(descriptor):
    data = b""
    with contextlib.suppress(BlockingIOError):
        while more := os.read(descriptor, 65536):
            data += more
    return data


def test_what_a_stuck_line_throws_away_was_not_sent():
    """Rule 40: a line that takes nothing is told, and not as a stream of 30 Hz."""

    async def body(watched):
        watched.feed(cycles(25.0))  # and the loop, which would write, does not go round
        snapshot, offered = watched.snapshot(), watched.companion.session.outbox.sent["ODOMETRY"]
        waiting, data, end = watched.link.backlog.replaceable, b"", time.monotonic() + LIMIT
        while len(data) < watched.link.bytes_out:
            assert time.monotonic() < end
            data += read(theirs)
        return snapshot, offered, waiting, odometries(data)

    with wire() as (url, theirs):
        snapshot, offered, waiting, taken = asyncio.run(flown(url, body))
    output, process = snapshot.output, snapshot.process
    assert output.sent["ODOMETRY"] == process.latency_count == taken
    assert offered == output.sent["ODOMETRY"] + output.unsent + waiting
    assert output.unsent > 300
    assert (output.rate, output.is_streaming) == (0.0, False)
    assert output.unsent_rate == pytest.approx(30.0, rel=0.1)
    words = judge(snapshot).line
    assert "no ODOMETRY, 30 Hz thrown away as the link takes no more" in words


def test_what_had_to_wait_for_room_was_late_by_that():
    async def body(watched):
        flight = cycles(60.0)
        while not watched.link.backlog.replaceable:
            watched.feed([next(flight)])
        before = watched.observer.latency.count
        watched.now_ns += FRESH_NS // 2
        read(theirs)
        end = time.monotonic() + LIMIT
        while watched.link.backlog.replaceable:
            assert time.monotonic() < end
            await asyncio.sleep(0.002)
        process = watched.snapshot().process
        return process.latency_count - before, process.latency

    with wire() as (url, theirs):
        new, latency = asyncio.run(flown(url, body))
    assert new == 1
    assert latency[100.0] == latency[50.0] + 1


def test_without_a_link_nothing_is_sent():
    watched = Watched(config=ALWAYS)
    link, said = watched.link, 0
    for t_ns, data in cycles(8.0):
        watched.companion.receive(data, t_ns)
        for frame in watched.companion.data_to_send():
            link.send(frame, is_replaceable=bool(odometries(frame)))
            said += odometries(frame)
        watched.observer.tick(watched.now_ns)
    output = watched.snapshot().output
    assert said > 100
    assert (output.sent["ODOMETRY"], output.unsent) == (0, said)
