"""What the motion was when a late fix was true, against a motion in closed form."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Then
from ekf_companion.core.memory.state import State
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


@pytest.mark.parametrize("late", [-0.05, 2.5])
def test_beyond_what_is_kept_the_acceleration_goes_on(late):
    x = flown(3.0)
    nearest = 3.0 if late < 0.0 else min(x.past.kept_t) * 1e-9
    assert late < 0.0 or 2.1 < 3.0 - nearest < late
    then = look(x, late)
    expected = velocity(nearest) + (3.0 - late - nearest) * acceleration(3.0)
    np.testing.assert_allclose(then.until, expected - velocity(0.0), atol=3e-3)


def test_nothing_is_kept_at_first():
    x = flown(0.0)
    x.t += 5e7
    load().past.forget(x)
    np.testing.assert_allclose(look(x, 0.1).since, 0.1 * np.array(x.accel_n), rtol=1e-12)


def uneven(velocities: np.ndarray, span: float, noise: float = 0.0) -> np.ndarray:
    """Return the unevenness of velocities at RATE, shape (n, 3), over their last seconds."""
    x, core, found = State(), load(), np.zeros(3)
    x.fix_dt = span / 2.0
    core.past.forget(x)
    array(x.noise)[3:] = noise
    for n, one in enumerate(velocities):
        x.t = n * 1e9 / RATE
        array(x.past.gained)[:] = one
        core.past.keep_velocity(x)
    core.past.unevenness(x, found)
    return found


def test_a_straight_line_is_even():
    t = np.arange(0.0, 2.0, 1.0 / RATE)
    steady = t[:, None] * np.array([3.0, -20.0, 0.5]) + 7.0
    np.testing.assert_allclose(uneven(steady, 0.4), 0.0, atol=1e-12)


@pytest.mark.parametrize("span", [0.2, 0.4, 3.0])
def test_unevenness_is_the_variance_about_a_straight_line(span):
    t = np.arange(0.0, 3.0, 1.0 / RATE)
    curved = velocity(t)
    step = np.floor(t / 0.035 + 1e-9)
    used = np.diff(step, prepend=-1.0) > 0.0
    used[-1] = True  # now
    used &= t > t[-1] - min(span, 0.5)
    t, curved = t[used], curved[used]
    slope, start = np.polyfit(t, curved, 1)
    left = curved - (np.outer(t, slope) + start)
    found = uneven(velocity(np.arange(0.0, 3.0, 1.0 / RATE)), span)
    np.testing.assert_allclose(found, (left**2).sum(axis=0) / (len(t) - 2), rtol=1e-6)


def test_the_noise_of_samples_is_none():
    rng, noise = np.random.default_rng(1), 0.02
    steps = rng.normal(0.0, np.sqrt(noise / RATE), (200, 250, 3))
    found = [uneven(np.cumsum(one, axis=0), 0.4, noise) for one in steps]
    raw = [uneven(np.cumsum(one, axis=0), 0.4) for one in steps]
    assert np.mean(found) < 0.4 * np.mean(raw)


def test_of_too_few_velocities_nothing_is_said():
    assert uneven(velocity(np.arange(0.0, 0.06, 1.0 / RATE)), 0.4).max() == 0.0
    assert uneven(velocity(np.arange(0.0, 2.0, 1.0 / RATE)), 0.0).max() == 0.0
