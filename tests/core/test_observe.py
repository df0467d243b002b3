"""Every Jacobian against central differences through plus, away from level and with a lever arm."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BA, E_BG, E_VEL, N
from ekf_companion.core.memory.scratch import Fix, Observation
from ekf_companion.core.memory.state import Reference, State
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.states import a_state, array, plus, some_parameters

STEP = 1e-6
RATE = [0.1, -0.2, 0.3]


def a_fix(vel_down: float = 3.0) -> Fix:
    fix = Fix(lat=0.8200021, lon=0.1500013, alt=490.0)
    fix.vel_n[:] = [1.0, 2.0, vel_down]
    fix.std[:] = [1.0, 1.0, 0.1]
    return fix


MODELS = {
    "position": lambda m, x, k, o: m.gnss.position(x, k, a_fix(), o),
    "height": lambda m, x, k, o: m.gnss.height(x, k, a_fix(), o),
    "velocity 2-D": lambda m, x, k, o: m.gnss.velocity(x, k, a_fix(np.nan), o),
    "velocity 3-D": lambda m, x, k, o: m.gnss.velocity(x, k, a_fix(), o),
    "zero velocity": lambda m, x, k, o: m.rest.zero_velocity(x, o, 0.1),
    "zero rate": lambda m, x, k, o: m.rest.zero_rate(x, o, RATE, 0.1, 0.3),
    "pressure": lambda m, x, k, o: m.baro.observe(x, k, o, 500.0),
}


@pytest.mark.parametrize("has_iron", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_of_an_azimuth_is_its_slope_where_it_should_point(has_iron, seed):
    x = a_state(seed)
    b = np.array([0.2, 0.1, 0.4])
    field = so3.rotate(np.array(x.q_nb), b - array(x.hard_iron) * has_iron)
    azimuth = np.arctan2(field[1], field[0]) + x.heading_offset
    reference = Reference(std=0.1, has_iron=has_iron, azimuth=azimuth)
    reference.direction_b[:] = b
    check(lambda m, x, k, o: m.heading.azimuth(x, o, reference), x, 1e-5)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slopes_of_an_azimuth_are_those_of_the_field_without_its_noise(seed):
    x = a_state(seed)
    b = np.array([0.2, 0.1, 0.4])
    field = so3.rotate(np.array(x.q_nb), b - array(x.hard_iron))
    x.field.strength = np.linalg.norm(field)
    x.field.inclination = np.arcsin(field[2] / x.field.strength)
    azimuth = np.arctan2(field[1], field[0]) + x.heading_offset
    slopes = []
    for noise in np.random.default_rng(seed).normal(0.0, [[0.0], [0.02]], (2, 3)):
        o, reference = Observation(), Reference(std=0.1, has_iron=True, azimuth=azimuth)
        reference.direction_b[:] = b + noise
        load().heading.azimuth(x, o, reference)
        slopes.append([*np.array(o.H)[0], np.array(o.R)[0][0]])
    np.testing.assert_allclose(slopes[1], slopes[0], rtol=1e-9, atol=1e-12)
    reference.direction_b[:] = b
    check(lambda m, x, k, o: m.heading.azimuth(x, o, reference), x, 1e-5)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_is_the_slope_of_the_prediction(name, seed):
    # turning the lever arm's part of a late position is left out: 0.03 s of 0.5 m at 1 rad/s
    tolerance = 2e-2 if name in ("position", "height") else 1e-5
    if name == "zero rate":
        tolerance = 1e-4  # how attitude turns the Earth's rate is left out
    check(MODELS[name], a_state(seed), tolerance)


def check(observe, x: State, tolerance: float) -> None:
    k, o, model = some_parameters(), Observation(), load()
    observe(model, x, k, o)
    rows = o.rows
    H = np.array(o.H)[:rows]

    slope = np.zeros((rows, N))
    for i in range(N):
        z = []
        for sign in (1.0, -1.0):
            observe(model, plus(x, sign * STEP * np.eye(N)[i]), k, o)
            z.append(np.array(o.z)[:rows])
        slope[:, i] = -(z[0] - z[1]) / (2.0 * STEP)  # innovation is measured minus predicted

    np.testing.assert_allclose(H[:, :E_VEL], slope[:, :E_VEL], atol=tolerance)
    rest = [i for i in range(E_VEL, N) if not (tolerance > 1e-3 and E_BG <= i < E_BA)]
    np.testing.assert_allclose(H[:, rest], slope[:, rest], rtol=1e-5, atol=1e-4)  # metres at 1e6


def test_a_vertical_direction_gives_no_azimuth():
    x, reference = State(), Reference(std=0.1)
    x.q_nb[0] = 1.0
    reference.direction_b[:] = [0.05, 0.0, 1.0]
    assert not load().heading.azimuth(x, Observation(), reference)
