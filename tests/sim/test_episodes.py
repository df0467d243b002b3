import math

import numpy as np
import pytest

from sim_autopilot.episodes import ErrorSeries, episode, episodes, sentence
from sim_autopilot.faults.fault import parse

LIMITS = (2.0, 1.0, 0.1)


def error_series(position, velocity=None, attitude=None):
    """Return errors at 10 Hz, as functions of the time."""
    t = np.arange(0.0, 60.0, 0.1)
    zero = np.zeros_like(t)
    sizes = [zero if one is None else one(t) for one in (position, velocity, attitude)]
    return ErrorSeries(t, np.stack(sizes, axis=-1))


def between(t, start, end):
    return ((t >= start - 1e-9) & (t < end - 1e-9)).astype(float)


def test_the_largest_errors_are_those_of_the_window():
    errors = error_series(
        lambda t: 5 * between(t, 10, 12) + 50 * between(t, 40, 41),
        lambda t: 3 * between(t, 11, 12),
        lambda t: 0.5 * between(t, 9, 9.5),
    )
    found = episode(errors, 10.0, 15.0, LIMITS)
    assert (found.position, found.velocity, found.attitude) == (5.0, 3.0, 0.0)
    assert found.count == 50


def test_recovery_is_when_all_errors_are_small_and_stay_so():
    errors = error_series(
        lambda t: 5 * between(t, 10, 18) + 5 * between(t, 19, 20),  # a second is not enough
        lambda t: 3 * between(t, 10, 17) + 3 * between(t, 25, 26),
    )
    assert episode(errors, 10.0, 15.0, LIMITS).recovery == pytest.approx(5.0, abs=0.01)
    assert episode(errors, 10.0, 21.0, LIMITS).recovery == pytest.approx(0.0, abs=0.01)
    assert episode(errors, 10.0, 24.0, LIMITS).recovery == pytest.approx(2.0, abs=0.01)


def test_what_never_gets_small_has_not_recovered():
    assert episode(error_series(lambda t: 5 + 0 * t), 10.0, 15.0, LIMITS).recovery == math.inf
    # nor what gets small only after the next fault began
    errors = error_series(lambda t: 5 * between(t, 10, 25))
    assert episode(errors, 10.0, 15.0, LIMITS, until=20.0).recovery == math.inf
    assert episode(errors, 10.0, 15.0, LIMITS, until=40.0).recovery == pytest.approx(10.0, abs=0.01)


def test_no_odometry_is_no_error_and_no_recovery():
    errors = error_series(lambda t: 0 * t)
    silent = ErrorSeries(errors.t[:100], errors.size[:100])
    found = episode(silent, 20.0, 25.0, LIMITS)
    assert math.isnan(found.position)
    assert (found.count, found.recovery) == (0, math.inf)


def test_each_fault_is_looked_at_up_to_the_next():
    errors = error_series(lambda t: 5 * between(t, 10, 17) + 9 * between(t, 30, 60))
    faults = [parse("cut:start=30,duration=5"), parse("loss:start=10,duration=5")]
    (first, one), (second, other) = episodes(errors, faults, LIMITS)
    assert (first.kind.name, second.kind.name) == ("loss", "cut")
    assert (one.position, other.position) == (5.0, 9.0)
    assert one.recovery == pytest.approx(2.0, abs=0.01)
    assert other.recovery == math.inf
    assert episodes(errors, [], LIMITS) == []


def test_an_account_is_one_sentence():
    summary = {"fault": "cut:start=1", "odometry": 3, "position_m": 14.22, "velocity_mps": 3.6}
    summary |= {"attitude_deg": 104.2, "recovery_s": 1.27}
    line = "cut:start=1: errors up to 14.2 m, 3.6 m/s, 104 deg; right again 1.3 s after it"
    assert sentence(summary) == line
    line = "cut:start=1: no ODOMETRY; not right again"
    assert sentence({**summary, "odometry": 0, "recovery_s": None}) == line
