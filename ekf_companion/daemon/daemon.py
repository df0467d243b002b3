"""The daemon: one link, one session, one pipeline, one loop; threads for its files."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import random
import signal
import sys
import threading
import time
from collections.abc import Callable

from ekf_companion.config.config import Config
from ekf_companion.daemon import logging as log
from ekf_companion.daemon.access import own_names
from ekf_companion.daemon.bandwidth import capacity, overloads
from ekf_companion.daemon.checkpoint_file import open_checkpoint_file, open_parameter_file
from ekf_companion.daemon.clock import read_clocks, unix_clock
from ekf_companion.daemon.exporters import open_exporters
from ekf_companion.daemon.freshness import Freshness
from ekf_companion.daemon.http import open_http_server
from ekf_companion.daemon.key_file import open_signing
from ekf_companion.daemon.loop import run_loop
from ekf_companion.daemon.monitors import Monitors
from ekf_companion.daemon.recent_events import RecentEvents
from ekf_companion.daemon.reception import deliver, open_aid_port, open_reception
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
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 0.1
"""Seconds between two periodic runs while nothing comes."""
TICK_NS = round(TICK * 1e9)
PAUSE_NS = 1_000_000_000
"""Without a run of the loop for so long, the process was stopped or the board is overloaded: PX4
has stopped using ODOMETRY by then, and texts about silence would blame others."""
LEAST_NS = 50_000_000
"""Shortest time between two periodic runs: each costs as much as several samples."""
WAIT_NS = 30_000_000
"""Longest time for which read bytes may be batched: about that between two ODOMETRYs at 30 Hz."""
DRAIN = 0.1
"""Seconds for the last message to leave a serial port, whose closing discards what waits."""
READING = 3.0
"""Longest time for a reload to read the configuration, s: less than ``ekf-companion reload`` waits.
"""
CLASH_PATIENCE_NS = (5_000_000_000, 15_000_000_000)
"""Wait for another sender with our ids before we send; drawn at random, so that of two daemons only
one begins."""
CLOSING = 1.2
"""Seconds that all threads have to end, even if disks hang: with the drain and the interpreter's
own end, at most 2 s pass from SIGTERM."""


def run(read: Callable[[], Config]) -> None:
    """Serve with the configuration that ``read`` returns, now and at every SIGHUP.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The configuration is wrong.
        CompanionError: A bug; its traceback is in the log.
    """
    config = read()
    run_loop(serve(config, read))


async def serve(config: Config, read: Callable[[], Config]) -> None:
    """Run until SIGTERM or SIGINT; at SIGHUP, apply the changes that can be applied in flight.

    Raises:
        LinkError: The link's URL names no link.
        ConfigError: No file can have one of the names, or the key is not one.
    """
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    daemon = Daemon(config)
    # Before READY=1: whoever waits for that may reload at once
    loop.add_signal_handler(signal.SIGHUP, daemon.reload, read)
    with daemon:
        async with TaskGroup() as group:
            pumps = [group.create_task(link.run()) for link in daemon.links]
            tick = group.create_task(daemon.tick())
            await stop.wait()
            tick.cancel()
            daemon.say_goodbye()
            await asyncio.sleep(DRAIN)
            for pump in pumps:
                pump.cancel()
    log.flush(is_end=True)
    _log.info("Stopped")


class Daemon:
    """The parts of one run; heartbeat and watchdog stop if the filter does."""

    def __init__(self, config: Config) -> None:
        """Start the threads, and make the rest ready; raise what ``serve`` does."""
        for words in overloads(config):
            _log.warning("%s", words)
        self._due_ns = 0
        self._ran_ns = 0
        """When the loop last ran."""
        self._waiting: list[Received] = []
        self._is_reading = False
        self._reading_limit: asyncio.TimerHandle | None = None
        # The state of the last run is read by threads while the rest is made ready
        self._checkpoint = open_checkpoint_file(config.checkpoint.file, config.checkpoint.interval)
        self._parameters = parameters = open_parameter_file(config.checkpoint.file)
        self._signing = open_signing(config)
        signing = None if self._signing is None else self._signing.signing
        self.link = open_reception(
            config,
            is_signed=signing is not None,
            on_read=self.receive,
            on_state=self._on_state,
            on_sent=self._on_sent,
        )
        self._aid_port = open_aid_port(config, self.receive_from_board)
        self._monitors = Monitors(config, self.link, signing)
        self._recorder = open_recorder(config.record)
        found = None if self._checkpoint is None else self._checkpoint.read()
        warm_start = WarmStart(found, read_clocks(), unix_clock(), config.checkpoint.limit)
        tuning = Tuning(config)
        if parameters is not None:
            tuning = Tuning(config, parameters.read(), str(parameters.path), parameters.write)
        self._companion = Companion(config, self._recorder is not None, warm_start, signing, tuning)
        session = self._companion.session
        session.delivery.pacing.capacity = capacity(self.link.address)
        session.clash.patience_ns = random.randint(*CLASH_PATIENCE_NS)
        session.second_source.patience_ns = random.randint(*CLASH_PATIENCE_NS)
        self._observer = Observer(
            self.link, self._companion, unix_clock, self._recorded, self._monitors.unsent
        )
        self._events = RecentEvents()
        logging.root.addHandler(self._events)
        loop = asyncio.get_running_loop()
        self._http = open_http_server(config.http, self._observer, loop, self._events)
        self._exporters = open_exporters(config.live, self._observer, loop, own_names(config.http))
        self._systemd = Systemd()
        self._freshness = Freshness()

    def __enter__(self) -> Daemon:
        # Objects that live as long as the daemon need no garbage collection; garbage there is none
        gc.freeze()
        self._systemd.notify("READY=1")
        return self

    def __exit__(self, *error: object) -> None:
        logging.root.removeHandler(self._events)
        state = (self._checkpoint, self._parameters, self._signing)
        parts = (self._http, *self._exporters, *state, self._recorder)
        running = [part for part in parts if part is not None]
        for part in running:
            part.finish()
        end_s = time.monotonic() + CLOSING
        for part in running:
            part.join(end_s)

    @property
    def links(self) -> list[Link]:
        """The links to run: the autopilot's, the second port, and the monitors'."""
        aid_ports = [] if self._aid_port is None else [self._aid_port]
        return [self.link, *aid_ports, *self._monitors.links]

    def receive(self, received: Received) -> None:
        """Process what was read, and send what follows from it.

        Bytes that need no answer, and after which no output is due, are batched until the next
        output: an idle processor reloads its caches then once for all of them.
        """
        now_ns, waiting = received.now_ns, self._waiting
        self._notice_pause(now_ns)
        waiting.append(received)
        has_time = now_ns - waiting[0].now_ns < WAIT_NS
        if has_time and self._companion.may_wait(received.data, self._monitors.due_ns):
            return
        self._process_waiting()
        if now_ns >= self._due_ns:
            self._run_periodic(now_ns)
        else:
            self._send(now_ns)

    def receive_from_board(self, received: Received) -> None:
        """Process what software of this board sent beside the link, after all that came before."""
        data, now_ns, sender = received
        self._notice_pause(now_ns)
        self._process_waiting()
        self._companion.receive_from_board(data, now_ns, sender)
        self._send(now_ns)

    def _process_waiting(self) -> None:
        companion, waiting = self._companion, self._waiting
        self._waiting = []
        for received in waiting:
            deliver(received, companion.receive, companion.session, self.link)

    async def tick(self) -> None:
        """Run the periodic work while nothing comes."""
        while True:
            if (now_ns := unix_clock()) >= self._due_ns:
                self._run_periodic(now_ns)
            due = time.monotonic() + TICK
            await asyncio.sleep(TICK)
            self._observer.on_late_timer(time.monotonic() - due)
            log.flush()

    def reload(self, read: Callable[[], Config]) -> None:
        """Read the configuration again, on a thread, and apply what can be applied in flight.

        A file that takes too long to read, such as one on a share that is gone, is not waited for.
        """
        loop = asyncio.get_running_loop()

        def read_again() -> None:
            answer: Config | CompanionError
            try:
                answer = read()
            except CompanionError as error:
                answer = error
            except Exception as error:  # noqa: BLE001  # whoever waits for the reload needs an answer
                _log.exception("The configuration cannot be read, by a bug")
                answer = ConfigError(f"cannot be read, by a bug: {error!r}; please report it")
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(self._on_read, answer)

        self._systemd.notify_reloading()
        if self._is_reading:
            self._apply(ConfigError("the configuration is still being read; wait for that"))
            return
        self._is_reading = True
        self._reading_limit = loop.call_later(READING, self._on_unread)
        threading.Thread(target=read_again, name="reload", daemon=True).start()

    def _on_read(self, answer: Config | CompanionError) -> None:
        """Use the configuration that was read, unless the reading was abandoned."""
        self._is_reading = False
        if self._reading_limit is not None:
            self._reading_limit.cancel()
            self._reading_limit = None
            self._apply(answer)

    def _on_unread(self) -> None:
        """Abandon the reading; another may begin when its thread has ended."""
        self._reading_limit = None
        self._apply(ConfigError(f"the configuration could not be read within {READING:g} s"))

    def _apply(self, read: Config | CompanionError) -> None:
        """Apply the configuration that was read, or log why there is none."""
        self._process_waiting()
        is_wrong = isinstance(read, CompanionError)
        words = self._companion.reload(str(read) if isinstance(read, CompanionError) else read)
        level, reason = (logging.ERROR, "refused") if is_wrong else (logging.INFO, "taken")
        _log.log(level, "Reload: %s", words, extra={"EKF_EVENT": "reload", "EKF_REASON": reason})
        self._systemd.notify("READY=1")

    def say_goodbye(self) -> None:
        """Send the last heartbeat, and write the last checkpoint."""
        self._systemd.notify("STOPPING=1")
        self._process_waiting()
        now_ns = unix_clock()
        if self.link.opened:
            self._companion.close(now_ns)
        self._monitors.say_goodbye()
        self._send(now_ns)
        self._write_checkpoint()

    def _on_state(self, is_open: bool) -> None:
        """Send a heartbeat as soon as the link is open."""
        if is_open:
            self._run_periodic(unix_clock())

    def _notice_pause(self, now_ns: int) -> None:
        """Notice that this process did not run for a while."""
        paused_ns, self._ran_ns = now_ns - self._ran_ns, now_ns
        if PAUSE_NS < paused_ns < now_ns:
            self._companion.on_pause((paused_ns - TICK_NS) * 1e-9, now_ns)

    def _run_periodic(self, now_ns: int) -> None:
        self._notice_pause(now_ns)
        self._process_waiting()
        self._due_ns = now_ns + LEAST_NS
        companion = self._companion
        companion.session.delivery.lag.loop_ns = self._observer.loop_lag_ns
        if self.link.opened:
            companion.tick(now_ns)
        self._send(now_ns)
        if self._checkpoint is not None and self._checkpoint.is_due(now_ns, companion.resets):
            self._write_checkpoint()
        if self._signing is not None:
            self._signing.write(now_ns)
        if not self._observer.is_barren:
            self._systemd.beat(now_ns)
        self._systemd.report(now_ns, self._observer.health_line)

    def _send(self, now_ns: int) -> None:
        companion = self._companion
        newest = companion.estimate
        if newest is not None:
            self._freshness.on_estimate(newest.t_ns, now_ns)
        for data, is_replaceable, t_ns in companion.frames_to_send():
            if is_replaceable and t_ns is not None and not self._is_fresh(t_ns, now_ns):
                self.link.unsent += 1  # it waited to be read
                self._observer.on_stale()
            else:
                self.link.send(data, is_replaceable=is_replaceable)
        if self._monitors.links:
            is_fresh = newest is not None and self._is_fresh(newest.t_ns, now_ns)
            self._monitors.send_due(companion, now_ns, is_fresh=is_fresh)
        if self._recorder is not None:
            self._recorder.write(companion.session.outbox.take_record())
        self._observer.tick(now_ns)

    def _is_fresh(self, t_ns: int, now_ns: int) -> bool:
        """Return whether an estimate of this stamp is new enough to be sent."""
        limit = self._companion.tuning.config.output.odometry.age_limit
        return self._freshness.is_fresh(t_ns, now_ns, limit)

    def _on_sent(self, waited_ns: int) -> None:
        self._observer.on_sent(waited_ns)

    def _recorded(self) -> tuple[int, int, str]:
        """Return the bytes recorded, the bytes that could not be, and why."""
        if (recorder := self._recorder) is None:
            return 0, 0, ""
        return recorder.recorded_bytes, recorder.unrecorded_bytes, recorder.trouble

    def _write_checkpoint(self) -> None:
        if self._checkpoint is None:
            return
        if (data := self._companion.checkpoint(read_clocks())) is not None:
            self._checkpoint.write(data)
