"""Drag across a multirotor's axis: learnt while the velocity is known, and used without it."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_VEL, Mode
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import State
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array

COEFFICIENT = 0.4
WIND = np.array([1.5, -2.0, 0.0])


def force_of(x: State) -> np.ndarray:
    """Return the specific force across the axis at the state's velocity, its bias included, b."""
    through = so3.rotate(array(x.q_nb) * [1.0, -1.0, -1.0, -1.0], array(x.vel_n) - WIND)
    return -COEFFICIENT * through + array(x.accel_bias)


def flying(seed: int) -> State:
    x = a_state(seed)
    load().wind.restart(x)
    x.mode, x.at_rest, x.needs_reset, x.armed = Mode.NAVIGATE, 0.0, 0.0, 1.0
    return x


def block(x: State, force: np.ndarray) -> None:
    x.drag.n = 4.0
    x.drag.force[:] = 4.0 * force


def learnt(seed: int, noise: float = 0.02) -> State:
    """Return a state that has seen five minutes of turns at 3 to 8 m/s."""
    rng, x, o = np.random.default_rng(seed), flying(seed), Observation()
    wind = load().wind
    for i in range(1500):
        yaw, speed = 0.02 * i, 5.5 + 2.5 * np.sin(0.11 * i)
        x.vel_n[:] = [speed * np.cos(yaw), speed * np.sin(yaw), 0.0]
        x.q_nb[:] = so3.from_euler(0.1 * np.sin(0.3 * i), 0.1 * np.cos(0.2 * i), 0.5 * yaw)
        block(x, force_of(x) + noise * rng.standard_normal(3))
        wind.learn(x, o)
    return x


@pytest.mark.parametrize("seed", [1, 2])
def test_coefficient_and_wind_are_found_within_their_sigmas(seed):
    x = learnt(seed)
    found = array(x.drag.theta)
    expected = COEFFICIENT * np.array([1.0, WIND[0], WIND[1]])
    sigma = np.sqrt(np.diag(array(x.drag.P)))
    assert found[0] == pytest.approx(COEFFICIENT, abs=0.02)
    assert (np.abs(found - expected) < 3.0 * sigma).all()
    assert sigma[0] < 0.1 * COEFFICIENT


def test_a_force_that_has_nothing_to_do_with_velocity_proves_nothing():
    rng, x, o = np.random.default_rng(3), flying(3), Observation()
    wind = load().wind
    for i in range(1500):
        x.vel_n[:] = [5.0 * np.cos(0.02 * i), 5.0 * np.sin(0.02 * i), 0.0]
        block(x, rng.standard_normal(3))
        wind.learn(x, o)
    assert not wind.is_proven(x)
    x.drag.theta[0] *= -1.0
    assert not wind.is_proven(x)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_jacobian_is_the_slope_of_the_prediction(seed):
    x, wind = learnt(seed), load().wind
    x.drag.theta[:] = COEFFICIENT * np.array([1.0, WIND[0], WIND[1]])
    force = force_of(x)

    def observe(state: State, _: Parameters, o: Observation) -> None:
        block(state, force)
        wind.observe(state, o)

    o = Observation()
    observe(x, Parameters(), o)
    assert np.array(o.z)[:2] == pytest.approx(np.zeros(2), abs=1e-12)
    assert np.abs(array(o.H)[:2, E_VEL : E_VEL + 3]).max() > 0.5 * COEFFICIENT
    check(observe, x, 1e-4)
