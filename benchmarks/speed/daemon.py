"""The real daemon in a process of its own, over loopback UDP."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.speed.result import Result
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Frame, Splitter
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight

RATE = 250.0
ODOMETRY = "output: {{odometry: {{rate: {rate}}}}}\n"
CONFIG = "link: {{imu_rate: {imu}}}\nhttp: {{host: 127.0.0.1, port: {port}}}\n"
WARM_UP = 5.0
"""s of flight before the measurement: the daemon requests, aligns and finds its position."""
PATIENCE = 60.0
"""s; a daemon that has sent nothing by then never will."""
STARTS = 5
SUSTAINED_RATE = 1000.0
NICE = -10
"""As in the systemd unit, where that is allowed."""
SO_TIMESTAMPNS = 35
"""Linux: the kernel stamps each datagram on arrival; Python has no name for it."""
RECEIVER = (
    "import os; os.environ['MAVLINK20'] = '1'\n"
    "from pymavlink import mavutil\n"
    "link = mavutil.mavlink_connection('udpout:127.0.0.1:{port}')\n"
    "link.mav.heartbeat_send(18, 8, 0, 0, 4)\n"
    "while True: link.recv_match(blocking=True)\n"
)


def measure(
    duration: float = 20.0, starts: int = STARTS, sustained: float = 600.0
) -> Iterator[Result]:
    """Time the way through the daemon, its load and its start."""
    with TemporaryDirectory() as folder:
        config = Path(folder) / "bench.yaml"
        configure(config, RATE)
        yield from _start(config, starts)
        yield from _bare(round(duration * RATE / 2.0))
        yield from _load(config, duration)
        yield from _weighing(config, duration)
        config.write_text(config.read_text() + ODOMETRY.format(rate=RATE), encoding="ascii")
        yield from _loopback(config, duration)
        yield from _sustain(config, sustained)


def configure(config: Path, rate: float) -> int:
    """Write a configuration; return the port of its status."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    config.write_text(CONFIG.format(imu=rate, port=port), encoding="ascii")
    return port


def _start(config: Path, starts: int) -> Iterator[Result]:
    """Time from the process's start to its first HEARTBEAT."""
    spent = []
    for _ in range(starts):
        with open_socket() as ours, running(config, ours) as process:
            began = time.monotonic()
            first_datagram(ours, process)
            spent.append(time.monotonic() - began)
    value = float(np.median(spent))
    yield Result(name="start to first HEARTBEAT, median", value=value, unit="s", aim=0.3)


def _load(config: Path, duration: float) -> Iterator[Result]:
    """Measure the load of the daemon with ODOMETRY at 30 Hz, and of mavutil that only reads."""
    flight = plan(RATE, duration)
    with open_socket() as ours, running(config, ours) as process:
        ours.connect(first_datagram(ours, process))
        _, _, load = fly(flight, ours, process.pid)
        memory = _memory(process.pid)
    name = f"daemon's share of one processor, inertial samples at {RATE:g} Hz"
    yield Result(name=name, value=100.0 * load, unit="%", aim=6.0)
    yield Result(name="daemon's resident memory, largest", value=memory, unit="MB", aim=80.0)
    with open_socket() as ours:
        code = RECEIVER.format(port=ours.getsockname()[1])
        process = subprocess.Popen([sys.executable, "-c", code])
        try:
            ours.connect(first_datagram(ours, process))
            _, _, alone = fly(flight, ours, process.pid)
        finally:
            process.kill()
            process.wait()
    yield Result(
        name="mavutil's share, which only receives the same", value=100.0 * alone, unit="%"
    )
    yield Result(name="daemon over mavutil", value=load / alone, unit="", aim=6.0 / 6.4)


def _weighing(config: Path, duration: float) -> Iterator[Result]:
    """Measure the same where the fault hypotheses decide."""
    usual = config.read_text()
    config.write_text(usual + "weigh_faults: act\n", encoding="ascii")
    flight = plan(RATE, duration)
    with open_socket() as ours, running(config, ours) as process:
        ours.connect(first_datagram(ours, process))
        _, _, load = fly(flight, ours, process.pid)
        memory = _memory(process.pid)
    config.write_text(usual, encoding="ascii")
    name = "daemon's share of one processor, with weigh_faults: act"
    yield Result(name=name, value=100.0 * load, unit="%")
    yield Result(
        name="daemon's resident memory, largest, with weigh_faults: act", value=memory, unit="MB"
    )


def _loopback(config: Path, duration: float) -> Iterator[Result]:
    """Time from a HIGHRES_IMU datagram to the ODOMETRY datagram of its stamp."""
    flight = plan(RATE, duration)
    with open_socket() as ours, running(config, ours) as process:
        ours.connect(first_datagram(ours, process))
        sent, heard, load = fly(flight, ours, process.pid)

    begin = flight.first_ns // 1000 + round(WARM_UP * 1e6)
    wanted = [stamp for stamp in sent if stamp >= begin]
    delays = np.array([heard[stamp] - sent[stamp] for stamp in wanted if stamp in heard]) * 1e-6
    assert len(delays), "no ODOMETRY came back"
    for share, aim in ((50.0, 0.3), (99.0, 1.0), (99.9, 3.0)):
        yield Result(
            name=f"HIGHRES_IMU in to ODOMETRY out at {RATE:g} Hz, p{share:g}",
            value=float(np.percentile(delays, share)),
            unit="ms",
            aim=aim,
        )
    answered = 100.0 * len(delays) / len(wanted)
    yield Result(name="samples answered by an ODOMETRY", value=answered, unit="%")
    name = "daemon's share of one processor, an ODOMETRY for each sample"
    yield Result(name=name, value=100.0 * load, unit="%")


def _sustain(config: Path, duration: float) -> Iterator[Result]:
    """Send inertial samples at 1 kHz, and read from the status how many came."""
    port = configure(config, SUSTAINED_RATE)
    flight = plan(SUSTAINED_RATE, duration)
    with open_socket() as ours, running(config, ours) as process:
        ours.connect(first_datagram(ours, process))
        sent, _, load = fly(flight, ours, process.pid)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=PATIENCE) as answer:
            status = json.load(answer)
    taken = status["messages"]["HIGHRES_IMU"]["count"]
    lost = len(sent) - taken + status["link"]["dropped"] + status["frames"]["lost"]
    minutes = duration / 60.0
    name = f"inertial samples lost of {SUSTAINED_RATE:g} Hz for {minutes:.3g} min"
    yield Result(name=name, value=float(lost), unit="", aim=0.0)
    yield Result(name="daemon's share of one processor there", value=100.0 * load, unit="%")


def plan(rate: float, duration: float) -> Flight:
    """Return a flight of so many seconds after the warm-up."""
    config = SimConfig(imu=ImuConfig(rate=rate))
    return Flight.plan("figure-eight", config, duration=WARM_UP + duration)


def _bare(count: int) -> Iterator[Result]:
    """Time an echo through a bare process: what this machine adds now."""
    code = (
        "import socket as s; u = s.socket(s.AF_INET, s.SOCK_DGRAM); u.bind(('127.0.0.1', 0))\n"
        "print(u.getsockname()[1], flush=True)\n"
        "while True:\n    d, a = u.recvfrom(2048); u.sendto(d, a)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        with open_socket() as ours:
            assert process.stdout is not None, "it was asked for"
            ours.connect(("127.0.0.1", int(process.stdout.readline())))
            ours.settimeout(PATIENCE)
            delays = []
            for _ in range(count):
                time.sleep(1.0 / RATE)
                began = time.monotonic_ns()
                ours.send(b"?")
                ours.recv(16)
                delays.append((time.monotonic_ns() - began) * 1e-6)
    finally:
        process.kill()
        process.communicate()
    for share in (50.0, 99.0):
        value = float(np.percentile(delays, share))
        yield Result(
            name=f"a bare echo through another process, p{share:g}", value=value, unit="ms"
        )


def fly(
    flight: Flight, ours: socket.socket, pid: int
) -> tuple[dict[int, int], dict[int, int], float]:
    """Play the autopilot in real time.

    Returns:
        When HIGHRES_IMU left and when ODOMETRY came, ns by stamp (us), and the processor's share.
    """
    autopilot = Autopilot(flight.config)
    splitter, inbox = Splitter(), Splitter()
    sent: dict[int, int] = {}
    heard: dict[int, int] = {}
    autopilot.heartbeat()
    began, spent = time.monotonic_ns(), 0.0
    for cycle in flight.cycles():
        due = began + cycle.t_ns - flight.first_ns
        _listen(ours, due, inbox, heard, autopilot, cycle.t_ns)
        autopilot.cycle(cycle)
        for data in autopilot.data_to_send():
            (frame,) = splitter.feed(data)
            if frame.message_id == IDS["HIGHRES_IMU"]:
                sent[unpack(frame).time_usec] = time.time_ns()
            ours.send(data)
        if cycle.number == round(WARM_UP * flight.config.imu.rate):
            spent, measured_from = _seconds(pid), time.monotonic_ns()
    _listen(ours, time.monotonic_ns() + 100_000_000, inbox, heard, autopilot, cycle.t_ns)
    return sent, heard, (_seconds(pid) - spent) / ((time.monotonic_ns() - measured_from) * 1e-9)


def _listen(
    ours: socket.socket,
    until_ns: int,
    inbox: Splitter,
    heard: dict[int, int],
    autopilot: Autopilot,
    now_ns: int,
) -> None:
    """Receive until a time of ours, and answer."""
    while (left := until_ns - time.monotonic_ns()) > 0:
        if not select.select([ours], [], [], left * 1e-9)[0]:
            return
        data, ancillary, _, _ = ours.recvmsg(2048, 64)
        # When the kernel had it: our own wake-up is no part of the daemon's time
        seconds, nanoseconds = struct.unpack("@ll", ancillary[0][2])
        came_ns = seconds * 1_000_000_000 + nanoseconds
        for frame in inbox.feed(data):
            _note(frame, came_ns, heard)
        autopilot.receive(data, now_ns)
        for answer in autopilot.data_to_send():
            ours.send(answer)


def _note(frame: Frame, came_ns: int, heard: dict[int, int]) -> None:
    if frame.message_id == IDS["ODOMETRY"]:
        heard[unpack(frame).time_usec] = came_ns


def open_socket() -> socket.socket:
    """Return a socket whose datagrams the kernel stamps."""
    ours = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    ours.bind(("127.0.0.1", 0))
    return ours


@contextmanager
def running(config: Path, ours: socket.socket) -> Iterator[subprocess.Popen[bytes]]:
    """Run the daemon towards our socket while the body runs."""
    url = f"udpout:127.0.0.1:{ours.getsockname()[1]}"
    command = [sys.executable, "-m", "ekf_companion", "run", "--config", str(config), "--link", url]
    process = subprocess.Popen(
        [*command, "--log-level", "ERROR"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process.pid, NICE)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE)


def first_datagram(ours: socket.socket, process: subprocess.Popen[bytes]) -> tuple[str, int]:
    """Wait for the daemon's first datagram; return its address."""
    if not select.select([ours], [], [], PATIENCE)[0]:
        raise SystemExit(
            f"the daemon sent nothing within {PATIENCE:g} s (exit code {process.poll()})"
        )
    address: tuple[str, int] = ours.recvfrom(2048)[1]
    return address


def _seconds(pid: int) -> float:
    """Return the processor time of a process in all its threads, s."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text(encoding="ascii").split()[0]) for task in tasks) * 1e-9


def _memory(pid: int) -> float:
    """Return the largest resident memory of a process, MB."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024.0
    return float("nan")
