"""How much later the velocity of a fix is true than its position, learnt from fixes alone."""

import numpy as np
import pytest

from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Fix
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from tests.core.interpreted import load

EARTH = 6378137.0


def settings(std: float = 0.1) -> Parameters:
    k = as_parameters(parameters(FilterSettings(), "unknown"))
    k.lag_std = std
    return k


def swaying(t: np.ndarray) -> np.ndarray:
    """Return the velocity of a vehicle that turns to and fro, m/s, of shape (n, 2)."""
    return np.stack([6.0 * np.sin(0.7 * t), 8.0 * np.sin(0.45 * t + 1.0)], axis=-1)


def moved(t: np.ndarray) -> np.ndarray:
    """Return the way to it, m, of the same shape."""
    return np.stack([-6.0 / 0.7 * np.cos(0.7 * t), -8.0 / 0.45 * np.cos(0.45 * t + 1.0)], axis=-1)


def fly(seconds, lag, *, rate=5.0, noise=0.1, jump=0.0, speed=1.0, seed=1, std=0.1):
    """Return the state after fixes whose velocity is so much later than their position, s."""
    x, k, fix = State(), settings(std), Fix()
    load().restart.start(x, 0.0)
    load().lag.forget(x)
    x.origin.is_known, x.origin.scale_n, x.origin.scale_e = 1.0, EARTH, EARTH
    x.fix_dt = 1.0 / rate
    fix.stated_var[:] = [1.0, 1.0, 0.01]
    rng = np.random.default_rng(seed)
    for n in range(round(seconds * rate)):
        t = 5.0 + n / rate
        x.t = t * 1e9
        pos = speed * moved(t) + noise * rng.standard_normal(2)
        if jump and 0.5 < n / (seconds * rate) < 0.7:
            pos += jump
        vel = speed * swaying(t - lag) + 0.05 * rng.standard_normal(2)
        fix.lat, fix.lon = pos / EARTH
        fix.vel_n[:] = [*vel, 0.0]
        load().lag.take(x, k, fix)
    return x, k, fix


@pytest.mark.parametrize("lag", [-0.1, 0.0, 0.08, 0.2])
@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0, 10.0])
def test_a_velocity_that_is_later_than_its_position_is_found(lag, rate):
    x, _, fix = fly(60.0, lag, rate=rate)
    assert fix.lag == x.lag.late
    assert fix.lag == pytest.approx(lag, abs=max(0.02, 4.0 * fix.lag_var**0.5))
    assert fix.lag_var < 0.05**2


def test_the_lag_is_as_sure_as_it_is_said_to_be():
    squares = []
    for seed in range(24):
        lag = float(np.random.default_rng(100 + seed).normal(0.0, 0.1))
        _, _, fix = fly(40.0, lag, noise=0.5, seed=seed)
        squares.append((fix.lag - lag) ** 2 / fix.lag_var)
    # chi-square of 24, 0.001 on the side that is too sure; neighbouring gains share a fix, whose
    # noise is counted twice
    assert np.sum(squares) < 51.2
    assert np.sum(squares) > 2.0


def test_a_position_that_jumps_and_comes_back_leaves_the_lag_as_it_was():
    _, _, fix = fly(60.0, 0.15, jump=40.0)
    assert fix.lag == pytest.approx(0.15, abs=0.03)


def test_a_hover_says_nothing_of_the_lag_and_leaves_it_unknown():
    x, _, fix = fly(60.0, 0.15, speed=0.02)
    assert x.lag.changed2 == 0.0
    assert (fix.lag, fix.lag_var) == (0.0, pytest.approx(0.1**2))


def test_another_receiver_begins_anew():
    x, k, fix = fly(60.0, 0.15)
    load().lag.forget(x)
    fix.vel_n[0] += 1.0
    load().lag.take(x, k, fix)
    assert (fix.lag, fix.lag_var) == (0.0, pytest.approx(0.1**2))


def test_a_receiver_that_is_told_to_have_none_has_none():
    x, _, fix = fly(60.0, 0.15, std=0.0)
    assert x.lag.changed2 == 0.0
    assert (fix.lag, fix.lag_var) == (0.0, 0.0)


def test_fixes_without_velocity_or_far_apart_teach_nothing():
    x, k, fix = fly(60.0, 0.15)
    before = x.lag.changed2
    for n in range(20):
        x.t += 3e9
        fix.vel_n[:] = [(-1.0) ** n * 5.0, 0.0, 0.0]
        load().lag.take(x, k, fix)
    assert x.lag.changed2 == before
    fix.vel_n[0] = np.nan
    fix.lag, fix.lag_var = 0.0, 0.0
    load().lag.take(x, k, fix)
    assert fix.lag_var == 0.0
