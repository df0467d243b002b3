"""Start of navigation at a fix, and resets to one: what the state is then, and what has moved."""

import numpy as np
import pytest

from ekf_companion.core.memory.bank import Bank
from ekf_companion.core.memory.enums import (
    AIDS,
    CORE,
    E_ATT,
    E_BG,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_POS,
    E_VEL,
    Aid,
    Mode,
    NeedsReset,
    Reset,
    Verdict,
)
from ekf_companion.core.memory.overlay import as_parameters, errors
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import earth, so3
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy
from tests.core.test_slow_error import is_covariance

NAN = float("nan")
NOW = 100e9
ARM = np.array([0.4, -0.3, -0.2])


def settings() -> Parameters:
    k = as_parameters(parameters(FilterSettings(weigh_faults="off"), "unknown"))
    k.lever_arm_b[:] = ARM
    return k


def flown(mode: Mode = Mode.NAVIGATE) -> State:
    """Return a state that turns, with a full covariance."""
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, 0.0)
    known = a_state(1)
    for field in ("q_nb", "vel_n", "pos_n", "gnss_offset", "gnss_vel_offset", "gyro", "gyro_bias"):
        getattr(x, field)[:] = getattr(known, field)
    x.origin, x.t, x.mode = known.origin, NOW, mode
    root = np.random.default_rng(2).normal(0.0, 1e-3, (CORE, CORE))
    array(x.P)[:CORE, :CORE] = root @ root.T
    x.gnss_offset_var[:], x.gnss_vel_offset_var[:] = [0.5, 2.0], [0.01, 0.01]
    return x


def scratch(vel_down: float = -1.0) -> Scratch:
    """Return working memory with a fix some way off."""
    w = Scratch()
    w.fix.lat, w.fix.lon, w.fix.alt = 0.8200021, 0.1500013, 490.0
    w.fix.vel_n[:], w.fix.std[:] = [3.0, 4.0, vel_down], [0.5, 0.7, 0.1]
    w.fix.stated_var[:] = [0.75, 2.5, 0.01]
    return w


def innovation(x: State, w: Scratch, observe: str) -> np.ndarray:
    o = Observation()
    getattr(load().gnss, observe)(x, settings(), w.fix, o)
    return np.array(o.z)[: o.rows]


@pytest.mark.parametrize(
    ("observe", "place", "offset", "variance"),
    [
        ("position", E_POS, E_GNSS, 0.5**2 + 0.5),
        ("height", E_POS + 2, E_GNSS + 2, 0.7**2 + 2.0),
        ("velocity", E_VEL, E_GNSS_VEL, 0.1**2 + 0.01),
    ],
)
def test_a_reset_to_a_fix_agrees_with_it_and_shares_its_error(observe, place, offset, variance):
    x, w, k = flown(), scratch(), settings()
    k.timing_std = k.lever_var = 0.0
    before = copy(x)
    getattr(load().navigation, f"reset_{observe}")(x, k, w)
    np.testing.assert_allclose(innovation(x, w, observe), 0.0, atol=1e-9)
    P = array(x.P)
    # that of the fix, white and slow, and a little of attitude and delay
    assert P[place, place] == pytest.approx(variance, rel=1e-2)
    assert P[place, offset] == pytest.approx(-P[offset, offset], rel=1e-4)
    assert is_covariance(x)
    assert errors(x)[offset - E_VEL] == 0.0
    # what has moved is what is reported
    for name in ("pos_n", "vel_n"):
        moved = np.array(getattr(x, name)) - np.array(getattr(before, name))
        np.testing.assert_allclose(getattr(x.moved, name), moved, atol=1e-12)
    assert x.used_t[Aid[observe.upper()]] == NOW


@pytest.mark.parametrize(("at_rest", "std"), [(0.0, 2.0), (1.0, 0.2)])
def test_a_velocity_without_down_leaves_that_unknown(at_rest, std):
    x, w = flown(), scratch(vel_down=NAN)
    x.at_rest = at_rest
    down = x.vel_n[2]
    load().navigation.reset_velocity(x, settings(), w)
    np.testing.assert_allclose(innovation(x, w, "velocity"), 0.0, atol=1e-9)
    assert (x.vel_n[2], x.moved.vel_n[2]) == (0.0, -down)
    assert x.P[E_VEL + 2][E_VEL + 2] == pytest.approx(std**2)
    assert is_covariance(x)


def test_the_first_fix_of_all_becomes_the_origin():
    x, w, k = flown(Mode.ATTITUDE), scratch(), settings()
    x.origin.is_known, x.gnss_delay = 0.0, 0.0
    x.gnss_offset[:] = [0.0] * 3
    load().navigation.start_navigation(x, k, w, True)
    assert x.mode == Mode.NAVIGATE
    counts = [x.count[aid][Verdict.FUSED] for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY)]
    assert counts == [1.0] * 3
    fixed = (x.origin.lat, x.origin.lon, x.origin.alt)
    assert fixed == (w.fix.lat, w.fix.lon, w.fix.alt)
    # the origin is the antenna's place
    np.testing.assert_allclose(x.pos_n, -so3.rotate(np.array(x.q_nb), ARM), atol=1e-9)
    assert is_covariance(x)


def test_a_given_origin_and_slow_error_are_gone_on_from():
    x, w, k = flown(Mode.ATTITUDE), scratch(), settings()
    x.gnss_delay = 0.0
    origin, offset = copy(x.origin), [3.0, -2.0, 5.0]
    x.gnss_offset[:] = offset
    load().navigation.start_navigation(x, k, w, True)
    assert bytes(x.origin) == bytes(origin)
    assert list(x.gnss_offset) == pytest.approx(offset)
    frame = earth.LocalFrame(x.origin.lat, x.origin.lon, x.origin.alt)
    antenna = np.array(x.pos_n) + so3.rotate(np.array(x.q_nb), ARM)
    fixed = frame.to_ned(w.fix.lat, w.fix.lon, w.fix.alt)
    np.testing.assert_allclose(antenna, fixed - offset, atol=1e-8)


@pytest.mark.parametrize(("variance", "is_doubted"), [(0.0, True), (1e6, False)])
def test_a_jump_beyond_what_is_known_may_be_the_receiver_s_as_well_as_ours(variance, is_doubted):
    x, w, k = flown(), scratch(), settings()
    array(x.P)[[E_POS, E_POS + 1, E_POS + 2], [E_POS, E_POS + 1, E_POS + 2]] += variance
    o = w.observation
    o.has_bank, o.bank = 1, (Bank * 1)()
    level = innovation(x, w, "position") if is_doubted else np.zeros(2)
    height = innovation(x, w, "height") if is_doubted else np.zeros(1)
    load().navigation.doubt_jump(x, k, w)
    half = [0.5 * level @ level, 0.5 * height @ height]
    np.testing.assert_allclose(o.bank[0].let_go, half)
    np.testing.assert_allclose(x.gnss_offset_var, np.add([0.5, 2.0], half))


@pytest.mark.parametrize(("at_rest", "proving"), [(0.0, 2.5e9), (1.0, 0.0)])
def test_an_attitude_found_in_motion_is_to_be_confirmed(at_rest, proving):
    x = flown(Mode.ATTITUDE)
    x.at_rest = at_rest
    load().navigation.start_navigation(x, settings(), scratch(), False)
    assert x.proven_t - NOW == proving
    assert list(x.vel_n) == [0.0] * 3
    assert x.P[E_VEL][E_VEL] == (0.04 if at_rest else 100.0)


def with_bank(x: State) -> np.ndarray:
    """Let the yaw bank know the attitude; return it."""
    true = so3.exp(np.array([0.1, -0.2, -2.0]))
    b = x.yaw_bank
    b.yaw, b.yaw_std, b.tilt_std, b.gyro_bias_std = -1.1, 0.08, 0.02, 0.003
    b.q_sb[:] = so3.multiply(so3.exp(np.array([0.0, 0.0, 1.1])), true)
    b.gyro_bias[:] = [0.01, 0.02, -0.01]
    return true


def test_the_yaw_bank_s_attitude_replaces_a_wrong_one_with_all_that_it_has_taught():
    x, k, w = flown(), settings(), scratch()
    true = with_bank(x)
    x.accel_bias[:], x.hard_iron[:] = [0.3] * 3, [0.1] * 3
    x.accel[:] = [0.0, 0.0, -k.gravity]
    before = so3.to_euler(np.array(x.q_nb))
    x.q_nb[:] = so3.from_euler(*so3.to_euler(true)[:2], before[2])
    load().navigation.start_from_yaw_bank(x, k, w)
    np.testing.assert_allclose(np.abs(np.dot(x.q_nb, true)), 1.0, atol=1e-12)
    assert x.moved.yaw == pytest.approx(float(so3.wrap(so3.to_euler(true)[2] - before[2])))
    assert list(x.gyro_bias) == [0.01, 0.02, -0.01]
    assert not any([*x.accel_bias, *x.hard_iron, x.heading_offset])
    # of the bank's heading at least 0.05 rad are uncertain; of a compass everything is
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(0.08**2 + 0.05**2, rel=2e-2)
    assert x.P[E_HEADING][E_HEADING] == pytest.approx(np.pi**2 / 3.0, rel=1e-3)
    np.testing.assert_allclose(np.diag(array(x.P))[E_BG : E_BG + 3], 0.003**2, rtol=1e-2)
    np.testing.assert_allclose(innovation(x, w, "velocity"), 0.0, atol=1e-9)
    assert (x.mode, x.has_yaw) == (Mode.NAVIGATE, 1.0)
    assert is_covariance(x)


@pytest.mark.parametrize(
    ("mode", "is_rushing", "is_kept"),
    [(Mode.NAVIGATE, 1.0, True), (Mode.NAVIGATE, 0.0, False), (Mode.ATTITUDE, 1.0, False)],
)
def test_a_height_is_kept_where_the_receiver_s_climb_is_a_fault(mode, is_rushing, is_kept):
    x, height = flown(mode), -33.0
    with_bank(x)
    x.voices.is_rushing, x.pos_n[2], x.P[E_POS + 2][E_POS + 2] = is_rushing, height, 4.0
    pos_n, vel_n = np.array(x.pos_n), np.array(x.vel_n)
    load().navigation.start_from_yaw_bank(x, settings(), scratch())
    if mode == Mode.NAVIGATE:
        np.testing.assert_allclose(x.moved.pos_n, np.array(x.pos_n) - pos_n, atol=1e-9)
        np.testing.assert_allclose(x.moved.vel_n, np.array(x.vel_n) - vel_n, atol=1e-9)
    assert (x.pos_n[2] == height) == is_kept
    assert (x.P[E_POS + 2][E_POS + 2] == 4.0) == is_kept


def test_after_a_gap_fixes_alone_are_followed_until_patience_ends():
    x, k = flown(), settings()
    x.needs_reset, x.alignment.motion.has_fix, x.alignment.motion.fix_t = NeedsReset.FIX, 0.0, 0.0
    resets, found = x.resets, []
    for n in range(17):
        x.t, w = NOW + 0.2e9 * n, scratch()
        load().navigation.resume_after_gap(x, k, w, True)
        found.append(x.needs_reset)
        np.testing.assert_allclose(innovation(x, w, "velocity"), 0.0, atol=1e-9)
        np.testing.assert_allclose(innovation(x, w, "position"), 0.0, atol=1e-9)
    # no heading comes to find the attitude with: 3 s later it is left to the filter
    assert found == [NeedsReset.TILT] * 16 + [NeedsReset.NOTHING]
    assert (x.resets, x.reset_reason) == (resets + 1.0, Reset.GAP)


def test_fixes_without_velocity_show_no_attitude_after_a_gap():
    x = flown()
    x.needs_reset = NeedsReset.FIX
    load().navigation.resume_after_gap(x, settings(), scratch(), False)
    assert x.needs_reset == NeedsReset.NOTHING


@pytest.mark.parametrize(("first", "axes"), [(0, [0, 1]), (2, [2])])
def test_a_velocity_that_nothing_shows_is_none_within_5_m_s(first, axes):
    x = flown()
    before = copy(x)
    load().navigation.reset_unknown_velocity(x, first, len(axes))
    for axis in range(3):
        is_reset = axis in axes
        assert x.vel_n[axis] == (0.0 if is_reset else before.vel_n[axis])
        assert x.moved.vel_n[axis] == (-before.vel_n[axis] if is_reset else 0.0)
        e = E_VEL + axis
        assert x.P[e][e] == (25.0 if is_reset else before.P[e][e])


def test_a_height_that_was_wrong_leaves_no_aid_but_the_barometer_at_it():
    core = load()
    resets = (
        lambda x: core.navigation.reset_height(x, settings(), scratch()),
        core.voices.doubt_height,
    )
    for doubt in resets:
        x = flown()
        x.has_aid[:] = [1.0] * AIDS
        doubt(x)
        assert [Aid(i) for i, has in enumerate(x.has_aid) if has] == [Aid.BARO]
