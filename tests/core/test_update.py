import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    E_ATT,
    E_BG,
    E_DELAY,
    E_HEADING,
    E_IRON,
    Aid,
    N,
)
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy


def a_problem(seed: int, rows: int):
    rng = np.random.default_rng(seed)
    x, o = a_state(seed), Observation(rows=rows)
    root = rng.normal(0.0, 0.1, (N, N))
    P = root @ root.T
    H = rng.normal(0.0, 1.0, (rows, N))
    z = rng.normal(0.0, 0.01, rows)
    root = rng.normal(0.0, 0.5, (rows, rows))
    R = root @ root.T + 0.1 * np.eye(rows)
    array(x.P)[:] = P
    array(o.H)[:rows], array(o.z)[:rows], array(o.R)[:rows, :rows] = H, z, R
    return x, o, P, H, z, R


@pytest.mark.parametrize("shows_delay", [1, 0])
def test_an_update_is_what_the_joseph_form_says(shows_delay):
    """Where it does not show the delay, of a gain that is zero there."""
    for rows in (1, 2, 3):
        x, o, P, H, z, R = a_problem(rows, rows)
        o.shows_delay = shows_delay
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        if not shows_delay:
            K[E_DELAY] = 0.0
        I_KH = np.eye(N) - K @ H
        dx = K @ z
        expected = I_KH @ P @ I_KH.T + K @ R @ K.T
        d = 0.5 * dx[:3]
        J = np.eye(N)
        J[:3, :3] += [[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]
        expected = J @ expected @ J.T

        nis = load().update.innovate(x, o)
        load().update.apply_update(x, o)
        assert np.isclose(nis, z @ np.linalg.inv(S) @ z, rtol=1e-12)
        np.testing.assert_allclose(array(o.dx), dx, rtol=1e-10, atol=1e-15)
        after = array(x.P)
        np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-13)
        assert np.array_equal(after, after.T)
        assert np.linalg.eigvalsh(after).min() > 0.0


def test_noise_is_inflated_as_if_r_had_been_larger():
    x, o, P, H, _, R = a_problem(7, 2)
    S = H @ P @ H.T + R
    inflated = 2.5 * S - H @ P @ H.T
    y, larger = copy(x), copy(o)
    array(larger.R)[:2, :2] = inflated
    update = load().update
    update.innovate(x, o)
    update.inflate_noise(o, 2.5)
    update.apply_update(x, o)
    update.innovate(y, larger)
    update.apply_update(y, larger)
    np.testing.assert_allclose(array(x.P), array(y.P), rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(array(o.dx), array(larger.dx), rtol=1e-10)


def test_an_azimuth_moves_yaw_gyro_bias_and_iron_only_and_says_so_in_its_covariance():
    x, o, P, H, z, R = a_problem(6, 1)
    before = copy(x)
    S = H @ P @ H.T + R
    K = P @ H.T / S
    down = np.array([0.36, -0.48, 0.8])
    array(o.C_nb)[2] = down
    K[E_BG : E_BG + 3, 0] = down * (down @ K[E_BG : E_BG + 3, 0])
    free = [E_ATT + 2, E_BG, E_BG + 1, E_BG + 2, E_HEADING, E_IRON, E_IRON + 1, E_IRON + 2]
    K[[i for i in range(N) if i not in free]] = 0.0
    I_KH = np.eye(N) - K @ H
    expected = I_KH @ P @ I_KH.T + K @ R @ K.T
    dx = (K @ z).ravel()
    J = np.eye(N)
    J[:3, :3] += 0.5 * np.array([[0, -dx[2], 0], [dx[2], 0, 0], [0, 0, 0]])
    load().update.innovate(x, o)
    load().update.apply_yaw_update(x, o)
    after = array(x.P)
    np.testing.assert_allclose(after, J @ expected @ J.T, rtol=1e-9, atol=1e-13)
    assert np.array_equal(after, after.T)
    for name in ("vel_n", "pos_n"):
        assert list(getattr(x, name)) == list(getattr(before, name))


def test_an_innovation_covariance_that_is_none_passes_no_gate():
    x, o, *_ = a_problem(4, 2)
    array(o.R)[:] = -100.0
    assert np.isnan(load().update.innovate(x, o))
    k = Parameters()
    array(k.gate)[:], array(k.soft_gate)[:] = 1e9, 1e8
    assert not load().gate.fuse(x, k, o, Aid.HEADING)


def test_the_difference_of_two_states_is_the_error_that_was_injected_and_takes_p_back():
    update = load().update
    for seed, size in ((1, 0.3), (2, 2.5), (3, 1e-5)):
        x, o, P, *_ = a_problem(seed, 1)
        rng = np.random.default_rng(seed)
        error = rng.normal(0.0, 1.0, N)  # every state: one that is left out comes back as zero
        error[:3] *= size / np.linalg.norm(error[:3])
        y = copy(x)
        if seed == 2:
            array(y.q_nb)[:] *= -1.0
        array(o.dx)[:] = error
        update.inject(y, o)
        assert not np.allclose(array(y.P), array(x.P), rtol=1e-9)
        array(o.dx)[:] = np.nan
        update.difference(x, y, o)
        np.testing.assert_allclose(array(o.dx), error, rtol=1e-9, atol=1e-14)
        update.rebase(y, o)
        after = array(y.P)
        np.testing.assert_allclose(after, P, rtol=1e-12, atol=1e-14)
        assert np.array_equal(after, after.T)


def test_a_nominal_state_is_copied_whole_and_nothing_else_is():
    x, y = a_state(1), State()
    load().update.copy_nominal(y, x)
    o = Observation()
    load().update.difference(x, y, o)
    assert not array(o.dx).any()
    assert not any(y.gyro)
    assert not any(y.accel_n)


def test_a_log_likelihood_is_that_of_a_normal_distribution_up_to_the_gate():
    gate = load().gate
    x, o = State(), Observation(rows=2)
    S = np.array([[4.0, 1.0], [1.0, 2.0]])
    array(o.L)[:2, :2] = np.linalg.cholesky(S)
    z = np.array([1.0, -2.0])
    nis = float(z @ np.linalg.solve(S, z))
    gate.score(x, o, nis, 20.0)
    right = -0.5 * (nis + np.log(np.linalg.det(S)))
    assert x.log_likelihood == pytest.approx(right, rel=1e-12)
    gate.score(x, o, 1e6, 20.0)
    outlier = -0.5 * (20.0 + np.log(np.linalg.det(S)))
    assert x.log_likelihood == pytest.approx(right + outlier, rel=1e-12)
    gate.score(x, o, np.nan, 20.0)  # no covariance to judge by
    assert x.log_likelihood == pytest.approx(right + outlier, rel=1e-12)
