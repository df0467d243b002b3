"""An inertial interval: its mean motion, the advance in parts, and what a gap makes uncertain."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_ATT, E_BA, E_BG, E_POS, E_VEL, Mode, NeedsReset
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import ImuRow, Motion, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.nav.inertial_pair import UNKNOWN
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy, minus, some_parameters

CORRELATION_TIME = 0.4
FORCE_STD = 6.7
DT = 0.01
BEFORE = np.array([0.4, -0.8, 0.3, 1.5, -2.0, -9.0])
AFTER = np.array([0.6, -0.5, 0.1, 1.0, -1.0, -11.0])


def a_sample(values: np.ndarray) -> ImuRow:
    row = ImuRow()
    row.gyro[:], row.accel[:] = values[:3], values[3:]
    return row


def begun(mode: Mode = Mode.NAVIGATE) -> State:
    """Return a state that had a sample at its time."""
    x = a_state(1)
    x.t, x.dt, x.samples, x.mode = 100e9, DT, 50.0, mode
    x.gyro[:], x.accel[:] = BEFORE[:3], BEFORE[3:]
    load().past.forget(x)
    load().yaw_frame.restart(x.yaw_bank)
    return x


def parameters(is_mean: bool = True) -> Parameters:
    k = some_parameters()
    k.gap, k.gap_reset, k.mean_samples = 0.15, 1.0, float(is_mean)
    return k


def motion(span: float, is_mean: bool = True, after: np.ndarray = AFTER) -> Motion:
    """Return the motion that is taken for an interval."""
    m = Motion()
    k = parameters(is_mean)
    load().interval.find_interval_motion(begun(), k, m, a_sample(after), span)
    return m


@pytest.mark.parametrize(
    ("is_mean", "span", "expected", "has_slope"),
    [
        (True, 0.0149, AFTER, True),
        (True, 0.0151, 0.5 * (BEFORE + AFTER), False),  # one is missing
        (False, 0.0149, 0.5 * (BEFORE + AFTER), True),
        (False, 0.0151, 0.5 * (BEFORE + AFTER), False),
    ],
)
def test_a_mean_stands_for_its_interval_and_a_reading_for_its_end(
    is_mean, span, expected, has_slope
):
    m = motion(span, is_mean)
    np.testing.assert_allclose(m.mean, expected)
    slopes = [*m.rate_slope, *m.force_slope]
    np.testing.assert_allclose(slopes, has_slope * (AFTER - BEFORE) / span)


def covariance(times: np.ndarray) -> np.ndarray:
    """Return that of a Gauss-Markov process of unit variance at these times."""
    return np.exp(-np.abs(times[:, None] - times) / CORRELATION_TIME)


def integral_between(span: float) -> tuple[float, float]:
    """Return weight of each end in the mean over a gap, and the variance of the integral.

    The process is conditioned on its values at both ends, on a grid.
    """
    n = 1000
    inner = (np.arange(n) + 0.5) * span / n
    C = covariance(np.array([0.0, span, *inner]))
    gain = C[2:, :2] @ np.linalg.inv(C[:2, :2])
    left = C[2:, 2:] - gain @ C[:2, 2:]
    return gain.mean(axis=0)[0], left.sum() * (span / n) ** 2


@pytest.mark.parametrize("span", [0.16, 0.5, 2.0])
def test_over_a_gap_both_ends_count_by_how_far_they_reach(span):
    m, x = motion(span), begun()
    share, _ = integral_between(span)
    up_b = array(m.C_nb)[2]
    rest = np.array([*x.gyro_bias, *(np.array(x.accel_bias) - 9.8 * up_b)])
    expected = rest + share * (BEFORE + AFTER - 2.0 * rest)
    np.testing.assert_allclose(m.mean, expected, rtol=1e-5)
    assert not any([*m.rate_slope, *m.force_slope])


def test_what_turns_by_two_radians_between_samples_is_not_followed():
    """Such a rate says nothing of where it points to afterwards."""
    for rate, is_followed in ((19.9, True), (20.1, False)):
        m = motion(0.1, after=np.array([0.0, 0.0, rate, 0.0, 0.0, -9.8]))
        assert (m.mean[2] > 1.0) == is_followed
    np.testing.assert_allclose(m.mean[:3], begun().gyro_bias)


def test_the_rate_that_the_ends_of_a_gap_show_is_their_rms():
    rate = load().interval.shown_rate(begun(), a_sample(AFTER))
    assert rate == pytest.approx(np.sqrt(np.mean([BEFORE[:3] ** 2, AFTER[:3] ** 2])))


@pytest.mark.parametrize(
    ("span", "shown", "rate"), [(0.05, 0.9, 0.9), (0.2, 0.6, 0.6), (0.3, 0.1, 0.5)]
)
def test_a_gap_adds_what_a_gauss_markov_process_may_have_done_between_its_ends(span, shown, rate):
    """A vehicle is flown hard, whatever calm the ends show."""
    x = begun()
    load().interval.inflate_after_gap(x, parameters(), span, shown, True)
    _, variance = integral_between(span)
    added = np.diag(array(x.P))
    np.testing.assert_allclose(added[E_ATT : E_ATT + 3], rate**2 * variance, rtol=1e-3)
    gained = FORCE_STD**2 * variance
    np.testing.assert_allclose(added[E_VEL : E_VEL + 3], gained, rtol=1e-3)
    np.testing.assert_allclose(added[E_POS : E_POS + 3], 0.25 * span**2 * gained, rtol=1e-3)
    assert not added[E_BG:].any()


def test_a_long_gap_leaves_tilt_and_speed_bounded():
    x = begun()
    load().interval.inflate_after_gap(x, parameters(), 1e4, 5.0, True)
    np.testing.assert_allclose(np.diag(array(x.P))[:6], [0.25, 0.25, 1.8**2, 400, 400, 400])


@pytest.mark.parametrize(
    ("span", "is_gap", "mode", "needs"),
    [
        (0.99, True, Mode.NAVIGATE, NeedsReset.NOTHING),
        (1.01, True, Mode.NAVIGATE, NeedsReset.FIX),
        (1.01, True, Mode.ATTITUDE, NeedsReset.NOTHING),
        (1.01, False, Mode.NAVIGATE, NeedsReset.NOTHING),  # a stream that is always as slow
    ],
)
def test_only_after_a_long_gap_a_fix_must_reset_the_state(span, is_gap, mode, needs):
    x = begun(mode)
    x.alignment.reference.is_known = x.alignment.motion.has_fix = 1.0
    load().interval.inflate_after_gap(x, parameters(), span, 0.5, is_gap)
    assert x.needs_reset == needs
    assert bool(x.alignment.reference.is_known) == (needs == NeedsReset.NOTHING)
    assert x.gaps == is_gap


def test_an_interval_in_parts_is_the_same_motion():
    """An event within an interval divides it."""
    span, k = 0.008, parameters()
    k.gyro_noise = 1e-3
    ends = []
    for parts in ([1.0], [0.3, 0.35, 1.0]):
        x, w = begun(), Scratch()
        begin = x.t
        load().interval.find_interval_motion(x, k, w.motion, a_sample(AFTER), span)
        for part in parts:
            load().interval.advance(x, k, w, begin + part * span * 1e9, begin, span)
        assert x.t == begin + span * 1e9
        ends.append(x)
    whole, divided = ends
    error = np.abs(minus(divided, whole))
    # coning over 8 ms: a change of 0.3 rad/s across 0.9 rad/s, a twelfth
    assert error[:3].max() < 1e-5
    assert error[E_VEL : E_VEL + 3].max() < 1e-4
    assert error[E_POS:].max() < 1e-6


def test_a_part_of_an_interval_has_the_mean_of_that_part():
    x, k, w, span = begun(), parameters(), Scratch(), 0.008
    load().interval.find_interval_motion(x, k, w.motion, a_sample(AFTER), span)
    load().interval.advance(x, k, w, x.t + 0.3e9 * span, x.t, span)
    # its middle is at 0.15 of the interval, and AFTER at 0.5
    expected = AFTER - 0.35 * (AFTER - BEFORE)
    np.testing.assert_allclose([*w.motion.rate, *w.motion.force], expected)


def test_the_covariance_follows_every_10_ms_and_at_each_sample_that_does_not_measure():
    def carried(clipped: float) -> list[bool]:
        x, k, w = begun(), parameters(), Scratch()
        k.accel_noise, x.unmeasured[0] = 0.1, clipped
        found = []
        for _ in range(4):
            before = copy(x)
            load().interval.advance(x, k, w, x.t + 4e6, x.t, 0.004)
            found.append(not np.array_equal(array(x.P), array(before.P)))
        return found

    assert carried(0.0) == [False, False, True, False]
    assert carried(1.0) == [True] * 4


@pytest.mark.parametrize("needs", [NeedsReset.NOTHING, NeedsReset.FIX, NeedsReset.TILT])
def test_after_a_long_gap_the_reference_is_carried_on_beside_the_state(needs):
    x, k, w = begun(), parameters(), Scratch()
    x.needs_reset, x.alignment.reference.is_known = needs, 1.0
    x.alignment.reference.direction_b[:] = [1.0, 0.0, 0.0]
    w.motion.mean[:] = BEFORE
    q = list(x.q_nb)
    load().interval.advance(x, k, w, x.t + 1e7, x.t, DT)
    assert list(x.q_nb) != q
    assert (x.alignment.reference.direction_b[1] != 0.0) == (needs != NeedsReset.NOTHING)


def test_while_levelling_nothing_but_the_reference_moves():
    x, k, w = begun(Mode.LEVEL), parameters(), Scratch()
    x.alignment.reference.is_known = 1.0
    x.alignment.reference.direction_b[:] = [1.0, 0.0, 0.0]
    w.motion.mean[:] = BEFORE
    before = copy(x)
    load().interval.advance(x, k, w, x.t + 1e7, x.t, DT)
    np.testing.assert_allclose(minus(x, before), 0.0, atol=1e-15)
    # as the body turns to the right, what stands still turns to the left
    turned = DT * (x.gyro_bias[2] - BEFORE[2])
    assert x.alignment.reference.direction_b[1] == pytest.approx(turned, rel=1e-2)


def test_another_unit_makes_biases_attitude_and_velocity_as_uncertain_as_it_says():
    x, k = begun(), parameters()
    k.gyro_bias_std, k.accel_bias_std = 0.02, 0.2
    before = array(x.P).copy()
    imu = a_sample(AFTER)
    imu.gyro_std, imu.accel_std, imu.turned, imu.gained = 0.003, 0.7, 0.01, 0.2
    load().interval.inflate_after_change(x, k, imu)
    added = np.diagonal(array(x.P) - before)
    for first, sigma in ((E_BG, 0.003), (E_BA, 0.7), (E_ATT, 0.01), (E_VEL, 0.2), (E_POS, 0.0)):
        np.testing.assert_allclose(added[first : first + 3], sigma**2, atol=1e-12)
    # Of a unit of which nothing is known the biases are those of a start
    x = begun()
    before = array(x.P).copy()
    imu.gyro_std = imu.accel_std = UNKNOWN
    load().interval.inflate_after_change(x, k, imu)
    added = np.diagonal(array(x.P) - before)
    np.testing.assert_allclose(added[[E_BG, E_BA]], [0.02**2, 0.2**2])
