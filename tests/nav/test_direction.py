import numpy as np
import pytest

from ekf_companion.nav.direction import (
    basis,
    direction_by_angles,
    direction_jacobian,
    direction_minus,
    direction_plus,
)
from tests.filters.differences import central

SOUTH = np.array([0.0, 0.0, -1.0])
DOWN = np.array([0.0, 0.0, 1.0])


def unit(seed):
    v = np.random.default_rng(seed).standard_normal(3)
    return v / np.linalg.norm(v)


@pytest.mark.parametrize("direction", [DOWN, SOUTH, unit(1), unit(2), np.array([0.0, 1.0, -0.0])])
def test_the_axes_of_a_direction_are_normal_to_it(direction):
    axes = np.column_stack([basis(direction), direction])
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("size", [1e-7, 0.2, 1.5, 3.0])
def test_a_direction_comes_back_from_where_it_was_moved(size):
    for start in (DOWN, SOUTH, unit(3)):
        u = size * np.array([0.6, -0.8])
        moved = direction_plus(start, u)
        assert np.linalg.norm(moved) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(direction_minus(moved, start), u, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.2, 1.5, 3.0])
def test_the_jacobians_of_a_direction_agree_with_differences(angle):
    for start in (DOWN, SOUTH, unit(3)):
        to = direction_plus(start, angle * np.array([0.6, 0.8]))
        seen = central(
            lambda u, to=to, start=start: direction_minus(direction_plus(to, u), start), 2
        )
        np.testing.assert_allclose(direction_jacobian(to, start), seen, atol=2e-7)  # near pi, steep
        seen = central(lambda u, to=to: direction_plus(to, u), 2)
        np.testing.assert_allclose(direction_by_angles(to), seen, atol=1e-9)
