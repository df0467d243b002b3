"""How uncertain the lever arm makes a velocity, learnt from what turns show of it."""

import numpy as np
import pytest

from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load
from tests.core.states import array

STD = 0.2
"""One sigma of the arm per axis, m."""
NOISE = 0.07
"""Of a gain of velocity, m/s."""


def turning(rate: np.ndarray) -> np.ndarray:
    """Return the matrix that takes an arm to its velocity, n e by b, level and to the north."""
    x, y, z = rate
    return np.array([[0.0, -z, y], [z, 0.0, -x]])


def learn(seed: int, arm: np.ndarray, rates: np.ndarray, sampled: float = 0.0) -> State:
    """Return what gains between fixes a second apart teach of an arm; ``sampled``: gyro's noise."""
    rng, x, k, o, lever = np.random.default_rng(seed), State(), Parameters(), Observation(), load()
    k.lever_var, x.dt = STD**2, 0.01
    x.noise[:3] = [sampled**2 * x.dt] * 3
    lever.lever_arm.restart(x)
    rows = [turning(rate + sampled * rng.standard_normal(3)) for rate in rates]
    for begin, end, first, last in zip(rows, rows[1:], rates, rates[1:], strict=False):
        array(x.gain.begin.turn)[:], array(x.gain.end.turn)[:] = begin, end
        gained = (turning(last) - turning(first)) @ arm + NOISE * rng.standard_normal(2)
        true = lever.lever_arm.true_share(x)
        for axis in range(2):
            o.L[0][0], o.z[0] = NOISE, gained[axis]
            lever.lever_arm.learn(x, k, o, axis, true)
    return x


def noise(x: State, rate: np.ndarray) -> np.ndarray:
    """Return what is added to R of a velocity in a turn."""
    k, o = Parameters(), Observation()
    k.lever_var, o.rows = STD**2, 3
    x.gyro[:] = rate
    array(o.C_nb)[:] = np.eye(3)
    wx, wy, wz = rate
    array(o.turn_nb)[:] = [[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]]
    load().lever_arm.add_noise(x, k, o)
    return np.array(array(o.R))


def wobble(seconds: int) -> np.ndarray:
    """Return rates that change all the time."""
    return np.random.default_rng(5).normal(0.0, 0.5, (seconds, 3))


def test_an_arm_nothing_is_known_of_counts_as_configured():
    x = learn(0, np.zeros(3), np.zeros((1, 3)))
    rate = np.array([0.3, -0.2, 1.0])
    np.testing.assert_allclose(noise(x, rate), STD**2 * (rate @ rate) * np.eye(3), atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_turns_that_show_no_arm_leave_the_velocity_certain(seed):
    x = learn(seed, np.zeros(3), wobble(60))
    rate = np.array([0.0, 0.0, 1.0])
    assert noise(x, rate)[0, 0] < 0.1 * STD**2


@pytest.mark.parametrize("seed", range(5))
def test_an_arm_that_is_there_goes_on_to_count(seed):
    arm = np.array([0.6, 0.0, 0.0])
    x = learn(seed, arm, wobble(60))
    off = turning(np.array([0.0, 0.0, 1.0])) @ arm
    assert noise(x, np.array([0.0, 0.0, 1.0]))[1, 1] > 0.8 * off[1] ** 2


def test_a_steady_turn_shows_nothing():
    x = learn(1, np.array([0.3, 0.0, 0.0]), np.tile([0.0, 0.0, 1.0], (60, 1)))
    np.testing.assert_allclose(np.array(array(x.lever.P)), np.eye(3), rtol=1e-9)
    assert list(x.lever.arm_b) == [0.0, 0.0, 0.0]


def test_a_rate_that_is_only_noise_shows_nothing():
    x = learn(2, np.array([0.3, 0.0, 0.0]), np.zeros((200, 3)), sampled=0.5)
    assert np.diag(array(x.lever.P)).min() > 0.3
