"""What a receiver should read at its antenna."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Fix, Observation
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, some_parameters


def a_fix(vel_down: float = 3.0) -> Fix:
    fix = Fix(lat=0.8200021, lon=0.1500013, alt=490.0)
    fix.vel_n[:] = [1.0, 2.0, vel_down]
    fix.std[:] = [1.0, 1.0, 0.1]
    return fix


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["position", "height", "velocity"])
def test_jacobian_is_the_slope_of_the_prediction(name, seed):
    # turning the lever arm's part of a late position is left out: 0.03 s of 0.5 m at 1 rad/s
    tolerance = 1e-5 if name == "velocity" else 2e-2
    observe = getattr(load().gnss, name)
    check(lambda x, k, o: observe(x, k, a_fix(), o), a_state(seed), tolerance)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_of_a_velocity_without_down(seed):
    check(lambda x, k, o: load().gnss.velocity(x, k, a_fix(np.nan), o), a_state(seed), 1e-5)


def test_a_late_fix_counts_where_the_antenna_was():
    """At a steady velocity it is of the place that lies its delay behind."""
    x, k, o = a_state(1), some_parameters(), Observation()
    k.lever_arm_b[:] = x.accel_n[:] = [0.0] * 3
    x.gnss_delay = 0.0
    load().gnss.position(x, k, a_fix(), o)
    before = np.array(o.z)[:2]
    x.gnss_delay = 0.1
    load().gnss.position(x, k, a_fix(), o)
    np.testing.assert_allclose(np.array(o.z)[:2] - before, 0.1 * np.array(x.vel_n)[:2], atol=1e-9)


def test_a_timing_error_counts_by_how_fast_what_is_measured_changes():
    x, k, o = a_state(1), some_parameters(), Observation()
    k.timing_std = 0.02
    load().gnss.position(x, k, a_fix(), o)
    n, e, _ = x.vel_n
    expected = np.eye(2) + 0.02**2 * np.array([[n * n, n * e], [n * e, e * e]])
    np.testing.assert_allclose(np.array(o.R)[:2, :2], expected)
