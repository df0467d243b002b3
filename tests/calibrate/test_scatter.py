import numpy as np
import pytest

from ekf_companion.calibrate.scatter import measure
from sim_autopilot.sensors import gauss_markov

PERIOD = 0.2


def errors(seconds, white, slow=0.0, time=60.0, seed=1):
    rng = np.random.default_rng(seed)
    count = round(seconds / PERIOD)
    values = white * rng.standard_normal((count, 2))
    return values + slow * gauss_markov(rng.standard_normal((count, 2)), PERIOD, time)


def scatter(values, wander=0.0):
    return measure([values], PERIOD, wander)


def test_a_white_level_is_found_and_as_sure_as_it_says():
    found = [scatter(errors(120.0, 0.5, seed=seed)) for seed in range(30)]
    off = [(one.white / 0.5 - 1.0) / one.white_std for one in found]
    assert np.mean([one.white for one in found]) == pytest.approx(0.5, rel=0.02)
    assert 0.5 < np.std(off) < 1.3


def test_white_noise_alone_has_no_correlation_time():
    times = [scatter(errors(900.0, 1.0, seed=seed)).time for seed in range(10)]
    assert times == [None] * 10


@pytest.mark.parametrize("time", [20.0, 60.0])
def test_a_slow_error_is_found_with_its_time(time):
    found = [scatter(errors(1800.0, 0.2, 1.0, time, seed)) for seed in range(10)]
    assert np.mean([one.white for one in found]) == pytest.approx(0.2, rel=0.1)
    assert np.median([one.slow for one in found]) == pytest.approx(1.0, rel=0.25)
    assert all(time / 2.5 < one.time < time * 2.5 for one in found)


def test_a_log_too_short_for_the_slow_error_says_so():
    found = scatter(errors(120.0, 0.2, 1.0, 100.0))
    assert found.time is None
    assert found.slow > 0.2


def test_a_drift_of_the_reference_leaves_the_white_level_alone():
    values = errors(300.0, 0.3)
    drift = np.linspace(0.0, 60.0, len(values))[:, None]
    assert scatter(values + drift).white == pytest.approx(scatter(values).white, rel=0.01)


def test_what_the_reference_is_known_to_wander_by_is_not_the_receivers():
    rng = np.random.default_rng(7)
    values = errors(900.0, 0.3)
    wandered = values + np.cumsum(0.05 * rng.standard_normal(values.shape), axis=0)
    wander = 0.05**2 / PERIOD
    found = scatter(wandered, wander)
    assert found.time is None
    assert found.structure[-1] < 0.5 * scatter(wandered).structure[-1]


def test_one_wild_fix_in_fifty_changes_little():
    values = errors(300.0, 0.3)
    values[::50] += 40.0
    assert scatter(values).white == pytest.approx(0.3, rel=0.15)


def test_too_few_fixes_tell_nothing():
    assert scatter(errors(2.0, 1.0)) is None
    assert measure([], PERIOD) is None
