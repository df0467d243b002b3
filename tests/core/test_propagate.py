import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from ekf_companion.core import state as at
from ekf_companion.nav import earth, so3
from tests.core.interpreted import load
from tests.core.test_observe import a_state, parameters, plus


def errors_between(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Give the error that turns x into y."""
    error = np.zeros(at.N)
    q = so3.multiply(y[at.X_Q : at.X_Q + 4], so3.conjugate(x[at.X_Q : at.X_Q + 4]))
    error[at.E_ATT : at.E_ATT + 3] = so3.log(q)
    for first, place in ((at.E_VEL, at.X_VEL), (at.E_POS, at.X_POS), (at.E_BG, at.X_BG)):
        error[first : first + 3] = y[place : place + 3] - x[place : place + 3]
    error[at.E_BA : at.E_BA + 3] = y[at.X_BA : at.X_BA + 3] - x[at.X_BA : at.X_BA + 3]
    error[at.E_BARO] = y[at.X_BARO] - x[at.X_BARO]
    error[at.E_DELAY] = y[at.X_DELAY] - x[at.X_DELAY]
    error[at.E_HEADING] = y[at.X_HEADING] - x[at.X_HEADING]
    error[at.E_SLOW : at.E_SLOW + 3] = y[at.X_SLOW : at.X_SLOW + 3] - x[at.X_SLOW : at.X_SLOW + 3]
    error[at.E_IRON : at.E_IRON + 3] = y[at.X_IRON : at.X_IRON + 3] - x[at.X_IRON : at.X_IRON + 3]
    return error


SAMPLE = (0.4, -0.8, 0.3, 1.5, -2.0, -9.0)


def sampled(w: np.ndarray, sample=SAMPLE) -> np.ndarray:
    w[at.W_RATE : at.W_RATE + 6] = sample
    return w


@pytest.mark.parametrize("dt", [0.004, 0.02, 0.1])
def test_covariance_follows_the_slope_of_the_motion(dt):
    propagate = load().propagate
    x, k, w = a_state(5), parameters(), np.zeros(at.SCRATCH)
    Phi = np.zeros((at.N, at.N))
    step = 1e-5
    for i in range(at.N):
        error = np.zeros(at.N)
        error[i] = step
        ends = []
        for sign in (1.0, -1.0):
            moved = plus(x, sign * error)
            propagate.move(moved, k, sampled(w), dt)
            ends.append(moved)
        Phi[:, i] = errors_between(ends[1], ends[0]) / (2.0 * step)

    rng = np.random.default_rng(6)
    root = (
        rng.normal(0.0, 1.0, (at.N, at.N))
        * np.repeat([0.1, 1.0, 5.0, 0.01, 0.2, 1.0, 0.01], [3, 3, 3, 3, 3, 6, 3])[:, None]
    )
    P = root @ root.T
    x[at.X_COV :] = P.ravel()
    propagate.move(x, k, sampled(w), dt)
    propagate.spread(x, k, w, dt)
    after = x[at.X_COV :].reshape(at.N, at.N)

    assert np.array_equal(after, after.T)
    expected = Phi @ P @ Phi.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # the mean direction of the turning body is taken at the start: half of 1 rad/s dt of a bias
    assert np.abs((after - expected) / scale).max() < 5e-4 + 0.5 * dt * dt


@pytest.mark.parametrize("dt", [0.004, 0.1])
def test_the_transition_is_the_one_that_the_covariance_went_by(dt):
    propagate = load().propagate
    x, k = a_state(8), parameters()
    w = np.zeros(at.SCRATCH + at.N * at.N)
    k[at.K_GYRO_NOISE], k[at.K_ACCEL_NOISE], k[at.K_BARO_WALK] = 2e-3, 3e-2, 0.05
    k[at.K_GYRO_WALK], k[at.K_ACCEL_WALK], x[at.X_HEADING_STD] = 1e-4, 1e-3, 0.1
    root = np.random.default_rng(8).normal(0.0, 1.0, (at.N, at.N))
    ends = []
    for P in (root @ root.T, np.zeros((at.N, at.N))):
        y = x.copy()
        y[at.X_COV :] = P.ravel()
        propagate.move(y, k, sampled(w), dt)
        propagate.spread(y, k, w, dt)
        propagate.transition(k, w, dt, at.SCRATCH)
        ends.append(y[at.X_COV :].reshape(at.N, at.N))
    Phi = w[at.SCRATCH :].reshape(at.N, at.N)
    with_noise, noise = ends
    assert np.diag(noise).min() >= 0.0 < np.trace(noise)
    np.testing.assert_allclose(with_noise, Phi @ root @ root.T @ Phi.T + noise, atol=1e-12)


def test_noise_is_what_van_loan_gives():
    propagate = load().propagate
    x, k, w = a_state(7), parameters(), np.zeros(at.SCRATCH)
    k[at.K_GYRO_NOISE], k[at.K_ACCEL_NOISE] = 2e-3, 3e-2
    k[at.K_GYRO_WALK], k[at.K_ACCEL_WALK], k[at.K_BARO_WALK] = 1e-4, 1e-3, 0.05
    dt = 0.01
    x[at.X_COV :] = 0.0
    propagate.move(x, k, sampled(w), dt)
    C = w[at.W_C_NB : at.W_C_NB + 9].reshape(3, 3).copy()
    force = w[at.W_DV : at.W_DV + 3] / dt
    propagate.spread(x, k, w, dt)

    F = np.zeros((at.N, at.N))
    F[0:3, 9:12] = -C
    F[3:6, 0:3] = -np.array(
        [[0, -force[2], force[1]], [force[2], 0, -force[0]], [-force[1], force[0], 0]]
    )
    F[3:6, 12:15] = -C
    F[6:9, 3:6] = np.eye(3)
    Q = np.diag(
        np.repeat([2e-3**2, 3e-2**2, 0.0, 1e-4**2, 1e-3**2, 0.05**2, 0.0], [3, 3, 3, 3, 3, 1, 8])
    )
    block = expm(np.block([[-F, Q], [np.zeros_like(F), F.T]]) * dt)
    expected = block[at.N :, at.N :].T @ block[: at.N, at.N :]
    after = x[at.X_COV :].reshape(at.N, at.N)
    for part in (slice(0, 3), slice(3, 6), slice(9, 12), slice(12, 15), slice(15, 16)):
        # to first order in dt: what the noise of attitude adds to velocity in 10 ms is left out
        largest = np.abs(expected[part, part]).max()
        np.testing.assert_allclose(after[part, part], expected[part, part], atol=1e-4 * largest)


def test_gravity_and_earth_rate_agree_with_the_vocabulary():
    propagate = load().propagate
    lat, alt, dt = 0.7, 1000.0, 0.01
    x, k, w = np.zeros(at.BLOCK), parameters(), np.zeros(at.SCRATCH)
    x[at.X_Q] = 1.0
    propagate.originate(x, lat, 0.2, alt)
    north, east = earth.LocalFrame(lat, 0.2, alt).scale
    assert (x[at.X_SCALE_N], x[at.X_SCALE_E]) == pytest.approx((north, east), rel=1e-14)
    propagate.move(x, k, w, dt)
    assert x[at.X_VEL + 2] / dt == pytest.approx(float(earth.gravity(lat, alt)), rel=1e-12)
    # a body that does not turn in inertial space turns against the Earth
    turned = so3.log(x[at.X_Q : at.X_Q + 4]) / dt
    np.testing.assert_allclose(turned, -earth.earth_rate_n(lat), atol=1e-12)


@pytest.mark.parametrize("kind", ["cone", "scull"])
def test_two_samples_in_a_row_show_coning_and_sculling(kind):
    """A body that cones, or swings in time with its acceleration, sampled as means at 100 Hz."""
    propagate = load().propagate
    dt, n, w0, fine = 0.01, 300, 2.0 * np.pi * 8.0, 50
    t = (np.arange(n * fine) + 0.5) * dt / fine
    zero = np.zeros_like(t)
    rate = np.stack([0.8 * np.sin(w0 * t), 0.8 * np.cos(w0 * t) * (kind == "cone"), zero], axis=-1)
    force = np.stack([zero, 6.0 * np.sin(w0 * t) * (kind == "scull"), zero - 9.8], axis=-1)

    def fly(samples: np.ndarray, period: float, has_slope: bool) -> np.ndarray:
        x, k, w = np.zeros(at.BLOCK), parameters(), np.zeros(at.SCRATCH)
        x[at.X_Q] = 1.0
        for before, now in itertools.pairwise(samples):
            sampled(w, now)
            w[at.W_RATE_SLOPE : at.W_RATE_SLOPE + 6] = (now - before) / period * has_slope
            propagate.move(x, k, w, period)
        return x

    exact = np.concatenate([rate, force], axis=-1)
    means = exact.reshape(n, fine, 6).mean(axis=1)
    truth = fly(np.concatenate([exact[fine - 1 : fine], exact[fine:]]), dt / fine, True)
    plain = errors_between(truth, fly(means, dt, False))
    better = errors_between(truth, fly(means, dt, True))
    part = slice(0, 3) if kind == "cone" else slice(3, 6)
    assert np.abs(better[part]).max() < 0.1 * np.abs(plain[part]).max()
