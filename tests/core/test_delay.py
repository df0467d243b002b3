"""How late fixes are, learnt from what the receiver's velocity and ours gain between two."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_ATT, E_BA, E_BG, E_DELAY
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Fix, Observation, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import so3
from tests.core.interpreted import load

STD = 0.08
"""One sigma of a delay that nothing is known of, s."""
NOISE = 0.1
"""Of the receiver's velocity, m/s."""


def settings() -> Parameters:
    k = as_parameters(parameters(FilterSettings(), "unknown"))
    k.delay_std, k.told_delay_std, k.unset_delay, k.gnss_delay = STD, 0.02, 0.22, 0.1
    k.lever_arm_b[:] = [0.0] * 3
    return k


def begun() -> State:
    x = State()
    load().restart.start(x, 0.0)
    x.q_nb[:] = so3.exp(np.array([0.1, -0.2, 1.0]))
    x.dt, x.fix_dt, x.doubt = 0.01, 0.2, 0.0
    x.P[E_DELAY][E_DELAY] = STD**2
    return x


def swaying(t: float) -> np.ndarray:
    """Return the velocity of a vehicle that changes its acceleration all the time, m/s."""
    return np.array([2.5 * np.sin(2.0 * t), 2.5 * np.sin(1.6 * t + 1.0), 0.0])


def speeding_up(t: float) -> np.ndarray:
    return np.array([1.5 * t, -0.5 * t, 0.0])


def fly(seconds: float, late: float, velocity=swaying, seed: int = 1, noise=NOISE, sampled=0.0):
    """Return what fixes at 5 Hz, true some time before their stamps, have taught of their delay."""
    x, k, w, fix = begun(), settings(), Scratch(), Fix()
    rng = np.random.default_rng(seed)
    x.noise[3:] = [sampled] * 3
    fix.stated_var[2] = NOISE**2
    for n in range(round(seconds / x.dt)):
        t = n * x.dt
        x.t = t * 1e9
        x.past.gained[:] = velocity(t) - velocity(0.0)
        x.accel_n[:] = (velocity(t + 1e-4) - velocity(t - 1e-4)) / 2e-4
        load().past.keep_velocity(x)
        if n % 20 == 0:
            fix.vel_n[:] = velocity(t - late) + noise * rng.standard_normal(3)
            load().delay.keep_fix(x, k, fix, w.observation)
        if load().delay.is_due(x):
            load().delay.learn(x, k, w)
    return x


@pytest.mark.parametrize("late", [0.0, 0.05, 0.15])
def test_a_delay_is_found_from_a_changing_acceleration(late):
    x = fly(60.0, late, noise=1e-3)
    assert x.gnss_delay == pytest.approx(late, abs=0.005)
    assert x.P[E_DELAY][E_DELAY] < (0.3 * STD) ** 2


def test_the_delay_is_as_certain_as_it_is_said_to_be():
    errors = []
    for seed in range(12):
        late = float(np.random.default_rng(100 + seed).normal(0.0, STD))
        x = fly(25.0, late, seed=seed)
        errors.append((x.gnss_delay - late) ** 2 / x.P[E_DELAY][E_DELAY])
    # chi-square of 12, 0.001 and 0.999; the noise of gains is counted twice, on purpose
    assert 0.5 * 2.21 / 12.0 < np.mean(errors) < 32.9 / 12.0


@pytest.mark.parametrize(
    ("velocity", "sampled"),
    [
        (speeding_up, 0.0),  # which tilt and biases explain as well
        (swaying, 20.0),  # all of the change may be noise of the samples
    ],
)
def test_what_shows_no_delay_moves_none(velocity, sampled):
    x = fly(20.0, 0.15, velocity, sampled=sampled)
    assert x.gnss_delay == pytest.approx(0.0, abs=1e-9)
    assert x.P[E_DELAY][E_DELAY] == pytest.approx(STD**2)


@pytest.mark.parametrize(("density", "share"), [(0.0, 1.0), (0.046875, 0.5), (0.1, 0.0)])
def test_of_a_change_of_acceleration_the_noise_of_the_samples_is_no_knowledge(density, share):
    """An acceleration is a mean over 0.12 s; the change is a mean over eight pairs of fixes."""
    x = begun()
    x.noise[3:] = [density] * 3
    x.gain.begin.accel_n[:], x.gain.end.accel_n[:] = [1.0, 2.0], [4.0, -2.0]
    assert load().delay.true_share(x) == pytest.approx(share)
    x.gain.change, x.gain.begin.accel_n[:] = 0.0, [4.0, -2.0]
    assert load().delay.true_share(x) == 0.0


def test_the_noise_of_gains_is_learnt_whatever_the_receiver_states():
    """That of two fixes, per axis."""
    found = [fly(60.0, 0.0, seed=seed, noise=0.3).gain.var for seed in range(4)]
    assert np.mean(found) == pytest.approx(2.0 * 0.3**2, rel=0.3)


def test_a_gain_depends_on_tilt_and_bias_as_the_turned_force_does():
    """Of the east gain, by differences."""
    x, k, o, span = begun(), settings(), Observation(), 1.2
    gain = np.array([3.0, -2.0, 0.0])
    force = gain - [0.0, 0.0, k.gravity * span]
    x.gain.begin.t, x.gain.end.t, x.gain.var = 0.0, span * 1e9, 0.02
    x.gain.end.until[:] = gain[:2]
    x.gain.begin.accel_n[:], x.gain.end.accel_n[:] = [0.5, -1.0], [1.0, 2.0]
    load().delay.compare_gains(x, k, o)
    H, step = np.array(o.H)[0], 1e-6
    C = so3.to_matrix(np.array(x.q_nb))
    for i, axis in enumerate(np.eye(3)):
        ends = [so3.rotate(so3.exp(sign * step * axis), force)[1] for sign in (1.0, -1.0)]
        assert H[E_ATT + i] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-6)
        # a force less its bias
        assert H[E_BA + i] == pytest.approx(-C[1, i] * span)
    # a fix that is older has gained less
    assert H[E_DELAY] == pytest.approx(-3.0)
    assert not H[E_BG : E_BG + 3].any()


def a_gain(z: float) -> tuple[State, Observation]:
    """Return the state after a gain north that is off by some velocity, and its observation."""
    x, o = begun(), Observation()
    x.gain.begin.t, x.gain.end.t, x.gain.var = 0.0, 1e9, 0.02
    x.gain.end.until[0], x.gain.end.vel_n[0] = 2.0, 2.0 + z
    x.gain.begin.accel_n[0], x.gain.end.accel_n[0] = -1.0, 2.0
    load().delay.compare_gains(x, settings(), o)
    return x, o


@pytest.mark.parametrize(("z", "is_used"), [(0.5, True), (-0.5, True), (9.0, False)])
def test_a_gain_that_no_delay_explains_teaches_nothing_but_its_noise(z, is_used):
    x, _ = a_gain(z)
    # more was gained by the receiver while it accelerated: it is less late
    assert np.sign(x.gnss_delay) == (-np.sign(z) if is_used else 0.0)
    assert (x.P[E_DELAY][E_DELAY] < STD**2) == is_used
    assert x.gain.var < 9.0 * 0.02 * 2.0


def test_a_delay_that_was_corrected_meanwhile_makes_no_gain():
    """The begin was looked up by the delay of then; on the way it accelerated steadily."""
    found = []
    for delay in (0.0, 0.05):
        x, o, accel = begun(), Observation(), np.array([2.0, -1.0])
        x.gain.begin.t, x.gain.end.t, x.gain.var = 0.0, 1e9, 0.02
        x.gain.begin.delay, x.gain.begin.until[:] = delay, -delay * accel
        x.gain.begin.accel_n[:] = x.gain.end.accel_n[:] = accel
        x.gain.end.until[:] = accel
        x.gain.end.vel_n[:] = [2.3, -0.9]
        load().delay.compare_gains(x, settings(), o)
        found.append((o.z[0], o.H[0][E_ATT + 2]))
    np.testing.assert_allclose(found, [(0.1, 2.0)] * 2, rtol=1e-9)


def test_gains_are_counted_between_fixes_at_least_0_7_s_apart():
    x, k, fix, o = begun(), settings(), Fix(), Observation()

    def is_kept(after: float) -> bool:
        x.gain.begin.t, x.gain.end.t, x.t = 0.0, -1e18, after * 1e9
        load().delay.keep_fix(x, k, fix, o)
        return x.gain.end.t == x.t

    assert not is_kept(0.69)
    assert is_kept(0.71)
    # one is enough at a time
    x.t += 1e9
    load().delay.keep_fix(x, k, fix, o)
    assert x.gain.end.t == 0.71e9
    x.P[E_DELAY][E_DELAY] = 0.0
    assert not is_kept(0.71)


@pytest.mark.parametrize(
    ("late", "delay", "is_due"),
    [
        (0.05, 0.0, False),
        (0.07, 0.0, True),
        (0.0, 0.07, True),  # it is that old already
        (0.5, -0.5, False),
        (0.61, -0.9, True),  # longer it is not waited for
    ],
)
def test_a_fix_waits_for_the_samples_after_it(late, delay, is_due):
    x = begun()
    assert not load().delay.is_due(x)
    x.gain.end.t, x.t, x.gnss_delay = 1e9, (1.0 + late) * 1e9, delay
    assert load().delay.is_due(x) == is_due


def show(x: State, delay: float, std: float) -> None:
    """Correct the delay by a measurement of it."""
    o = Observation()
    load().observation.clear(o, 1, std**2)
    o.H[0][E_DELAY], o.z[0] = 1.0, delay - x.gnss_delay
    load().update.innovate(x, o)
    load().update.apply_delay_update(x, o)


def test_a_reported_delay_counts_the_same_before_and_after_what_was_learnt():
    k, ends = settings(), []
    for is_early in (True, False):
        x = begun()
        if is_early:
            load().delay.take_told(x, k, 0.15)
            assert x.gnss_delay == pytest.approx(0.05)  # beside the configured one
        show(x, 0.09, 0.03)
        if not is_early:
            load().delay.take_told(x, k, 0.15)
        ends.append((x.gnss_delay, x.P[E_DELAY][E_DELAY], x.first_delay, x.first_delay_var))
    assert ends[0] == pytest.approx(ends[1])
    assert ends[0][1] == pytest.approx(1.0 / (1.0 / 0.02**2 + 1.0 / 0.03**2))


def test_a_reported_delay_that_nobody_has_set_is_a_guess():
    x, k = begun(), settings()
    load().delay.take_told(x, k, k.unset_delay)
    assert (x.gnss_delay, x.P[E_DELAY][E_DELAY]) == pytest.approx((0.12, STD**2))
    y = State()
    load().delay.take_told(y, k, 0.15)  # one that is not estimated
    assert (y.gnss_delay, y.P[E_DELAY][E_DELAY]) == (pytest.approx(0.05), 0.0)
    k.told_delay_std = -1.0  # the user has configured one
    load().delay.take_told(x, k, 0.3)
    assert x.gnss_delay == pytest.approx(0.12)


def test_gains_weigh_less_once_their_noise_is_known_to_be_more():
    x, k = begun(), settings()
    x.gain.shown, x.gain.var = 40.0, 0.02
    variance = 1.0 / (1.0 / STD**2 + 40.0 / (2.0 * 0.02))
    x.P[E_DELAY][E_DELAY], x.gnss_delay = variance, 0.06
    load().delay.weigh_anew(x, k)
    assert (x.gnss_delay, x.P[E_DELAY][E_DELAY]) == pytest.approx((0.06, variance))
    x.gain.var = 0.18
    less = 1.0 / (1.0 / STD**2 + 40.0 / (2.0 * 0.18))
    load().delay.weigh_anew(x, k)
    assert x.P[E_DELAY][E_DELAY] == pytest.approx(less)
    # what they have shown counts by its part of the information; the first guess is zero
    shown = 0.06 / (1.0 - variance / STD**2)
    assert x.gnss_delay == pytest.approx(shown * (1.0 - less / STD**2))
