"""When the bank's heading is used, and what becomes of a compass that lies."""

import numpy as np
import pytest

from ekf_companion.core.memory.state import State
from ekf_companion.nav import so3
from tests.core.interpreted import load


def a_state(error: float, std: float = 0.05) -> State:
    """Return a filter whose yaw is wrong by an error of which its bank knows."""
    x = State(t=100e9)
    b = x.yaw_bank
    true = so3.exp(np.array([0.4, -0.3, 2.0]))
    b.yaw, b.yaw_std, b.good, b.failing_t = -1.1, std, 5.0, 100e9
    b.q_sb[:] = so3.multiply(so3.exp(np.array([0.0, 0.0, -b.yaw])), true)
    x.q_nb[:] = so3.multiply(so3.exp(np.array([0.0, 0.0, -error])), true)
    return x


@pytest.mark.parametrize("error", [-3.0, -0.5, 0.0, 0.2, 1.5, 3.1])
def test_the_yaw_error_is_the_turn_about_down_in_any_attitude(error):
    assert load().yaw_reset.yaw_error(a_state(error)) == pytest.approx(error, abs=1e-12)


def test_the_banks_attitude_leaves_no_yaw_error():
    x = a_state(2.5)
    x.yaw_bank.gyro_bias[:] = [0.01, 0.02, 0.03]
    load().yaw_reset.take_attitude(x)
    assert load().yaw_reset.yaw_error(x) == pytest.approx(0.0, abs=1e-12)
    assert list(x.gyro_bias) == [0.01, 0.02, 0.03]


def asked(x: State, seconds: float, nis: float = 20.0, std: float = 0.1) -> bool:
    """Judge five velocities a second of this normalised innovation squared."""
    is_needed = False
    for _ in range(round(5.0 * seconds)):
        x.t += 0.2e9
        is_needed = load().yaw_reset.is_needed(x, nis, 0.2, std)
    return is_needed


def test_a_filter_that_velocities_contradict_for_long_enough_is_put_right():
    assert not asked(a_state(3.0), 0.8)
    assert asked(a_state(3.0), 2.0)


@pytest.mark.parametrize(
    ("change", "options"),
    [
        ({}, {"nis": 3.0}),  # velocities agree
        ({}, {"std": 0.8}),  # the receiver is not sure itself
        ({"good": 4.0}, {}),  # the bank is not sure
        ({"repairs": 3.0}, {}),  # enough is enough
        ({"repairs": 1.0, "repair_t": 98e9}, {}),  # too soon
        ({"yaw_std": 1.05}, {}),  # three sigma hold the difference
    ],
)
def test_one_condition_that_does_not_hold_is_enough_to_leave_it_alone(change, options):
    x = a_state(3.0)
    for name, value in change.items():
        setattr(x.yaw_bank, name, value)
    assert not asked(x, 2.0, **options)


def test_a_small_error_is_left_to_the_filter():
    assert not asked(a_state(0.25, std=0.01), 2.0)
    assert asked(a_state(0.28, std=0.01), 2.0)


def test_one_good_velocity_does_not_hide_many_bad_ones():
    x = a_state(3.0)
    asked(x, 2.0)
    x.t += 0.2e9
    assert load().yaw_reset.is_needed(x, 0.5, 0.2, 0.1)


def test_a_compass_that_lies_is_as_wrong_as_it_was_seen_to_be():
    x = State()
    slow_error = load().yaw_reset.slow_error
    x.heading_offset = 0.1
    assert slow_error(x, 0.05) == 0.05
    x.heading_offset = -0.8
    assert slow_error(x, 0.05) == pytest.approx(0.8)
    x.heading_offset = 2.0 * np.pi + 0.02  # once round
    assert slow_error(x, 0.05) == 0.05
    assert x.heading_offset == pytest.approx(0.02)
    x.heading_offset = 3.1
    assert slow_error(x, 0.05) == pytest.approx(np.pi / np.sqrt(3.0))
