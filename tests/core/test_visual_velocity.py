"""The velocity of another estimator."""

import math

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_VISUAL_VELOCITY, Aid, Mode
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array, copy, some_parameters

NEVER = -1e18


def begun(seed=1):
    x, k = a_state(seed), some_parameters()
    own = k.aid[Aid.VISUAL_VELOCITY]
    own.std = 0.1
    own.own[0], own.own[1], own.own[3] = 0.3, 0.1, 0.1
    own.own[4], own.own[5], own.own[6] = 0.3, -0.2, 0.1
    x.mode, x.t = Mode.NAVIGATE, 5e9
    x.used_t[Aid.VISUAL_ODOMETRY] = NEVER
    past = x.past
    for j in range(15):
        past.kept_t[j] = x.t - 35e6 * (15 - j)
        past.kept[j][:] = [0.3 * j, -0.2 * j, 0.01 * j]
    past.gained[:] = [0.3 * 15, -0.2 * 15, 0.01 * 15]
    assert load().visual_velocity.begin(x, k, [1.0, 2.0, 3.0, math.nan, 0.0])
    x.visual_velocity_scale, x.visual_velocity_frame_yaw = 0.05, 0.2
    x.visual_velocity_delay = 0.15
    return x, k


@pytest.mark.parametrize("is_level", [0.0, 1.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_jacobian_is_the_slope_of_the_prediction(is_level, seed):
    x, k = begun(seed)
    row = [3.0, -1.0, 0.5, math.nan, is_level]

    o, s = Observation(), 1.05
    assert load().visual_velocity.observe(copy(x), k, o, row)
    z = array(o.z) / s  # where it is right, the velocity in its slope is both's
    if is_level:
        turn = so3.to_matrix(so3.from_euler(0.0, 0.0, 0.2))
        z = turn.T @ z
    row[:3] = list(np.array(row[:3]) - z)

    def observe(moved, _, o):
        assert load().visual_velocity.observe(copy(moved), k, o, row)

    check(observe, x, 1e-5)


@pytest.mark.parametrize("is_level", [0.0, 1.0])
def test_a_velocity_that_is_right_is_no_news(is_level):
    x, k = begun()
    x.visual_velocity_scale = x.visual_velocity_frame_yaw = x.visual_velocity_delay = 0.0
    x.gyro[:] = [0.5, -0.4, 0.9]
    own = k.aid[Aid.VISUAL_VELOCITY].own
    own[4], own[5], own[6] = 0.3, 0.0, 0.0
    C_nb = load().rotation  # its own matrix
    o = Observation()
    C_nb.to_dcm(x.q_nb, o.C_nb)
    C = array(o.C_nb).copy()
    turn = np.array(x.gyro) - np.array(x.gyro_bias)
    vel_b = C.T @ np.array(x.vel_n) + np.cross(turn, [0.3, 0.0, 0.0])
    said = C @ vel_b if is_level else vel_b
    assert load().visual_velocity.observe(x, k, o, [*said, math.nan, is_level])
    assert list(o.z) == pytest.approx([0.0] * 3, abs=1e-9)


def test_it_does_not_count_beside_a_pose_nor_where_it_repeats_itself():
    x, k = begun()
    row = [3.0, -1.0, 0.5, math.nan, 0.0]
    observe = load().visual_velocity.observe
    assert observe(x, k, Observation(), row)
    assert not observe(x, k, Observation(), row)
    row[0] = 3.1
    x.used_t[Aid.VISUAL_ODOMETRY], x.has_aid[Aid.VISUAL_ODOMETRY] = x.t - 1e8, 1.0
    assert not observe(x, k, Observation(), row)


def test_it_begins_with_what_is_set_and_learns_once():
    x, k = begun()
    P = array(x.P)
    assert P[E_VISUAL_VELOCITY + 1, E_VISUAL_VELOCITY + 1] == pytest.approx(0.01)
    P[E_VISUAL_VELOCITY + 1, E_VISUAL_VELOCITY + 1] = 1e-4
    load().visual_velocity.begin(x, k, [1.0, 2.0, 3.0, math.nan, 0.0])
    assert P[E_VISUAL_VELOCITY + 1, E_VISUAL_VELOCITY + 1] == 1e-4
