"""What is told of a state, against the same in matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.core import state as at
from ekf_companion.core.odometry import tell
from ekf_companion.nav import so3
from tests.core.interpreted import load

DIAGONAL = [0, 6, 11, 15, 18, 20]
angles = st.floats(-3.1, 3.1)


def told(euler=(0.1, -0.2, 1.5), P=None, scale=1.0, function=tell):
    """Give the numbers told of a state at this attitude, and its covariance."""
    rng = np.random.default_rng(3)
    x, out = np.zeros(at.BLOCK), np.zeros(at.OUT)
    x[at.X_GYRO : at.X_GYRO + 3], x[at.X_BG : at.X_BG + 3] = (0.3, 0.2, 0.1), (0.03, 0.02, 0.01)
    A = rng.normal(size=(at.N, at.N))
    P = A @ A.T * 1e-2 if P is None else P
    x[at.X_COV : at.X_COV + at.N**2] = P.ravel()
    out[at.OUT_POS : at.OUT_POS + 3], out[at.OUT_VEL : at.OUT_VEL + 3] = (10, -20, -30), (3, 4, -1)
    out[at.OUT_Q : at.OUT_Q + 4] = scale * so3.from_euler(*euler)
    out[at.OUT_EULER : at.OUT_EULER + 3] = so3.to_euler(so3.from_euler(*euler))
    numbers = np.zeros(at.TOLD)
    function(x, out, np.zeros(at.SCRATCH), numbers)
    return numbers, P


def part(numbers, start, n=3):
    return numbers[start : start + n]


def upper(numbers):
    """Give the symmetric matrix of 21 numbers, row by row."""
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = numbers
    return P + np.triu(P, 1).T


def euler_jacobian(q_nb):
    """Give d(roll, pitch, yaw) / d(rotation vector in n) by central differences."""
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
    numbers, _ = told((roll, pitch, yaw), scale=scale * sign)
    q = part(numbers, at.TOLD_Q, 4).astype(np.float32)
    assert abs(1.0 - np.linalg.norm(q)) <= 1e-5
    assert q[0] >= 0.0
    turned = so3.rotate(part(numbers, at.TOLD_Q, 4), part(numbers, at.TOLD_VEL))
    assert turned == pytest.approx([3.0, 4.0, -1.0], abs=1e-12)
    assert part(numbers, at.TOLD_POS).tolist() == [10.0, -20.0, -30.0]
    assert part(numbers, at.TOLD_RATE) == pytest.approx([0.27, 0.18, 0.09])


@pytest.mark.parametrize("euler", [(0.0, 0.0, 0.7), (0.3, -0.5, 2.0), (-2.0, 1.2, -3.0)])
def test_covariances_are_whole_and_turned_with_what_they_belong_to(euler):
    """Rule 20: the full triangle; angles by a Jacobian that differences confirm; velocity in b."""
    numbers, P = told(euler)
    q_nb = so3.from_euler(*euler)
    J = np.zeros((6, at.N))
    J[:3, at.E_POS : at.E_POS + 3] = np.eye(3)
    J[3:, at.E_ATT : at.E_ATT + 3] = euler_jacobian(q_nb)
    pose = upper(part(numbers, at.TOLD_POSE, 21))
    assert pose == pytest.approx(J @ P @ J.T, rel=1e-6, abs=1e-8)
    twist = upper(part(numbers, at.TOLD_TWIST, 21))
    C_bn = so3.to_matrix(q_nb).T
    V = P[at.E_VEL : at.E_VEL + 3, at.E_VEL : at.E_VEL + 3]
    assert twist[:3, :3] == pytest.approx(C_bn @ V @ C_bn.T, rel=1e-12, abs=1e-14)
    assert twist[3:, 3:].tolist() == (1e-6 * np.eye(3)).tolist()
    assert not twist[:3, 3:].any()


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, 1.5])
def test_straight_up_the_angles_covariance_stays_finite(pitch):
    numbers, _ = told((0.2, pitch, 0.4), P=1e-3 * np.eye(at.N))
    assert np.isfinite(numbers).all()
    assert abs(part(numbers, at.TOLD_POSE, 21)).max() < 0.3


@pytest.mark.parametrize("variance", [0.0, 1e30])
def test_no_variance_is_zero_and_none_too_large_for_a_float(variance):
    """Rule 20: a floor of 1e-6."""
    numbers, _ = told(P=variance * np.eye(at.N))
    for start in (at.TOLD_POSE, at.TOLD_TWIST):
        values = part(numbers, start, 21).astype(np.float32)
        assert np.isfinite(values).all()
        assert (values[DIAGONAL] >= 0.99e-6).all()


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
@pytest.mark.parametrize(
    ("place", "start", "other"),
    [(at.E_VEL, at.TOLD_TWIST, at.TOLD_POSE), (at.E_ATT, at.TOLD_POSE, at.TOLD_TWIST)],
)
def test_what_is_not_known_starts_with_nan(unknown, place, start, other):
    """Rule 20: NaN first, never zeros."""
    P = np.eye(at.N)
    P[place, place] = unknown
    numbers, _ = told(P=P)
    assert math.isnan(numbers[start])
    assert not numbers[start + 1 : start + 21].any()
    assert np.isfinite(part(numbers, other, 21)).all()


def test_compiled_and_interpreted_tell_the_same_bits():
    ours = told()[0]
    assert ours.tobytes() == told(function=load().odometry.tell)[0].tobytes()
