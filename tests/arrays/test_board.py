"""A program beside the daemon: what it sends, and what it reads, over real sockets."""

import contextlib
import math
import socket
import time

import numpy as np
import pytest

from ekf_companion import Board
from ekf_companion.errors import DataError
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter

TURN = (math.cos(0.25), 0.0, 0.0, math.sin(0.25))


@pytest.fixture
def heard():
    """Open the daemon's port, and return it with what reads a message there."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as port:
        port.bind(("127.0.0.1", 0))
        port.settimeout(60.0)

        def read():
            (frame,) = Splitter().feed(port.recv(4096))
            return frame, unpack(frame)

        yield port.getsockname()[1], read


def test_a_pose_and_a_velocity_arrive_as_they_were_sent(heard):
    port, read = heard
    pose, speed = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.3]), np.diag([0.4, 0.5, 0.6])
    pose[0, 5] = pose[5, 0] = 0.004
    with Board(port) as board:
        before = time.time_ns()
        board.send(
            position=(1.0, 2.0, -3.0),
            q=TURN,
            velocity=(4.0, 5.0, 6.0),
            pose_covariance=pose,
            velocity_covariance=speed,
            reset_counter=7,
            quality=90,
        )
    frame, m = read()
    assert (frame.system_id, frame.component_id) == (240, 197)
    assert before // 1000 <= m.time_usec <= time.time_ns() // 1000
    assert [m.x, m.y, m.z, m.vx, m.vy, m.vz] == [1.0, 2.0, -3.0, 4.0, 5.0, 6.0]
    assert m.q == pytest.approx(TURN, abs=1e-6)
    assert m.pose_covariance == pytest.approx(pose[np.triu_indices(6)].tolist(), abs=1e-7)
    assert [m.velocity_covariance[k] for k in (0, 6, 11)] == pytest.approx([0.4, 0.5, 0.6])
    assert math.isnan(m.velocity_covariance[15])
    assert (m.frame_id, m.child_frame_id, m.reset_counter, m.quality) == (20, 12, 7, 90)
    assert m.estimator_type not in (4, 5, 8)  # which would be refused


def test_what_is_not_given_is_not_known(heard):
    port, read = heard
    with Board(port) as board:
        board.send(velocity=(1.0, 0.0, 0.0), frame="LOCAL_ENU", is_body_velocity=False)
    _, m = read()
    assert math.isnan(m.x)
    assert m.q == (0.0, 0.0, 0.0, 0.0)
    assert math.isnan(m.pose_covariance[0])
    assert (m.frame_id, m.child_frame_id) == (4, 4)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "neither position nor velocity"),
        ({"position": (1.0, 2.0)}, "position: .* is not 3 finite numbers"),
        ({"position": (1.0, 2.0, math.nan)}, "is not 3 finite"),
        ({"position": (1, 2, 3), "q": (1.0, 1.0, 0.0, 0.0)}, "q: .* has length 1.414, not 1"),
        ({"velocity": (1, 2, 3), "velocity_covariance": np.ones(3)}, "velocity_covariance"),
        ({"position": (1, 2, 3), "pose_covariance": -np.eye(3)}, "negative variance"),
        ({"position": (1, 2, 3), "pose_covariance": np.triu(np.ones((6, 6)))}, "not symmetric"),
        ({"position": (1, 2, 3), "frame": "MAP"}, "frame: 'MAP' is none of LOCAL_NED"),
        ({"position": (1, 2, 3), "t": 12.5}, "is not unix time of now"),
        ({"position": (1, 2, 3), "t": 1_700_000_000_000}, "is not unix time of now"),
    ],
)
def test_what_cannot_be_meant_is_said(heard, fields, words):
    port, _ = heard
    with Board(port) as board, pytest.raises(DataError, match=words):
        board.send(**fields)


def test_estimates_come_back_with_their_origin():
    daemon = Sender(1, 194)
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    place = {"latitude": 474_000_000, "longitude": 85_000_000, "altitude": 488_000}
    said = {"x": 1.0, "y": 2.0, "z": -3.0, "q": TURN, "vx": 4.0, "time_usec": 20_000_000}
    said |= {"pose_covariance": list(range(1, 22)), "quality": 100, "reset_counter": 3}
    with Board(1, port) as board, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        assert board.read(timeout=0.0) is None
        for data in (
            daemon.message("HEARTBEAT", type=18, autopilot=8),
            b"noise",
            daemon.message("GPS_GLOBAL_ORIGIN", **place),
            daemon.message("ODOMETRY", **said),
        ):
            out.sendto(data, ("127.0.0.1", port))
        found = board.read(timeout=60.0)
        assert board.origin == pytest.approx((47.4, 8.5, 488.0))
        assert board.read(timeout=0.0) is None
    assert (found.t_ns, found.resets, found.quality) == (20_000_000_000, 3, 100)
    assert found.pos_n.tolist() == [1.0, 2.0, -3.0]
    assert found.q_nb == pytest.approx(np.array(TURN), abs=1e-6)
    assert found.vel_b[0] == 4.0
    assert np.array_equal(found.pose_covariance, found.pose_covariance.T)
    assert found.pose_covariance[np.triu_indices(6)].tolist() == list(range(1, 22))


def test_without_a_port_there_is_nothing_to_read(heard):
    with Board(heard[0]) as board, pytest.raises(DataError, match="give estimate_port"):
        board.read()
