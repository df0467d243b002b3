"""What ODOMETRY says of a state, against the same in matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.core.memory.enums import E_ATT, E_GNSS, E_POS, E_VEL, N
from ekf_companion.core.memory.scratch import Estimate, OdometryNumbers, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.nav import so3
from ekf_companion.nav.state import Status
from tests.core.flights import between, flight
from tests.core.interpreted import load
from tests.core.states import array
from tests.core.test_timeline import a_timeline, put

DIAGONAL = [0, 6, 11, 15, 18, 20]
angles = st.floats(-3.1, 3.1)


def odometry(euler=(0.1, -0.2, 1.5), P=None, scale=1.0):
    """Return ODOMETRY's numbers of a state at this attitude, and its covariance."""
    rng = np.random.default_rng(3)
    x, out, numbers = State(), Estimate(), OdometryNumbers()
    x.gyro[:], x.gyro_bias[:] = (0.3, 0.2, 0.1), (0.03, 0.02, 0.01)
    A = rng.normal(size=(N, N))
    P = A @ A.T * 1e-2 if P is None else P
    array(x.P)[:] = P
    out.pos_n[:], out.vel_n[:] = (10, -20, -30), (3, 4, -1)
    out.q_nb[:] = scale * so3.from_euler(*euler)
    out.euler[:] = so3.to_euler(so3.from_euler(*euler))
    load().odometry.write_odometry(x, x, out, Scratch(), numbers)
    return numbers, P


def upper(numbers):
    """Return the symmetric matrix of 21 numbers, row by row."""
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = numbers
    return P + np.triu(P, 1).T


def euler_jacobian(q_nb):
    """Return d(roll, pitch, yaw) / d(rotation vector in n) by central differences."""
    step, columns = 1e-6, []
    for axis in np.eye(3):
        ahead, behind = (
            so3.to_euler(so3.multiply(so3.exp(sign * step * axis), q_nb)) for sign in (1.0, -1.0)
        )
        columns.append(so3.wrap(ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=-1)


@given(angles, st.floats(-1.5, 1.5), angles, st.floats(0.5, 2.0), st.sampled_from([1.0, -1.0]))
@settings(deadline=None, max_examples=200)
def test_pose_velocity_and_rates(roll, pitch, yaw, scale, sign):
    """Rule 19: unit norm within 1e-5 in float32, velocity in b, as ArduPilot turns it back."""
    numbers, _ = odometry((roll, pitch, yaw), scale=scale * sign)
    q = array(numbers.q_nb).astype(np.float32)
    assert abs(1.0 - np.linalg.norm(q)) <= 1e-5
    assert q[0] >= 0.0
    turned = so3.rotate(array(numbers.q_nb), array(numbers.vel_b))
    assert turned == pytest.approx([3.0, 4.0, -1.0], abs=1e-12)
    assert list(numbers.pos_n) == [10.0, -20.0, -30.0]
    assert list(numbers.rate_b) == pytest.approx([0.27, 0.18, 0.09])


@pytest.mark.parametrize("euler", [(0.0, 0.0, 0.7), (0.3, -0.5, 2.0), (-2.0, 1.2, -3.0)])
def test_covariances_are_whole_and_turned_with_what_they_belong_to(euler):
    """Rule 20: the full triangle; angles by a Jacobian that differences confirm; velocity in b."""
    numbers, P = odometry(euler)
    q_nb = so3.from_euler(*euler)
    J = np.zeros((6, N))
    J[:3, E_POS : E_POS + 3] = np.eye(3)
    J[3:, E_ATT : E_ATT + 3] = euler_jacobian(q_nb)
    pose = upper(numbers.pose_cov)
    assert pose == pytest.approx(J @ P @ J.T, rel=1e-6, abs=1e-8)
    twist = upper(numbers.twist_cov)
    C_bn = so3.to_matrix(q_nb).T
    V = P[E_VEL : E_VEL + 3, E_VEL : E_VEL + 3]
    assert twist[:3, :3] == pytest.approx(C_bn @ V @ C_bn.T, rel=1e-12, abs=1e-14)
    assert twist[3:, 3:].tolist() == (1e-6 * np.eye(3)).tolist()
    assert not twist[:3, 3:].any()


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, 1.5])
def test_straight_up_the_angles_covariance_stays_finite(pitch):
    numbers, _ = odometry((0.2, pitch, 0.4), P=1e-3 * np.eye(N))
    assert np.isfinite([*numbers.pose_cov, *numbers.twist_cov]).all()
    assert abs(array(numbers.pose_cov)).max() < 0.3


@pytest.mark.parametrize("variance", [0.0, 1e30])
def test_no_variance_is_zero_and_none_too_large_for_a_float(variance):
    """Rule 20: a floor of 1e-6."""
    numbers, _ = odometry(P=variance * np.eye(N))
    for triangle in (numbers.pose_cov, numbers.twist_cov):
        values = array(triangle).astype(np.float32)
        assert np.isfinite(values).all()
        assert (values[DIAGONAL] >= 0.99e-6).all()


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
@pytest.mark.parametrize(
    ("place", "triangle", "other"),
    [(E_VEL, "twist_cov", "pose_cov"), (E_ATT, "pose_cov", "twist_cov")],
)
def test_what_is_not_known_starts_with_nan(unknown, place, triangle, other):
    """Rule 20: NaN first, never zeros."""
    P = np.eye(N)
    P[place, place] = unknown
    numbers, _ = odometry(P=P)
    assert math.isnan(getattr(numbers, triangle)[0])
    assert not any(getattr(numbers, triangle)[1:])
    assert np.isfinite(getattr(numbers, other)).all()


def test_compiled_and_interpreted_write_the_same_bits():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0)
    ours, sources = a_timeline(), a_timeline(load().timeline.Timeline)
    numbers = []
    for timeline in (ours, sources):
        put(timeline, events.take(between(events, 3.0, 8.0)))
        numbers.append(timeline.odometry())
    assert numbers[0] == numbers[1]
    assert numbers[0][0] >= Status.OK


def test_the_relative_covariance_leaves_out_what_position_and_receiver_have_in_common():
    """A receiver's slow error moves the position and the fixes alike: no noise of a message."""
    P = np.diag(np.full(N, 1e-4))
    slow, white = 0.8**2, 0.1**2
    for k in range(3):
        P[E_POS + k, E_POS + k] = slow + white
        P[E_GNSS + k, E_GNSS + k] = slow
        P[E_POS + k, E_GNSS + k] = P[E_GNSS + k, E_POS + k] = -slow
    numbers, _ = odometry(P=P)
    assert array(numbers.pose_cov)[DIAGONAL[:3]] == pytest.approx(slow + white)
    assert array(numbers.relative_cov)[DIAGONAL[:3]] == pytest.approx(white)
    assert array(numbers.relative_cov)[DIAGONAL[3:]] == pytest.approx(
        array(numbers.pose_cov)[DIAGONAL[3:]]
    )


def test_the_relative_covariance_is_that_of_the_sum():
    numbers, P = odometry((0.3, -0.5, 2.0))
    J = np.zeros((6, N))
    J[:3, E_POS : E_POS + 3] = J[:3, E_GNSS : E_GNSS + 3] = np.eye(3)
    J[3:, E_ATT : E_ATT + 3] = euler_jacobian(so3.from_euler(0.3, -0.5, 2.0))
    assert upper(numbers.relative_cov) == pytest.approx(J @ P @ J.T, rel=1e-6, abs=1e-8)
