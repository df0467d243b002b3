"""Rest: what levels, what is fused, and when no rest is believed."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BG, E_POS, E_VEL, Aid, Mode, N, NeedsReset, Verdict
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.states import array
from tests.core.test_slow_error import is_covariance

NOW = 100e9
TRUE = so3.from_euler(0.3, -0.2, 0.0)
BIAS = np.array([0.004, -0.003, 0.002])


def settings() -> Parameters:
    return as_parameters(parameters(FilterSettings(), "unknown"))


def standing(mode: Mode) -> State:
    """Return a state that begins a window of rest."""
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, NOW)
    load().yaw_bank.restart(x.yaw_bank, settings())
    x.mode, x.armed, x.landed, x.dt = mode, 0.0, 1.0, 0.01
    if mode != Mode.LEVEL:
        x.q_nb[:] = TRUE
        array(x.P)[:] = np.diag(
            [1e-4] * 3 + [0.04] * 3 + [1.0] * 3 + [1e-4] * 3 + [1e-3] * (N - 12)
        )
    x.used_t[Aid.POSITION] = NOW
    return x


def sample(x: State, seconds: float, shaking: float = 0.01, rate=BIAS) -> None:
    """Feed samples at 100 Hz of a vehicle that stands, or shakes."""
    rng, k, w = np.random.default_rng(1), settings(), Scratch()
    up_b = so3.rotate(so3.conjugate(TRUE), np.array([0.0, 0.0, -k.gravity]))
    for _ in range(round(100.0 * seconds)):
        x.t += 1e7
        x.gyro[:] = rate + 0.03 * shaking * rng.standard_normal(3)
        x.accel[:] = up_b + shaking * rng.standard_normal(3)
        load().zero_velocity.check_rest(x, k, w)


def window() -> float:
    """Return the length of a window of rest, s."""
    return settings().align_time


def test_a_window_of_rest_levels_and_finds_the_gyro_s_bias():
    x = standing(Mode.LEVEL)
    sample(x, window() - 0.02)
    assert x.mode == Mode.LEVEL
    sample(x, 0.03)
    assert (x.mode, x.at_rest) == (Mode.ATTITUDE, 1.0)
    up = so3.rotate(np.array(x.q_nb), so3.rotate(so3.conjugate(TRUE), np.array([0.0, 0.0, -1.0])))
    np.testing.assert_allclose(up, [0.0, 0.0, -1.0], atol=2e-3)
    np.testing.assert_allclose(x.gyro_bias, BIAS, atol=1e-4)
    np.testing.assert_allclose(x.yaw_bank.gyro_bias, BIAS, atol=1e-4)
    assert is_covariance(x)


@pytest.mark.parametrize(
    ("armed", "landed", "shaking", "is_rest"),
    [
        (0.0, 0.0, 0.01, True),
        (1.0, 1.0, 0.01, True),
        (float("nan"), float("nan"), 0.01, True),  # an autopilot that reports nothing
        (1.0, 0.0, 0.01, False),  # a smooth flight
        (0.0, 1.0, 2.0, False),
    ],
)
def test_a_quiet_window_is_rest_unless_the_autopilot_reports_flight(
    armed, landed, shaking, is_rest
):
    x = standing(Mode.LEVEL)
    x.armed, x.landed = armed, landed
    sample(x, window() + 0.02, shaking)
    assert (x.at_rest == 1.0) == is_rest
    assert (x.mode == Mode.ATTITUDE) == is_rest


@pytest.mark.parametrize(
    ("seconds", "fix_age", "is_levelled"),
    [(5.9, None, False), (7.2, None, True), (7.2, 1.0, False)],
)
def test_a_vehicle_that_never_rests_is_levelled_roughly_unless_fixes_do_better(
    seconds, fix_age, is_levelled
):
    x = standing(Mode.LEVEL)
    if fix_age is not None:
        x.alignment.motion.has_fix, x.fix_t = 1.0, NOW + 1e9 * (seconds - fix_age)
    sample(x, seconds, shaking=2.0)
    assert (x.mode == Mode.ATTITUDE) == is_levelled
    if is_levelled:
        assert x.P[0][0] >= 0.15**2 * 0.9


def test_rest_holds_a_velocity_and_tells_where_the_ground_is():
    x = standing(Mode.NAVIGATE)
    x.vel_n[:], x.pos_n[2] = [0.1, -0.05, 0.02], -7.0
    sample(x, window() + 0.02)
    np.testing.assert_allclose(x.vel_n, 0.0, atol=0.1 * 0.05**2 / (0.04 + 0.05**2) * 1.1)
    assert x.P[E_VEL][E_VEL] == pytest.approx(1.0 / (1.0 / 0.04 + 1.0 / 0.05**2))
    assert (x.has_ground, x.ground) == (1.0, x.pos_n[2])
    np.testing.assert_allclose(x.gyro_bias, BIAS, atol=1e-4)
    assert x.count[Aid.REST][Verdict.FUSED] == 2.0
    assert is_covariance(x)


@pytest.mark.parametrize(
    ("landed", "seen", "count"), [(1.0, 0.0, 2.0), (0.0, 1e-6, 2.0), (0.0, 0.0, 0.0)]
)
def test_a_first_hover_is_not_taken_for_rest(landed, seen, count):
    """Only where rest was seen before, or the autopilot says that it has landed."""
    x = standing(Mode.NAVIGATE)
    x.landed, x.rest_gyro = landed, seen
    sample(x, window() + 0.02)
    assert x.at_rest == 1.0
    assert sum(x.count[Aid.REST]) == count


@pytest.mark.parametrize(
    ("use_rest", "needs_reset"), [(0.0, NeedsReset.NOTHING), (1.0, NeedsReset.TILT)]
)
def test_rest_is_not_fused_where_that_is_off_or_the_attitude_is_to_be_reset(use_rest, needs_reset):
    x, k, w = standing(Mode.NAVIGATE), settings(), Scratch()
    sample(x, 0.5 * window())
    k.use_rest, x.needs_reset = use_rest, needs_reset
    load().zero_velocity.use_rest_window(x, k, w)
    assert x.at_rest == 1.0
    assert sum(x.count[Aid.REST]) == 0.0


@pytest.mark.parametrize(
    ("was_still", "shaking", "kept"), [(1.0, 0.01, 50e9), (0.0, 0.01, 0.0), (1.0, 2.0, 0.0)]
)
def test_fields_are_compared_while_rest_lasts(was_still, shaking, kept):
    x = standing(Mode.NAVIGATE)
    sample(x, 0.5 * window(), shaking)
    x.at_rest, x.alignment.still.t0 = was_still, 50e9
    load().zero_velocity.use_rest_window(x, settings(), Scratch())
    assert x.alignment.still.t0 == kept


@pytest.mark.parametrize(
    ("bias", "admitted"),
    [
        (0.001, False),  # as it may be
        (0.9, True),  # of one sigma at the start
        (1.1, False),  # a turn after all
    ],
)
def test_a_gyro_s_bias_that_has_moved_is_found_anew(bias, admitted):
    x, k, w = standing(Mode.NAVIGATE), settings(), Scratch()
    for i in range(E_BG, E_BG + 3):
        x.P[i][i] = 1e-8
    bias *= k.gyro_bias_std
    load().rest.zero_rate(x, w.observation, [bias, 0.0, 0.0], 1e-4, 1e-4)
    load().zero_velocity.admit_new_bias(x, k, w.observation)
    expected = 1e-8 + (bias**2 if admitted else 0.0)
    assert x.P[E_BG][E_BG] == pytest.approx(expected)


def test_without_gnss_no_travel_is_assumed_five_times_a_second():
    x = standing(Mode.ATTITUDE)
    x.vel_n[:], x.pos_n[:] = [3.0, 1.0, 0.0], [5.0, 6.0, -7.0]
    x.at_rest = 0.0
    sample(x, 0.19)
    assert x.vel_n[0] == 3.0
    sample(x, 0.02)
    # 30 m/s are not excluded, but for good
    share = 30.0**2 / (0.04 + 30.0**2)
    np.testing.assert_allclose(x.vel_n, [3.0 * share, share, 0.0], rtol=1e-9)
    np.testing.assert_allclose(x.pos_n, [0.0, 0.0, -7.0], atol=1e-9)
    assert x.P[E_POS][E_POS] == 1.0
    at = x.fake_t
    sample(x, 0.2)
    assert x.fake_t - at == 2e8


@pytest.mark.parametrize(
    ("outage", "share", "is_lost"), [(60.1, 1.01, True), (59.0, 1.01, False), (60.1, 0.99, False)]
)
def test_a_position_that_nobody_has_corrected_for_long_is_dropped(outage, share, is_lost):
    x, k = standing(Mode.NAVIGATE), settings()
    x.used_t[Aid.POSITION] = NOW - 1e9 * outage
    x.P[E_POS][E_POS] = share * (10.0 * k.limit_pos) ** 2
    x.vel_n[0] = 4.0
    load().zero_velocity.check_rest(x, k, Scratch())
    assert (x.mode == Mode.ATTITUDE) == is_lost
    assert x.vel_n[0] == (0.0 if is_lost else 4.0)
    assert (x.P[E_VEL][E_VEL] == 100.0) == is_lost
