"""Odometry of ROS 2 to the daemon and back: a partner in zenoh, the process, and the daemon."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.lidar.messages import SCANS
from ekf_companion.link.ros2 import CLOUD, IMU, stamp_ns
from tests.daemon.test_aid_port import aid_of, resting
from tests.daemon.test_daemon import Daemon, Record, assert_same_as_its_messages, free_port, manager
from tests.daemon.test_run_lidar import MOUNTED, Listener, pace, wait_for_silence
from tests.daemon.waiting import LIMIT, wait_until
from tests.lidar.recordings import cloud, imu, small
from tests.lidar.test_messages import rows
from tests.link.ros2 import HASH, ODOMETRY, STORE, TYPE, Partner, odometry, router

AGE = 0.06
"""s; of a pose when it is published."""
POSE, TWIST = np.diag([1e-4] * 3 + [1e-3] * 3), np.zeros((6, 6))


class Ros2Daemon(Daemon):
    """``ekf-companion run-ros2``, or another command, in its own process."""

    def __init__(self, folder, *options, command="run-ros2", environment=None):
        self.words = folder / "ros2.txt"
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", command, *options]
        with self.words.open("wb") as words:
            self._process = subprocess.Popen(
                command,
                stdout=words,
                stderr=subprocess.STDOUT,
                env={**os.environ, **(environment or {})},
            )


class Vio:
    """A visual-inertial odometry at rest, in a frame that is turned and away."""

    def __init__(self, session, key):
        self._partner, self._rng = Partner(session, key), np.random.default_rng(1)

    def put(self, t_ns=None, pose=POSE):
        t_ns = time.time_ns() - round(AGE * 1e9) if t_ns is None else t_ns
        place = np.array([5.0, -6.0, 7.0]) + 0.01 * self._rng.standard_normal(3)
        q = (np.cos(0.4), 0.0, 0.0, np.sin(0.4))
        self._partner.put(odometry(t_ns, place, q, np.zeros(3), pose, TWIST))


@pytest.mark.parametrize("key", [f"0/vio/odom/{TYPE}/{HASH}", "vio/odom"], ids=["rmw", "bridge"])
def test_odometry_is_used_recorded_and_estimates_come_back(tmp_path, key):
    port, aid, estimates = free_port(), free_port(), free_port()
    http, zenoh = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM)
    config = (
        f"link: {{aid_url: 'udpin:127.0.0.1:{aid}'}}\nhttp: {{port: {http}}}\n"
        f"output: {{monitors: ['udpout:127.0.0.1:{estimates}']}}\nvisual_odometry: {{use: true}}\n"
    )
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    ours = (
        "--odometry=/vio/odom",
        "--estimate=/ekf/odom",
        f"--connect=tcp/127.0.0.1:{zenoh}",
        f"--to=127.0.0.1:{aid}",
        f"--estimate-port={estimates}",
    )
    back = []
    with (
        router(zenoh) as session,
        Daemon(tmp_path, *options, config=config) as daemon,
        Ros2Daemon(tmp_path, *ours) as bridge,
    ):
        vio = Vio(session, key)
        hearer = session.declare_subscriber(
            key.replace("vio", "ekf"), lambda sample: back.append((time.time_ns(), sample))
        )
        daemon.wait_for(f"udpin:127.0.0.1:{aid}: open")
        bridge.wait_for("ROS 2 by zenoh at")
        with resting(f"udpout:127.0.0.1:{port}"):

            def is_used():
                vio.put()
                time.sleep(0.05)
                one = aid_of(http)
                return one if one.get("state") == "used" else {}

            one = wait_until(is_used)
            for _ in range(60):
                is_used()
            wait_until(lambda: len(back) > 5)
        hearer.undeclare()
        assert bridge.stop() == 0
        assert daemon.stop() == 0
    assert one["source"].startswith("240/197 ODOMETRY")
    words = bridge.words.read_text()
    assert "/vio/odom: comes" in words
    assert "Traceback" not in words
    for arrived_ns, sample in back:
        m = STORE.deserialize_cdr(bytes(sample.payload), ODOMETRY)
        assert stamp_ns(m) <= arrived_ns  # it was true before it came
        P = m.pose.covariance.reshape(6, 6)
        assert (np.linalg.eigvalsh(P) > 0.0).all()
        assert abs(m.pose.pose.position.x) < 10.0
        assert m.header.frame_id == "odom"
    # What the daemon recorded of it gives the same estimate
    record = Record(tmp_path / "flight.tlog", daemon.config)
    assert len([f for f in record.frames if f[1:3] == (240, 197)]) >= 10
    assert_same_as_its_messages(record)


def test_the_frame_that_reaches_the_daemon_is_the_pose(tmp_path):
    zenoh = free_port(socket.SOCK_STREAM)
    with router(zenoh) as session, Listener() as daemon:
        options = (f"--connect=tcp/127.0.0.1:{zenoh}", f"--to=127.0.0.1:{daemon.port}")
        with Ros2Daemon(tmp_path, "--odometry=/odom", *options) as bridge:
            vio = Vio(session, "odom")

            def comes():
                vio.put()
                time.sleep(0.02)
                return daemon.read()

            ((_, m),) = wait_until(comes)[:1]
            # A clock that is not unix time, and what is no covariance
            vio.put(t_ns=5_000_000_000)
            bridge.wait_for("not used: t: 5")
            vio.put(pose=-POSE)

            def damaged():
                vio.put()
                time.sleep(0.02)
                daemon.read()
                return len(daemon.poses) > 3

            wait_until(damaged)
            bridge.wait_for("is silent")
            assert bridge.stop(signal.SIGINT) == 0
    assert (m.frame_id, m.child_frame_id, m.quality) == (20, 12, 100)
    assert [m.x, m.y, m.z] == pytest.approx([5.0, 6.0, -7.0], abs=0.1)
    assert m.q == pytest.approx((np.cos(0.4), 0.0, 0.0, -np.sin(0.4)), abs=1e-6)
    assert m.pose_covariance[20] == pytest.approx(1e-3)
    assert np.isnan(m.vx)  # a twist that was not filled in
    assert abs(m.time_usec * 1e-6 - time.time()) < LIMIT


def play(flown, session, domain, is_due):
    """Publish what a lidar measures as rmw_zenoh does, each message in its time and once due."""
    both = {}
    for topic, kind in (("points", CLOUD), ("imu", IMU)):
        package, _, name = kind.split("/")
        key = f"{domain}/{topic}/{package}::msg::dds_::{name}_/{STORE.hash_rihs01(kind)}"
        both[topic] = Partner(session, key, kind)
    wait_until(lambda: all(one.is_heard for one in both.values()))
    begin, begin_ns = time.monotonic(), time.time_ns()
    for seconds, kind, k in rows(flown, 12.0):
        time.sleep(max(begin + seconds - time.monotonic(), 0.0))
        wait_until(lambda seconds=seconds: is_due(seconds))
        begin = max(begin, time.monotonic() - seconds)  # its clock stood until then
        if kind == "cloud":
            both["points"].put(cloud(flown, k, begin_ns + round(float(flown.stamp[k]) * 1e9)))
        else:
            both["imu"].put(imu(flown, k, begin_ns + round(float(flown.imu_stamp[k]) * 1e9)))


def test_a_lidar_of_ros_2(tmp_path):
    zenoh, flown = free_port(socket.SOCK_STREAM), small()
    with router(zenoh) as session, Listener() as daemon:
        options = (
            "--domain=4",
            f"--connect=tcp/127.0.0.1:{zenoh}",
            f"--to=127.0.0.1:{daemon.port}",
        )
        with Ros2Daemon(tmp_path, "/points", MOUNTED, *options, command="run-lidar") as lidar:
            lidar.wait_for("waiting for it at zenoh, with inertial samples of /imu")
            limit = pace(daemon, lidar, SCANS)

            def is_due(seconds):
                daemon.read()
                return seconds <= limit()

            play(flown, session, 4, is_due)
            wait_until(lambda: len(daemon.read()) >= 20)
            wait_for_silence(lidar)
            assert lidar.stop() == 0
    words = lidar.words.read_text()
    assert "Traceback" not in words
    assert "specific force is in m/s2" in words
    assert "times of points (t) are nanoseconds after the stamp" in words
    poses = [m for _, m in daemon.poses]
    stamps = np.array([m.time_usec for m in poses]) * 1e-6
    assert (np.diff(stamps) > 0.05).all()
    place = np.array([(m.x, m.y, m.z) for m in poses])
    true = flown.motion.position(np.arange(0.0, 12.0, 0.1))
    assert np.linalg.norm(place, axis=1).max() < np.linalg.norm(true - true[0], axis=1).max() + 0.1
    assert np.abs(place[:, 2]).max() < 0.2
    assert 0.0 < poses[-1].pose_covariance[0] < 0.05


def test_the_service_manager_is_told_that_it_lives(tmp_path):
    with manager(tmp_path) as (address, told):
        environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000"}
        options = ("--odometry=/odom", f"--connect=tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}")
        with Ros2Daemon(tmp_path, *options, environment=environment) as bridge:
            wait_until(lambda: sum("WATCHDOG=1" in words for _, words in told) >= 2)
            assert bridge.stop() == 0
    words = [one for _, one in told]
    assert words[0] == "READY=1"
    assert "STATUS=ROS 2: 0 poses to the daemon, 0 estimates published" in words
    assert words[-1] == "STOPPING=1"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--odometry, --estimate: give one of them"),
        (["--odometry=/a", "--estimate=/a"], "the daemon would be given its own estimates"),
        (["--odometry=/a", "--to=board"], "is no numeric address"),
        (["--odometry=/a b"], "'/a b': is no topic of ROS 2, as in /odom"),
        (["--odometry=/a", "--connect=tcp"], "zenoh: "),
        (["--odometry=/a", "--log-level=loud"], "use DEBUG, INFO"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_sentence(options, words):
    done = CliRunner().invoke(app, ["run-ros2", "--zenoh-listen=", *options])
    assert done.exit_code == 2, done.output
    assert words in done.stderr


def test_a_port_that_is_taken_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        options = ["--estimate=/a", f"--estimate-port={port}"]
        done = CliRunner().invoke(app, ["run-ros2", "--zenoh-listen=", *options])
    assert done.exit_code == 2
    assert f"127.0.0.1 port {port}: " in done.stderr
