"""The barometer: its offset, and the noise that rotors near the ground add."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BARO, E_POS, Aid, N
from ekf_companion.core.memory.scratch import Observation
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array, some_parameters


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobian_is_the_slope_of_the_prediction(seed):
    check(lambda x, k, o: load().baro.observe(x, k, o, [500.0]), a_state(seed), 1e-5)


def test_the_first_reading_gives_the_offset_with_the_height_s_error():
    x, k, o = a_state(1), some_parameters(), Observation()
    k.aid[Aid.BARO].std = 0.5
    root = np.random.default_rng(1).normal(size=(N, N))
    P = array(x.P)
    P[:] = root @ root.T
    before = P.copy()
    load().baro.begin(x, k, [512.0])
    load().baro.observe(x, k, o, [512.0])
    assert o.z[0] == 0.0
    assert P[E_BARO, E_BARO] == before[E_POS + 2, E_POS + 2] + 0.25
    others = [i for i in range(N) if i != E_BARO]
    assert np.array_equal(P[E_BARO, others], before[E_POS + 2, others])
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-9
    assert x.redrawn[E_BARO] == 1.0


@pytest.mark.parametrize(
    ("armed", "height", "std"), [(1.0, 1.0, 2.5), (1.0, 5.0, 0.5), (0.0, 1.0, 0.5)]
)
def test_rotors_near_the_ground_add_noise(armed, height, std):
    x, k, o = a_state(1), some_parameters(), Observation()
    k.aid[Aid.BARO].std, x.armed, x.has_ground = 0.5, armed, 1.0
    x.ground = x.pos_n[2] + height
    load().baro.observe(x, k, o, [500.0])
    assert o.R[0][0] == std * std
