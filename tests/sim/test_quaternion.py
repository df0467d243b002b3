"""Rotations one at a time agree with those of arrays."""

import numpy as np
import pytest

from ekf_companion.nav import so3
from sim_autopilot.quaternion import back, rotated, turned


@pytest.mark.parametrize("size", [0.0, 1e-10, 1e-3, 1.0, 3.0])
def test_they_are_those_of_arrays(size):
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = so3.normalise(rng.standard_normal(4))
        phi, v = size * rng.standard_normal(3), rng.standard_normal(3)
        expected = so3.normalise(so3.multiply(q, so3.exp(phi)))
        assert turned(q, phi) == pytest.approx(expected, abs=1e-14)
        assert rotated(q, v) == pytest.approx(so3.rotate(q, v), abs=1e-14)
        assert rotated(back(q), rotated(q, v)) == pytest.approx(v, abs=1e-14)
