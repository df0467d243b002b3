"""What the motion was when a late fix was true, against a motion in closed form."""

import numpy as np
import pytest

from ekf_companion.core.scratch import Then
from ekf_companion.core.state import State
from tests.core.interpreted import load
from tests.core.states import array

RATE = 250.0


def velocity(t: np.ndarray) -> np.ndarray:
    """m/s at times in s: two sines and a climb that begins."""
    return np.stack([5.0 * np.sin(1.5 * t), 3.0 * np.cos(2.0 * t), -0.5 * t * t], axis=-1)


def acceleration(t: float) -> np.ndarray:
    return (velocity(t + 1e-4) - velocity(t - 1e-4)) / 2e-4


def flown(seconds: float) -> State:
    """Return a state that has flown so long."""
    x, core = State(), load()
    core.past.forget(x)
    for t in np.arange(0.0, seconds + 0.5 / RATE, 1.0 / RATE):
        x.t = t * 1e9
        array(x.past.gained)[:] = velocity(t) - velocity(0.0)
        array(x.accel_n)[:] = acceleration(t)
        core.past.keep_velocity(x)
    return x


def look(x: State, late: float) -> Then:
    then = Then()
    load().past.look_back(x, late, then)
    return then


@pytest.mark.parametrize("late", [0.0, 0.013, 0.1, 0.25])
def test_velocity_and_acceleration_are_those_of_then(late):
    then = look(flown(3.0), late)
    np.testing.assert_allclose(then.until, velocity(3.0 - late) - velocity(0.0), atol=3e-3)
    np.testing.assert_allclose(then.since, velocity(3.0) - velocity(3.0 - late), atol=3e-3)
    np.testing.assert_allclose(then.accel_n, acceleration(3.0 - late), atol=0.25)


@pytest.mark.parametrize("late", [-0.05, 0.8])
def test_beyond_what_is_kept_the_acceleration_goes_on(late):
    x = flown(3.0)
    nearest = 3.0 if late < 0.0 else min(x.past.kept_t) * 1e-9
    assert late < 0.0 or 0.45 < 3.0 - nearest < late
    then = look(x, late)
    expected = velocity(nearest) + (3.0 - late - nearest) * acceleration(3.0)
    np.testing.assert_allclose(then.until, expected - velocity(0.0), atol=3e-3)


def test_nothing_is_kept_at_first():
    x = flown(0.0)
    x.t += 5e7
    load().past.forget(x)
    np.testing.assert_allclose(look(x, 0.1).since, 0.1 * np.array(x.accel_n), rtol=1e-12)
