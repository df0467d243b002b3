"""The daemon: one link, one session, one pipeline, one loop."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from ekf_companion.companion import Companion
from ekf_companion.config import Config
from ekf_companion.errors import ConfigError
from ekf_companion.link import Link, open_link

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 0.1
"""Seconds between two looks at what time brings."""
FLUSH = 0.5
"""Seconds between two flushes of the recording."""


class Recorder:
    """Appends what went in and out to a .tlog."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            ConfigError: It cannot be written.
        """
        try:
            self._file: BinaryIO = path.open("ab")
        except OSError as error:
            raise ConfigError(f"record.path: {path}: cannot be written: {error.strerror}") from error
        self._flushed = time.monotonic()

    def write(self, record: list[tuple[int, bytes]]) -> None:
        """Append stamps (us) and bytes; twice a second they reach the kernel."""
        if record:
            self._file.write(
                b"".join(stamp.to_bytes(8, "big") + data for stamp, data in record)
            )
        now = time.monotonic()
        if now - self._flushed >= FLUSH:
            self._flushed = now
            self._file.flush()

    def close(self) -> None:
        """Write what is left."""
        self._file.close()


def unix_clock() -> int:
    """Give unix time, ns, that never steps: the monotonic clock, set once."""
    return time.monotonic_ns() + _BOOT_NS


_BOOT_NS = time.time_ns() - time.monotonic_ns()


def notify(state: str) -> None:
    """Tell systemd, where it listens (sd_notify)."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as peer:
        try:
            peer.connect(address)
            peer.send(state.encode())
        except OSError as error:
            _log.warning("systemd does not listen on NOTIFY_SOCKET: %s", error.strerror)


async def serve(config: Config) -> None:
    """Run until SIGTERM or SIGINT.

    Raises:
        LinkError: The link's URL names no link.
        ConfigError: The recording cannot be written.
    """
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    link = open_link(config.link.url, clock=unix_clock)
    recorder = None
    if config.record.path is not None:
        started = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        recorder = Recorder(Path(config.record.path.replace("%s", started)))
    companion = Companion(config, is_recording=recorder is not None)
    notify("READY=1")
    try:
        async with TaskGroup() as group:
            tasks = [
                group.create_task(link.run()),
                group.create_task(_wake(link)),
                group.create_task(_work(link, companion, recorder)),
            ]
            await stop.wait()
            notify("STOPPING=1")
            companion.close(unix_clock())
            _send(link, companion, recorder)
            for task in tasks:
                task.cancel()
    finally:
        if recorder is not None:
            recorder.close()
    _log.info("Stopped")


async def _wake(link: Link) -> None:
    """Keep the loop turning while nothing comes."""
    while True:
        await asyncio.sleep(TICK)
        link.wake()


async def _work(link: Link, companion: Companion, recorder: Recorder | None) -> None:
    """Take what comes, do what is due; heartbeat and watchdog beat with the filter or not at all."""
    watched = "WATCHDOG_USEC" in os.environ
    beaten = 0
    while True:
        data, now_ns = await link.receive()
        if data:
            companion.receive(data, now_ns)
        companion.tick(now_ns)
        _send(link, companion, recorder)
        if watched and now_ns - beaten > 1_000_000_000:
            beaten = now_ns
            notify("WATCHDOG=1")


def _send(link: Link, companion: Companion, recorder: Recorder | None) -> None:
    for frame in companion.data_to_send():
        link.send(frame)
    if recorder is not None:
        recorder.write(companion.session.take_record())


def run(config: Config, url: str | None = None) -> None:
    """Serve with this configuration, on another link where one is named.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The recording cannot be written.
    """
    if url is not None:
        config = replace(config, link=replace(config.link, url=url))
    asyncio.run(serve(config))
