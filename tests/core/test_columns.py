"""The columns of a fault follow what the filter does to its state, by dense algebra."""

import ctypes

import numpy as np
import pytest

from ekf_companion.core.memory.bank import BANK, MOVING, Bank
from ekf_companion.core.memory.enums import E_DELAY, E_HEADING, E_POS, N
from ekf_companion.core.memory.scratch import Motion
from tests.core.interpreted import load
from tests.core.states import array, some_parameters
from tests.core.test_update import a_problem


def a_bank(o, rng, count: int = 2):
    """Return a bank with some instances, laid under an observation; and their columns."""
    numbers = np.zeros((1, BANK))
    banks = ctypes.cast(numbers.ctypes.data, ctypes.POINTER(Bank))
    o.has_bank, o.bank = 1, banks
    b = banks[0]
    load().columns.stand(b)
    b.n = count
    U = rng.normal(0.0, 1.0, (count, 3, N))
    for i in range(count):
        b.instance[i].rows = i + 1
        array(b.instance[i].U)[:] = U[i]
    return numbers, b, U


def turned(dx):
    d = 0.5 * dx[:3]
    J = np.eye(N)
    J[:3, :3] += [[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]
    return J


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("shows_delay", [0, 1])
def test_a_correction_takes_its_gain_off_what_the_fault_adds_to_the_rows(rows, shows_delay):
    x, o, P, H, _, R = a_problem(rows, rows)
    o.shows_delay = shows_delay
    rng = np.random.default_rng(rows)
    _memory, b, U = a_bank(o, rng)
    D = rng.normal(0.0, 1.0, (rows, 3))
    load().columns.observe(x, b, o)
    for i in range(b.n):
        array(b.T)[i, :rows, : i + 1] += D[:, : i + 1]
    b.is_observed = 1
    load().update.innovate(x, o)
    load().update.apply_update(x, o)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    if not shows_delay:
        K[E_DELAY] = 0.0
    J = turned(array(o.dx))
    for i in range(b.n):
        for c in range(i + 1):
            expected = J @ (U[i, c] - K @ (H @ U[i, c] + D[:, c]))
            np.testing.assert_allclose(array(b.instance[i].U)[c], expected, rtol=1e-9, atol=1e-12)


def test_a_correction_that_nobody_weighed_is_followed_too():
    x, o, P, H, _, R = a_problem(5, 2)
    o.shows_delay = 1
    _memory, b, U = a_bank(o, np.random.default_rng(5))
    load().update.innovate(x, o)
    load().update.apply_update(x, o)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    expected = turned(array(o.dx)) @ (U[0, 0] - K @ H @ U[0, 0])
    np.testing.assert_allclose(array(b.instance[0].U)[0], expected, rtol=1e-9, atol=1e-12)


def test_transitions_multiply_up_to_those_of_the_covariance():
    x, o, *_ = a_problem(3, 1)
    k, m = some_parameters(), Motion()
    _memory, b, U = a_bank(o, np.random.default_rng(3))
    rng = np.random.default_rng(4)
    whole, faded = np.eye(N), np.ones(N)
    for _ in range(5):
        dt = 0.01
        array(m.G)[:] = rng.normal(0.0, dt, (3, 3))
        array(m.S)[:] = rng.normal(0.0, 0.1, (3, 3))
        array(m.SG)[:] = 0.5 * array(m.S) @ array(m.G)
        m.slow_dt, m.heading_faded = dt, 1e-3
        Phi = np.zeros((N, N))
        load().covariance.write_transition(k, m, dt, Phi)
        load().columns.move(b, k, m, dt)
        whole = Phi @ whole
        faded = np.diag(Phi) * faded
    moving = slice(0, MOVING)
    np.testing.assert_allclose(array(b.Phi), whole[moving, moving], rtol=1e-12, atol=1e-15)
    array(b.redrawn)[:] = array(x.redrawn)
    load().columns.follow(x, b)
    np.testing.assert_allclose(array(b.instance[0].U)[0], whole @ U[0, 0], rtol=1e-10, atol=1e-12)
    assert np.array_equal(array(b.Phi), np.eye(MOVING))


def test_what_is_a_copy_of_another_error_owes_to_the_fault_what_that_does():
    x, o, *_ = a_problem(4, 1)
    _memory, b, U = a_bank(o, np.random.default_rng(4))
    array(b.redrawn)[:] = array(x.redrawn)
    last = N - 1
    load().slow_error.copy_error(x, last, E_POS + 1, 1.0)
    load().slow_error.reset_variance(x, E_HEADING, 1, 1.0)
    load().columns.follow(x, b)
    U[..., last], U[..., E_HEADING] = U[..., E_POS + 1], 0.0
    for i in range(b.n):
        np.testing.assert_allclose(array(b.instance[i].U)[: i + 1], U[i, : i + 1], rtol=1e-12)
