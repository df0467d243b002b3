"""One filter of the bank against differences and against the textbook's matrices."""

import numpy as np
import pytest

from ekf_companion.core import state as at
from ekf_companion.nav import so3
from tests.core.interpreted import load

H = at.X_BANK + at.B_H
"""Where the first hypothesis lies."""
STATE = slice(H + at.H_X, H + at.H_X + at.H_N)
P = slice(H + at.H_P, H + at.H_P + at.H_N * at.H_N)
SCALE = np.array([1.0, 1.0, 0.1, 0.05, 0.05, 0.01, 0.01, 0.01, 0.05])


def a_bank(seed: int) -> np.ndarray:
    """Give a block whose bank has summed an interval, and whose first hypothesis is anything."""
    rng = np.random.default_rng(seed)
    x = np.zeros(at.BLOCK)
    b = at.X_BANK
    x[b + at.B_Q : b + at.B_Q + 4] = so3.exp(rng.normal(0.0, 0.3, 3))
    x[b + at.B_DT] = 0.2
    x[b + at.B_U : b + at.B_U + 3] = 0.2 * (rng.normal(0.0, 3.0, 3) - [0.0, 0.0, 9.8])
    x[b + at.B_G : b + at.B_G + 9] = 0.2 * so3.to_matrix(so3.exp(rng.normal(0.0, 0.5, 3))).ravel()
    x[b + at.B_A : b + at.B_A + 2] = rng.normal(0.0, 3.0, 2)
    x[STATE] = rng.normal(0.0, 1.0, at.H_N) * SCALE
    x[H + at.H_X + 2] = rng.uniform(-3.0, 3.0)
    root = rng.normal(0.0, 1.0, (at.H_N, at.H_N)) * SCALE[:, None]
    x[P] = (root @ root.T).ravel()
    return x


def covariance(x: np.ndarray) -> np.ndarray:
    return x[P].reshape(at.H_N, at.H_N).copy()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_covariance_follows_the_slope_of_the_prediction(seed):
    predict = load().yaw_filter.predict
    x, k, w = a_bank(seed), np.zeros(at.PARAMETERS), np.zeros(at.SCRATCH)
    Phi, step = np.zeros((at.H_N, at.H_N)), 1e-5
    for i in range(at.H_N):
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[H + at.H_X + i] += sign * step
            predict(moved, k, w, H)
            ends.append(moved[STATE].copy())
        Phi[:, i] = (ends[0] - ends[1]) / (2.0 * step)

    still = x.copy()
    still[P] = 0.0  # what is left is the noise that does not depend on P
    predict(still, k, w, H)
    noise = covariance(still)
    assert np.all(np.diag(noise)[:5] > 0.0)
    before, variance = covariance(x), covariance(x)[2, 2]
    gained = x[STATE][:2].copy()
    predict(x, k, w, H)
    gained = x[STATE][:2] - gained
    noise[0, 0] += 0.5 * variance**2 * (gained @ gained)
    noise[1, 1] += 0.5 * variance**2 * (gained @ gained)
    np.testing.assert_allclose(
        covariance(x), Phi @ before @ Phi.T + noise, rtol=1e-6, atol=1e-9
    )  # central difference, step 1e-5


def test_velocity_is_the_sum_turned_by_yaw():
    x, k, w = a_bank(4), np.zeros(at.PARAMETERS), np.zeros(at.SCRATCH)
    x[STATE] = [3.0, -2.0, np.radians(150.0), 0, 0, 0, 0, 0, 0]
    u = x[at.X_BANK + at.B_U : at.X_BANK + at.B_U + 2]
    c, s = np.cos(np.radians(150.0)), np.sin(np.radians(150.0))
    expected = [3.0 + c * u[0] - s * u[1], -2.0 + s * u[0] + c * u[1]]
    load().yaw_filter.predict(x, k, w, H)
    np.testing.assert_allclose(x[STATE][:2], expected, rtol=1e-14)


def test_a_tilt_turns_the_force_as_a_rotation_does():
    """The true force is exp(phi) u; phi small, about x and y."""
    x, k, w = a_bank(5), np.zeros(at.PARAMETERS), np.zeros(at.SCRATCH)
    phi = np.array([0.01, -0.02, 0.0])
    x[STATE] = [0, 0, 0, *phi[:2], 0, 0, 0, 0]
    u = x[at.X_BANK + at.B_U : at.X_BANK + at.B_U + 3]
    true = so3.rotate(so3.exp(phi), u)
    load().yaw_filter.predict(x, k, w, H)
    np.testing.assert_allclose(x[STATE][:2], true[:2], atol=5e-4)  # second order: 0.02^2 of 2 m/s


def measured(x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Give what a fix should read, from the innovation of a fix of zero."""
    load().yaw_filter.judge(x, w, H, at.W_C, 0.0, 0.0, 1.0)
    return -w[at.W_C : at.W_C + 2]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_fix_is_absorbed_as_the_textbook_does(seed):
    x, w = a_bank(seed), np.zeros(at.SCRATCH)
    w[at.W_R : at.W_R + 2] = [0.4, -0.7]  # the antenna swings
    rows, step = np.zeros((2, at.H_N)), 1e-6
    for i in range(at.H_N):
        up, down = x.copy(), x.copy()
        up[H + at.H_X + i] += step
        down[H + at.H_X + i] -= step
        rows[:, i] = (measured(up, w) - measured(down, w)) / (2.0 * step)
    before, mean = covariance(x), x[STATE].copy()
    z = np.array([1.2, -0.4]) - measured(x, w)
    S = rows @ before @ rows.T + 0.3 * np.eye(2)
    K = before @ rows.T @ np.linalg.inv(S)
    nis = load().yaw_filter.judge(x, w, H, at.W_C, 1.2, -0.4, 0.3)
    assert nis == pytest.approx(z @ np.linalg.inv(S) @ z, rel=1e-7)
    assert w[at.W_C + 5] == pytest.approx(-0.5 * (nis + np.log(np.linalg.det(S))), rel=1e-7)
    load().yaw_filter.absorb(x, w, H, at.W_C)
    np.testing.assert_allclose(covariance(x), before - K @ S @ K.T, rtol=1e-6, atol=1e-9)
    expected = mean + K @ z
    expected[2] = so3.wrap(expected[2])
    np.testing.assert_allclose(x[STATE], expected, rtol=1e-6, atol=1e-9)
    assert np.array_equal(covariance(x), covariance(x).T)
