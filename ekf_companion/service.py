"""The daemon: one link, one session, one pipeline, one loop; beside it threads that write."""

from __future__ import annotations

import asyncio
import logging
import os
import queue
import signal
import socket
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from ekf_companion.companion import Companion
from ekf_companion.config import Config
from ekf_companion.errors import CompanionError, ConfigError
from ekf_companion.keeper import Keeper, clocks, open_keeper, open_memory
from ekf_companion.keyring import Keyring, open_keyring
from ekf_companion.link import Link, Peers, Received, open_link
from ekf_companion.resumption import Resumption
from ekf_companion.tuning import Tuning

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from exceptiongroup import BaseExceptionGroup
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 0.1
"""Seconds between two looks at what time brings."""
FLUSH = 0.5
"""Seconds between two writes to the recording."""
BATCHES = 120
"""Writes that wait for a slow disk: a minute; what comes then is lost to the recording."""
LAST_WORDS = 0.1
"""Seconds for the last message to leave a serial port, whose closing throws away what waits."""
PATIENCE = 1.0
"""Seconds that a slow disk may take for the end of the recording."""


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
    keyring = open_keyring(config)
    signed_only = keyring is not None and not config.signing.accept_unsigned
    peers = Peers(is_signed=signed_only)
    link = open_link(config.link.url, peer=config.link.peer, clock=unix_clock, peers=peers)
    recorder = open_recorder(config.record.path)
    keeper = open_keeper(config.checkpoint.file, config.checkpoint.interval)
    resumption = Resumption(
        None if keeper is None else keeper.read(), clocks(), unix_clock(), config.checkpoint.limit
    )
    signing = None if keyring is None else keyring.signing
    memory = open_memory(config.checkpoint.file)
    tuning = Tuning(config)
    if memory is not None:
        tuning = Tuning(config, memory.read(), str(memory.path), memory.keep)
    companion = Companion(config, recorder is not None, resumption, signing, tuning)
    systemd = Systemd()
    systemd.tell("READY=1")
    try:
        async with TaskGroup() as group:
            pump = group.create_task(link.run())
            wake = group.create_task(_wake(link))
            work = group.create_task(_work(link, companion, recorder, keeper, keyring, systemd))
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
        if memory is not None:
            memory.close()
        if keyring is not None:
            keyring.close()
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
    keyring: Keyring | None,
    systemd: Systemd,
) -> None:
    """Take what comes, do what is due; heart and watchdog beat with the filter or not at all."""
    while True:
        received = await link.receive()
        now_ns = received.now_ns
        if received.data:
            _hear(link, companion, received)
        companion.tick(now_ns)
        _send(link, companion, recorder)
        if keeper is not None and keeper.is_due(now_ns, companion.resets):
            _keep(companion, keeper)
        if keyring is not None:
            keyring.keep(now_ns)
        systemd.beat(now_ns)


def _hear(link: Link, companion: Companion, received: Received) -> None:
    """Take what was read; tell the link whom to go on listening to."""
    session, sender = companion.session, received.sender
    heard, admitted = session.heard, session.admission.admitted
    companion.receive(received.data, received.now_ns, sender)
    if sender is None:
        return
    if session.heard != heard:
        link.peers.pin(sender, received.now_ns)
    elif session.admission.admitted != admitted:
        link.peers.answer(sender)


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


class Systemd:
    """The service manager, where there is one (sd_notify)."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = int(os.environ.get("WATCHDOG_USEC") or 0) * 1000 // 2
        self._next_ns = 0
        self._has_complained = False

    def tell(self, state: str) -> None:
        """Tell it, if there is one; that it does not listen is said once."""
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ours:
            try:
                ours.sendto(state.encode(), self._address)
            except OSError as error:
                if not self._has_complained:
                    _log.warning("NOTIFY_SOCKET: %s", error.strerror)
                self._has_complained = True

    def beat(self, now_ns: int) -> None:
        """Say twice in the watchdog's time that we live."""
        if self._period_ns and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self.tell("WATCHDOG=1")


def open_recorder(path: str | None) -> Recorder | None:
    """Begin a recording; None: none is wanted, or the disk is out of order, which stops no flight.

    Raises:
        ConfigError: The name cannot be meant.
    """
    if path is None:
        return None
    name = path.replace("%s", time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    try:
        recorder = Recorder(Path(name))
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        raise ConfigError(
            f"record.path: {name}: {error.strerror}; name a file in a folder that can be written to"
        ) from error
    except OSError as error:
        _log.warning("%s: %s; flying without a recording", name, error.strerror)
        return None
    _log.info("Recording to %s", recorder.path)
    return recorder


class Recorder:
    """Keeps what went in and out in a .tlog; a disk that is slow or full holds up nobody."""

    def __init__(self, path: Path) -> None:
        """Open a new file and start its thread.

        Raises:
            OSError: It cannot be opened.
        """
        self.path, self._file = _create(path)
        self._waiting: list[bytes] = []
        self._batches: queue.Queue[bytes] = queue.Queue(BATCHES)
        self._next = 0.0
        self._lost = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, record: list[tuple[int, bytes]]) -> None:
        """Append stamps (us) and bytes; twice a second they go to the disk."""
        for stamp, data in record:
            self._waiting += stamp.to_bytes(8, "big"), data
        now = time.monotonic()
        if now >= self._next:
            self._next = now + FLUSH
            self._hand_over()

    def close(self) -> None:
        """Write what is left, if the disk lets us."""
        self._hand_over()
        try:
            self._batches.put_nowait(b"")
        except queue.Full:
            pass
        else:
            self._thread.join(PATIENCE)
        if self._thread.is_alive():
            _log.warning("%s: the disk is too slow; the end is not recorded", self.path)
        elif self._lost:
            _log.warning("%s: %d bytes are missing", self.path, self._lost)

    def _hand_over(self) -> None:
        batch = b"".join(self._waiting)
        self._waiting.clear()
        if not batch:
            return
        try:
            self._batches.put_nowait(batch)
        except queue.Full:
            self._lose(len(batch), "the disk is too slow")

    def _run(self) -> None:
        """Write batch by batch, until an empty one."""
        while batch := self._batches.get():
            rest = memoryview(batch)
            try:
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self._lose(len(rest), error.strerror or str(error))
        self._file.close()

    def _lose(self, size: int, reason: str) -> None:
        """Count what is not recorded; say so once."""
        if not self._lost:
            _log.warning("%s: %s; not all is recorded", self.path, reason)
        self._lost += size


def _create(path: Path) -> tuple[Path, BinaryIO]:
    """Open a new file without a buffer; where there is one of that name, put a number behind it."""
    number, free = 1, path
    while True:
        try:
            return free, free.open("xb", buffering=0)
        except FileExistsError:
            number += 1
            free = path.with_name(f"{path.stem}-{number}{path.suffix}")
