"""The process of a lidar: what it sends in, its odometry to the daemon as ODOMETRY.

A Livox sends datagrams; of any other lidar ROS 2 has the points, and inertial samples. One loop
receives; a thread beside it takes one scan after the other. What a scan costs delays nobody:
neither what comes here, nor the daemon, which is a process of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import signal
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ekf_companion.arrays.board import Board
from ekf_companion.daemon import logging as log
from ekf_companion.daemon.clock import unix_offset
from ekf_companion.daemon.loop import run_loop
from ekf_companion.daemon.systemd import Systemd
from ekf_companion.errors import LinkError
from ekf_companion.lidar.live import Live, Pose
from ekf_companion.lidar.livox import IMU_PORT, MID_360, POINT_PORT, Inertial
from ekf_companion.lidar.livox_command import COMMAND_PORT, HOST_PORT, configure, read_answer
from ekf_companion.lidar.messages import Messages
from ekf_companion.lidar.recording import Mounting, StampedScan
from ekf_companion.lidar.settings import Settings
from ekf_companion.link.ros2 import CLOUD, IMU, Network, Ros2, stamp_ns
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.relative_pose import FLU_TO_FRD

if sys.version_info >= (3, 11):
    from asyncio import TaskGroup
else:
    from taskgroup import TaskGroup

_log = logging.getLogger(__name__)

TICK = 1.0
"""Seconds from one look at the state to the next."""
SILENT_NS = 2_000_000_000
"""Without a datagram for so long the lidar is told anew to send: it may have been switched off."""
STUCK_NS = 5_000_000_000
"""A scan that takes so long stops the watchdog's signal: a start takes a tenth of that."""
RECEIVE_BUFFER = 4 << 20
"""Bytes asked of the kernel for each socket: a second of a Mid-360."""
READS = 64
"""Datagrams that are read before the loop does something else: 30 ms of a Mid-360."""
LARGEST = 2048
_TURNED = np.kron(np.eye(2), FLU_TO_FRD)


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarOptions:
    """Which lidar, how it is mounted, and where its odometry goes."""

    lidar: str
    """A Livox' numeric address; from no other one a datagram is used. Or the topic of its points in
    ROS 2, which begins with a slash."""
    command_port: int = COMMAND_PORT
    """Of the lidar."""
    listen: str = "0.0.0.0"
    """The address here."""
    point_port: int = POINT_PORT
    imu_port: int = IMU_PORT
    host_port: int = HOST_PORT
    """Of the commands, here."""
    is_configured: bool = True
    """Whether it is told to send, and where to."""
    imu_topic: str = "/imu"
    network: Network = field(default_factory=Network)
    """Of ROS 2."""
    aid_host: str = "127.0.0.1"
    aid_port: int = 14560
    """Of the daemon's ``link.aid_url``."""
    system_id: int = 240
    mounting: Mounting = MID_360
    """Of the lidar on its inertial sensor."""
    on_vehicle: Array = field(default_factory=lambda: np.eye(3))
    """Inertial sensor to vehicle, both forward, left, up, shape (3, 3)."""
    settings: Settings = field(default_factory=Settings)


def run(options: LidarOptions) -> None:
    """Serve until SIGTERM or SIGINT.

    Raises:
        LinkError: A port here is taken, an address is none of this computer's, or a topic has no
            name of one.
        MissingPackageError: The extra for ROS 2 is not installed.
        CompanionError: A bug; its traceback is in the log.
    """
    run_loop(_serve(options))


async def _serve(options: LidarOptions) -> None:
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    kind = Ros2LidarProcess if options.lidar.startswith("/") else LivoxProcess
    with kind(options) as process:
        async with TaskGroup() as group:
            tasks = [group.create_task(process.estimate()), group.create_task(process.watch())]
            await stop.wait()
            for task in tasks:
                task.cancel()
    log.flush(is_end=True)
    _log.info("Stopped")


class LidarProcess(ABC):
    """The state of one lidar; how it is heard its kind says."""

    def __init__(self, options: LidarOptions) -> None:
        """Open the ports; raise what ``run`` does."""
        self.options = options
        self.live = Live(options.mounting, options.settings)
        self.sent = 0
        self.cost = 0.0
        """Of a scan, the mean of the last ten or so, s."""
        self._begun_ns: int | None = None
        """When the scan that is being processed was begun; None: none is."""
        self._systemd = Systemd()
        self._sockets = contextlib.ExitStack()
        self._ready = asyncio.Event()
        self._heard_ns = 0
        """When the last datagram was used, monotonic; 0: none was."""
        self._is_sending = False
        self._said: Counter[str] = Counter()
        self._world = 0
        # Another one than before a restart, so that the daemon knows of a new frame
        self._first_frame = time.time_ns() // 1_000_000_000 % 256

    def __enter__(self) -> LidarProcess:
        options = self.options
        try:
            self._board = self._sockets.enter_context(
                Board(options.aid_port, host=options.aid_host, system_id=options.system_id)
            )
            where = self.open()
        except BaseException:
            self._sockets.close()
            raise
        _log.info(
            "Lidar %s: waiting for it at %s; its odometry goes to %s port %d",
            options.lidar,
            where,
            options.aid_host,
            options.aid_port,
        )
        self._systemd.notify("READY=1")
        return self

    @abstractmethod
    def open(self) -> str:
        """Open what it is heard by, to be closed with ``_sockets``; return where that is."""

    @abstractmethod
    def ask(self) -> None:
        """Ask a lidar that is silent to send."""

    @abstractmethod
    def left_out(self) -> dict[str, int]:
        """Return what of it was left out before it reached the filter, by the reason."""

    def __exit__(self, *error: object) -> None:
        self._systemd.notify("STOPPING=1")
        self._sockets.close()

    async def estimate(self) -> None:
        """Take each scan as it comes, and send what is found."""
        while True:
            await self._ready.wait()
            self._ready.clear()
            while (job := self.live.take()) is not None:
                self._begun_ns = time.monotonic_ns()
                poses = await asyncio.to_thread(self.live.process, job)
                spent = (time.monotonic_ns() - self._begun_ns) * 1e-9
                self._begun_ns = None
                self.cost += 0.1 * (spent - self.cost)
                if poses:  # those of a start are a second old, but for the last
                    self._send(poses[-1])

    def _send(self, pose: Pose) -> None:
        if pose.world != self._world:
            why = self.live.collector.why
            if self._world:
                _log.warning("Lidar: begins anew: %s", why or "no scans for long")
            else:
                _log.info("Lidar: the start is found")
            self._world = pose.world
        place = FLU_TO_FRD @ pose.pos
        C = FLU_TO_FRD @ pose.C @ self.options.on_vehicle.T @ FLU_TO_FRD
        P = _TURNED @ pose.P @ _TURNED
        with contextlib.suppress(OSError):  # the daemon is not there, for now
            self._board.send(
                t=pose.ours_ns + unix_offset(),
                position=place,
                q=so3.from_matrix(C),
                pose_covariance=0.5 * (P + P.T),
                reset_counter=self._first_frame + pose.world,
            )
            self.sent += 1

    async def watch(self) -> None:
        """Ask the lidar to send while it does not, and report what changes."""
        while True:
            now_ns = time.monotonic_ns()
            is_sending = self._heard_ns > 0 and now_ns - self._heard_ns < SILENT_NS
            if is_sending != self._is_sending:
                self._is_sending = is_sending
                words = "sends" if is_sending else "is silent"
                _log.log(
                    logging.INFO if is_sending else logging.WARNING,
                    "Lidar %s: %s",
                    self.options.lidar,
                    words,
                )
            if not is_sending:
                self.ask()
            self._say_what_grew()
            if self._begun_ns is None or now_ns - self._begun_ns < STUCK_NS:
                self._systemd.beat(now_ns)
            self._systemd.status(self.describe())
            log.flush()
            await asyncio.sleep(TICK)

    def counts(self) -> dict[str, int]:
        """Return what was left out, by the reason."""
        dropped = {f"scans dropped, {why}": count for why, count in self.live.dropped.items()}
        return {**dropped, **self.left_out()}

    def _say_what_grew(self) -> None:
        for what, count in self.counts().items():
            if count > self._said[what]:
                _log.warning("Lidar: %s: %d", what, count, extra={"EKF_REASON": what})
                self._said[what] = count

    def describe(self) -> str:
        """Return the state in one line."""
        state = "sends" if self._is_sending else "silent"
        left_out = ", ".join(f"{what} {count}" for what, count in self.counts().items() if count)
        return (
            f"lidar {state}, {self.live.processed} scans, {1e3 * self.cost:.0f} ms each, "
            f"{self.sent} poses sent" + (f"; {left_out}" if left_out else "")
        )


class LivoxProcess(LidarProcess):
    """The sockets of a Livox."""

    def __init__(self, options: LidarOptions) -> None:
        """Open the ports; raise what ``run`` does."""
        super().__init__(options)
        self.foreign: Counter[str] = Counter()
        """Datagrams of other addresses."""
        self._number = 0
        self._answer: str | None = None

    def open(self) -> str:
        """Open the ports."""
        options, loop = self.options, asyncio.get_running_loop()
        for port in (options.point_port, options.imu_port):
            ours = self._open(port)
            loop.add_reader(ours, self._on_data, ours)
            self._sockets.callback(loop.remove_reader, ours)
        self._commands = self._open(options.host_port)
        loop.add_reader(self._commands, self._on_answer)
        self._sockets.callback(loop.remove_reader, self._commands)
        return f"ports {options.point_port} and {options.imu_port}"

    def _open(self, port: int) -> socket.socket:
        ours = self._sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        try:
            ours.bind((self.options.listen, port))
        except OSError as error:
            what = "taken by another program: stop it, or name others with --ports"
            if error.errno != errno.EADDRINUSE:
                what = error.strerror or str(error)
            raise LinkError(f"{self.options.listen} port {port}: {what}") from None
        return ours

    def _on_data(self, ours: socket.socket) -> None:
        for _ in range(READS):
            try:
                data, sender = ours.recvfrom(LARGEST)
            except OSError:  # nothing more, or what the other end has refused
                break
            # After the read: nothing may seem to have come before it did, as the least lag counts
            now_ns = time.monotonic_ns()
            if sender[0] != self.options.lidar:
                self.foreign[sender[0]] += 1
                continue
            if self.live.receive(data, now_ns):
                self._heard_ns = now_ns
        if self.live.is_ready:
            self._ready.set()

    def _on_answer(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                data, sender = self._commands.recvfrom(LARGEST)
                if sender[0] != self.options.lidar:
                    self.foreign[sender[0]] += 1
                elif (answer := read_answer(data, self._number)) is not None:
                    self._on_configured(answer)

    def _on_configured(self, answer: str) -> None:
        if answer == self._answer:
            return
        self._answer = answer
        if answer:
            _log.warning("Lidar %s: does not take its settings: %s", self.options.lidar, answer)
        else:
            _log.info("Lidar %s: is told to send", self.options.lidar)

    def ask(self) -> None:
        """Ask the lidar to sample and to send here, by the address that it sees."""
        options = self.options
        if not options.is_configured:
            return
        self._number += 1
        with contextlib.suppress(OSError):  # no route yet
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.connect((options.lidar, options.command_port))
                host = probe.getsockname()[0]
            said = configure(self._number, host, options.point_port, options.imu_port)
            self._commands.sendto(said, (options.lidar, options.command_port))

    def left_out(self) -> dict[str, int]:
        """Return the datagrams that were, by the reason."""
        collector = self.live.collector
        return {
            "datagrams lost": collector.lost,
            "datagrams too late": collector.late,
            "datagrams repeated": collector.repeated,
            "datagrams of others": sum(self.foreign.values()),
            **{f"datagrams {why}": count for why, count in collector.refused.items()},
        }


class Ros2LidarProcess(LidarProcess):
    """A lidar whose points and inertial samples ROS 2 has."""

    def open(self) -> str:
        """Join the network."""
        options, loop = self.options, asyncio.get_running_loop()
        self._messages = Messages()
        self._ros2 = self._sockets.enter_context(contextlib.closing(Ros2(options.network)))

        def on_imu(message: Any, data: bytes, now_ns: int) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                for one in self._messages.samples(message, stamp_ns(message), data):
                    loop.call_soon_threadsafe(self._take, one, now_ns)

        def on_cloud(message: Any, _data: bytes, now_ns: int) -> None:
            with contextlib.suppress(RuntimeError):
                for one in self._messages.scans(message, stamp_ns(message)):
                    loop.call_soon_threadsafe(self._take, one, now_ns)

        self._ros2.subscribe(options.imu_topic, IMU, on_imu)
        self._ros2.subscribe(options.lidar, CLOUD, on_cloud)
        return f"zenoh, with inertial samples of {options.imu_topic}"

    def _take(self, one: Inertial | StampedScan, now_ns: int) -> None:
        """Take what has come."""
        for words in self._messages.decisions():
            _log.info("Lidar %s: %s", self.options.lidar, words)
        if self.live.take_in(one, now_ns):
            self._heard_ns = now_ns
        if self.live.is_ready:
            self._ready.set()

    def ask(self) -> None:
        """Wait: a driver of ROS sends by itself."""

    def left_out(self) -> dict[str, int]:
        """Return the messages that were, by the reason."""
        collector = self.live.collector
        return {
            "messages too late": collector.late,
            "samples repeated": collector.repeated,
            **{f"messages {why}": count for why, count in self._messages.refused.items()},
            **{f"messages of {topic} that are none": n for topic, n in self._ros2.refused.items()},
        }
