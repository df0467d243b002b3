"""Initial alignment: level, north and what is not known of both."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    E_ATT,
    E_BA,
    E_BG,
    E_DELAY,
    E_HEADING,
    E_VEL,
    Azimuth,
    Mode,
)
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Motion, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.states import array
from tests.core.test_slow_error import is_covariance

NOW = 100e9
DOWN = np.array([0.0, 0.0, 1.0])


def settings() -> Parameters:
    return as_parameters(parameters(FilterSettings(), "unknown"))


def levelling() -> State:
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, NOW)
    return x


def refer(x: State, direction_b: np.ndarray, azimuth: float, std: float = 0.02) -> None:
    """Let a direction of the body be of known azimuth."""
    r = x.alignment.reference
    r.is_known, r.t, r.azimuth, r.std = 1.0, x.t, azimuth, std
    r.direction_b[:] = direction_b
    x.azimuth, x.heading_std = Azimuth.OTHER, std


@pytest.mark.parametrize("seed", range(6))
def test_the_attitude_turns_the_pair_into_each_other_and_the_reference_to_its_azimuth(seed):
    rng = np.random.default_rng(seed)
    x, w, true = levelling(), Scratch(), so3.exp(rng.normal(0.0, 1.5, 3))
    n = np.array([*rng.normal(0.0, 2.0, 2), -9.8])
    b = so3.rotate(so3.conjugate(true), n)
    north = so3.rotate(so3.conjugate(true), np.array([np.cos(0.4), np.sin(0.4), 0.3]))
    refer(x, north, 0.4)
    w.pair.n[:], w.pair.b[:] = n, 3.0 * b
    load().align.set_attitude(x, w, w.pair)
    error = so3.log(so3.multiply(np.array(x.q_nb), so3.conjugate(true)))
    # the force is up to a third off the vertical: four rounds about it
    np.testing.assert_allclose(error, 0.0, atol=1e-3)
    np.testing.assert_allclose(so3.rotate(np.array(x.q_nb), b), n, atol=1e-12)


@pytest.mark.parametrize("b", [(0.0, 0.0, 9.8), (0.0, 0.0, -9.8), (0.0, 9.8, 1e-9)])
def test_upside_down_as_well_the_forward_axis_points_north_without_a_reference(b):
    x, w = levelling(), Scratch()
    w.pair.n[:], w.pair.b[:] = -DOWN, b
    load().align.set_attitude(x, w, w.pair)
    forward = so3.rotate(np.array(x.q_nb), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(forward, [1.0, 0.0, 0.0], atol=1e-12)
    up = so3.rotate(np.array(x.q_nb), np.array(b) / 9.8)
    np.testing.assert_allclose(up, -DOWN, atol=1e-9)


def levelled(true: np.ndarray, bias: np.ndarray, at: tuple[float, ...] | None = None) -> State:
    """Return a state that has levelled at rest by samples of noise and a bias."""
    x, k, w = levelling(), settings(), Scratch()
    load().rest.begin_window(x, x.t)
    up_b = so3.rotate(so3.conjugate(true), -k.gravity * DOWN)
    noise = np.random.default_rng(1).normal(0.0, 0.02, (100, 3))
    for one in noise - noise.mean(axis=0):
        x.t += 1e7
        x.accel[:], x.gyro[:] = up_b + bias + one, 0.005 + 0.01 * one
        load().rest.add_to_window(x)
    if at is not None:
        refer(x, so3.rotate(so3.conjugate(true), np.array(at)), np.arctan2(at[1], at[0]))
    load().align.level_at_rest(x, k, w)
    return x


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tilt_is_correlated_with_the_bias_that_it_was_levelled_by(seed):
    """The slope of the attitude found by the accelerometer's bias, by differences."""
    rng = np.random.default_rng(seed)
    true, step, at = so3.exp(rng.normal(0.0, 1.0, 3)), 1e-4, (0.6, 0.8, 0.0)
    slope = np.zeros((3, 3))
    for i in range(3):
        ends = [
            np.array(levelled(true, sign * step * np.eye(3)[i], at).q_nb) for sign in (1.0, -1.0)
        ]
        # true less estimated: with a bias that it does not know it finds the wrong attitude
        slope[:, i] = -so3.log(so3.multiply(ends[0], so3.conjugate(ends[1]))) / (2.0 * step)
    x = levelled(true, np.zeros(3), at)
    P, variance = array(x.P), settings().accel_bias_std ** 2
    found = P[E_ATT : E_ATT + 2, E_BA : E_BA + 3]
    np.testing.assert_allclose(found, variance * slope[:2], atol=1e-6 * variance)
    tilt = variance / settings().gravity ** 2
    assert np.diag(P)[:2] == pytest.approx(tilt, rel=2e-2)  # and a little for the noise
    assert (np.diag(P)[:2] > tilt).all()
    assert is_covariance(x)


def test_how_quiet_rest_is_is_learnt():
    x = levelled(so3.exp(np.array([0.1, -0.2, 2.0])), np.zeros(3))
    noise = np.random.default_rng(1).normal(0.0, 0.02, (100, 3))
    variance = noise.var(axis=0).sum()
    assert x.rest_accel == pytest.approx(variance, rel=1e-6)
    assert x.rest_gyro == pytest.approx(0.01**2 * variance, rel=1e-6)


def test_a_heading_makes_yaw_known_and_without_one_it_is_not():
    true = so3.exp(np.array([0.1, -0.2, 2.0]))
    x = levelled(true, np.zeros(3), at=(0.6, 0.8, 0.0))
    assert x.has_yaw == 1.0
    error = so3.log(so3.multiply(np.array(x.q_nb), so3.conjugate(true)))
    np.testing.assert_allclose(error, 0.0, atol=1e-6)
    # what the azimuth is wrong by, slowly and for once
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(2.0 * 0.02**2, rel=1e-3)
    assert x.P[E_ATT + 2][E_HEADING] == pytest.approx(-(0.02**2), rel=1e-3)
    x = levelled(true, np.zeros(3))
    assert x.has_yaw == 0.0
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(np.pi**2 / 3.0, rel=1e-3)
    assert x.mode == Mode.ATTITUDE


def test_what_was_learnt_before_the_clock_began_anew_counts():
    """A bias that is known better than its usual sigma stays so; one known worse does not."""
    k, std = settings(), settings().gyro_bias_std
    for learnt, mode, expected in (
        (0.5 * std, Mode.LEVEL, 0.5 * std),
        (2.0 * std, Mode.LEVEL, std),
        (0.0, Mode.LEVEL, std),
        (0.5 * std, Mode.ATTITUDE, std),
    ):
        x = levelling()
        x.q_nb[0], x.mode = 1.0, mode
        x.P[E_BG + 1][E_BG + 1] = learnt**2
        x.P[E_DELAY][E_DELAY] = 0.25 * k.delay_std**2
        load().align.start_filter(x, k, Scratch(), 0.01, std)
        assert np.diag(array(x.P))[E_BG : E_BG + 3] == pytest.approx(expected**2)
        assert x.P[E_VEL][E_VEL] == 0.01
        # no attitude has taught the delay
        assert x.P[E_DELAY][E_DELAY] == 0.25 * k.delay_std**2


def test_a_reference_is_carried_along_with_the_turning_body():
    x, m, dt = levelling(), Motion(), 0.004
    x.gyro_bias[:] = [0.1, 0.0, -0.1]
    rate = np.array([1.5, -2.0, 1.0])
    direction = np.array([0.3, -0.2, 0.4])
    refer(x, direction, 0.0)
    m.rate[:] = rate + np.array(x.gyro_bias)
    for _ in range(250):
        load().align.integrate(x, m, dt)
    expected = so3.rotate(so3.exp(-rate), direction)
    # third order: (2.7 rad/s 4 ms)^3 / 6 a sample
    np.testing.assert_allclose(x.alignment.reference.direction_b, expected, atol=250 * 2e-7)


def flown(seconds: float, north: bool, accel: float = 3.0) -> tuple[State, Scratch, np.ndarray]:
    """Return a state that flies and turns between two fixes, with the last one; its attitude."""
    x, k, w, m, dt = levelling(), settings(), Scratch(), Motion(), 0.005
    q, velocity, rate = so3.exp(np.array([0.3, -0.2, 1.0])), np.zeros(3), np.array([0.2, 0.1, -0.5])
    w.fix.std[2], w.fix.vel_n[:] = 0.05, velocity
    x.gyro_bias[:], x.accel_bias[:] = [0.02, -0.01, 0.01], [0.5, -0.4, 0.3]
    load().rest.begin_window(x, x.t)
    load().align.begin_motion(x, w.fix)
    forward = np.array([1.0, 0.0, 0.0])
    if north:
        azimuth = np.arctan2(*so3.rotate(q, forward)[1::-1])
        refer(x, forward, float(azimuth))
    for n in range(round(seconds / dt)):
        accel_n = accel * np.array([1.0, 0.5 * np.sin(n * dt), -0.2])
        middle = so3.multiply(q, so3.exp(0.5 * dt * rate))
        force = so3.rotate(so3.conjugate(middle), accel_n - k.gravity * DOWN)
        m.rate[:], m.force[:] = rate + x.gyro_bias, force + x.accel_bias
        x.accel[:], x.gyro[:] = m.force, m.rate
        load().align.integrate(x, m, dt)
        q, velocity = so3.multiply(q, so3.exp(dt * rate)), velocity + dt * accel_n
        x.t += dt * 1e9
        if n == 0:
            x.alignment.motion.force[:] = m.force
    if north:
        r = x.alignment.reference
        forward_n = so3.rotate(q, np.array(r.direction_b))
        r.t, r.azimuth = x.t, float(np.arctan2(forward_n[1], forward_n[0]))
    w.fix.vel_n[:] = velocity
    return x, w, q


def test_down_is_found_in_accelerated_flight_that_has_a_heading():
    x, w, true = flown(2.0, north=True)
    tilt = load().align.find_down(x, settings(), w)
    error = so3.log(so3.multiply(np.array(x.q_nb), so3.conjugate(true)))
    assert 0.0 < tilt < 0.3
    found = np.array(x.q_nb)
    # a climb that nobody has measured hardly tilts, but is not known
    w.fix.vel_n[2] = np.nan
    assert load().align.find_down(x, settings(), w) > tilt
    x.q_nb[:] = found
    # a level force would have been 17 degrees off; 5 ms steps, and four rounds for north
    np.testing.assert_allclose(error, 0.0, atol=5e-3)


def test_without_a_heading_only_a_steady_flight_is_levelled_in():
    x, w, true = flown(2.0, north=False, accel=0.02)
    assert load().align.find_down(x, settings(), w) > 0.0
    q = np.array(x.q_nb)
    up = so3.rotate(q, so3.rotate(so3.conjugate(true), -DOWN))
    np.testing.assert_allclose(up[:2], 0.0, atol=5e-3)  # 0.02 m/s^2 is taken for tilt
    x, w, _ = flown(2.0, north=False)
    assert load().align.find_down(x, settings(), w) == 0.0


@pytest.mark.parametrize(("share", "is_found"), [(0.98, False), (1.02, True)])
def test_down_is_found_after_the_time_to_align(share, is_found):
    x, w, _ = flown(share * settings().align_time, north=True)
    assert (load().align.find_down(x, settings(), w) > 0.0) == is_found


def test_a_stretch_that_became_too_long_begins_anew():
    x, w, _ = flown(1.0, north=True)
    x.t += 5e9
    assert load().align.find_down(x, settings(), w) == 0.0
    assert x.alignment.motion.fix_t == x.t
    assert not any(x.alignment.motion.dv)


@pytest.mark.parametrize(("age", "is_known"), [(1.4, True), (1.6, False)])
def test_a_reference_is_used_while_it_is_fresh(age, is_known):
    x = levelling()
    refer(x, np.array([1.0, 0.0, 0.0]), 0.3)
    x.t += age * 1e9
    assert bool(load().align.has_reference(x)) == is_known


@pytest.mark.parametrize("wrong", [-2.0, 0.3, 3.0])
def test_the_field_of_the_place_shows_the_turn_about_a_leaning_force(wrong):
    x, w = levelling(), Scratch()
    true = so3.exp(np.array([0.4, -0.3, 1.0]))
    field = np.array([0.2, 0.02, 0.43])
    refer(x, so3.rotate(so3.conjugate(true), field), 0.0)
    x.azimuth, x.field.strength = Azimuth.FIELD, float(np.linalg.norm(field))
    x.field.inclination = np.arcsin(field[2] / x.field.strength)
    x.field.declination = np.arctan2(field[1], field[0])
    axis = np.array([0.3, -0.2, -0.9])
    axis /= np.linalg.norm(axis)
    w.pair.n[:] = axis
    x.q_nb[:] = so3.multiply(so3.exp(wrong * axis), true)
    variance = load().align.turn_to_field(x, w, w.pair)
    # what moves the field as far as an error of its azimuth does
    ratio = np.linalg.norm(np.cross(DOWN, field)) / np.linalg.norm(np.cross(axis, field))
    assert variance == pytest.approx(2.0 * (0.02 * ratio) ** 2)
    error = so3.log(so3.multiply(np.array(x.q_nb), so3.conjugate(true)))
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


@pytest.mark.parametrize("north", [True, False])
@pytest.mark.parametrize(("spread", "scale"), [(0.0, 1.0), (0.5, None), (50.0, 300.0)])
def test_vibration_raises_the_inertial_noise_scale_that_a_flight_begins_with(north, spread, scale):
    """As a slow wave of a fifth of it, which pushes to one side for 1.6 s."""
    x, w, _ = flown(2.0, north=north, accel=3.0 if north else 0.02)
    x.alignment.rest.n, x.alignment.rest.accel2[2] = 10.0, 10.0 * spread**2
    x.doubt = 1.0
    # a large spread may leave no attitude to begin with, if nothing gives north
    is_found = load().align.level_in_motion(x, settings(), w)
    assert is_found == north
    if x.mode == Mode.ATTITUDE:
        pushed = 1.6 * (0.2 * spread / settings().accel_noise) ** 2
        assert x.doubt == pytest.approx(pushed if scale is None else scale)


def test_a_running_filter_that_levels_again_keeps_its_velocity():
    x, w, true = flown(2.0, north=True)
    x.mode, x.heading_offset, x.P[E_HEADING][E_HEADING] = Mode.NAVIGATE, 0.3, 1e-6
    x.vel_n[:], x.P[E_VEL][E_VEL] = [5.0, 1.0, 0.0], 0.3
    assert load().align.level_again(x, settings(), w)
    assert (list(x.vel_n), x.P[E_VEL][E_VEL], x.heading_offset) == ([5.0, 1.0, 0.0], 0.3, 0.0)
    error = so3.log(so3.multiply(np.array(x.q_nb), so3.conjugate(true)))
    np.testing.assert_allclose(error, 0.0, atol=5e-3)
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(np.pi**2 / 3.0, rel=1e-3)
    assert x.P[E_HEADING][E_HEADING] == pytest.approx(0.02**2)
