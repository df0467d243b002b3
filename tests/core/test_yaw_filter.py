"""One filter of the bank against differences and against the textbook's matrices."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import YAW_N
from ekf_companion.core.memory.scratch import YawUpdate
from ekf_companion.core.memory.state import YawBank, YawFilter
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.states import array, copy

SCALE = np.array([1.0, 1.0, 0.1, 0.05, 0.05, 0.01, 0.01, 0.01, 0.05])


def a_bank(seed: int) -> tuple[YawFilter, YawBank]:
    """Return a filter that is anything, and a bank that has summed an interval."""
    rng = np.random.default_rng(seed)
    f, b = YawFilter(), YawBank()
    b.q_sb[:] = so3.exp(rng.normal(0.0, 0.3, 3))
    b.sums.dt = 0.2
    b.sums.dv[:] = 0.2 * (rng.normal(0.0, 3.0, 3) - [0.0, 0.0, 9.8])
    array(b.sums.turn)[:] = 0.2 * so3.to_matrix(so3.exp(rng.normal(0.0, 0.5, 3)))
    b.accel[:] = rng.normal(0.0, 3.0, 2)
    f.x[:] = rng.normal(0.0, 1.0, YAW_N) * SCALE
    f.x[2] = rng.uniform(-3.0, 3.0)
    root = rng.normal(0.0, 1.0, (YAW_N, YAW_N)) * SCALE[:, None]
    array(f.P)[:] = root @ root.T
    return f, b


def predict(f: YawFilter, b: YawBank) -> None:
    load().yaw_filter.predict(f, b, 0.0, YawUpdate())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_covariance_follows_the_slope_of_the_prediction(seed):
    f, b = a_bank(seed)
    Phi, step = np.zeros((YAW_N, YAW_N)), 1e-5
    for i in range(YAW_N):
        ends = []
        for sign in (1.0, -1.0):
            moved = copy(f)
            moved.x[i] += sign * step
            predict(moved, b)
            ends.append(np.array(moved.x))
        Phi[:, i] = (ends[0] - ends[1]) / (2.0 * step)

    still = copy(f)
    array(still.P)[:] = 0.0  # what is left is the noise that does not depend on P
    predict(still, b)
    noise = np.array(still.P)
    assert np.all(np.diag(noise)[:5] > 0.0)
    before, variance = np.array(f.P), f.P[2][2]
    velocity = np.array(f.x[:2])
    predict(f, b)
    gained = np.array(f.x[:2]) - velocity
    noise[0, 0] += 0.5 * variance**2 * (gained @ gained)
    noise[1, 1] += 0.5 * variance**2 * (gained @ gained)
    np.testing.assert_allclose(
        array(f.P), Phi @ before @ Phi.T + noise, rtol=1e-6, atol=1e-9
    )  # central difference, step 1e-5


def test_velocity_is_the_sum_turned_by_yaw():
    f, b = a_bank(4)
    f.x[:] = [3.0, -2.0, np.radians(150.0), 0, 0, 0, 0, 0, 0]
    u = b.sums.dv
    c, s = np.cos(np.radians(150.0)), np.sin(np.radians(150.0))
    expected = [3.0 + c * u[0] - s * u[1], -2.0 + s * u[0] + c * u[1]]
    predict(f, b)
    np.testing.assert_allclose(f.x[:2], expected, rtol=1e-14)


def test_a_tilt_turns_the_force_as_a_rotation_does():
    """The true force is exp(phi) u; phi small, about x and y."""
    f, b = a_bank(5)
    phi = np.array([0.01, -0.02, 0.0])
    f.x[:] = [0, 0, 0, *phi[:2], 0, 0, 0, 0]
    true = so3.rotate(so3.exp(phi), np.array(b.sums.dv))
    predict(f, b)
    np.testing.assert_allclose(f.x[:2], true[:2], atol=5e-4)  # second order: 0.02^2 of 2 m/s


def measured(f: YawFilter, b: YawBank, u: YawUpdate) -> np.ndarray:
    """Return what a fix should read, from the innovation of a fix of zero."""
    u.vel_n[:] = [0.0, 0.0]
    load().yaw_filter.innovate(f, b, u, 0, 1.0)
    return -np.array(u.z[0])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_fix_is_fused_as_the_textbook_does(seed):
    (f, b), u = a_bank(seed), YawUpdate()
    u.arm_vel[:] = [0.4, -0.7]  # the antenna swings
    rows, step = np.zeros((2, YAW_N)), 1e-6
    for i in range(YAW_N):
        up, down = copy(f), copy(f)
        up.x[i] += step
        down.x[i] -= step
        rows[:, i] = (measured(up, b, u) - measured(down, b, u)) / (2.0 * step)
    before, mean = np.array(f.P), np.array(f.x)
    z = np.array([1.2, -0.4]) - measured(f, b, u)
    S = rows @ before @ rows.T + 0.3 * np.eye(2)
    K = before @ rows.T @ np.linalg.inv(S)
    u.vel_n[:] = [1.2, -0.4]
    nis = load().yaw_filter.innovate(f, b, u, 3, 0.3)
    assert nis == pytest.approx(z @ np.linalg.inv(S) @ z, rel=1e-7)
    likelihood = -0.5 * (nis + np.log(np.linalg.det(S)))
    assert u.log_likelihood[3] == pytest.approx(likelihood, rel=1e-7)
    load().yaw_filter.apply_update(f, b, u, 3)
    after = array(f.P)
    np.testing.assert_allclose(after, before - K @ S @ K.T, rtol=1e-6, atol=1e-9)
    expected = mean + K @ z
    expected[2] = so3.wrap(expected[2])
    np.testing.assert_allclose(f.x, expected, rtol=1e-6, atol=1e-9)
    assert np.array_equal(after, after.T)
