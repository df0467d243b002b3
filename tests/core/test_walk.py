"""How fast slow errors of gyro, compass and barometer change, learnt from their corrections."""

from collections.abc import Callable

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BARO, E_BG, E_HEADING
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load

WALK = 3e-5
"""Of the gyro's bias as the filter takes it, rad/s/sqrt(s)."""
GYRO_NOISE = 3e-4
"""Of a bias that is observed once a second, rad/s."""
LEVEL = 0.02
"""One sigma of the heading's slow error as the filter takes it, rad."""
TIME = 100.0
"""Its time constant, s."""
HEADING_NOISE = 0.004
AIR = 0.15
"""Walk of the barometer's offset at full speed as the filter takes it, m/sqrt(s)."""
WEATHER = 0.02
"""Of the offset at rest."""
HEIGHT_NOISE = 0.1
"""Of an offset that is observed once a second, m."""


def begun() -> State:
    x = State()
    for j in range(3):
        x.P[E_BG + j][E_BG + j] = 1e-6
    x.P[E_HEADING][E_HEADING] = LEVEL**2
    load().walk.restart(x)
    return x


def corrected(P: float, R: float, innovation: float) -> tuple[float, float]:
    """Return a state's correction and its variance after it."""
    gain = P / (P + R)
    return gain * innovation, P * (1.0 - gain)


def follow_gyro(
    seed: int, seconds: int, true: Callable[[int], np.ndarray], *, learns: bool = True
) -> tuple[State, np.ndarray]:
    """Estimate biases that are observed once a second; return the state and its last errors."""
    rng, x, walk = np.random.default_rng(seed), begun(), load().walk
    errors = []
    for n in range(seconds):
        bias = true(n)
        variance = WALK**2 * (x.walk.drift if learns else 1.0)
        walk.note_gyro_walk(x, variance)
        for j in range(3):
            place = E_BG + j
            x.P[place][place] += variance
            innovation = bias[j] + GYRO_NOISE * rng.standard_normal() - x.gyro_bias[j]
            change, x.P[place][place] = corrected(x.P[place][place], GYRO_NOISE**2, innovation)
            x.gyro_bias[j] += change
        walk.learn_walk(x, 1.0)
        errors.append(np.array(x.gyro_bias) - bias)
    return x, np.array(errors)


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_that_walks_as_the_filter_takes_it_is_no_drift(seed):
    steps = np.random.default_rng(100 + seed).normal(0.0, WALK, (600, 3)).cumsum(axis=0)
    x, errors = follow_gyro(seed, 600, lambda n: steps[n])
    assert x.walk.drift < 10.0
    _, without = follow_gyro(seed, 600, lambda n: steps[n], learns=False)
    assert np.std(errors[100:]) < 1.1 * np.std(without[100:])


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_that_runs_away_is_followed(seed):
    """As that of a gyro that warms up: 2 deg/s in ten minutes."""
    ramp = np.array([1.0, -1.0, 1.0]) * np.radians(2.0) / 600.0
    x, errors = follow_gyro(seed, 600, lambda n: n * ramp)
    _, without = follow_gyro(seed, 600, lambda n: n * ramp, learns=False)
    assert x.walk.drift > 1.5
    lag, lag_without = np.abs(errors[300:].mean(axis=0)), np.abs(without[300:].mean(axis=0))
    assert (lag < 0.6 * lag_without).all()


def follow_heading(seed: int, seconds: int, true: Callable[[int], float]) -> State:
    """Estimate a heading's slow error that is observed once a second beside a known yaw."""
    rng, x, walk = np.random.default_rng(seed), begun(), load().walk
    e = E_HEADING
    for n in range(seconds):
        share = x.walk.heading_share
        faded = share / (share + TIME)
        x.heading_offset -= faded * x.heading_offset
        x.P[e][e] = (1.0 - faded) ** 2 * x.P[e][e] + faded * (2.0 - faded) * LEVEL**2
        walk.note_fading(x, faded, LEVEL**2)
        innovation = true(n) + HEADING_NOISE * rng.standard_normal() - x.heading_offset
        change, x.P[e][e] = corrected(x.P[e][e], HEADING_NOISE**2, innovation)
        x.heading_offset += change
        walk.learn_walk(x, 1.0)
    return x


@pytest.mark.parametrize("seed", range(5))
def test_a_compass_whose_error_changes_as_expected_keeps_its_time_constant(seed):
    rng, errors, kept = np.random.default_rng(200 + seed), [0.0], 1.0 - 1.0 / TIME
    for _ in range(600):
        errors.append(kept * errors[-1] + LEVEL * np.sqrt(1.0 - kept**2) * rng.standard_normal())
    assert follow_heading(seed, 600, lambda n: errors[n]).walk.heading_share > 0.15


@pytest.mark.parametrize("seed", range(5))
def test_a_compass_whose_error_stays_is_found_to_be_steady(seed):
    x = follow_heading(seed, 300, lambda n: 0.015)
    assert x.walk.heading_share < 0.1
    assert x.heading_offset == pytest.approx(0.015, abs=3.0 * np.sqrt(x.P[E_HEADING][E_HEADING]))


def test_a_stretch_without_corrections_teaches_nothing():
    x, walk = begun(), load().walk
    e = E_HEADING
    for _ in range(100):
        x.P[e][e] = 0.99**2 * x.P[e][e] + (1.0 - 0.99**2) * LEVEL**2
        walk.note_fading(x, 0.01, LEVEL**2)
        walk.note_gyro_walk(x, WALK**2)
        for j in range(3):
            x.P[E_BG + j][E_BG + j] += WALK**2
        walk.learn_walk(x, 1.0)
    assert (x.walk.drift, x.walk.heading_share) == (1.0, 1.0)


def follow_baro(
    seed: int, true: Callable[[int], float], speed: Callable[[int], float], seconds: int = 200
) -> tuple[float, float]:
    """Estimate an offset observed once a second; return the share learnt and the largest error.

    The speed is a share of the full one; the errors are those after ten seconds, in sigmas.
    """
    rng, x, walk = np.random.default_rng(seed), begun(), load().walk
    largest = 0.0
    for n in range(seconds):
        speed2 = speed(n) ** 2
        by_speed = x.walk.speed_share * AIR**2 * speed2
        x.P[E_BARO][E_BARO] += WEATHER**2 + by_speed
        walk.note_baro_walk(x, WEATHER**2, by_speed, speed2)
        innovation = true(n) + HEIGHT_NOISE * rng.standard_normal() - x.baro_offset
        variance = x.P[E_BARO][E_BARO]
        change, x.P[E_BARO][E_BARO] = corrected(variance, HEIGHT_NOISE**2, innovation)
        x.baro_offset += change
        walk.learn_walk(x, 1.0)
        if n > 10:
            largest = max(largest, abs(x.baro_offset - true(n)) / x.P[E_BARO][E_BARO] ** 0.5)
    return x.walk.speed_share, largest


def swinging(n: int) -> float:
    return 0.6 - 0.4 * np.cos(n / 3.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_barometer_that_no_change_of_speed_disturbs_is_learnt(seed):
    assert follow_baro(seed, lambda n: 0.0, swinging)[0] < 0.25


@pytest.mark.parametrize("seed", range(5))
def test_one_that_walks_with_the_speed_keeps_its_share(seed):
    steps = np.random.default_rng(200 + seed).normal(0.0, AIR, 200)
    offsets = (steps * [swinging(n) for n in range(200)]).cumsum()
    assert follow_baro(seed, lambda n: offsets[n], swinging)[0] > 0.3


def test_at_a_steady_speed_nothing_is_learnt():
    assert follow_baro(1, lambda n: 0.0, lambda n: 1.0)[0] == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_an_offset_that_follows_the_speed_stays_within_its_sigma(seed):
    share, largest = follow_baro(seed, lambda n: 1.5 * swinging(n) ** 2, swinging)
    assert share > 0.3
    assert largest < 5.0


def test_a_barometer_that_begins_anew_teaches_nothing():
    x, walk = begun(), load().walk
    x.P[E_BARO][E_BARO] += WEATHER**2 + AIR**2
    walk.note_baro_walk(x, WEATHER**2, AIR**2, 0.0)
    walk.note_baro_walk(x, WEATHER**2, AIR**2, 1.0)
    x.baro_offset, x.redrawn[E_BARO] = 30.0, 1.0
    walk.learn_walk(x, 5.0)
    assert x.walk.speed_share == 1.0
