import tracemalloc

import numpy as np
import pytest

from ekf_companion.filters.gauss_newton import Manifold, Rows, correct, factor, gain
from ekf_companion.filters.strapdown import ATT, N
from tests.filters.differences import central, some_state
from tests.filters.room import COLUMNS, PRIOR_STD, Scan, start, update

PLANE = Manifold(
    plus=np.add,
    minus=np.subtract,
    jacobian=lambda x, y: np.eye(len(x)),
)


def covariance(k, rng):
    A = rng.standard_normal((k, k + 2))
    return A @ A.T


@pytest.mark.parametrize("count", [1, 6, 15, 40])
@pytest.mark.parametrize("columns", [None, np.r_[0:3, 6:9]])
def test_both_forms_of_the_gain_are_one(count, columns):
    rng = np.random.default_rng(count)
    P = covariance(N, rng)
    H = rng.standard_normal((count, N if columns is None else len(columns)))
    (K_s, P_s), (K_i, P_i) = (
        gain(factor(P), H, np.eye(count), columns, form) for form in ("innovation", "information")
    )
    np.testing.assert_allclose(K_s, K_i, atol=1e-9)
    np.testing.assert_allclose(P_s, P_i, atol=1e-9)
    full = np.zeros((count, N))
    full[:, np.arange(N) if columns is None else columns] = H
    textbook = P @ full.T @ np.linalg.inv(full @ P @ full.T + np.eye(count))
    np.testing.assert_allclose(K_s, textbook, atol=1e-9)
    np.testing.assert_allclose(P_s, (np.eye(N) - textbook @ full) @ P, atol=1e-9)


def test_a_linear_problem_is_solved_at_once_and_costs_the_nis():
    rng = np.random.default_rng(3)
    P, H, R = covariance(4, rng), rng.standard_normal((2, 4)), covariance(2, rng)
    x, seen = rng.standard_normal(4), rng.standard_normal(2)
    found = correct(x, P, lambda at: Rows(seen - H @ at, H, R), PLANE)
    z, S = seen - H @ x, H @ P @ H.T + R
    np.testing.assert_allclose(found.state, x + P @ H.T @ np.linalg.solve(S, z), atol=1e-10)
    assert found.cost == pytest.approx(z @ np.linalg.solve(S, z), rel=1e-9)
    assert found.evaluations == 2
    assert found.is_settled


def test_what_changes_nothing_is_evaluated_once():
    found = correct(np.ones(2), np.eye(2), lambda x: Rows(1.0 - x, np.eye(2), np.ones(2)), PLANE)
    assert (found.evaluations, found.is_settled) == (1, True)


def test_a_full_step_that_would_raise_the_cost_is_halved():
    # Newton's own example: on arctan full steps from 2 run away, ever further
    def rows(x):
        return Rows(-np.arctan(x), np.array([[1.0 / (1.0 + x[0] ** 2)]]), np.array([1e-4]))

    found = correct(np.array([2.0]), np.array([[1e6]]), rows, PLANE)
    assert found.is_settled
    assert abs(found.state[0]) < 0.01
    assert found.evaluations > 3
    linear = correct(np.array([2.0]), np.array([[1e6]]), rows, PLANE, max_iterations=1)
    assert linear.state[0] < -3.0


def test_the_result_is_the_least_cost():
    rng = np.random.default_rng(5)
    truth, prior, P = start(rng)
    scan = Scan.of(truth, 200, rng)
    found = update(prior, P, scan)

    def cost(x):
        gap, rows = x.minus(prior) / PRIOR_STD, scan.rows(x)
        return gap @ gap + (rows.z**2 / rows.R).sum()

    least = cost(found.state)
    for axis in np.vstack([np.eye(N), -np.eye(N)]):
        assert cost(found.state.plus(0.3 * np.sqrt(np.diag(found.P)) * axis)) > least


def test_a_state_that_is_known_stays():
    P = np.diag([1.0, 0.0, 2.0])
    H = np.ones((1, 3))
    for form in ("innovation", "information"):
        found = correct(
            np.zeros(3), P, lambda x: Rows(3.0 - H @ x, H, np.array([0.5])), PLANE, form=form
        )
        assert found.state[1] == 0.0
        np.testing.assert_allclose(found.P[1], 0.0, atol=1e-15)
        np.testing.assert_allclose(found.state[2], 2.0 * found.state[0], rtol=1e-9)


def test_the_rows_of_a_scan_are_the_derivative_of_what_they_say():
    rng = np.random.default_rng(1)
    state = some_state()
    scan = Scan.of(start(rng)[0], 30, rng)
    seen = -central(lambda dx: scan.rows(state.plus(dx)).z, N)
    np.testing.assert_allclose(scan.rows(state).H, seen[:, COLUMNS], atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_five_thousand_points_find_the_pose_that_one_linear_step_misses(seed):
    rng = np.random.default_rng(seed)
    truth, prior, P = start(rng)
    scan = Scan.of(truth, 5000, rng)
    found, linear = (update(prior, P, scan, max_iterations=n) for n in (20, 1))
    gap, part = truth.minus(found.state)[COLUMNS], found.P[np.ix_(COLUMNS, COLUMNS)]
    assert found.is_settled
    assert gap @ np.linalg.solve(part, gap) < 22.5  # chi-square of 6 dof, 0.999
    gap, part = truth.minus(linear.state)[COLUMNS], linear.P[np.ix_(COLUMNS, COLUMNS)]
    assert gap @ np.linalg.solve(part, gap) > 1e3
    assert np.linalg.eigvalsh(found.P).min() > 0.0
    assert (found.P == found.P.T).all()


def test_both_forms_agree_on_a_scan():
    rng = np.random.default_rng(2)
    truth, prior, P = start(rng)
    scan = Scan.of(truth, 300, rng)
    one, other = (update(prior, P, scan, form) for form in ("innovation", "information"))
    np.testing.assert_allclose(one.state.minus(other.state), 0.0, atol=1e-9)
    np.testing.assert_allclose(one.P, other.P, atol=1e-9)


def test_thousands_of_rows_need_memory_by_their_number_only():
    rng = np.random.default_rng(2)
    truth, prior, P = start(rng)
    scan = Scan.of(truth, 20_000, rng)
    tracemalloc.start()
    update(prior, P, scan)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6  # n by n would be 3 GB


def test_the_covariance_is_about_the_state_that_is_given():
    rng = np.random.default_rng(7)
    truth, prior, P = start(rng)
    scan = Scan.of(truth, 100, rng)
    linear = update(prior, P, scan, max_iterations=1)
    z, H, R, _ = scan.rows(prior)
    weight = 1.0 / np.sqrt(R)
    before = gain(factor(P), H * weight[:, None], z * weight, COLUMNS)[1]
    # What lies dx from the prior lies elsewhere from the state that moved
    ends = rng.multivariate_normal(np.zeros(N), before, 20_000) * 0.1
    seen = np.cov(
        [prior.plus(linear.state.minus(prior) + d).minus(linear.state) for d in ends[:2000]],
        rowvar=False,
    )
    turned, still = (
        np.abs(P_[ATT, ATT] * 0.01 - seen[ATT, ATT]).max() for P_ in (linear.P, before)
    )
    assert turned < 0.1 * np.abs(seen[ATT, ATT]).max()
    assert turned < still
