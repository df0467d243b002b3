"""Quaternions and direction cosines against the vocabulary's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.nav import so3
from tests.core.interpreted import load

turns = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array)
tiny = st.sampled_from([0.0, 1e-9, 1e-4, 9.9e-4, 1.1e-3, 1.0])
"""On both sides of where a series takes over."""


@given(turns, turns, tiny)
def test_a_rotation_in_n_and_in_b_is_the_product_from_that_side(attitude, turn, scale):
    q, turn = so3.exp(attitude), turn * scale
    for rotate, expected in (
        (load().rotation.rotate, so3.multiply(so3.exp(turn), q)),
        (load().rotation.rotate_body, so3.multiply(q, so3.exp(turn))),
    ):
        found = q.copy()
        rotate(found, *turn)
        np.testing.assert_allclose(found, expected, atol=1e-14)
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)


@given(turns)
def test_direction_cosines_turn_a_vector_as_the_quaternion_does(attitude):
    q, C = so3.exp(attitude), np.zeros((3, 3))
    load().rotation.to_dcm(q, C)
    for axis in np.eye(3):
        np.testing.assert_allclose(C @ axis, so3.rotate(q, axis), atol=1e-14)


@given(st.floats(-50.0, 50.0))
def test_an_angle_is_wrapped_to_the_same_direction(angle):
    wrapped = load().rotation.wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


def test_half_a_turn_is_minus_pi():
    assert load().rotation.wrap(math.pi) == -math.pi
