"""Rest: what it observes, and which windows of samples show it."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Mode
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, some_parameters

RATE = [0.1, -0.2, 0.3]
G = 9.8


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobians_are_the_slopes_of_the_prediction(seed):
    rest = load().rest
    check(lambda x, k, o: rest.zero_velocity(x, o, 0.1), a_state(seed), 1e-5)
    # how attitude turns the Earth's rate is left out
    check(lambda x, k, o: rest.zero_rate(x, o, RATE, 0.1, 0.3), a_state(seed), 1e-4)


def window(gyro: np.ndarray, accel: np.ndarray):
    """Return a state with a window of samples at 100 Hz, and the parameters that judge it."""
    rest, x, k = load().rest, a_state(1), some_parameters()
    x.mode, k.rest_gyro, k.rest_accel, k.align_time = Mode.NAVIGATE, 0.05, 0.6, 1.0
    x.vel_n[:] = [0.0] * 3
    rest.begin_window(x, x.t)
    for rate, force in zip(gyro, accel, strict=True):
        x.t += 1e7
        x.gyro[:], x.accel[:] = rate, force
        rest.add_to_window(x)
    return x, k


def samples(seed: int, n: int = 100, gyro: float = 1e-3, accel: float = 0.03):
    rng = np.random.default_rng(seed)
    up = np.array([0.0, 0.0, -G])
    return rng.normal(0.0, gyro, (n, 3)), up + rng.normal(0.0, accel, (n, 3))


@pytest.mark.parametrize("seed", range(5))
def test_a_quiet_window_is_rest_and_a_shaken_turning_or_pushed_one_is_not(seed):
    rest = load().rest
    gyro, accel = samples(seed)
    x, k = window(gyro, accel)
    assert rest.is_full(x, k)
    assert rest.was_at_rest(x, k)
    ramp = np.linspace(0.0, 1.0, 100)[:, None]
    for other in (
        samples(seed, gyro=0.1),
        samples(seed, accel=0.8),
        (gyro + np.array([0.0, 0.0, 0.2]), accel),  # a turn that no gyro's bias is
        (gyro, accel * 1.2),  # not one g
        (gyro, accel + np.array([0.5, 0.0, 0.0]) * ramp),  # a deck that rocks
    ):
        assert not rest.was_at_rest(*window(*other))


def test_half_a_window_is_none():
    x, k = window(*samples(1, n=50))
    assert not load().rest.is_full(x, k)


@pytest.mark.parametrize(("landed", "speed", "moves"), [(0.0, 5.0, True), (1.0, 5.0, False)])
def test_who_flies_as_quietly_as_it_stands_moves(landed, speed, moves):
    x, _ = window(*samples(2))
    x.vel_n[0], x.landed = speed, landed
    assert bool(load().rest.is_moving(x)) == moves


def test_the_variance_of_the_force_is_that_of_the_window():
    gyro, accel = samples(3, n=400)
    x, _ = window(gyro, accel)
    assert load().rest.force_variance(x) == pytest.approx(accel.var(axis=0).sum(), rel=1e-6)
