"""A fix: what its stated error is shared into, when it starts, corrects or resets the state."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    CORE,
    E_GNSS,
    E_POS,
    Aid,
    Mode,
    N,
    Reset,
    Verdict,
    Voice,
)
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Fix, GnssRow, Observation, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import earth, so3
from ekf_companion.nav.measurements import GnssFlag
from tests.core.interpreted import load
from tests.core.states import array, copy
from tests.core.test_slow_error import is_covariance

NAN = float("nan")
NOW = 100e9
FRAME = earth.LocalFrame(0.82, 0.15, 480.0)
STATED = (1.2, 2.0, 0.3)


def settings() -> Parameters:
    k = as_parameters(parameters(FilterSettings(weigh_faults="off"), "unknown"))
    k.lever_arm_b[:] = [0.0] * 3
    return k


def navigating() -> State:
    """Return a state that hovers at its origin, level, and was corrected just now."""
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, 0.0)
    load().strapdown.set_origin(x, FRAME.lat, FRAME.lon, FRAME.alt)
    load().yaw_bank.restart(x.yaw_bank, settings())
    x.t, x.mode, x.has_yaw, x.dt = NOW, Mode.NAVIGATE, 1.0, 0.01
    x.fix_t, x.fix_dt, x.raw_fix_t, x.armed, x.doubt = NOW - 0.2e9, 0.2, NOW, 1.0, 0.0
    x.begun = N - CORE
    array(x.P)[:] = np.diag([1e-5] * 3 + [1e-3] * 3 + [0.1] * 3 + [1e-8] * 3 + [1e-6] * (N - 12))
    for aid in Aid:
        x.used_t[aid] = NOW
    return x


def a_row(pos_n=(0.0, 0.0, 0.0), vel_n=(0.0, 0.0, 0.0), std=STATED) -> GnssRow:
    lat, lon, alt = FRAME.to_geodetic(np.array(pos_n, dtype=float))
    row = GnssRow(lat=float(lat), lon=float(lon), alt=float(alt), declination=NAN)
    row.vel_n[:], row.std[:] = vel_n, std
    return row


@pytest.mark.parametrize(("configured", "learnt"), [(0.25, 0.9), (NAN, 0.4), (1.0, 0.4)])
def test_a_stated_variance_is_shared_between_white_and_slow(configured, learnt):
    x, k, fix = navigating(), settings(), Fix()
    k.white_share, x.white_share[:] = configured, [learnt] * 3
    load().fix.read_fix(x, k, fix, a_row())
    white = learnt if np.isnan(configured) else configured
    for aid in (0, 1):
        assert fix.stated_var[aid] == STATED[aid] ** 2
        assert fix.std[aid] ** 2 == pytest.approx(white * STATED[aid] ** 2)
        assert x.gnss_offset_var[aid] + fix.std[aid] ** 2 == pytest.approx(fix.stated_var[aid])


def test_a_receiver_is_no_better_than_its_least_sigma_and_an_unknown_one_is_usual():
    x, k, fix = navigating(), settings(), Fix()
    k.learn_noise, k.vel_std_default, x.white_share[:] = 0.0, 0.7, [1.0] * 3
    load().fix.read_fix(x, k, fix, a_row(std=(1e-3, 1e-3, NAN)))
    assert list(fix.std) == pytest.approx([k.gnss_floor[0], k.gnss_floor[1], 0.7])
    load().fix.read_fix(x, k, fix, a_row(std=(1e-3, 1e-3, 1e-3)))
    assert fix.std[2] == k.gnss_floor[2]


@pytest.mark.parametrize(("stated", "factor"), [(0.05, 1.0), (0.09, 1.0), (0.3, 3.0)])
def test_a_velocity_worse_than_0_1_m_s_has_a_larger_slow_error(stated, factor):
    x, k = navigating(), settings()
    k.learn_noise, x.white_share[2] = 0.0, 1.0
    load().fix.read_fix(x, k, Fix(), a_row(std=(1.0, 1.0, stated)))
    assert list(x.gnss_vel_offset_var) == pytest.approx([(factor * k.gnss_vel_slow_std) ** 2] * 2)


@pytest.mark.parametrize(("share", "is_bound"), [(1.04, False), (1.06, True), (9.0, True)])
def test_a_slow_error_is_brought_down_to_its_level_with_what_depends_on_it(share, is_bound):
    x, axis, level = navigating(), 1, 0.5
    root = np.random.default_rng(1).normal(0.0, 0.1, (N, N))
    array(x.P)[:] = root @ root.T
    e = E_GNSS + axis
    array(x.P)[:] *= share * level / x.P[e][e]
    x.gnss_offset[axis] = 2.0
    before = copy(x)
    load().fix.bound_offset(x, Observation(), axis, level)
    if not is_bound:
        assert bytes(x) == bytes(before)
        return
    # the error is as it would be of that level, and others keep their regression on it
    assert x.P[e][e] == pytest.approx(level)
    assert x.gnss_offset[axis] == pytest.approx(2.0 / share)
    row = array(before.P)[e]
    moved = row[E_POS] / row[e] * (x.gnss_offset[axis] - 2.0)
    assert x.pos_n[0] - before.pos_n[0] == pytest.approx(moved)
    assert is_covariance(x)


@pytest.mark.parametrize(
    ("mode", "has_yaw", "starts"),
    [(Mode.LEVEL, 0.0, False), (Mode.ATTITUDE, 0.0, False), (Mode.ATTITUDE, 1.0, True)],
)
def test_a_fix_starts_navigation_once_there_is_an_attitude(mode, has_yaw, starts):
    x, k, w = navigating(), settings(), Scratch()
    x.mode, x.has_yaw = mode, has_yaw
    assert load().fix.fuse_fix(x, k, w, a_row((30.0, 40.0, -5.0), (1.0, 2.0, 0.0)))
    assert (x.mode == Mode.NAVIGATE) == starts
    verdict = Verdict.FUSED if starts else Verdict.BEFORE_ALIGNMENT
    assert x.count[Aid.POSITION][verdict] == 1.0
    if starts:
        np.testing.assert_allclose(x.pos_n, [30.0, 40.0, -5.0], atol=1e-6)
        np.testing.assert_allclose(x.vel_n, [1.0, 2.0, 0.0], atol=1e-9)


def test_the_place_of_the_first_fix_makes_magnetic_north_no_reference():
    for mode, stays in ((Mode.ATTITUDE, False), (Mode.NAVIGATE, True)):
        x, row = navigating(), a_row()
        x.mode, x.mag_t, x.alignment.reference.is_known = mode, NOW, 1.0
        row.declination, row.inclination, row.strength = 0.05, 1.1, 0.48
        load().fix.learn_field(x, row)
        assert (x.field.declination, x.field.inclination, x.field.strength) == (0.05, 1.1, 0.48)
        assert (x.has_yaw == 1.0) == stays
        # another estimate's heading is used after 5 s without a compass: in one more
        assert x.mag_t == (NOW if stays else NOW - 4e9)
        x.has_yaw = 1.0
        load().fix.learn_field(x, row)
        assert x.has_yaw == 1.0  # the next one changes nothing


@pytest.mark.parametrize(
    ("velocity_age", "off", "way", "std", "expected"),
    [
        (2.1, 60.0, 0.0, 0.1, 4.0),  # no velocity: ours may have drifted anywhere
        (1.9, 60.0, 0.0, 0.1, 30.0),
        (1.9, 6.0, 0.0, 0.1, 12.0),  # at half a metre a second
        (1.9, 1.5, 0.0, 0.1, 4.0),
        (1.9, 60.0, 0.0, 4.0, 30.0),
        (1.9, 60.0, 0.0, 4.5, 4.0),  # within ten of our own sigmas
        (1.9, 60.0, 55.0, 0.1, 2.0),  # where the velocity led that was refused
    ],
)
def test_a_jump_is_refused_for_as_long_as_drift_would_take(velocity_age, off, way, std, expected):
    x, k, w = navigating(), settings(), Scratch()
    k.timeout_pos = 4.0
    x.used_t[Aid.VELOCITY] = NOW - velocity_age * 1e9
    x.P[E_POS][E_POS] = x.P[E_POS + 1][E_POS + 1] = std**2
    w.observation.z[:2] = 0.6 * off, -0.8 * off
    x.refused_way[:2] = 0.6 * way, -0.8 * way
    assert load().fix.position_patience(x, k, w) == expected


def hover(
    x: State, fixes: int, place: tuple[float, ...], wander: float = 0.0, speed: float = 0.0
) -> list[bool]:
    """Fuse fixes at 5 Hz; ``wander`` is their noise in m, ``speed`` that of their velocity."""
    rng, k, w, found = np.random.default_rng(3), settings(), Scratch(), []
    for _ in range(fixes):
        x.t += 0.2e9
        pos_n = np.array(place) + wander * rng.standard_normal(3) * [1.0, 1.0, 0.0]
        vel_n = 0.05 * rng.standard_normal(3) + speed * rng.choice([-1.0, 1.0], 3)
        found.append(load().fix.fuse_fix(x, k, w, a_row(pos_n, vel_n)))
    return found


def test_a_fix_where_we_are_is_fused_and_makes_position_more_certain():
    x = navigating()
    x.refused_way[:2] = 5.0, -5.0
    for e in range(E_GNSS, E_GNSS + 3):
        x.P[e][e] = 30.0
    hover(x, 1, (0.0, 0.0, 0.0), wander=0.1)
    for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY):
        assert (x.count[aid][Verdict.FUSED], x.used_t[aid]) == (1.0, x.t)
    assert x.P[E_POS][E_POS] < 0.1
    # the slow error is no larger than what is stated
    assert (np.diag(array(x.P))[E_GNSS : E_GNSS + 3] < np.square([1.2, 1.2, 2.0])).all()
    assert list(x.refused_way[:2]) == [0.0, 0.0]
    assert is_covariance(x)


def test_a_jump_that_stays_is_followed_at_last_and_one_that_jumps_on_is_not():
    x = navigating()
    assert all(hover(x, 145, (40.0, 0.0, 0.0), wander=0.2))
    assert x.resets == 0.0
    assert abs(x.pos_n[0]) < 1.0
    assert all(hover(x, 10, (40.0, 0.0, 0.0), wander=0.2))
    assert (x.resets, x.reset_reason) == (1.0, Reset.POSITION)
    assert x.pos_n[0] == pytest.approx(40.0, abs=1.0)

    x = navigating()
    assert all(hover(x, 300, (40.0, 0.0, 0.0), wander=15.0))
    assert x.resets == 0.0


def test_a_height_that_stays_is_followed_after_its_time_out():
    x, fixes = navigating(), round(5.0 * settings().timeout_height)
    hover(x, fixes, (0.0, 0.0, -40.0), wander=0.1)
    assert (x.resets, x.count[Aid.HEIGHT][Verdict.FUSED]) == (0.0, 0.0)
    hover(x, 2, (0.0, 0.0, -40.0), wander=0.1)
    assert (x.resets, x.reset_reason) == (1.0, Reset.HEIGHT)
    assert x.pos_n[2] == pytest.approx(-40.0, abs=1.0)
    assert abs(x.pos_n[0]) < 1.0


@pytest.mark.parametrize(
    ("place", "reason"), [((40.0, 0.0, 0.0), Reset.POSITION), ((0.0, 0.0, -40.0), Reset.HEIGHT)]
)
def test_on_the_ground_a_receiver_that_settles_is_followed_after_three_seconds(place, reason):
    for armed, resets in ((1.0, 0.0), (0.0, 1.0)):
        x = navigating()
        x.armed, x.at_rest, x.has_aid[Aid.BARO] = armed, 1.0, 1.0
        hover(x, 14, place, wander=0.1)
        assert x.resets == 0.0
        hover(x, 2, place, wander=0.1)
        assert x.resets == resets
    assert x.reset_reason == reason
    # the barometer's offset was found by the height before
    assert x.has_aid[Aid.BARO] == (reason == Reset.POSITION)


def test_velocity_faults_start_the_filter_over_only_if_positions_contradict_us_too():
    assert all(hover(navigating(), 200, (0.0, 0.0, 0.0), speed=30.0))
    found = hover(navigating(), 200, (400.0, 0.0, 0.0), wander=50.0, speed=30.0)
    # once none has been used for the time-out, and all were refused for half of it
    assert 0.2 * found.index(False) == pytest.approx(settings().timeout_vel, abs=0.3)


def test_a_vehicle_that_moved_on_while_we_stood_resets_velocity_and_position():
    x, k, w = navigating(), settings(), Scratch()
    rng, vel_n = np.random.default_rng(3), np.array([10.0, -3.0, 0.0])
    for n in range(round(5.0 * k.timeout_vel) + 1):
        assert x.resets == 0.0
        x.t += 0.2e9
        row = a_row(0.2 * n * vel_n, vel_n + 0.03 * rng.standard_normal(3))
        assert load().fix.fuse_fix(x, k, w, row)
    assert x.reset_reason == Reset.VELOCITY
    np.testing.assert_allclose(x.vel_n, vel_n, atol=0.2)


def test_a_yaw_that_the_motion_contradicts_is_reset_to_the_bank_s():
    x, k, w = navigating(), settings(), Scratch()
    b = x.yaw_bank
    b.q_sb[:], b.yaw, b.yaw_std, b.good = x.q_nb, 2.0, 0.05, 5.0
    b.nis, b.failing_t, b.gyro_bias_std, b.tilt_std = 20.0, NOW - 2e9, 0.01, 0.02
    x.accel[:] = [0.0, 0.0, -k.gravity]
    load().fix.read_fix(x, k, w.fix, a_row(vel_n=(8.0, 0.0, 0.0), std=(1.0, 1.5, 0.1)))
    assert load().fix.correct_by_fix(x, k, w, True)
    assert (x.resets, x.reset_reason, b.repairs, x.doubt) == (1.0, Reset.MOTION, 1.0, 1.0)
    assert so3.to_euler(np.array(x.q_nb))[2] == pytest.approx(2.0)
    assert x.vel_n[0] == pytest.approx(8.0)


def test_the_interval_of_the_receiver_is_that_between_its_last_two_fixes():
    x = navigating()
    x.fix_t, x.fix_dt = -1e18, 0.0
    hover(x, 1, (0.0, 0.0, 0.0), wander=0.1)
    assert (x.fix_t, x.fix_dt) == (x.t, 0.0)
    # its velocity is kept, to learn how late it is
    assert x.gain.end.t == x.t
    x.t += 0.8e9
    hover(x, 1, (0.0, 0.0, 0.0), wander=0.1)
    assert x.fix_dt == pytest.approx(1.0)


def test_fixes_of_a_frozen_or_a_superfluous_receiver_are_counted_and_not_fused():
    x, k, w = navigating(), settings(), Scratch()
    row = a_row(vel_n=(3.0, 0.0, 0.0))
    x.vel_n[0] = 3.0
    for _ in range(4):
        x.t += 0.2e9
        load().fix.fuse_fix(x, k, w, row)
    assert x.count[Aid.POSITION][Verdict.SUSPECT] == 2.0
    row.flags = float(GnssFlag.SECOND)
    fixed = x.fix_t
    x.t += 0.2e9
    load().fix.fuse_fix(x, k, w, row)
    assert x.count[Aid.POSITION][Verdict.SUPERSEDED] == 1.0
    assert x.fix_t == fixed


def test_a_height_that_contradicts_the_others_is_not_fused():
    x, k, w = navigating(), settings(), Scratch()
    load().fix.read_fix(x, k, w.fix, a_row())
    x.voices.loser = Voice.HEIGHT
    load().fix.fuse_height(x, k, w)
    assert x.count[Aid.HEIGHT][Verdict.SUSPECT] == 1.0
    assert x.count[Aid.HEIGHT][Verdict.FUSED] == 0.0
