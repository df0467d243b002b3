"""The azimuth of a direction of the body: forward axis or magnetic field."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import Reference, State
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array


@pytest.mark.parametrize("has_iron", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_of_an_azimuth_is_its_slope_where_it_should_point(has_iron, seed):
    x = a_state(seed)
    b = np.array([0.2, 0.1, 0.4])
    field = so3.rotate(np.array(x.q_nb), b - array(x.hard_iron) * has_iron)
    azimuth = np.arctan2(field[1], field[0]) + x.heading_offset
    reference = Reference(std=0.1, has_iron=has_iron, azimuth=azimuth)
    reference.direction_b[:] = b
    check(lambda x, k, o: load().heading.azimuth(x, o, reference), x, 1e-5)


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
    check(lambda x, k, o: load().heading.azimuth(x, o, reference), x, 1e-5)


def test_a_vertical_direction_gives_no_azimuth():
    x, reference = State(), Reference(std=0.1)
    x.q_nb[0] = 1.0
    reference.direction_b[:] = [0.05, 0.0, 1.0]
    assert not load().heading.azimuth(x, Observation(), reference)
