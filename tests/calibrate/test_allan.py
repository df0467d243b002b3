import numpy as np
import pytest
from scipy.signal import butter, lfilter

from ekf_companion.calibrate import allan

PERIOD = 0.01


def white(seconds, density, seed=1):
    rng = np.random.default_rng(seed)
    count = round(seconds / PERIOD)
    return density / np.sqrt(PERIOD) * rng.standard_normal(count)


def walk(seconds, density, seed=2):
    rng = np.random.default_rng(seed)
    return density * np.sqrt(PERIOD) * np.cumsum(rng.standard_normal(round(seconds / PERIOD)))


def test_the_deviation_is_that_of_its_definition():
    values = np.random.default_rng(3).standard_normal(60)
    found = allan.curve([values], PERIOD, np.array([1.0, 4.0, 10.0]) * PERIOD)
    for tau, deviation in zip(found.tau, found.deviation, strict=True):
        m = round(tau / PERIOD)
        means = [values[i : i + m].mean() for i in range(len(values) - m + 1)]
        steps = [means[i + m] - means[i] for i in range(len(means) - m)]
        assert deviation == pytest.approx(np.sqrt(0.5 * np.mean(np.square(steps))), rel=1e-9)


def test_stretches_count_together_but_never_across_a_border():
    one, other = white(20.0, 1e-3), white(30.0, 1e-3, seed=5) + 7.0
    found = allan.curve([one, other], PERIOD)
    assert found.deviation[0] * np.sqrt(PERIOD) == pytest.approx(1e-3, rel=0.05)
    assert found.deviation[-1] < 1e-3


def test_white_noise_is_found_and_nothing_else():
    _, noise = allan.fit([white(300.0, 2e-4)], PERIOD)
    assert noise.white == pytest.approx(2e-4, rel=0.03)
    assert abs(noise.white - 2e-4) < 4.0 * noise.white_std * noise.white
    assert noise.corner is None
    assert noise.walk.value == 0.0
    assert noise.instability.value == 0.0


def test_a_walk_is_found_beneath_white_noise():
    _, noise = allan.fit([white(3000.0, 2e-4) + walk(3000.0, 2e-5)], PERIOD)
    assert noise.white == pytest.approx(2e-4, rel=0.03)
    assert noise.walk.value > 0.0
    assert noise.walk.value == pytest.approx(2e-5, rel=0.5)
    assert noise.walk.bound > 2e-5


def test_a_short_rest_gives_a_bound_that_holds():
    bounds = []
    for seed in range(10):
        _, noise = allan.fit([white(60.0, 2e-4, seed) + walk(60.0, 1e-5, 100 + seed)], PERIOD)
        bounds.append(noise.walk.bound)
    assert np.median(bounds) > 1e-5
    assert min(bounds) > 0.5e-5


@pytest.mark.parametrize("corner", [10.0, 20.0])
def test_white_noise_is_read_off_beyond_a_low_pass(corner):
    passed = lfilter(*butter(2, 2.0 * corner * PERIOD), white(300.0, 2e-4))
    found, noise = allan.fit([passed], PERIOD)
    assert found.deviation[0] * np.sqrt(PERIOD) < 1e-4
    assert noise.white == pytest.approx(2e-4, rel=0.1)
    assert noise.corner == pytest.approx(corner, rel=0.2)
    assert noise.white_from >= 1.0 / corner


def test_a_sensor_that_always_says_the_same_has_no_noise():
    _, noise = allan.fit([np.full(3000, 0.7)], PERIOD)
    assert noise.white < 1e-9
