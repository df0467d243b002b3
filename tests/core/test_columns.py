"""The columns of a fault follow what the filter does to its state, by dense algebra."""

import ctypes

import numpy as np
import pytest

from ekf_companion.core.memory.bank import BANK, MOVING, Bank
from ekf_companion.core.memory.enums import E_DELAY, E_HEADING, E_POS, N
from ekf_companion.core.memory.packing import pack, unpack
from ekf_companion.core.memory.scratch import Motion
from tests.core.interpreted import load
from tests.core.states import a_state, array, some_parameters
from tests.core.test_update import a_problem


def a_bank(o, rng, count: int = 2):
    """Return a bank with some instances, laid under an observation; and their columns."""
    numbers = np.zeros((1, BANK))
    banks = ctypes.cast(numbers.ctypes.data, ctypes.POINTER(Bank))
    o.has_bank, o.bank = 1, banks
    b = banks[0]
    load().columns.stand(b)
    b.n, b.pairs = count, count - 1
    U = rng.normal(0.0, 1.0, (count, 3, N))
    for i in range(count):  # those of more components stand first
        b.instance[i].rows = components(i, count)
        for c in range(components(i, count)):
            array(b.U)[c, :, i] = U[i, c]
    return numbers, b, U


def components(i, count: int = 2):
    return count - i


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
    load().columns.observe(b, o, N)
    for i in range(b.n):
        for c in range(components(i)):
            array(b.T)[c, :rows, i] += D[:, c]
    b.is_observed = 1
    load().update.innovate(x, o)
    load().update.apply_update(x, o)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    if not shows_delay:
        K[E_DELAY] = 0.0
    J = turned(array(o.dx))
    for i in range(b.n):
        for c in range(components(i)):
            expected = J @ (U[i, c] - K @ (H @ U[i, c] + D[:, c]))
            np.testing.assert_allclose(array(b.U)[c, :, i], expected, rtol=1e-9, atol=1e-12)


def test_a_correction_that_nobody_weighed_is_followed_too():
    x, o, P, H, _, R = a_problem(5, 2)
    o.shows_delay = 1
    _memory, b, U = a_bank(o, np.random.default_rng(5))
    load().update.innovate(x, o)
    load().update.apply_update(x, o)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    expected = turned(array(o.dx)) @ (U[0, 0] - K @ H @ U[0, 0])
    np.testing.assert_allclose(array(b.U)[0, :, 0], expected, rtol=1e-9, atol=1e-12)


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
    np.testing.assert_allclose(array(b.U)[0, :, 0], whole @ U[0, 0], rtol=1e-10, atol=1e-12)
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
        for c in range(components(i)):
            np.testing.assert_allclose(array(b.U)[c, :, i], U[i, c], rtol=1e-12)


def test_what_begins_and_ends_leaves_all_others_as_they_are():
    b, rng = Bank(), np.random.default_rng(2)
    load().hypotheses.begin(a_state(2), some_parameters(), b)
    expected = {}
    for step in range(400):
        if b.n and rng.random() < 0.4:
            gone = int(rng.integers(b.n))
            del expected[b.instance[gone].t0]
            load().onsets.drop(b, gone)
        else:
            i = load().onsets.make_room(b, int(rng.integers(1, 5)))
            h = b.instance[i]
            rows = 1 + sum(i < many for many in (b.pairs, b.triples, b.fours))
            h.rows, h.t0 = rows, float(step)
            U = rng.normal(size=(rows, N))
            for c in range(rows):
                array(b.U)[c, :, i] = U[c]
            expected[h.t0] = U
        assert b.n == len(expected) >= b.pairs >= b.triples >= b.fours >= 0
        for i in range(b.n):
            h = b.instance[i]
            assert h.rows == 1 + sum(i < many for many in (b.pairs, b.triples, b.fours))
            assert np.array_equal(array(b.U)[: h.rows, :, i], expected[h.t0])


def test_a_bank_that_is_saved_is_the_same_again():
    rng = np.random.default_rng(6)
    _, o, *_ = a_problem(4, 1)
    numbers, b, _ = a_bank(o, rng)
    array(b.U)[:, N - 5 :] = 0.0  # of errors that are not carried yet
    packed = pack(numbers[0])
    saved, again = Bank(), Bank()
    again.U[2][N - 1][7] = 1.0
    load().columns.save(saved, b, N - 5)
    copied = Bank()
    load().columns.copy_saved(copied, saved)
    load().columns.load(again, copied)
    for c in range(2):
        n = load().columns.with_component(b, c)
        assert np.array_equal(array(again.U)[c, :, :n], array(b.U)[c, :, :n])
    assert np.array_equal(pack(unpack(packed)), packed)
    with pytest.raises(ValueError, match="no bank"):
        unpack(packed[:-1])
