"""Error states set by hand: P stays symmetric and a covariance."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import CORE, E_BG, E_HEADING, E_POS, E_VEL, Aid, N
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load
from tests.core.states import array, let_walk, some_parameters


def a_covariance(seed: int) -> State:
    """Return a state with a full covariance."""
    x = State()
    root = np.random.default_rng(seed).normal(0.0, 0.1, (N, N))
    array(x.P)[:] = root @ root.T
    return x


def is_covariance(x: State) -> bool:
    P = array(x.P)
    return np.array_equal(P, P.T) and np.linalg.eigvalsh(P).min() > -1e-12


def test_a_reset_variance_leaves_no_correlation():
    x = a_covariance(5)
    load().slow_error.reset_variance(x, E_VEL, 3, 4.0)
    P = array(x.P)
    assert np.array_equal(P[E_VEL : E_VEL + 3, E_VEL : E_VEL + 3], 4.0 * np.eye(3))
    assert not P[E_VEL, :E_VEL].any()
    assert not P[E_POS:, E_VEL].any()
    assert np.flatnonzero(x.redrawn).tolist() == [E_VEL, E_VEL + 1, E_VEL + 2]
    assert is_covariance(x)


def test_what_is_added_to_a_variance_leaves_its_covariances():
    x = a_covariance(1)
    before = array(x.P).copy()
    load().slow_error.add_variance(x, E_VEL, 3.0)
    changed = np.argwhere(array(x.P) != before).tolist()
    assert changed == [[E_VEL, E_VEL]]
    assert x.P[E_VEL][E_VEL] == before[E_VEL, E_VEL] + 3.0
    assert is_covariance(x)


def test_an_error_that_two_states_share_is_added_to_both():
    """As of a height and an offset that was found by it."""
    x = a_covariance(2)
    before = array(x.P).copy()
    slow_error = load().slow_error
    for e in (E_POS, E_BG):
        slow_error.add_variance(x, e, 2.0)
    slow_error.add_covariance(x, E_POS, E_BG, 2.0)
    shared = np.zeros(N)
    shared[[E_POS, E_BG]] = 1.0
    np.testing.assert_allclose(array(x.P), before + 2.0 * np.outer(shared, shared), rtol=1e-15)
    assert is_covariance(x)


def test_an_error_copied_from_another_is_that_and_white_noise():
    x = a_covariance(3)
    load().slow_error.copy_error(x, E_HEADING, E_POS, 0.04)
    difference = np.zeros(N)
    difference[[E_HEADING, E_POS]] = [1.0, -1.0]
    assert difference @ array(x.P) @ difference == pytest.approx(0.04)
    assert is_covariance(x)


def test_a_scaled_correlation_is_scaled_in_row_and_column():
    x = a_covariance(6)
    before = array(x.P).copy()
    load().slow_error.scale_correlation(x, E_BG, 0.5)
    others = [i for i in range(N) if i != E_BG]
    np.testing.assert_array_equal(array(x.P)[E_BG, others], 0.5 * before[E_BG, others])
    np.testing.assert_array_equal(array(x.P), array(x.P).T)


def test_a_covariance_is_copied_and_cleared_whole():
    x, y = State(), a_covariance(7)
    load().slow_error.copy_covariance(x, y)
    assert np.array_equal(array(x.P), array(y.P))
    load().slow_error.clear_covariance(x)
    assert not array(x.P).any()


def test_the_errors_of_an_aid_are_carried_from_its_beginning_on():
    x, k, slow_error = State(), some_parameters(), load().slow_error
    let_walk(k, Aid.RANGE_FINDER, 0.1)
    let_walk(k, Aid.BARO, 0.1)
    assert slow_error.carried(x) == CORE
    slow_error.carry(x, k, Aid.BARO)  # it is there without any
    assert slow_error.carried(x) == CORE
    slow_error.carry(x, k, Aid.RANGE_FINDER)
    own = k.aid[Aid.RANGE_FINDER]
    assert slow_error.carried(x) == own.error + own.errors
    assert CORE < slow_error.carried(x) <= N


def test_it_is_known_of_which_error_another_is_a_copy():
    x = a_covariance(3)
    load().slow_error.copy_error(x, E_HEADING, E_BG, 1.0)
    assert x.copied[E_HEADING] == E_BG
    load().slow_error.reset_variance(x, E_HEADING, 1, 1.0)
    assert x.copied[E_HEADING] == -1


def test_a_share_of_another_error_brings_its_correlations():
    x = a_covariance(4)
    before, A = array(x.P).copy(), np.eye(N)
    A[E_HEADING, E_BG] = -0.7
    load().slow_error.add_error(x, E_HEADING, E_BG, -0.7)
    np.testing.assert_allclose(array(x.P), A @ before @ A.T, rtol=1e-12, atol=1e-12)
