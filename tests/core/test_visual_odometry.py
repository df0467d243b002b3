"""The pose of another estimator: its rows, its frame, and what ends that."""

import math

import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    E_ATT,
    E_POS,
    E_VISUAL_ODOMETRY,
    Aid,
    Mode,
    N,
)
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array, copy, some_parameters

E_YAW, E_SCALE, E_LATE = (E_VISUAL_ODOMETRY + i for i in (3, 4, 5))
NAN = math.nan
T = 5e9


def begun(seed=1):
    """Return a state that has begun with a pose, and the row of that: yaw 0.3, counter 3."""
    x, k = a_state(seed), some_parameters()
    rng = np.random.default_rng(seed)
    own = k.aid[Aid.VISUAL_ODOMETRY]
    own.std = 0.05
    own.own[0], own.own[1], own.own[3] = 0.01, 0.1, 0.15  # yaw, scale, delay
    own.own[4], own.own[5], own.own[6] = 0.2, -0.1, 0.05  # lever arm
    x.mode, x.t, x.has_yaw = Mode.NAVIGATE, T, 1.0
    x.vel_n[:] = rng.normal(0.0, 1.0, 3)
    x.q_nb[:] = so3.from_euler(0.1, -0.2, 0.7)
    past = x.past
    for j in range(15):
        past.kept_t[j] = T - 35e6 * (15 - j)
        past.kept[j][:] = [-0.3 * (15 - j), 0.2 * (15 - j), -0.01 * (15 - j)]
    root = rng.normal(0.0, 0.1, size=(N, N))
    array(x.P)[:] = root @ root.T
    row = [4.0, -3.0, 1.0, 0.3, NAN, NAN, 3.0, *[NAN] * 6]
    assert load().visual_odometry.begin(x, k, row)
    x.has_aid[Aid.VISUAL_ODOMETRY] = 1.0
    return x, k, row


def turned_on(x):
    """Let the vehicle have turned, with its yaw kept, and its delay found."""
    x.visual_odometry_has_delay = 1.0
    x.P[E_LATE][E_LATE] = 1e-4
    for j in range(24):
        x.visual_odometry_yaw_t[j] = T - 25e6 * (24 - j)
        x.visual_odometry_yaws[j] = 0.7 - 0.8 * (0.07 + 0.025 * (24 - j))
    x.visual_odometry_scale, x.visual_odometry_frame_yaw = 0.05, 0.4
    x.visual_odometry_delay = 0.11
    x.visual_odometry_pivot[:] = [3.5, -2.6, 0.8]
    x.t = T + 70e6
    x.past.gained[:] = [0.6, -0.4, 0.02]
    x.visual_odometry_ours[:] = [*x.pos_n, 0.7]
    return [4.1, -3.05, 1.02, 0.31, NAN, NAN, 3.0, *[NAN] * 6]


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_jacobian_is_the_slope_of_the_prediction(part, seed):
    x, k, _ = begun(seed)
    row = turned_on(x)

    def observe(moved, _, o):
        o.part = part
        assert load().visual_odometry.observe(copy(moved), k, o, row)

    # yaw of ours at a time between two that are kept does not move with yaw of now: it is one of
    # before, which has the same error
    if part == 0:
        o, y = Observation(), copy(x)
        observe(y, k, o)  # where it is right the way in its slope is both's
        x.visual_odometry_north -= o.z[0]
        x.visual_odometry_east -= o.z[1]
        x.visual_odometry_down -= o.z[2]
        check(observe, x, 1e-5)
        return
    o = Observation()
    observe(x, k, o)
    H = np.array(o.H)[0]
    assert H[E_ATT + 2] == 1.0
    assert H[E_YAW] == -1.0
    later, slope = copy(x), Observation()
    later.visual_odometry_delay += 1e-3
    observe(later, k, slope)
    assert -(slope.z[0] - o.z[0]) / 1e-3 == pytest.approx(H[E_LATE], rel=0.2)


def test_after_the_first_pose_the_same_one_is_no_news():
    x, k, row = begun()
    x.at_rest = 1.0  # else it would be frozen
    o = Observation()
    assert load().visual_odometry.observe(x, k, o, row)
    assert list(o.z) == pytest.approx([0.0] * 3, abs=1e-12)
    assert x.visual_odometry_frame_yaw == pytest.approx(0.7 - 0.3)
    P = array(x.P)
    assert np.linalg.eigvalsh(P).min() > -1e-9 * np.linalg.eigvalsh(P).max()


def test_a_new_pivot_changes_neither_what_is_expected_nor_how_surely():
    x, k, _ = begun()
    row = turned_on(x)
    found = []
    for moves in (False, True):
        y, o = copy(x), Observation()
        if moves:
            load().visual_odometry.move_pivot(y, o)
            assert list(y.visual_odometry_pivot) == list(y.visual_odometry_pose)[:3]
        assert load().visual_odometry.observe(y, k, o, row)
        H = np.array(o.H)
        found.append((np.array(o.z), H @ array(y.P) @ H.T))
    np.testing.assert_allclose(found[1][0], found[0][0], atol=1e-9)
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "is_new"),
    [
        ({}, False),
        ({0: 0.3}, False),
        ({0: 3.0}, True),
        ({2: -0.8}, True),
        ({3: 0.1}, False),
        ({3: 0.4}, True),
        ({3: NAN}, False),
        ({6: 4.0}, True),
        ({6: NAN}, False),
    ],
)
def test_a_frame_ends_by_its_counter_or_by_a_leap_that_is_not_ours(change, is_new):
    x, k, _ = begun()
    row = turned_on(x)
    for place, by in change.items():
        row[place] = by if place == 6 else row[place] + by
    position = list(x.pos_n)
    assert load().visual_odometry.observe(x, k, Observation(), row) is not is_new
    assert x.has_aid[Aid.VISUAL_ODOMETRY] == (0.0 if is_new else 1.0)
    assert list(x.pos_n) == position


def widened(x, k, yaw_drift, drift):
    """Return what a pose makes of the covariance by the drift that it states."""
    y = copy(x)
    load().visual_odometry.widen(y, [4.0, -3.0, 1.0, 0.3, NAN, yaw_drift, 3.0, *drift])
    return array(y.P) - array(x.P), y


def test_the_drift_that_a_pose_states_is_added_to_its_frame():
    x, k, _ = begun()
    x.visual_odometry_frame_yaw = 0.4
    drift = [0.3, -0.1, 0.2, 0.05, 0.07, -0.4]
    L = np.zeros((3, 3))
    L[np.tril_indices(3)] = drift
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    added, y = widened(x, k, 0.02, drift)
    place = slice(E_VISUAL_ODOMETRY, E_VISUAL_ODOMETRY + 3)
    np.testing.assert_allclose(added[place, place], turn @ L @ L.T @ turn.T, atol=1e-12)
    assert added[E_YAW, E_YAW] == pytest.approx(0.02**2)
    added[place, place], added[E_YAW, E_YAW] = 0.0, 0.0
    assert not added.any()
    # what is smoothed later knows no more of the frame before than of it now
    assert [
        y.redrawn[E_VISUAL_ODOMETRY + i] > x.redrawn[E_VISUAL_ODOMETRY + i] for i in range(5)
    ] == [
        *[True] * 4,
        False,
    ]


@pytest.mark.parametrize("drift", [[NAN] * 6, [0.0] * 6])
@pytest.mark.parametrize("yaw_drift", [NAN, 0.0])
def test_a_pose_that_states_no_drift_leaves_its_frame_as_it_is(yaw_drift, drift):
    x, k, _ = begun()
    added, y = widened(x, k, yaw_drift, drift)
    assert not added.any()
    assert list(y.redrawn) == list(x.redrawn)


def test_a_pose_that_is_refused_has_drifted_all_the_same():
    x, k, _ = begun()
    row = [*turned_on(x)]
    row[5:] = [0.01, 3.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0]
    row[:3] = list(x.visual_odometry_pose)[:3]  # frozen
    before = x.P[E_VISUAL_ODOMETRY][E_VISUAL_ODOMETRY]
    assert not load().visual_odometry.observe(x, k, Observation(), row)
    assert x.P[E_VISUAL_ODOMETRY][E_VISUAL_ODOMETRY] == pytest.approx(before + 1.0)


def test_a_pose_that_repeats_itself_counts_at_rest_only():
    x, k, row = begun()
    x.t += 5e7
    assert not load().visual_odometry.observe(x, k, Observation(), row)
    x.at_rest = 1.0
    assert load().visual_odometry.observe(x, k, Observation(), row)


def test_what_was_learnt_of_the_sensor_outlives_its_frame():
    x, k, row = begun()
    x.visual_odometry_scale, x.P[E_SCALE][E_SCALE] = 0.05, 1e-4
    load().visual_odometry.keep(x, row)
    array(x.P)[:] = 0.0  # the filter has started over
    load().visual_odometry.begin(x, k, row)
    assert x.visual_odometry_scale == 0.05
    assert x.P[E_SCALE][E_SCALE] == 1e-4
    assert x.P[E_POS][E_POS] == 0.0


def test_the_least_sigma_that_it_states_is_its_noise():
    """A source states how far it has drifted since it began; that is not white."""
    x, k, row = begun()
    assert load().visual_odometry.variance(x, k) == pytest.approx(0.05**2)
    for std in (0.3, 0.2, 0.9):
        load().visual_odometry.keep(x, [*row[:4], std, *row[5:]])
    assert load().visual_odometry.variance(x, k) == pytest.approx(0.2**2)


def test_at_a_start_without_north_its_frame_is_ours():
    x, k, row = begun()
    x.has_yaw = 0.0
    assert load().visual_odometry.place(x, k, row) > 0.0
    assert list(x.pos_n) == pytest.approx(row[:3])
    assert so3.to_euler(np.array(x.q_nb))[2] == pytest.approx(0.3)
    assert x.has_yaw == 1.0


def test_without_any_yaw_nothing_starts_by_it():
    x, k, row = begun()
    x.has_yaw = 0.0
    assert load().visual_odometry.place(x, k, [*row[:3], NAN, *row[4:]]) == 0.0
    assert x.has_yaw == 0.0


def test_at_a_start_with_north_its_frame_is_turned():
    x, k, row = begun()
    load().visual_odometry.place(x, k, row)
    c, s = math.cos(0.4), math.sin(0.4)
    assert list(x.pos_n) == pytest.approx([4.0 * c + 3.0 * s, 4.0 * s - 3.0 * c, 1.0])


@pytest.mark.parametrize("late", [0.0, 0.12, 0.3])
def test_the_delay_is_found_by_turns_also_where_they_swing_within_it(late):
    x, k, row = begun()
    module = load().visual_odometry
    for step in range(400):
        t = 0.05 * step
        x.t = T + t * 1e9

        def yaw(at):
            return 0.4 * math.sin(2.0 * math.pi * at / 0.9) + 0.3 * math.sin(at)

        x.q_nb[:] = so3.from_euler(0.0, 0.0, yaw(t))
        row = [4.0, -3.0, 1.0, yaw(t - late), NAN, NAN, 3.0]
        if module.finds_delay(x, k, row):
            module.hold_delay(x, k)
            module.compare_turns(x, Observation(), row)
        module.keep(x, row)
    assert x.visual_odometry_has_delay == 1.0
    assert x.visual_odometry_delay == pytest.approx(late, abs=0.015)
