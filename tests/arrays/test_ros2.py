"""nav_msgs/Odometry: axes and covariances, against rotations and differences of their own."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from ekf_companion.arrays.board import BoardEstimate
from ekf_companion.arrays.ros2 import read_odometry, write_odometry
from ekf_companion.nav import so3
from tests.link.ros2 import odometry

TYPES = get_typestore(Stores.ROS2_HUMBLE).types
TURN = so3.from_euler(0.2, -0.3, 1.1)


def covariance(seed):
    root = np.random.default_rng(seed).standard_normal((6, 6))
    return root @ root.T


def test_a_pose_keeps_where_the_nose_points_and_what_is_up():
    P, V = covariance(1), covariance(2)
    given = read_odometry(odometry(5, (1.0, 2.0, 3.0), TURN, (4.0, 5.0, 6.0), P, V))
    assert given["frame"] == "LOCAL_FRD"
    assert given["position"].tolist() == [1.0, -2.0, -3.0]
    assert given["velocity"].tolist() == [4.0, -5.0, -6.0]
    flu, frd = so3.to_matrix(TURN), so3.to_matrix(given["q"])
    for sign, axis in ((1.0, 0), (-1.0, 1), (-1.0, 2)):
        # The same direction, in the axes of either frame
        np.testing.assert_allclose(frd[:, axis] * (1, -1, -1), sign * flu[:, axis], atol=1e-12)
    turned = given["pose_covariance"]
    assert turned[0, 1] == pytest.approx(-P[0, 1])
    assert turned[1, 5] == pytest.approx(P[1, 5])
    assert np.diagonal(turned) == pytest.approx(np.diagonal(P))
    assert given["velocity_covariance"][0, 2] == pytest.approx(-V[0, 2])


def test_what_was_not_filled_in_is_not_known():
    none = np.zeros((6, 6))
    given = read_odometry(odometry(5, (1.0, 0.0, 0.0), np.zeros(4), np.zeros(3), none, none))
    assert given["pose_covariance"] is None
    assert not given.keys() & {"q", "velocity"}
    rest = read_odometry(odometry(5, np.zeros(3), TURN, np.zeros(3), none, np.eye(6)))
    assert rest["velocity"].tolist() == [0.0, 0.0, 0.0]
    moving = read_odometry(odometry(5, np.zeros(3), TURN, (1.0, 0.0, 0.0), none, none))
    assert moving["velocity_covariance"] is None


def estimate(q_nb=TURN, **other):
    numbers = {
        "t_ns": 1,
        "received_ns": 2,
        "pos_n": np.array([1.0, 2.0, 3.0]),
        "q_nb": q_nb,
        "vel_b": np.array([4.0, 5.0, 6.0]),
        "rate_b": np.array([0.1, 0.2, 0.3]),
        "pose_covariance": covariance(3),
        "velocity_covariance": covariance(4),
        "resets": 1,
        "quality": 100,
    }
    return BoardEstimate(**{**numbers, **other})


def write(one, t_ns=1_700_000_000_000_000_007):
    return write_odometry(one, t_ns, TYPES, "odom", "base_link")


def attitude(m):
    q = m.pose.pose.orientation
    return so3.to_matrix(np.array((q.w, q.x, q.y, q.z)))


def test_an_estimate_is_in_east_north_up():
    m = write(estimate())
    assert (m.header.stamp.sec, m.header.stamp.nanosec) == (1_700_000_000, 7)
    assert (m.header.frame_id, m.child_frame_id) == ("odom", "base_link")
    p, v, w = m.pose.pose.position, m.twist.twist.linear, m.twist.twist.angular
    assert (p.x, p.y, p.z, v.x, v.y, v.z, w.z) == (2.0, 1.0, -3.0, 4.0, -5.0, -6.0, -0.3)
    ned, enu = so3.to_matrix(TURN), attitude(m)
    np.testing.assert_allclose(enu[:, 0], ned[[1, 0, 2], 0] * (1, 1, -1), atol=1e-12)
    np.testing.assert_allclose(enu[:, 2], -ned[[1, 0, 2], 2] * (1, 1, -1), atol=1e-12)
    V = m.twist.covariance.reshape(6, 6)
    assert V[0, 1] == pytest.approx(-estimate().velocity_covariance[0, 1])


def test_the_covariance_of_angles_becomes_that_of_a_rotation_vector():
    """Each of roll, pitch and yaw is moved, and the attitude of the message shows by what."""
    step = 1e-6
    angles = so3.to_euler(TURN)
    for k in range(3):
        P = np.zeros((6, 6))
        P[3 + k, 3 + k] = 4.0
        C = attitude(write(estimate()))
        moved = attitude(write(estimate(so3.from_euler(*(angles + step * np.eye(3)[k])))))
        turned = moved @ C.T
        by = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / step
        found = write(estimate(pose_covariance=P)).pose.covariance.reshape(6, 6)
        # differences, step 1e-6
        np.testing.assert_allclose(found[3:, 3:], 4.0 * np.outer(by, by), atol=1e-4)


def test_what_is_not_to_be_used_is_not_published():
    assert write(estimate(quality=-1)) is None
    assert write(estimate(pose_covariance=np.full((6, 6), np.nan))) is None
