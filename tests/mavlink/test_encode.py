"""What we say, read back by pymavlink, against the rules of those who listen."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import EstimatorType, Frame, SystemStatus
from ekf_companion.nav import so3
from ekf_companion.nav.odometry import Odometry, euler_jacobian
from ekf_companion.nav.state import Status

DIAGONAL = [0, 6, 11, 15, 18, 20]


def read(name, payload):
    """Give the message as pymavlink reads it off the wire."""
    return dialect.MAVLink(None).decode(bytearray(Sender(1, 194).frame(name, payload)))


def estimate(**changes):
    values = {
        "t_ns": 123_456_789_000,
        "pos_n": np.array([10.0, -20.0, -30.0]),
        "vel_n": np.array([3.0, 4.0, -1.0]),
        "q_nb": so3.from_euler(0.1, -0.2, 1.5),
        "rates_b": np.array([0.01, 0.02, 0.03]),
        "pose_covariance": np.diag([1.0, 2.0, 3.0, 1e-4, 2e-4, 3e-4]),
        "velocity_covariance": np.diag([0.01, 0.04, 0.09]),
        "reset_count": 0,
        "quality": 80,
    }
    return Odometry(**(values | changes))


def odometry(said=None, **options):
    return read("ODOMETRY", encode.odometry(said or estimate(), **options))


def upper(values):
    """Give the symmetric matrix of 21 numbers, row by row."""
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = values
    return P + np.triu(P, 1).T


def test_odometry_says_what_was_estimated():
    m = odometry()
    assert m.time_usec == 123_456_789
    assert (m.frame_id, m.child_frame_id) == (20, 12)
    assert (m.x, m.y, m.z) == (10.0, -20.0, -30.0)
    assert (m.rollspeed, m.pitchspeed, m.yawspeed) == pytest.approx((0.01, 0.02, 0.03))
    assert m.q == pytest.approx(so3.from_euler(0.1, -0.2, 1.5), abs=1e-7)
    assert (m.reset_counter, m.estimator_type, m.quality) == (1, 5, 80)


def test_a_monitor_gets_the_north_east_down_frame():
    assert odometry(frame=Frame.LOCAL_NED).frame_id == 1


angles = st.floats(-3.1, 3.1)


@given(angles, st.floats(-1.5, 1.5), angles, st.floats(0.1, 10.0))
@settings(deadline=None, max_examples=200)
def test_the_quaternion_is_of_unit_norm_after_float32_as_px4_asks(roll, pitch, yaw, scale):
    q_nb = scale * so3.from_euler(roll, pitch, yaw)
    q = np.array(odometry(estimate(q_nb=q_nb)).q)
    assert abs(1.0 - np.linalg.norm(q)) <= 1e-5
    assert q[0] >= 0.0


@given(angles, st.floats(-1.5, 1.5), angles)
@settings(deadline=None, max_examples=100)
def test_the_velocity_is_in_the_body_frame(roll, pitch, yaw):
    # As ArduPilot turns it back
    said = estimate(q_nb=so3.from_euler(roll, pitch, yaw))
    m = odometry(said)
    assert so3.rotate(np.array(m.q), np.array([m.vx, m.vy, m.vz])) == pytest.approx(
        said.vel_n, abs=5e-6
    )


def random_covariance(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T * 1e-2


@pytest.mark.parametrize("seed", range(5))
def test_covariances_are_whole_and_turned_with_what_they_belong_to(seed):
    rng = np.random.default_rng(seed)
    q_nb = so3.from_euler(*rng.uniform(-1.2, 1.2, 3))
    P, V = random_covariance(rng, 6), random_covariance(rng, 3)
    m = odometry(estimate(q_nb=q_nb, pose_covariance=P, velocity_covariance=V))
    pose, velocity = upper(m.pose_covariance), upper(m.velocity_covariance)
    assert pose[:3, :3] == pytest.approx(P[:3, :3], rel=1e-6)
    C_bn = so3.to_matrix(q_nb).T
    assert velocity[:3, :3] == pytest.approx(C_bn @ V @ C_bn.T, rel=1e-5, abs=1e-8)
    assert np.linalg.eigvalsh(pose).min() > 0.0
    assert np.trace(velocity[:3, :3]) == pytest.approx(np.trace(V), rel=1e-5)


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.7), (0.3, -0.5, 2.0), (-2.0, 1.2, -3.0)])
def test_the_angles_covariance_is_by_a_jacobian_that_differences_confirm(attitude):
    q_nb = so3.from_euler(*attitude)
    step = 1e-6
    columns = []
    for axis in np.eye(3):
        ahead, behind = (
            so3.to_euler(so3.multiply(so3.exp(sign * step * axis), q_nb)) for sign in (1.0, -1.0)
        )
        columns.append(so3.wrap(ahead - behind) / (2.0 * step))
    numeric = np.stack(columns, axis=-1)
    assert euler_jacobian(q_nb) == pytest.approx(numeric, abs=1e-8)  # central difference, 1e-6


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, 1.5])
def test_straight_up_the_angles_covariance_stays_finite(pitch):
    m = odometry(estimate(q_nb=so3.from_euler(0.2, pitch, 0.4)))
    assert np.isfinite(m.pose_covariance).all()
    assert max(m.pose_covariance) < 10.0


def test_no_variance_is_zero_and_none_infinite():
    m = odometry(
        estimate(pose_covariance=np.zeros((6, 6)), velocity_covariance=np.diag([1e30, 0.0, 1.0]))
    )
    for values in (m.pose_covariance, m.velocity_covariance):
        assert np.isfinite(values).all()
        assert (np.array(values)[DIAGONAL] >= 0.99e-6).all()


@pytest.mark.parametrize("unknown", [None, np.full((6, 6), np.nan), np.full((6, 6), np.inf)])
def test_what_is_not_known_starts_with_nan_and_never_with_zero(unknown):
    m = odometry(estimate(pose_covariance=unknown, velocity_covariance=None))
    assert math.isnan(m.pose_covariance[0])
    assert math.isnan(m.velocity_covariance[0])


def test_the_reset_counter_starts_at_one_and_never_says_zero():
    said = [odometry(estimate(reset_count=count)).reset_counter for count in range(600)]
    assert said[0] == 1
    assert said[253:257] == [254, 255, 1, 2]
    assert set(said) == set(range(1, 256))


@pytest.mark.parametrize(("quality", "said"), [(-7, -1), (-1, -1), (0, 0), (100, 100), (300, 100)])
def test_quality_keeps_to_its_range(quality, said):
    assert odometry(estimate(quality=quality)).quality == said


def test_no_autopilot_is_told_a_type_that_it_refuses():
    assert encode.estimator_type(Family.PX4) is EstimatorType.VIO
    assert encode.estimator_type(Family.ARDUPILOT) is EstimatorType.GPS_INS
    assert encode.estimator_type(Family.UNKNOWN) is EstimatorType.GPS_INS
    assert (EstimatorType.VIO, EstimatorType.GPS_INS) == (
        dialect.MAV_ESTIMATOR_TYPE_VIO,
        dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
    )


def test_the_numbers_of_the_protocol_are_its_own():
    for ours, prefix in (
        (Frame, "MAV_FRAME_"),
        (EstimatorType, "MAV_ESTIMATOR_TYPE_"),
        (SystemStatus, "MAV_STATE_"),
    ):
        for member in ours:
            assert member.value == getattr(dialect, prefix + member.name)
    assert encode.SET_MESSAGE_INTERVAL == dialect.MAV_CMD_SET_MESSAGE_INTERVAL


def test_the_heartbeat_is_an_onboard_controllers():
    m = read("HEARTBEAT", encode.heartbeat(SystemStatus.ACTIVE))
    assert m.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER
    assert m.autopilot == dialect.MAV_AUTOPILOT_INVALID
    assert (m.base_mode, m.system_status, m.mavlink_version) == (0, 4, 3)


def test_every_status_has_a_word_in_the_heartbeat():
    assert set(encode.SYSTEM_STATUS) == set(Status)


@pytest.mark.parametrize(("rate", "interval_us"), [(250.0, 4000.0), (3.0, 333333.0), (0.0, -1.0)])
def test_a_message_is_asked_for_by_its_interval(rate, interval_us):
    payload = encode.set_message_interval(
        105, rate, target_system=3, target_component=1, confirmation=2
    )
    m = read("COMMAND_LONG", payload)
    assert (m.target_system, m.target_component, m.confirmation) == (3, 1, 2)
    assert (m.command, m.param1, m.param2) == (511, 105.0, interval_us)


def test_timesync_carries_its_targets_in_18_bytes():
    """Rule 27."""
    payload = encode.timesync(5, -7, target_system=1, target_component=1)
    assert len(payload) == 18
    assert payload[16:] == b"\x01\x01"
    m = read("TIMESYNC", payload)
    assert (m.tc1, m.ts1) == (5, -7)


def test_estimator_status_says_ratios_and_accuracies():
    health = encode.EstimatorHealth(
        t_ns=5_000_000,
        flags=encode.StatusFlag.ATTITUDE | encode.StatusFlag.POS_HORIZ_ABS,
        vel_ratio=0.25,
        pos_horiz_ratio=0.5,
        pos_vert_ratio=0.75,
        heading_ratio=1.5,
        std_horiz=2.0,
        std_vert=3.0,
    )
    m = read("ESTIMATOR_STATUS", encode.estimator_status(health))
    assert (m.time_usec, m.flags) == (5_000, 17)
    assert (m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio) == (0.25, 0.5, 0.75, 1.5)
    assert (m.pos_horiz_accuracy, m.pos_vert_accuracy) == (2.0, 3.0)
    for flag in set(encode.StatusFlag) - {encode.StatusFlag.NONE}:  # Python 3.10 lists it too
        assert flag.value == getattr(dialect, f"ESTIMATOR_{flag.name}")
