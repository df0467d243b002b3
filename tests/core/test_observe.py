"""Every Jacobian against central differences through plus, away from level and with a lever arm."""

import numpy as np
import pytest

from ekf_companion.core import state as at
from ekf_companion.nav import so3
from tests.core.interpreted import load

STEP = 1e-6


def a_state(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.zeros(at.BLOCK)
    x[at.X_Q : at.X_Q + 4] = so3.exp(rng.normal(0.0, 0.7, 3))
    x[at.X_VEL : at.X_VEL + 3] = rng.normal(0.0, 8.0, 3)
    x[at.X_POS : at.X_POS + 3] = rng.normal(0.0, 50.0, 3)
    x[at.X_BG : at.X_BG + 3] = rng.normal(0.0, 0.02, 3)
    x[at.X_BA : at.X_BA + 3] = rng.normal(0.0, 0.2, 3)
    x[at.X_BARO] = 12.0
    x[at.X_HEADING] = 0.05
    x[at.X_DELAY] = 0.03
    x[at.X_SLOW : at.X_SLOW + 3] = rng.normal(0.0, 1.0, 3)
    x[at.X_IRON : at.X_IRON + 3] = rng.normal(0.0, 0.02, 3)
    x[at.X_GYRO : at.X_GYRO + 3] = rng.normal(0.0, 1.0, 3)
    x[at.X_ACC_N : at.X_ACC_N + 3] = rng.normal(0.0, 3.0, 3)
    load().propagate.originate(x, 0.82, 0.15, 480.0)
    return x


def parameters() -> np.ndarray:
    k = np.zeros(at.PARAMETERS)
    k[at.K_LEVER : at.K_LEVER + 3] = [0.4, -0.3, -0.2]
    k[at.K_GRAVITY] = 9.8
    k[at.K_HEADING_TIME] = 50.0
    k[at.K_SLOW_TIME] = 80.0
    return k


def plus(x: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Put a small error into a state, as the kernel defines errors."""
    x = x.copy()
    attitude = so3.exp(error[at.E_ATT : at.E_ATT + 3])
    x[at.X_Q : at.X_Q + 4] = so3.multiply(attitude, x[at.X_Q : at.X_Q + 4])
    x[at.X_VEL : at.X_VEL + 3] += error[at.E_VEL : at.E_VEL + 3]
    x[at.X_POS : at.X_POS + 3] += error[at.E_POS : at.E_POS + 3]
    x[at.X_BG : at.X_BG + 3] += error[at.E_BG : at.E_BG + 3]
    x[at.X_BA : at.X_BA + 3] += error[at.E_BA : at.E_BA + 3]
    x[at.X_BARO] += error[at.E_BARO]
    x[at.X_DELAY] += error[at.E_DELAY]
    x[at.X_HEADING] += error[at.E_HEADING]
    x[at.X_SLOW : at.X_SLOW + 3] += error[at.E_SLOW : at.E_SLOW + 3]
    x[at.X_IRON : at.X_IRON + 3] += error[at.E_IRON : at.E_IRON + 3]
    return x


def a_fix(w: np.ndarray, vel_down: float = 3.0) -> np.ndarray:
    w[at.W_FIX : at.W_FIX + 6] = [0.8200021, 0.1500013, 490.0, 1.0, 2.0, vel_down]
    w[at.W_FIX + 6 : at.W_FIX + 9] = [1.0, 1.0, 0.1]
    return w


MODELS = {
    "position": (2, lambda o, x, k, w: o.position(x, k, a_fix(w))),
    "height": (1, lambda o, x, k, w: o.height(x, k, a_fix(w))),
    "velocity 2-D": (2, lambda o, x, k, w: o.velocity(x, k, a_fix(w, np.nan))),
    "velocity 3-D": (3, lambda o, x, k, w: o.velocity(x, k, a_fix(w))),
    "zero velocity": (3, lambda o, x, k, w: o.zero_velocity(x, w, 0.1)),
    "zero rate": (3, lambda o, x, k, w: o.zero_rate(x, w, 0.1)),
    "pressure": (1, lambda o, x, k, w: o.pressure_altitude(x, w, 500.0, 1.0)),
}


@pytest.mark.parametrize("has_iron", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_of_an_azimuth_is_its_slope_where_it_should_point(has_iron, seed):
    x, w = a_state(seed), np.zeros(at.SCRATCH)
    b = np.array([0.2, 0.1, 0.4])
    field = so3.rotate(x[at.X_Q : at.X_Q + 4], b - (x[at.X_IRON : at.X_IRON + 3] * has_iron))
    target = np.arctan2(field[1], field[0]) + x[at.X_HEADING]
    check(lambda o, x, k, w: o.azimuth(x, w, *b, target, 0.1, 0.0, has_iron), 1, x, w, 1e-5)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_is_the_slope_of_the_prediction(name, seed):
    m, observe = MODELS[name]
    # turning the lever arm's part of a late position is left out: 0.03 s of 0.5 m at 1 rad/s
    tolerance = 2e-2 if name in ("position", "height") else 1e-5
    if name == "zero rate":
        tolerance = 1e-4  # how attitude turns the Earth's rate is left out
    check(observe, m, a_state(seed), np.zeros(at.SCRATCH), tolerance)


def check(observe, m, x, w, tolerance):
    k = parameters()
    observe(load().observe, x, k, w)
    H = w[at.W_H : at.W_H + m * at.N].reshape(m, at.N).copy()

    slope = np.zeros((m, at.N))
    for i in range(at.N):
        error = np.zeros(at.N)
        error[i] = STEP
        z = []
        for sign in (1.0, -1.0):
            observe(load().observe, plus(x, sign * error), k, w)
            z.append(w[at.W_Z : at.W_Z + m].copy())
        slope[:, i] = -(z[0] - z[1]) / (2.0 * STEP)  # innovation is measured minus predicted

    np.testing.assert_allclose(H[:, : at.E_VEL], slope[:, : at.E_VEL], atol=tolerance)
    rest = [i for i in range(at.E_VEL, at.N) if not (tolerance > 1e-3 and at.E_BG <= i < at.E_BA)]
    np.testing.assert_allclose(H[:, rest], slope[:, rest], rtol=1e-5, atol=1e-4)  # metres at 1e6


def test_a_vertical_direction_gives_no_azimuth():
    x, w = np.zeros(at.BLOCK), np.zeros(at.SCRATCH)
    x[at.X_Q] = 1.0
    assert not load().observe.azimuth(x, w, 0.05, 0.0, 1.0, 0.0, 0.1, 0.0, False)
