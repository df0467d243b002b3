"""When the bank's heading is used, and what becomes of a compass that lies."""

import numpy as np
import pytest

from ekf_companion.core import state as at
from ekf_companion.nav import so3
from tests.core.interpreted import load

B = at.X_BANK


def a_block(error: float, std: float = 0.05) -> np.ndarray:
    """Give a filter whose yaw is wrong by an error of which its bank knows."""
    x = np.zeros(at.BLOCK)
    true = so3.exp(np.array([0.4, -0.3, 2.0]))
    frame_yaw = -1.1
    x[B + at.B_YAW] = frame_yaw
    x[B + at.B_Q : B + at.B_Q + 4] = so3.multiply(so3.exp(np.array([0.0, 0.0, -frame_yaw])), true)
    x[at.X_Q : at.X_Q + 4] = so3.multiply(so3.exp(np.array([0.0, 0.0, -error])), true)
    x[B + at.B_STD] = std
    x[B + at.B_GOOD] = 5.0
    x[at.X_T] = 100e9
    x[B + at.B_T_FAIL] = 100e9
    return x


@pytest.mark.parametrize("error", [-3.0, -0.5, 0.0, 0.2, 1.5, 3.1])
def test_the_excess_is_the_turn_about_down_in_any_attitude(error):
    assert load().yaw_reset.excess(a_block(error)) == pytest.approx(error, abs=1e-12)


def test_adopting_leaves_no_excess():
    x = a_block(2.5)
    x[B + at.B_BG : B + at.B_BG + 3] = [0.01, 0.02, 0.03]
    load().yaw_reset.adopt(x)
    assert load().yaw_reset.excess(x) == pytest.approx(0.0, abs=1e-12)
    assert x[at.X_BG : at.X_BG + 3].tolist() == [0.01, 0.02, 0.03]


def asked(x: np.ndarray, seconds: float, nis: float = 20.0, std: float = 0.1) -> bool:
    """Give five velocities a second of this normalised innovation squared."""
    is_needed = False
    for _ in range(round(5.0 * seconds)):
        x[at.X_T] += 0.2e9
        is_needed = load().yaw_reset.is_needed(x, nis, 0.2, std)
    return is_needed


def test_a_filter_that_velocities_contradict_for_long_enough_is_put_right():
    assert not asked(a_block(3.0), 0.8)
    assert asked(a_block(3.0), 2.0)


@pytest.mark.parametrize(
    ("change", "options"),
    [
        ({}, {"nis": 3.0}),  # velocities agree
        ({}, {"std": 0.8}),  # the receiver is not sure itself
        ({at.B_GOOD: 4.0}, {}),  # the bank is not sure
        ({at.B_REPAIRS: 3.0}, {}),  # enough is enough
        ({at.B_REPAIRS: 1.0, at.B_T_REPAIR: 98e9}, {}),  # too soon
        ({at.B_STD: 1.05}, {}),  # three sigma hold the difference
    ],
)
def test_one_condition_that_does_not_hold_is_enough_to_leave_it_alone(change, options):
    x = a_block(3.0)
    for place, value in change.items():
        x[B + place] = value
    assert not asked(x, 2.0, **options)


def test_a_small_error_is_left_to_the_filter():
    assert not asked(a_block(0.25, std=0.01), 2.0)
    assert asked(a_block(0.28, std=0.01), 2.0)


def test_one_good_velocity_does_not_hide_many_bad_ones():
    x = a_block(3.0)
    asked(x, 2.0)
    x[at.X_T] += 0.2e9
    assert load().yaw_reset.is_needed(x, 0.5, 0.2, 0.1)


def test_a_compass_that_lies_is_as_wrong_as_it_was_seen_to_be():
    x = np.zeros(at.BLOCK)
    slow_error = load().yaw_reset.slow_error
    x[at.X_HEADING] = 0.1
    assert slow_error(x, 0.05) == 0.05
    x[at.X_HEADING] = -0.8
    assert slow_error(x, 0.05) == pytest.approx(0.8)
    x[at.X_HEADING] = 2.0 * np.pi + 0.02  # once round
    assert slow_error(x, 0.05) == 0.05
    assert x[at.X_HEADING] == pytest.approx(0.02)
    x[at.X_HEADING] = 3.1
    assert slow_error(x, 0.05) == pytest.approx(np.pi / np.sqrt(3.0))
