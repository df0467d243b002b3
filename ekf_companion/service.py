"""The daemon: one link, one session, one pipeline, one loop; beside it threads that write."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
import time
from dataclasses import replace

from ekf_companion.companion import Companion
from ekf_companion.config import Config
from ekf_companion.errors import CompanionError
from ekf_companion.keeper import Keeper, clocks, open_keeper
from ekf_companion.link import Link, open_link
from ekf_companion.recorder import Recorder, open_recorder
from ekf_companion.resumption import Resumption
from ekf_companion.supervision import Systemd

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from exceptiongroup import BaseExceptionGroup
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 0.1
"""Seconds between two looks at what time brings."""
LAST_WORDS = 0.1
"""Seconds for the last message to leave a serial port, whose closing throws away what waits."""


def run(config: Config, url: str | None = None) -> None:
    """Serve with this configuration, on another link where one is named.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The recording or the checkpoints have no place.
        CompanionError: A bug; its traceback is in the log.
    """
    if url is not None:
        config = replace(config, link=replace(config.link, url=url))
    try:
        asyncio.run(serve(config))
    except Exception as error:  # noqa: BLE001  # the one place; systemd starts us again
        cause: BaseException = error
        # A task group wraps what its tasks raise
        while isinstance(cause, BaseExceptionGroup):
            cause = cause.exceptions[0]
        if isinstance(cause, CompanionError):
            raise cause from None
        _log.exception("Ended by a bug")
        raise CompanionError(
            f"ended by a bug ({type(cause).__name__}); the traceback is above: please report it"
        ) from None


async def serve(config: Config) -> None:
    """Run until SIGTERM or SIGINT.

    Raises:
        LinkError: The link's URL names no link.
        ConfigError: The recording or the checkpoints have no place.
    """
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    link = open_link(config.link.url, clock=unix_clock)
    recorder = open_recorder(config.record)
    keeper = open_keeper(config.checkpoint.file, config.checkpoint.interval)
    resumption = Resumption(
        None if keeper is None else keeper.read(), clocks(), unix_clock(), config.checkpoint.limit
    )
    companion = Companion(config, recorder is not None, resumption)
    systemd = Systemd()
    systemd.tell("READY=1")
    try:
        async with TaskGroup() as group:
            pump = group.create_task(link.run())
            wake = group.create_task(_wake(link))
            work = group.create_task(_work(link, companion, recorder, keeper, systemd))
            await stop.wait()

            # Say goodbye when nothing else can be said any more
            work.cancel()
            systemd.tell("STOPPING=1")
            companion.close(unix_clock())
            _send(link, companion, recorder)
            _keep(companion, keeper)
            await asyncio.sleep(LAST_WORDS)
            wake.cancel()
            pump.cancel()
    finally:
        if keeper is not None:
            keeper.close()
        if recorder is not None:
            recorder.close()
    _log.info("Stopped")


async def _wake(link: Link) -> None:
    """Keep the loop turning while nothing comes."""
    while True:
        await asyncio.sleep(TICK)
        link.wake()


async def _work(
    link: Link,
    companion: Companion,
    recorder: Recorder | None,
    keeper: Keeper | None,
    systemd: Systemd,
) -> None:
    """Take what comes, do what is due; heart and watchdog beat with the filter or not at all."""
    while True:
        data, now_ns = await link.receive()
        if data:
            companion.receive(data, now_ns)
        companion.tick(now_ns)
        _send(link, companion, recorder)
        if keeper is not None and keeper.is_due(now_ns, companion.resets):
            _keep(companion, keeper)
        systemd.beat(now_ns)


def _send(link: Link, companion: Companion, recorder: Recorder | None) -> None:
    for frame in companion.data_to_send():
        link.send(frame)
    if recorder is not None:
        recorder.write(companion.session.take_record())


def _keep(companion: Companion, keeper: Keeper | None) -> None:
    if keeper is not None and (data := companion.checkpoint(clocks())) is not None:
        keeper.keep(data)


def unix_clock() -> int:
    """Give unix time, ns, that never steps: the monotonic clock, set once."""
    return time.monotonic_ns() + _BOOT_NS


_BOOT_NS = time.time_ns() - time.monotonic_ns()
