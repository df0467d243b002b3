import numpy as np
import pytest

from ekf_companion.core import state as at
from tests.core.interpreted import load
from tests.core.test_observe import a_state


def a_problem(seed: int, m: int):
    rng = np.random.default_rng(seed)
    x, w = a_state(seed), np.zeros(at.SCRATCH)
    root = rng.normal(0.0, 0.1, (at.N, at.N))
    P = root @ root.T
    H = rng.normal(0.0, 1.0, (m, at.N))
    z = rng.normal(0.0, 0.01, m)
    root = rng.normal(0.0, 0.5, (m, m))
    R = root @ root.T + 0.1 * np.eye(m)
    x[at.X_COV :] = P.ravel()
    w[at.W_H : at.W_H + m * at.N] = H.ravel()
    w[at.W_Z : at.W_Z + m] = z
    for i in range(m):
        w[at.W_R + 3 * i : at.W_R + 3 * i + m] = R[i]
    return x, w, P, H, z, R


def test_a_block_is_absorbed_as_the_joseph_form_says():
    for m in (1, 2, 3):
        x, w, P, H, z, R = a_problem(m, m)
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        I_KH = np.eye(at.N) - K @ H
        dx = K @ z
        expected = I_KH @ P @ I_KH.T + K @ R @ K.T
        d = 0.5 * dx[:3]
        J = np.eye(at.N)
        J[:3, :3] += [[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]
        expected = J @ expected @ J.T

        nis = load().correct.innovate(x, w, m)
        load().correct.absorb(x, w, m)
        assert np.isclose(nis, z @ np.linalg.inv(S) @ z, rtol=1e-12)
        np.testing.assert_allclose(w[at.W_DX : at.W_DX + at.N], dx, rtol=1e-10, atol=1e-15)
        after = x[at.X_COV :].reshape(at.N, at.N)
        np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-13)
        assert np.array_equal(after, after.T)
        assert np.linalg.eigvalsh(after).min() > 0.0


def test_an_azimuth_moves_yaw_gyro_bias_and_iron_only_and_says_so_in_its_covariance():
    x, w, P, H, z, R = a_problem(6, 1)
    before = x.copy()
    S = H @ P @ H.T + R
    K = P @ H.T / S
    down = np.array([0.36, -0.48, 0.8])
    w[at.W_C_NB + 6 : at.W_C_NB + 9] = down
    K[at.E_BG : at.E_BG + 3, 0] = down * (down @ K[at.E_BG : at.E_BG + 3, 0])
    free = [at.E_ATT + 2, at.E_BG, at.E_BG + 1, at.E_BG + 2, at.E_HEADING]
    free += [at.E_IRON, at.E_IRON + 1, at.E_IRON + 2]
    K[[i for i in range(at.N) if i not in free]] = 0.0
    I_KH = np.eye(at.N) - K @ H
    expected = I_KH @ P @ I_KH.T + K @ R @ K.T
    dx = (K @ z).ravel()
    J = np.eye(at.N)
    J[:3, :3] += 0.5 * np.array([[0, -dx[2], 0], [dx[2], 0, 0], [0, 0, 0]])
    load().correct.innovate(x, w, 1)
    load().correct.absorb_yaw(x, w)
    after = x[at.X_COV :].reshape(at.N, at.N)
    np.testing.assert_allclose(after, J @ expected @ J.T, rtol=1e-9, atol=1e-13)
    assert np.array_equal(after, after.T)
    same = slice(at.X_VEL, at.X_BG)
    assert x[same].tolist() == before[same].tolist()


def test_an_innovation_covariance_that_is_none_passes_no_gate():
    x, w, *_ = a_problem(4, 2)
    w[at.W_R : at.W_R + 9] = -100.0
    assert load().correct.innovate(x, w, 2) > 1e20


def test_the_difference_of_two_states_is_the_error_that_was_injected_and_takes_p_back():
    correct = load().correct
    for seed, size in ((1, 0.3), (2, 2.5), (3, 1e-5)):
        x, w, P, *_ = a_problem(seed, 1)
        rng = np.random.default_rng(seed)
        error = rng.normal(0.0, 1.0, at.N)  # every state: one that is left out comes back as zero
        error[:3] *= size / np.linalg.norm(error[:3])
        y = x.copy()
        if seed == 2:
            y[at.X_Q : at.X_Q + 4] *= -1.0
        w[at.W_DX : at.W_DX + at.N] = error
        correct.inject(y, w)
        assert not np.allclose(y[at.X_COV :], x[at.X_COV :], rtol=1e-9)
        w[at.W_DX : at.W_DX + at.N] = np.nan
        correct.difference(x, y, w)
        np.testing.assert_allclose(w[at.W_DX : at.W_DX + at.N], error, rtol=1e-9, atol=1e-14)
        correct.rebase(y, w)
        after = y[at.X_COV :].reshape(at.N, at.N)
        np.testing.assert_allclose(after, P, rtol=1e-12, atol=1e-14)
        assert np.array_equal(after, after.T)


def test_forgetting_leaves_no_correlation():
    x, *_ = a_problem(5, 1)
    load().correct.forget(x, at.E_VEL, 3, 4.0)
    P = x[at.X_COV :].reshape(at.N, at.N)
    assert np.array_equal(P[at.E_VEL : at.E_VEL + 3, at.E_VEL : at.E_VEL + 3], 4.0 * np.eye(3))
    assert not P[at.E_VEL, : at.E_VEL].any()
    assert not P[at.E_POS :, at.E_VEL].any()
    fresh = x[at.X_FRESH : at.X_FRESH + at.N]
    assert np.flatnonzero(fresh).tolist() == [at.E_VEL, at.E_VEL + 1, at.E_VEL + 2]


def test_a_log_likelihood_is_that_of_a_normal_distribution_up_to_the_gate():
    account = load().gate
    x, w = np.zeros(at.BLOCK), np.zeros(at.SCRATCH)
    S = np.array([[4.0, 1.0], [1.0, 2.0]])
    L = np.linalg.cholesky(S)
    w[at.W_L], w[at.W_L + 3], w[at.W_L + 4] = L[0, 0], L[1, 0], L[1, 1]
    z = np.array([1.0, -2.0])
    nis = float(z @ np.linalg.solve(S, z))
    account.score(x, w, 2, nis, 20.0)
    said = -0.5 * (nis + np.log(np.linalg.det(S)))
    assert x[at.X_LOGLIK] == pytest.approx(said, rel=1e-12)
    account.score(x, w, 2, 1e6, 20.0)
    outlier = -0.5 * (20.0 + np.log(np.linalg.det(S)))
    assert x[at.X_LOGLIK] == pytest.approx(said + outlier, rel=1e-12)
    account.score(x, w, 2, 1e30, 20.0)
    assert x[at.X_LOGLIK] == pytest.approx(said + outlier, rel=1e-12)
