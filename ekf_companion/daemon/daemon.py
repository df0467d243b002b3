"""The daemon: one link, one session, one pipeline, one loop; beside it threads that write."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import signal
import sys
import threading
import time
from collections.abc import Callable

from ekf_companion.config.config import Config
from ekf_companion.daemon import logging as journal
from ekf_companion.daemon.bandwidth import overloads
from ekf_companion.daemon.checkpoint_file import clocks, open_keeper, open_memory
from ekf_companion.daemon.http import open_endpoint
from ekf_companion.daemon.key_file import open_keyring
from ekf_companion.daemon.monitors import Monitors
from ekf_companion.daemon.reception import hear, open_reception, unix_clock
from ekf_companion.daemon.systemd import Systemd
from ekf_companion.daemon.tlog_recorder import open_recorder
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.tuning import Tuning
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.errors import CompanionError, ConfigError
from ekf_companion.link.link import Link, Received
from ekf_companion.status.observer import Observer

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from exceptiongroup import BaseExceptionGroup
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 0.1
"""Seconds between two looks at what time brings while nothing comes."""
LEAST_NS = 50_000_000
"""Between two looks while much comes: each costs as much as several samples."""
LAST_WORDS = 0.1
"""Seconds for the last message to leave a serial port, whose closing throws away what waits."""

CLOSING = 1.2
"""Seconds that all our threads have to end, however many disks hang: with the last words, and the
interpreter's own end, no more than 2 s pass from SIGTERM."""


def run(read: Callable[[], Config]) -> None:
    """Serve with the configuration that is read, now and again at every SIGHUP.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The configuration is wrong.
        CompanionError: A bug; its traceback is in the log.
    """
    config = read()
    try:
        asyncio.run(serve(config, read))
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


async def serve(config: Config, read: Callable[[], Config]) -> None:
    """Run until SIGTERM or SIGINT; take at SIGHUP what has changed, and can be taken in flight.

    Raises:
        LinkError: The link's URL names no link.
        ConfigError: A name can be none of a file, or the key is none.
    """
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    daemon = Daemon(config)
    # Before it says that it is ready: whoever waits for that may reload at once
    loop.add_signal_handler(signal.SIGHUP, daemon.reload, read)
    with daemon:
        async with TaskGroup() as group:
            pumps = [group.create_task(link.run()) for link in daemon.links]
            tick = group.create_task(daemon.tick())
            await stop.wait()
            tick.cancel()
            daemon.say_goodbye()
            await asyncio.sleep(LAST_WORDS)
            for pump in pumps:
                pump.cancel()
    _log.info("Stopped")


class Daemon:
    """The parts of one run; heart and watchdog beat with the filter or not at all."""

    def __init__(self, config: Config) -> None:
        """Make ready.

        Raises:
            LinkError: The link's URL names no link.
            ConfigError: A name can be none of a file, or the key is none.
        """
        for words in overloads(config):
            _log.warning("%s", words)
        self._due_ns = 0
        # What the last run left is read beside while the rest is made ready
        self._keeper = open_keeper(config.checkpoint.file, config.checkpoint.interval)
        self._memory = memory = open_memory(config.checkpoint.file)
        self._keyring = keyring = open_keyring(config)
        self.link = open_reception(
            config,
            is_signed=keyring is not None,
            on_read=self.receive,
            on_state=self._greet,
            on_sent=self._note_sent,
        )
        signing = None if keyring is None else keyring.signing
        self._monitors: Monitors | None = None
        if config.output.monitors:
            self._monitors = Monitors(config, self.link, signing)
        self._recorder = open_recorder(config.record)
        found = None if self._keeper is None else self._keeper.read()
        warm_start = WarmStart(found, clocks(), unix_clock(), config.checkpoint.limit)
        tuning = Tuning(config)
        if memory is not None:
            tuning = Tuning(config, memory.read(), str(memory.path), memory.keep)
        self._companion = Companion(config, self._recorder is not None, warm_start, signing, tuning)
        self._observer = Observer(
            self.link, self._companion, unix_clock, self._recorded, self._unheard
        )
        self._endpoint = open_endpoint(config.http, self._observer, asyncio.get_running_loop())
        self._systemd = Systemd()

    def __enter__(self) -> Daemon:
        # What lives as long as we do need not be looked through for garbage
        gc.collect()
        gc.freeze()
        self._systemd.tell("READY=1")
        return self

    def __exit__(self, *error: object) -> None:
        parts = (self._endpoint, self._keeper, self._memory, self._keyring, self._recorder)
        running = [part for part in parts if part is not None]
        for part in running:
            part.finish()
        end_s = time.monotonic() + CLOSING
        for part in running:
            part.join(end_s)

    @property
    def links(self) -> list[Link]:
        """All that are to be run: the autopilot's, and the monitors'."""
        return [self.link, *([] if self._monitors is None else self._monitors.links)]

    def receive(self, received: Received) -> None:
        """Take what was read, send what follows from it, and say whom to go on listening to."""
        companion, now_ns = self._companion, received.now_ns
        hear(received, companion.receive, companion.session, self.link)
        if now_ns >= self._due_ns:
            self._do_what_is_due(now_ns)
        else:
            self._send(now_ns)

    async def tick(self) -> None:
        """Keep time while nothing comes."""
        while True:
            if (now_ns := unix_clock()) >= self._due_ns:
                self._do_what_is_due(now_ns)
            due = time.monotonic() + TICK
            await asyncio.sleep(TICK)
            self._observer.late(time.monotonic() - due)
            journal.tell()

    def reload(self, read: Callable[[], Config]) -> None:
        """Read the configuration again, beside the loop, and take what can be taken."""
        loop = asyncio.get_running_loop()

        def read_beside() -> None:
            answer: Config | CompanionError
            try:
                answer = read()
            except CompanionError as error:
                answer = error
            except Exception as error:  # noqa: BLE001  # whoever waits for the reload needs an end
                _log.exception("The configuration cannot be read, by a bug")
                answer = ConfigError(f"cannot be read, by a bug: {error!r}; please report it")
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(self._take, answer)

        self._systemd.reloading()
        threading.Thread(target=read_beside, name="reload", daemon=True).start()

    def _take(self, read: Config | CompanionError) -> None:
        """Go on with what was read, or as before."""
        is_wrong = isinstance(read, CompanionError)
        words = self._companion.reload(str(read) if isinstance(read, CompanionError) else read)
        level, reason = (logging.ERROR, "refused") if is_wrong else (logging.INFO, "taken")
        _log.log(level, "Reload: %s", words, extra={"EKF_EVENT": "reload", "EKF_REASON": reason})
        self._systemd.tell("READY=1")

    def say_goodbye(self) -> None:
        """Send the last heartbeat, when nothing else can be said any more."""
        self._systemd.tell("STOPPING=1")
        now_ns = unix_clock()
        self._companion.close(now_ns)
        if self._monitors is not None:
            self._monitors.say_goodbye()
        self._send(now_ns)
        self._keep()

    def _greet(self, is_open: bool) -> None:
        """Be heard as soon as there is a link."""
        if is_open:
            self._do_what_is_due(unix_clock())

    def _do_what_is_due(self, now_ns: int) -> None:
        self._due_ns = now_ns + LEAST_NS
        companion = self._companion
        if self.link.opened:
            companion.tick(now_ns)
        self._send(now_ns)
        if self._keeper is not None and self._keeper.is_due(now_ns, companion.resets):
            self._keep()
        if self._keyring is not None:
            self._keyring.keep(now_ns)
        if not self._observer.is_barren:
            self._systemd.beat(now_ns)
        self._systemd.report(now_ns, self._observer.words)

    def _send(self, now_ns: int) -> None:
        for data, is_replaceable in self._companion.frames_to_send():
            self.link.send(data, is_replaceable=is_replaceable)
        if self._monitors is not None:
            self._monitors.send_due(self._companion, now_ns)
        if self._recorder is not None:
            self._recorder.write(self._companion.session.take_record())
        self._observer.beat(now_ns)

    def _note_sent(self, waited_ns: int) -> None:
        self._observer.sent(waited_ns)

    def _recorded(self) -> tuple[int, int, str]:
        """Give the bytes that were recorded, those that should have been, and why they are not."""
        if (ours := self._recorder) is None:
            return 0, 0, ""
        return ours.recorded_bytes, ours.unrecorded_bytes, ours.trouble

    def _unheard(self) -> dict[str, int]:
        """Give the datagrams that found no monitor, by its address."""
        return {} if self._monitors is None else self._monitors.unsent

    def _keep(self) -> None:
        if self._keeper is not None and (data := self._companion.checkpoint(clocks())) is not None:
            self._keeper.keep(data)
