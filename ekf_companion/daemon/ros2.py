"""The process between the daemon and ROS 2: nav_msgs/Odometry to it, and its estimates back.

Both go by zenoh on the one side and by MAVLink on the other, as any program of this board speaks to
the daemon: it needs no part of ROS, and its recordings hold what it was sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ekf_companion.arrays.board import Board, BoardEstimate
from ekf_companion.arrays.ros2 import read_odometry, write_odometry
from ekf_companion.daemon import logging as log
from ekf_companion.daemon.loop import run_loop
from ekf_companion.daemon.systemd import Systemd
from ekf_companion.errors import DataError, LinkError
from ekf_companion.link.ros2 import ODOMETRY, Network, Ros2, stamp_ns
from ekf_companion.nav.stamps import least_lag

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 1.0
"""Seconds from one look at the state to the next, and longest wait for an estimate."""
LEAPT_NS = 1_000_000_000
"""The autopilot's clock has begun anew where a stamp is so far from the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Options:
    """Which topics, and where the daemon is."""

    odometry: str | None = None
    """Topic whose poses and velocities go to the daemon; None: none."""
    estimate: str | None = None
    """Topic of the daemon's estimates; None: they are not published."""
    network: Network = field(default_factory=Network)
    aid_host: str = "127.0.0.1"
    aid_port: int = 14560
    """Of the daemon's ``link.aid_url``."""
    estimate_port: int = 14561
    """Of ``udpout:127.0.0.1:PORT`` in its ``output.monitors``."""
    system_id: int = 240
    frame: str = "odom"
    body: str = "base_link"
    """Names of the frames of what is published."""


def run(options: Ros2Options) -> None:
    """Serve until SIGTERM or SIGINT.

    Raises:
        LinkError: The port is taken, an endpoint is none, or a topic has no name of one.
        MissingPackageError: The extra is not installed.
        CompanionError: A bug; its traceback is in the log.
    """
    run_loop(_serve(options))


async def _serve(options: Ros2Options) -> None:
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    with contextlib.closing(Ros2Process(options)) as process:
        async with TaskGroup() as group:
            tasks = [group.create_task(process.publish()), group.create_task(process.watch())]
            await stop.wait()
            for task in tasks:
                task.cancel()
    log.flush(is_end=True)
    _log.info("Stopped")


class Ros2Process:
    """The session, the sockets and the counts."""

    def __init__(self, options: Ros2Options) -> None:
        """Open all; raise what ``run`` does."""
        self.options = options
        self.heard = self.sent = self.published = 0
        """Messages of the topic, those that went to the daemon, and estimates."""
        self.refused: Counter[str] = Counter()
        """Messages that did not go to the daemon, by the reason."""
        self._loop = asyncio.get_running_loop()
        self._systemd = Systemd()
        self._said: Counter[str] = Counter()
        self._lag_ns: int | None = None
        self._received_ns = 0
        self._was_heard = False
        port = options.estimate_port if options.estimate else None
        try:
            self._board = Board(
                options.aid_port, port, host=options.aid_host, system_id=options.system_id
            )
        except OSError as error:
            raise LinkError(
                f"127.0.0.1 port {port}: {error.strerror}: another program has it; name another "
                "with --estimate-port, and in output.monitors"
            ) from None
        parts = contextlib.ExitStack()
        parts.callback(self._board.close)
        with parts:
            self._ros2 = Ros2(options.network)
            parts.callback(self._ros2.close)
            if options.odometry:
                self._ros2.subscribe(options.odometry, ODOMETRY, self._on_message)
            if options.estimate:
                self._publish = self._ros2.advertise(options.estimate, ODOMETRY)
            self._parts = parts.pop_all()
        _log.info(
            "ROS 2 by zenoh at %s, domain %d: %s",
            ", ".join((*options.network.connect, *options.network.listen)),
            options.network.domain,
            "; ".join(
                [f"poses of {options.odometry}"] * bool(options.odometry)
                + [f"estimates to {options.estimate}"] * bool(options.estimate)
            ),
        )
        self._systemd.notify("READY=1")

    def close(self) -> None:
        """Leave the network."""
        self._systemd.notify("STOPPING=1")
        self._parts.close()

    def _on_message(self, message: Any, _data: bytes, _now_ns: int) -> None:
        # On a thread of zenoh; the loop may have ended
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._send, message)

    def _send(self, message: Any) -> None:
        """Send a pose to the daemon."""
        self.heard += 1
        try:
            with contextlib.suppress(OSError):  # the daemon is not there, for now
                self._board.send(t=stamp_ns(message), **read_odometry(message))
                self.sent += 1
        except DataError as error:
            self.refused[str(error).partition(":")[0]] += 1
            if not self._said["refused"]:
                self._said["refused"] = 1
                _log.warning("ROS 2: %s: not used: %s", self.options.odometry, error)

    async def publish(self) -> None:
        """Publish each estimate of the daemon."""
        if self.options.estimate is None:
            return
        while True:
            one = await asyncio.to_thread(self._board.read, TICK)
            if one is None:
                continue
            message = write_odometry(
                one, self._unix(one), self._ros2.types, self.options.frame, self.options.body
            )
            if message is not None:
                self._publish(message)
                self.published += 1

    def _unix(self, one: BoardEstimate) -> int:
        """Return when an estimate was true by unix time: the least lag is taken for none."""
        lag_ns, since_ns = one.received_ns - one.t_ns, one.received_ns - self._received_ns
        if self._lag_ns is not None and abs(lag_ns - self._lag_ns) < LEAPT_NS:
            lag_ns = least_lag(self._lag_ns, lag_ns, since_ns)
        self._lag_ns, self._received_ns = lag_ns, one.received_ns
        return one.t_ns + lag_ns

    async def watch(self) -> None:
        """Report what changes."""
        before = 0
        while True:
            is_heard = self.heard > before
            if is_heard != self._was_heard:
                words = "comes" if is_heard else "is silent"
                level = logging.INFO if is_heard else logging.WARNING
                _log.log(level, "ROS 2: %s: %s", self.options.odometry, words)
            before, self._was_heard = self.heard, is_heard
            self._systemd.beat(time.monotonic_ns())
            self._systemd.status(self.describe())
            log.flush()
            await asyncio.sleep(TICK)

    def describe(self) -> str:
        """Return the state in one line."""
        refused = self.refused + self._ros2.refused
        left_out = ", ".join(f"{what} {count}" for what, count in refused.items())
        return f"ROS 2: {self.sent} poses to the daemon, {self.published} estimates published" + (
            f"; refused: {left_out}" if left_out else ""
        )
