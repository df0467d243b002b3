"""What of a flight's knowledge outlives a reboot of the autopilot."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BA, E_BG, E_DELAY, E_IRON, N
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load
from tests.core.states import a_state, array

NAN = float("nan")


def some_parameters(keeps_bias: float = 1.0) -> Parameters:
    k = Parameters(gyro_bias_std=0.02, accel_bias_std=0.3, iron_std=0.1, delay_std=0.05)
    k.keeps_bias, k.gyro_bias_walk, k.accel_bias_walk = keeps_bias, 1e-4, 2e-3
    return k


def flown(armed: float = 1.0, landed: float = 0.0) -> State:
    """Return a state that knows its biases better than at first."""
    y = a_state(3)
    y.armed, y.landed = armed, landed
    array(y.P)[:] = 1e-6 * np.eye(N)
    y.gyro_bias[:], y.accel_bias[:] = [0.01, -0.02, 0.03], [0.1, -0.2, 0.3]
    return y


def carried(y: State, keeps_bias: float = 1.0) -> State:
    x = State()
    load().reboot.carry_over(x, y, some_parameters(keeps_bias))
    return x


@pytest.mark.parametrize(
    ("armed", "landed", "keeps_bias", "is_kept"),
    [
        (1.0, 0.0, 1.0, True),
        (1.0, NAN, 1.0, True),  # an autopilot that does not report that it has landed
        (1.0, 1.0, 1.0, False),
        (0.0, 0.0, 1.0, False),
        (NAN, NAN, 1.0, False),
        (1.0, 0.0, 0.0, False),
    ],
)
def test_the_gyro_s_bias_is_kept_in_flight_only(armed, landed, keeps_bias, is_kept):
    """On the ground the autopilot calibrates the gyro as it starts."""
    x = carried(flown(armed, landed), keeps_bias)
    assert list(x.gyro_bias) == ([0.01, -0.02, 0.03] if is_kept else [0.0] * 3)
    assert (x.P[E_BG][E_BG] > 0.0) == is_kept


@pytest.mark.parametrize("keeps_bias", [0.0, 1.0])
def test_the_accelerometer_s_bias_is_kept_but_a_guess_is_no_surer_than_at_a_start(keeps_bias):
    x = carried(flown(armed=0.0), keeps_bias)
    assert list(x.accel_bias) == [0.1, -0.2, 0.3]
    assert (x.P[E_BA + 2][E_BA + 2] > 0.0) == bool(keeps_bias)


def test_a_bias_has_walked_for_100_s_meanwhile():
    x = carried(flown())
    variances = np.diag(array(x.P))
    np.testing.assert_allclose(variances[E_BG : E_BG + 3], 1e-6 + (1e-4 * 10.0) ** 2)
    np.testing.assert_allclose(variances[E_BA : E_BA + 3], 1e-6 + (2e-3 * 10.0) ** 2)
    # what is not the autopilot's has not changed
    np.testing.assert_array_equal(variances[E_IRON : E_IRON + 3], 1e-6)
    assert variances[E_DELAY] == 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_was_learnt_is_kept_within_two_sigmas_of_what_is_usual(sign):
    y = flown()
    y.gyro_bias[:], y.accel_bias[:] = [sign * 0.5] * 3, [sign * 5.0] * 3
    y.hard_iron[:] = [sign * 0.15, sign * 0.3, 0.0]
    y.first_delay, y.gnss_delay = 0.04, 0.04 + sign * 0.2
    x = carried(y)
    np.testing.assert_allclose(x.gyro_bias, sign * 0.04)
    np.testing.assert_allclose(x.accel_bias, sign * 0.6)
    np.testing.assert_allclose(x.hard_iron, [sign * 0.15, sign * 0.2, 0.0])
    # the delay about its first guess
    assert x.gnss_delay == pytest.approx(0.04 + sign * 0.1)
    assert x.first_delay == 0.04
    y.gnss_delay = 0.04 + sign * 0.05
    assert carried(y).gnss_delay == pytest.approx(y.gnss_delay)


def test_the_motion_is_not_kept():
    x, new = carried(flown()), State()
    for name in ("q_nb", "vel_n", "pos_n", "gnss_offset", "gnss_vel_offset", "gyro", "accel_n"):
        assert list(getattr(x, name)) == list(getattr(new, name)), name
    assert (x.mode, x.has_yaw, x.heading_offset, x.baro_offset) == (0.0, 0.0, 0.0, 0.0)
    kept = {*range(E_BG, E_BG + 3), *range(E_BA, E_BA + 3), *range(E_IRON, E_IRON + 3), E_DELAY}
    assert set(np.flatnonzero(array(x.P).any(axis=0)).tolist()) == kept
