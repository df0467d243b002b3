"""P carried on by a motion, against the slope of the motion itself."""

import numpy as np
import pytest
from scipy.linalg import expm

from ekf_companion.core.memory.enums import E_HEADING, Aid, N
from ekf_companion.core.memory.scratch import Motion, TapeRecord
from tests.core.interpreted import load
from tests.core.states import (
    SAMPLE,
    a_state,
    array,
    copy,
    let_walk,
    minus,
    plus,
    sampled,
    some_parameters,
)


def move(x, k, m, dt):
    """Integrate the state and propagate its covariance."""
    load().strapdown.integrate_strapdown(x, k, sampled(m), dt)
    load().process_noise.scale_noise(x, k, m)
    load().covariance.propagate_covariance(x, k, m)


@pytest.mark.parametrize("dt", [0.004, 0.02, 0.1])
def test_covariance_follows_the_slope_of_the_motion(dt):
    x, k, m = a_state(5), some_parameters(), Motion()
    Phi = np.zeros((N, N))
    step = 1e-5
    for i in range(N):
        ends = []
        for sign in (1.0, -1.0):
            moved = plus(x, sign * step * np.eye(N)[i])
            move(moved, k, m, dt)
            ends.append(moved)
        Phi[:, i] = minus(*ends) / (2.0 * step)

    rng = np.random.default_rng(6)
    root = (
        rng.normal(0.0, 1.0, (N, N))
        * np.repeat([0.1, 1.0, 5.0, 0.01, 0.2, 1.0, 0.01, 0.1], [3, 3, 3, 3, 3, 6, 3, N - 24])[
            :, None
        ]
    )
    P = root @ root.T
    array(x.P)[:] = P
    move(x, k, m, dt)
    after = array(x.P)

    assert np.array_equal(after, after.T)
    expected = Phi @ P @ Phi.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # the mean direction of the turning body is taken at the start: half of 1 rad/s dt of a bias
    assert np.abs((after - expected) / scale).max() < 5e-4 + 0.5 * dt * dt


def test_a_covariance_that_follows_three_samples_at_once_is_as_exact():
    k, m = some_parameters(), Motion()
    root = np.random.default_rng(9).normal(0.0, 1.0, (N, N))
    found = []
    for every in (1, 3):
        x = a_state(7)
        array(x.P)[:] = root @ root.T
        for n in range(1, 13):
            turning = (3.0 * np.sin(n), -4.0, 2.0, *SAMPLE[3:])
            load().strapdown.integrate_strapdown(x, k, sampled(m, turning), 0.004)
            if n % every == 0:
                load().process_noise.scale_noise(x, k, m)
                load().covariance.propagate_covariance(x, k, m)
        found.append(np.array(x.P))
    each, at_once = found
    sigmas = np.sqrt(np.diag(each))
    # second order in 12 ms: the largest, of a gyro bias in position
    assert np.abs((at_once - each) / np.outer(sigmas, sigmas)).max() < 1e-3
    assert not np.array_equal(at_once, each)


@pytest.mark.parametrize("dt", [0.004, 0.1])
def test_the_transition_is_the_one_that_the_covariance_went_by(dt):
    x, k, m, record = a_state(8), some_parameters(), Motion(), TapeRecord()
    k.gyro_noise, k.accel_noise = 2e-3, 3e-2
    let_walk(k, Aid.BARO, 0.05)
    k.gyro_bias_walk, k.accel_bias_walk, x.heading_std = 1e-4, 1e-3, 0.1
    root = np.random.default_rng(8).normal(0.0, 1.0, (N, N))
    ends = []
    for P in (root @ root.T, np.zeros((N, N))):
        y = copy(x)
        array(y.P)[:] = P
        move(y, k, m, dt)
        load().covariance.write_transition(k, m, dt, record.Phi)
        ends.append(np.array(y.P))
    Phi = np.array(record.Phi)
    with_noise, noise = ends
    assert np.diag(noise).min() >= 0.0 < np.trace(noise)
    np.testing.assert_allclose(with_noise, Phi @ root @ root.T @ Phi.T + noise, atol=1e-12)


def test_noise_is_what_van_loan_gives():
    x, k, m = a_state(7), some_parameters(), Motion()
    k.gyro_noise, k.accel_noise = 2e-3, 3e-2
    k.gyro_bias_walk, k.accel_bias_walk = 1e-4, 1e-3
    let_walk(k, Aid.BARO, 0.05)
    dt = 0.01
    move(x, k, m, dt)
    C, force = np.array(m.C_nb), np.array(m.dv_n) / dt

    F = np.zeros((N, N))
    F[0:3, 9:12] = -C
    F[3:6, 0:3] = -np.array(
        [[0, -force[2], force[1]], [force[2], 0, -force[0]], [-force[1], force[0], 0]]
    )
    F[3:6, 12:15] = -C
    F[6:9, 3:6] = np.eye(3)
    variances = [2e-3**2, 3e-2**2, 0.0, 1e-4**2, 1e-3**2, 0.05**2, 0.0]
    Q = np.diag(np.repeat(variances, [3, 3, 3, 3, 3, 1, N - 16]))
    block = expm(np.block([[-F, Q], [np.zeros_like(F), F.T]]) * dt)
    expected = block[N:, N:].T @ block[:N, N:]
    after = array(x.P)
    for part in (slice(0, 3), slice(3, 6), slice(9, 12), slice(12, 15), slice(15, 16)):
        # to first order in dt: what the noise of attitude adds to velocity in 10 ms is left out
        largest = np.abs(expected[part, part]).max()
        np.testing.assert_allclose(after[part, part], expected[part, part], atol=1e-4 * largest)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_decay_is_that_of_a_gauss_markov_process(share):
    x, e, level = a_state(4), E_HEADING, 0.5
    root = np.random.default_rng(4).normal(0.0, 0.1, (N, N))
    array(x.P)[:] = root @ root.T
    before = array(x.P).copy()
    Phi = np.eye(N)
    Phi[e, e] = 1.0 - share
    load().covariance.decay(x, e, share, level)
    expected = Phi @ before @ Phi.T
    expected[e, e] += (1.0 - (1.0 - share) ** 2) * level
    after = array(x.P)
    after[e, :9] = after[:9, e]  # the propagation mirrors the first nine rows itself
    np.testing.assert_allclose(after, expected, rtol=1e-12, atol=1e-15)
