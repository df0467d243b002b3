"""A lidar's odometry as a process of its own, over real sockets, with a simulated Mid-360."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.nav import so3
from sim_autopilot.lidar.device import Device
from tests.daemon.test_daemon import Daemon, free_port, manager
from tests.daemon.waiting import LIMIT, wait_until
from tests.lidar.recordings import small

LIDAR, OTHER = "127.0.0.2", "127.0.0.3"


class LidarProcess(Daemon):
    """``ekf-companion run-lidar`` in its own process."""

    def __init__(self, folder, command_port, aid_port, *options, environment=None, **process):
        self.ports = [free_port() for _ in range(3)]
        self.words = folder / "lidar.txt"
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", "run-lidar"]
        with self.words.open("wb") as words:
            self._process = subprocess.Popen(
                [
                    *command,
                    f"{LIDAR}:{command_port}",
                    f"--to=127.0.0.1:{aid_port}",
                    f"--ports={','.join(map(str, self.ports))}",
                    *options,
                ],
                stdout=words,
                stderr=subprocess.STDOUT,
                env={**os.environ, **(environment or {})},
                **process,
            )


class Listener:
    """What reaches the daemon's port for poses."""

    def __init__(self):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._splitter = Splitter()
        self.poses = []
        """Unix time of arrival, s, and message."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    def read(self):
        with contextlib.suppress(BlockingIOError):
            while True:
                for frame in self._splitter.feed(self._socket.recv(2000)):
                    self.poses.append((time.time(), unpack(frame)))
        return self.poses


def wait_for_silence(lidar):
    """Wait until a lidar is silent for good; before, its clock may have stood for as long."""

    def is_silent():
        words = lidar.words.read_text()
        return words.count(": is silent") >= words.count(": sends") > 0

    wait_until(is_silent)


def pace(daemon, lidar, taken=0):
    """Return up to when a lidar may run, s: no scan comes before what became of the last but one.

    The start is found by the scans of the first second, whose last one is whole a fifth of a second
    later. From then on each scan gives a pose, or is dropped; ``taken`` are those before the start
    by which it is decided what messages hold.
    """

    def limit():
        dropped = dict(re.findall(r"scans dropped, (.*): (\d+)", lidar.words.read_text()))
        return 1.3 + 0.1 * (taken + len(daemon.poses) + sum(map(int, dropped.values())))

    return limit


MOUNTED = "--lidar-pose=0.05,0,0.08,0,0,0"


def test_a_lidar_that_comes_later_beside_another_one(tmp_path):
    """It is told to send, a stranger is not heard, and the way is that of the truth."""
    port, flown = free_port(), small()
    with Listener() as daemon, LidarProcess(tmp_path, port, daemon.port, MOUNTED) as lidar:
        lidar.wait_for("waiting for it")
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.bind((OTHER, 0))
        with contextlib.closing(stranger):
            stranger.sendto(b"anything", ("127.0.0.1", lidar.ports[0]))
            lidar.wait_for("datagrams of others: 1")
        assert "is told to send" not in lidar.words.read_text()
        with Device(flown, LIDAR, port=port, limit=pace(daemon, lidar)) as device:
            lidar.wait_for("is told to send")
            wait_until(lambda: len(daemon.read()) >= 20)
        wait_for_silence(lidar)
        assert lidar.stop() == 0
    assert device.refused == []
    words = lidar.words.read_text()
    assert "Traceback" not in words
    assert words.splitlines()[-1].endswith("Stopped")
    poses = [m for _, m in daemon.poses]
    assert {(m.frame_id, m.child_frame_id, m.quality) for m in poses} == {(20, 12, 100)}
    assert len({m.reset_counter for m in poses}) == 1
    stamps = np.array([m.time_usec for m in poses]) * 1e-6
    assert (np.diff(stamps) > 0.05).all()
    # It is at rest for three seconds, level to a hand's measure, and then walks
    place = np.array([(m.x, m.y, m.z) for m in poses])
    true = flown.motion.position(np.arange(0.0, 12.0, 0.1))
    assert np.linalg.norm(place[0]) < 0.1
    most = np.linalg.norm(true - true[0], axis=1).max()
    assert np.linalg.norm(place, axis=1).max() < most + 0.1
    # down is down: forward, right, down of a walk that keeps its height
    assert np.abs(place[:, 2]).max() < 0.2
    tilt = so3.to_matrix(np.array([m.q for m in poses]))[:, 2, 2]
    assert (tilt > 0.95).all()
    size = [m.pose_covariance[0] + m.pose_covariance[6] for m in poses]
    assert 0.0 < size[-1] < 0.1


def test_the_service_manager_is_told_that_it_lives(tmp_path):
    with manager(tmp_path) as (address, told), Listener() as daemon:
        environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000"}
        with LidarProcess(tmp_path, free_port(), daemon.port, environment=environment) as lidar:
            wait_until(lambda: sum("WATCHDOG=1" in words for _, words in told) >= 2)
            assert lidar.stop(signal.SIGINT) == 0
    words = [one for _, one in told]
    assert words[0] == "READY=1"
    assert "STATUS=lidar silent, 0 scans, 0 ms each, 0 poses sent" in words
    assert words[-1] == "STOPPING=1"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["lidar.local"], "LIDAR: 'lidar.local': is no numeric address"),
        (["192.168.1.150:0"], "is no HOST:PORT"),
        (["192.168.1.150", "--to", "127.0.0.1"], "--to: '127.0.0.1': is no HOST:PORT"),
        (["192.168.1.150", "--ports", "1,2"], "is three ports, as in 56301,56401,56101"),
        (["192.168.1.150", "--ports", "9,9,9"], "is three ports"),
        (["192.168.1.150", "--on-vehicle", "a,b,c"], "--on-vehicle"),
        (["192.168.1.150", "--lidar-pose", "1"], "--lidar-pose: 1: is six numbers"),
        (["192.168.1.150", "--nearest", "90"], "--nearest: is beyond --farthest"),
        (["192.168.1.150", "--log-level", "loud"], "use DEBUG, INFO, WARNING or ERROR"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_sentence(options, words):
    done = CliRunner().invoke(app, ["run-lidar", *options])
    assert done.exit_code == 2, done.output
    assert words in done.stderr


def test_a_port_that_is_taken_is_named(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        port = taken.getsockname()[1]
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", "run-lidar", LIDAR]
        done = subprocess.run(
            [*command, f"--ports={port},{free_port()},{free_port()}"],
            capture_output=True,
            text=True,
            check=False,
            timeout=LIMIT,
        )
    assert done.returncode == 2
    assert f"0.0.0.0 port {port}: taken by another program" in done.stderr
