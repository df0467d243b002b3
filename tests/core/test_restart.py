"""Start with nothing known, start over, and put an earlier state in place of an unsound one."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import AIDS, E_ATT, E_VEL, Aid, Mode, N, Reset
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy, some_parameters
from tests.core.test_slow_error import is_covariance

NOW = 500e9
NAN, INFINITE = float("nan"), float("inf")


def parameters() -> Parameters:
    k = some_parameters()
    k.gap_reset = 1.0
    return k


def flown() -> State:
    """Return a state that has flown for long."""
    x = a_state(1)
    load().restart.forget_sensors(x)
    load().restart.start(x, 0.0)
    x.q_nb[:] = a_state(1).q_nb
    x.t, x.mode, x.resets, x.first_delay = NOW, Mode.NAVIGATE, 2.0, 0.05
    root = np.random.default_rng(1).normal(0.0, 0.1, (N, N))
    array(x.P)[:] = root @ root.T
    x.armed, x.raw_fix_t, x.count[Aid.POSITION][0] = 1.0, NOW, 70.0
    return x


def test_a_state_that_flies_is_sound():
    assert load().restart.is_sound(flown())


@pytest.mark.parametrize("value", [NAN, INFINITE, -INFINITE])
@pytest.mark.parametrize(
    "field",
    ["q_nb", "vel_n", "pos_n", "gyro_bias", "accel_bias"],
)
def test_no_part_of_a_sound_state_is_not_a_number(field, value):
    for i in range(3):
        x = flown()
        getattr(x, field)[i] = value
        assert not load().restart.is_sound(x)


@pytest.mark.parametrize("value", [NAN, INFINITE])
@pytest.mark.parametrize("field", ["baro_offset", "heading_offset", "gnss_delay"])
def test_nor_is_an_offset(field, value):
    x = flown()
    setattr(x, field, value)
    assert not load().restart.is_sound(x)


@pytest.mark.parametrize("value", [NAN, INFINITE, -1e-9])
def test_every_variance_of_a_sound_state_is_one(value):
    for i in range(N):
        x = flown()
        x.P[i][i] = value
        assert not load().restart.is_sound(x)


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("vel_n", 999.0, 1001.0),
        ("gyro_bias", 0.99, 1.01),
        ("accel_bias", 9.9, 10.1),
        ("pos_n", 1e11, 1e13),
    ],
)
def test_a_sound_state_is_of_a_vehicle(field, good, bad):
    for value, is_sound in ((good, True), (bad, False)):
        x = flown()
        x.vel_n[:] = x.gyro_bias[:] = x.accel_bias[:] = [0.0] * 3
        getattr(x, field)[1] = value
        assert load().restart.is_sound(x) == is_sound


def test_who_starts_over_keeps_the_place_the_counts_and_what_sensors_have_said():
    x, before = flown(), flown()
    load().restart.start_over(x, NOW + 1e7, Reset.CLOCK)
    assert not array(x.P).any()
    assert not any([*x.vel_n, *x.pos_n, *x.gyro_bias, *x.accel_bias, *x.hard_iron])
    assert (x.mode, x.t, list(x.q_nb)) == (Mode.LEVEL, NOW + 1e7, [1.0, 0.0, 0.0, 0.0])
    assert x.gnss_delay == 0.05  # its first guess
    assert all(x.t - x.used_t[aid] > 1e17 for aid in range(AIDS))
    assert bytes(x.origin) == bytes(before.origin)
    assert (x.armed, x.raw_fix_t, x.count[Aid.POSITION][0]) == (1.0, NOW, 70.0)
    assert (x.resets, x.reset_reason) == (3.0, Reset.CLOCK)


def test_what_was_learnt_by_the_estimate_that_is_discarded_begins_anew():
    x, new = flown(), State()
    x.doubt, x.walk.drift, x.drag.n, x.field_noise.share = 50.0, 9.0, 7.0, 4.0
    x.gain.begin.t = x.gain.end.t = NOW
    x.alignment.motion.has_fix = x.alignment.reference.is_known = 1.0
    x.alignment.rest.n, x.run[1].n, x.last_z_t[1] = 30.0, 5.0, NOW
    load().restart.start_over(x, NOW, Reset.CLOCK)
    load().restart.start(new, NOW)
    for part in ("walk", "drag", "field_noise", "run", "alignment"):
        assert bytes(getattr(x, part)) == bytes(getattr(new, part)), part
    assert (x.doubt, x.gain.begin.t, x.gain.end.t, x.last_z_t[1]) == (1.0, -1e18, -1e18, -1e18)


def test_a_new_filter_has_nothing_of_the_sensors():
    x = flown()
    load().restart.forget_sensors(x)
    assert np.isnan([x.armed, x.landed]).all()
    assert x.raw_fix_t < -1e17


def test_how_white_a_receiver_is_stays_known():
    x = State()
    load().restart.start(x, 0.0)
    assert list(x.white_share) == [0.3, 0.3, 1.0]
    x.white_share[:] = [0.1, 0.2, 0.5]
    load().restart.start(x, 1.0)
    assert list(x.white_share) == [0.1, 0.2, 0.5]


def spoilt() -> State:
    """Return a state after a step that has made it unsound."""
    x = flown()
    x.vel_n[0], x.q_nb[2], x.P[E_VEL][E_VEL] = NAN, NAN, -1.0
    x.gyro[:], x.accel_n[:] = [0.1, 0.2, 0.3], [NAN] * 3
    x.pending.dt = 0.004
    return x


def test_an_earlier_state_takes_the_place_of_an_unsound_one():
    x, good, age = spoilt(), flown(), 0.5
    good.t = NOW - age * 1e9
    x.has_aid[Aid.RANGE_FINDER], good.has_aid[Aid.BARO] = 1.0, 1.0
    before = copy(good)
    load().restart.recover(x, parameters(), good, NOW)
    assert load().restart.is_sound(x)
    assert bytes(good) == bytes(before)
    for field in ("q_nb", "vel_n", "pos_n", "gyro_bias", "gnss_offset", "has_aid"):
        assert list(getattr(x, field)) == list(getattr(good, field)), field
    assert (x.mode, x.t, x.pending.dt) == (Mode.NAVIGATE, NOW, 0.0)
    # it is as uncertain as after a gap of that length, and only that
    added = array(x.P) - array(good.P)
    assert np.count_nonzero(added) == 9
    assert (np.diag(added)[:9] > 0.0).all()
    assert is_covariance(x)
    assert list(x.accel_n) == [0.0] * 3
    # the last sample and the counts go on
    assert list(x.gyro) == [0.1, 0.2, 0.3]
    assert (x.resets, x.reset_reason, x.needs_reset) == (3.0, Reset.BOUNDS, 0.0)


def test_a_state_of_before_navigation_is_none_of_navigation():
    x, good = spoilt(), flown()
    good.mode, good.has_yaw = Mode.ATTITUDE, 0.0
    load().restart.recover(x, parameters(), good, NOW)
    # a position that the earlier state does not have is not navigated from
    assert (x.mode, x.has_yaw) == (Mode.ATTITUDE, 0.0)


def test_the_older_the_state_the_less_is_known_of_it():
    found = []
    for age in (0.1, 0.3):
        x, good = spoilt(), flown()
        good.t = NOW - age * 1e9
        load().restart.recover(x, parameters(), good, NOW)
        found.append(x.P[E_ATT][E_ATT] - good.P[E_ATT][E_ATT])
    # between two known ends, by the cube of a short time
    assert found[1] == pytest.approx(27.0 * found[0], rel=0.1)


@pytest.mark.parametrize(
    ("again", "mode", "starts_over"),
    [
        (10.1, Mode.NAVIGATE, False),
        (9.9, Mode.NAVIGATE, True),
        (1000.0, Mode.ATTITUDE, False),
        (1000.0, Mode.LEVEL, True),
    ],
)
def test_a_second_time_or_without_a_good_state_the_filter_starts_over(again, mode, starts_over):
    x, good = spoilt(), flown()
    x.restored_t, good.mode = NOW - again * 1e9, mode
    load().restart.recover(x, parameters(), good, NOW)
    assert (x.mode == Mode.LEVEL) == starts_over
    assert (x.restored_t, x.resets) == (NOW, 3.0)
    assert load().restart.is_sound(x)
