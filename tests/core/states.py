"""States and small errors of them, for the tests of the kernel's parts."""

import numpy as np

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.enums import (
    CORE,
    E_ATT,
    E_VEL,
    SLOW_ERRORS,
    Aid,
    N,
)
from ekf_companion.core.memory.overlay import errors
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Motion
from ekf_companion.core.memory.state import State
from ekf_companion.nav import so3
from tests.core.interpreted import load

SAMPLE = (0.4, -0.8, 0.3, 1.5, -2.0, -9.0)
"""Rate, rad/s, and specific force, m/s^2."""


def array(field) -> np.ndarray:
    """Return the memory of a field of a struct as an array."""
    return np.ctypeslib.as_array(field)


def copy(struct):
    """Return a copy of a struct."""
    return type(struct).from_buffer_copy(struct)


def a_state(seed: int) -> State:
    """Return a state with everything away from zero."""
    rng = np.random.default_rng(seed)
    x = State()
    x.q_nb[:] = so3.exp(rng.normal(0.0, 0.7, 3))
    x.vel_n[:] = rng.normal(0.0, 8.0, 3)
    x.pos_n[:] = rng.normal(0.0, 50.0, 3)
    x.gyro_bias[:] = rng.normal(0.0, 0.02, 3)
    x.accel_bias[:] = rng.normal(0.0, 0.2, 3)
    x.baro_offset, x.heading_offset, x.gnss_delay = 12.0, 0.05, 0.03
    x.gnss_offset[:] = rng.normal(0.0, 1.0, 3)
    x.hard_iron[:] = rng.normal(0.0, 0.02, 3)
    x.gyro[:] = rng.normal(0.0, 1.0, 3)
    x.accel_n[:] = rng.normal(0.0, 3.0, 3)
    x.gnss_vel_offset[:] = rng.normal(0.0, 0.1, 3)
    x.begun = N - CORE
    load().strapdown.set_origin(x, 0.82, 0.15, 480.0)
    return x


def some_parameters() -> Parameters:
    """Return parameters with a lever arm."""
    k = Parameters()
    k.lever_arm_b[:] = [0.4, -0.3, -0.2]
    k.gravity, k.heading_time, k.gnss_offset_time = 9.8, 50.0, 80.0
    k.gnss_vel_offset_time = 25.0
    return k


def let_walk(k: Parameters, aid: Aid, walk: float) -> None:
    """Let the slow errors of an aid that declares itself walk, by its unit and sqrt(s)."""
    one = k.aid[aid]
    name = aid.name.lower()
    errors = next(known.slow_errors for known in DECLARED if known.name == name)
    one.walk[0], one.error, one.errors = walk, SLOW_ERRORS[name], len(errors)


def plus(x: State, error: np.ndarray) -> State:
    """Return a state with a small error put into it, as the kernel defines errors."""
    x = copy(x)
    x.q_nb[:] = so3.multiply(so3.exp(error[E_ATT : E_ATT + 3]), np.array(x.q_nb))
    array(errors(x))[:] += error[E_VEL:]
    return x


def minus(y: State, x: State) -> np.ndarray:
    """Return the error that turns x into y."""
    error = np.zeros(N)
    q = so3.multiply(np.array(y.q_nb), so3.conjugate(np.array(x.q_nb)))
    error[E_ATT : E_ATT + 3] = so3.log(q)
    error[E_VEL:] = array(errors(y)) - array(errors(x))
    return error


def sampled(m: Motion, sample: tuple[float, ...] = SAMPLE) -> Motion:
    """Return a motion with a rate and a force."""
    m.rate[:], m.force[:] = sample[:3], sample[3:]
    return m
