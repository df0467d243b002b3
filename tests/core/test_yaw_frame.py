"""The yaw bank's frame: what it sums over an interval, and when it begins anew."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Motion, YawUpdate
from ekf_companion.core.memory.state import YawBank
from ekf_companion.nav import so3
from tests.core.interpreted import load
from tests.core.states import a_state, array, some_parameters

GRAVITY = 9.80665
RATE, FORCE = (0.4, -0.8, 0.3), (1.5, -2.0, -9.0)


def begun() -> YawBank:
    b = YawBank()
    load().yaw_frame.restart(b)
    return b


def carry(b: YawBank, dt: float, rate=RATE, force=FORCE) -> None:
    m = Motion()
    m.rate[:], m.force[:] = rate, force
    load().yaw_frame.integrate(b, m, dt)


@pytest.mark.parametrize("angle", [1e-9, 1e-3, 0.19, 0.21, 2.0])
def test_a_small_turn_by_its_series_is_the_same_rotation_as_a_large_one(angle):
    """On both sides of 0.2 rad."""
    q = so3.exp(np.array([0.4, -0.3, 2.0]))
    turn = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    expected = so3.multiply(q, so3.exp(turn))
    load().yaw_frame.rotate_frame(q, *turn)
    np.testing.assert_allclose(q, expected, atol=1e-8)


def test_a_norm_that_rounding_has_spoilt_returns_to_one():
    q = np.array([1.0, 0.0, 0.0, 0.0]) * (1.0 + 1e-7)
    for _ in range(3):
        load().yaw_frame.rotate_frame(q, 1e-3, 2e-3, -1e-3)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("axis", range(3))
def test_the_summed_turn_is_what_an_error_of_the_bias_does_to_the_frame(axis):
    ends, error = [], 1e-5
    for bias in (0.0, error):
        b = begun()
        b.gyro_bias[axis] = bias
        for _ in range(200):
            carry(b, 0.002)
        ends.append(b)
    without, with_error = (np.array(b.q_sb) for b in ends)
    turned = so3.log(so3.multiply(with_error, so3.conjugate(without)))
    # taken at the start of each sample: half of 0.9 rad/s 2 ms
    expected = -error * array(ends[0].sums.turn)[:, axis]
    np.testing.assert_allclose(turned, expected, atol=2e-3 * error)


def test_the_force_turns_with_the_body_within_a_sample():
    """Against a thousand steps of the midpoint rule."""
    b, dt, steps = begun(), 0.02, 1000
    carry(b, dt)
    middle = (np.arange(steps) + 0.5) * dt / steps
    turned = [so3.rotate(so3.exp(np.array(RATE) * t), np.array(FORCE)) for t in middle]
    # second order: (0.9 rad/s 0.02 s)^2 / 6 of 9 m/s^2
    np.testing.assert_allclose(b.sums.dv, dt * np.mean(turned, axis=0), atol=dt * 1e-3)


@pytest.mark.parametrize(("is_running", "kept"), [(0.0, 0.5), (1.0, 1.0)])
def test_the_mean_force_is_kept_for_two_seconds_while_up_is_being_found(is_running, kept):
    b = begun()
    b.is_running = is_running
    for _ in range(8):
        carry(b, 0.25, (0.0, 0.0, 0.0))
    assert b.sums.dt == 2.0
    carry(b, 0.25, (0.0, 0.0, 0.0))
    assert b.sums.dt == 2.25 * kept
    np.testing.assert_allclose(np.array(b.sums.dv) / b.sums.dt, FORCE, rtol=1e-14)
    np.testing.assert_allclose(array(b.sums.turn) / b.sums.dt, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("rate", "force", "is_lost"),
    [
        ((19.9, 0.0, 0.0), FORCE, False),
        ((15.0, 0.0, 15.0), FORCE, True),  # 21 rad/s in all
        (RATE, (0.0, 0.0, -59.9), False),
        (RATE, (0.0, 50.0, -50.0), True),  # 71 m/s^2 in all
    ],
)
def test_a_shock_loses_all_but_the_bias(rate, force, is_lost):
    b = begun()
    b.is_running, b.good, b.yaw, b.yaw_std, b.gyro_bias[1] = 1.0, 5.0, 2.0, 0.1, 0.01
    carry(b, 0.004)
    carry(b, 0.004, rate, force)
    assert bool(b.is_running) != is_lost
    assert (b.good, b.yaw) == ((0.0, 0.0) if is_lost else (5.0, 2.0))
    assert (b.yaw_std > np.pi / np.sqrt(3.0)) == is_lost  # that of any angle
    assert b.sums.dt == pytest.approx(0.004 if is_lost else 0.008)
    assert list(b.gyro_bias) == [0.0, 0.01, 0.0]


@pytest.mark.parametrize("up", [(0.3, -0.8, -0.5), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
def test_levelling_turns_about_a_level_axis(up):
    """So that it changes no more than it must: the frame keeps its heading."""
    b = begun()
    b.sums.dv[:] = GRAVITY * np.array(up) / np.linalg.norm(up)
    load().yaw_frame.level(b)
    q = np.array(b.q_sb)
    np.testing.assert_allclose(so3.rotate(q, np.array(b.sums.dv)), [0.0, 0.0, -GRAVITY], atol=1e-14)
    assert q[3] == pytest.approx(0.0, abs=1e-15)


def test_the_acceleration_follows_within_50_ms():
    b, dt = begun(), 1e-4
    for _ in range(500):
        carry(b, dt, (0.0, 0.0, 0.0))
    share = 1.0 - np.exp(-1.0)
    # steps of a five-hundredth of the time constant
    np.testing.assert_allclose(b.accel, share * np.array(FORCE[:2]), rtol=2e-3)


def test_the_antenna_s_velocity_is_the_rate_across_the_lever_arm():
    x, k, u = a_state(2), some_parameters(), YawUpdate()
    x.yaw_bank.q_sb[:] = so3.exp(np.array([0.2, -0.4, 1.0]))
    x.yaw_bank.gyro_bias[:] = [0.1, 0.2, -0.3]
    load().yaw_frame.lever_arm_velocity(x, k, u)
    rate = np.array(x.gyro) - [0.1, 0.2, -0.3]
    arm = so3.rotate(np.array(x.yaw_bank.q_sb), np.cross(rate, np.array(k.lever_arm_b)))
    np.testing.assert_allclose(u.arm_vel, arm[:2], rtol=1e-12)
