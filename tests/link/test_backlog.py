"""What waits for a slow stream: how long, in what order, and what is dropped of it."""

import asyncio
import contextlib
import fcntl
import os
import struct
import termios
import time
import tty

from ekf_companion.link.address import parse_url
from ekf_companion.link.backlog import FRESH_NS, LARGEST, PATIENCE_NS, Backlog
from ekf_companion.link.link import Link
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.stamp import SECOND_NS
from tests.daemon.waiting import LIMIT

MS = 1_000_000


def drained(backlog):
    taken = []
    while (first := backlog.take()) is not None:
        taken.append(first.data)
    return taken


def test_of_replaceable_messages_the_newest_waits_alone_and_nothing_overtakes():
    backlog = Backlog()
    assert backlog.add(b"old", 0, is_replaceable=True) == 0
    assert backlog.add(b"beat", 1) == 0
    assert backlog.add(b"new", 2, is_replaceable=True) == 1
    assert backlog.add(b"ack", 3) == 0
    assert drained(backlog) == [b"beat", b"new", b"ack"]


def test_what_has_waited_too_long_is_dropped_the_replaceable_first():
    backlog = Backlog()
    backlog.add(b"beat", 0)
    backlog.add(b"odometry", 0, is_replaceable=True)
    assert backlog.expire(FRESH_NS) == 0
    assert backlog.expire(FRESH_NS + 1) == 1
    assert backlog.add(b"late", PATIENCE_NS + 1) == 1
    assert drained(backlog) == [b"late"]


def test_a_message_that_has_begun_is_finished_whatever_comes():
    backlog = Backlog()
    backlog.add(b"begun", 0, is_replaceable=True)
    backlog.put_back(backlog.take(), 2)
    assert backlog.add(b"new", 100 * PATIENCE_NS, is_replaceable=True) == 0
    assert backlog.add(bytes(LARGEST), 100 * PATIENCE_NS) == 1
    assert drained(backlog) == [b"gun", bytes(LARGEST)]


def test_what_was_taken_and_not_begun_can_still_be_dropped():
    backlog = Backlog()
    backlog.add(b"old", 0, is_replaceable=True)
    backlog.put_back(backlog.take(), 0)
    assert backlog.expire(FRESH_NS + 1) == 1
    assert not backlog


def test_it_never_holds_more_than_its_bytes():
    """Rule 37: whoever makes us answer does not fill the memory."""
    backlog = Backlog()
    dropped = sum(backlog.add(bytes(1000), 0) for _ in range(1000))
    assert dropped == 1000 - LARGEST // 1000
    assert len(drained(backlog)) == LARGEST // 1000
    assert backlog.clear() == 0


def odometry(sender, stamp):
    covariance = [1.0] * 21
    return sender.message(
        "ODOMETRY", time_usec=stamp, pose_covariance=covariance, velocity_covariance=covariance
    )


async def opened(link):
    task = asyncio.create_task(link.run())
    end = time.monotonic() + LIMIT
    while not link.is_open:
        assert time.monotonic() < end
        await asyncio.sleep(0.002)
    return task


def test_after_a_stall_of_the_line_what_comes_is_fresh():
    """Rule 37: a line that took nothing for a second and a half goes on with what is true now."""

    async def scenario():
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        now_ns = SECOND_NS
        link = Link(parse_url(f"serial:{os.ttyname(slave)}:57600"), clock=lambda: now_ns)
        task = await opened(link)
        sender, splitter, frames = Sender(1, 194), Splitter(), []
        # Fill what the system holds; then thirty times a second for 1.5 s, and the reader is back
        while not link.unsent:
            link.send(odometry(sender, 0), is_replaceable=True)
        for k in range(47):
            link.send(odometry(sender, now_ns // 1000), is_replaceable=True)
            if k % 10 == 0:
                link.send(sender.message("HEARTBEAT", custom_mode=k))
            now_ns += SECOND_NS // 30
            await asyncio.sleep(0)
        resumed = now_ns // 1000
        end = time.monotonic() + LIMIT
        while not any(frame.message_id == IDS["HEARTBEAT"] for frame in frames):
            assert time.monotonic() < end
            try:
                frames += splitter.feed(os.read(master, 65536))
            except BlockingIOError:
                await asyncio.sleep(0.005)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        os.close(master)
        os.close(slave)
        return resumed, splitter, frames

    resumed, splitter, frames = asyncio.run(scenario())
    assert splitter.junk_bytes == 0  # each message whole
    stamps = [unpack(f).time_usec for f in frames if f.message_id == IDS["ODOMETRY"]]
    late = [stamp for stamp in stamps[:-1] if stamp]
    assert late == [] or resumed - late[0] <= FRESH_NS // 1000
    assert len([stamp for stamp in stamps if stamp]) <= 2
    beats = [unpack(f).custom_mode for f in frames if f.message_id == IDS["HEARTBEAT"]]
    assert beats == [40]  # those of more than half a second ago went


class Uart:
    """What a UART at 57600 baud still holds of what was written: no pseudo-terminal says it."""

    def __init__(self, monkeypatch):
        self.most = 0.0
        self._queue, self._last = 0.0, time.monotonic()
        self._ioctl, self._write = fcntl.ioctl, os.write
        monkeypatch.setattr(fcntl, "ioctl", self.ioctl)
        monkeypatch.setattr(os, "write", self.write)

    def held(self):
        now = time.monotonic()
        self._queue, self._last = max(self._queue - 5760 * (now - self._last), 0.0), now
        return self._queue

    def ioctl(self, descriptor, request, *rest):
        if request == termios.TIOCOUTQ:
            return struct.pack("=i", int(self.held()))
        return self._ioctl(descriptor, request, *rest)

    def write(self, descriptor, data):
        size = self._write(descriptor, data)
        self._queue = self.held() + size
        self.most = max(self.most, self._queue)
        return size


def test_no_more_waits_in_the_system_than_leaves_in_a_twentieth_of_a_second(monkeypatch):
    async def scenario():
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        link = Link(parse_url(f"serial:{os.ttyname(slave)}:57600"))
        task = await opened(link)
        uart, splitter, sender = Uart(monkeypatch), Splitter(), Sender(1, 194)
        count, begin = 0, time.monotonic()
        for k in range(60):
            link.send(odometry(sender, time.monotonic_ns() // 1000), is_replaceable=True)
            await asyncio.sleep(max(begin + (k + 1) / 30 - time.monotonic(), 0.0))
            with contextlib.suppress(BlockingIOError):
                count += len(splitter.feed(os.read(master, 65536)))
        monkeypatch.undo()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        os.close(master)
        os.close(slave)
        return uart.most, link.unsent, count

    most, unsent, count = asyncio.run(scenario())
    assert most <= 0.05 * 5760 + 280  # the message that was written last on top
    assert unsent > 0
    assert count > 12  # and the line is kept busy: of 2 s, 23 a second, if nobody else is
