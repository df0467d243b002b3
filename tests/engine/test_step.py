"""The step from one estimate to the next that no motion explains."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.engine.step import JumpDetector, Pose, Step, StepMeter
from ekf_companion.nav import so3

DT = 1.0 / 30.0
NOT_AIDED = (0.0, 0.0, 0.0)


def pose(t: float, pos_n, vel_n, angles) -> Pose:
    q = so3.from_euler(*angles)
    return Pose(round(t * 1e9), np.array(pos_n), q, np.array(vel_n))


def circle(t: float) -> tuple[Pose, tuple[float, ...]]:
    """A banked turn of 5 m and 2 rad/s, 20 m/s^2 to the centre; pose and sample at a time."""
    radius, rate, bank = 5.0, 2.0, 1.1
    a = rate * t
    now = pose(
        t,
        (radius * np.cos(a), radius * np.sin(a), -10.0),
        (-radius * rate * np.sin(a), radius * rate * np.cos(a), 0.0),
        (bank, 0.0, a + np.pi / 2),
    )
    force_n = np.array([-radius * rate**2 * np.cos(a), -radius * rate**2 * np.sin(a), -9.81])
    C_nb = so3.to_matrix(now.q_nb)
    gyro = C_nb.T @ np.array([0.0, 0.0, rate])
    return now, (*gyro, *(C_nb.T @ force_n))


def measured(jump=lambda now: now) -> list[Step]:
    """Return the steps at 30 Hz of a second of the turn, of which each pose is changed."""
    meter, steps = StepMeter(), []
    for k in range(240):
        now, sample = circle(k / 240)
        meter.add(sample)
        if k % 8 == 0 and (step := meter.measure(jump(now))) is not None:
            steps.append(step)
    return steps


def test_a_turn_at_two_g_is_motion_and_no_step():
    steps = measured()
    assert len(steps) == 29
    assert all(step.dt == pytest.approx(DT, abs=1e-9) for step in steps)
    assert max(step.sizes[0] for step in steps) < 0.002
    assert max(step.sizes[1] for step in steps) < 0.06
    assert max(step.sizes[2] for step in steps) < 0.001


@pytest.mark.parametrize("is_mean", [True, False])
@pytest.mark.parametrize("rate", [50, 250])
@pytest.mark.parametrize("lag", [0.0, 0.0115])
def test_gusts_that_an_estimate_is_carried_on_by_are_motion_and_no_step(lag, rate, is_mean):
    """30 m/s^2 at 4 Hz, as a fixed wing in turbulence; samples behind a lag, as ArduPilot's are."""
    meter, sizes = StepMeter(lag, is_mean=is_mean), []
    size, w = 30.0, 2.0 * np.pi * 4.0

    def speed(t: float) -> float:
        return -size / w * np.cos(w * t)

    for k in range(1, 2 * rate):
        t = k / rate
        force = size * np.sin(w * (t - lag))
        if is_mean:
            force = (speed(t - lag) - speed(t - 1.0 / rate - lag)) * rate
        meter.add((0.0, 0.0, 0.0, 0.0, 0.0, force - 9.81))
        if k % max(rate // 30, 1) == 0:
            # The state lies behind by the lag; the last sample carries it on
            now = speed(t - lag) + lag * force
            step = meter.measure(pose(t, (0.0, 0.0, 0.0), (0.0, 0.0, now), (0.0, 0.0, 0.0)))
            if step is not None:
                sizes.append(step.sizes[1])
    assert max(sizes) < 0.1


def test_a_step_is_measured_in_position_velocity_and_yaw_by_itself():
    def moved(now: Pose) -> Pose:
        if now.t_ns < 500_000_000:
            return now
        q = so3.multiply(so3.exp(np.array([0.0, 0.0, 0.3])), now.q_nb)
        at = now.pos_n + np.array([3.0 + (now.t_ns * 1e-9 - 0.5), -4.0, 1.0])
        return Pose(now.t_ns, at, q, now.vel_n + np.array([1.0, 0.0, 0.0]))

    steps = measured(moved)
    largest = max(steps, key=lambda step: step.sizes[0])
    assert largest.pos_n == pytest.approx([3.0, -4.0, 1.0], abs=0.02)
    assert largest.vel_n == pytest.approx([1.0, 0.0, 0.0], abs=0.1)
    assert largest.yaw == pytest.approx(0.3, abs=0.001)
    assert sorted(step.sizes[0] for step in steps)[-2] < 0.02


def test_without_a_look_before_or_a_sample_between_there_is_no_step():
    meter, (now, sample) = StepMeter(), circle(0.0)
    assert meter.measure(now) is None
    meter.add(sample)
    assert meter.measure(circle(0.5 * DT)[0]) is None
    assert meter.measure(circle(DT)[0]) is None
    meter.add(sample)
    assert meter.measure(circle(2 * DT)[0]) is not None
    meter.add(sample)
    meter.forget()
    assert meter.measure(circle(3 * DT)[0]) is None


def step(position=0.0, velocity=0.0, yaw=0.0, dt=DT) -> Step:
    return Step(dt, np.array([position, 0.0, 0.0]), np.array([0.0, velocity, 0.0]), yaw)


def settled(usual=0.0) -> JumpDetector:
    """Return a detector that has seen a minute of usual steps, of fixes at 5 Hz."""
    detector = JumpDetector()
    for k in range(1800):
        detector.judge(step(position=usual if k % 6 == 0 else 0.0), NOT_AIDED)
    return detector


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"position": 0.45}, (False, False, False)),
        ({"position": 0.55}, (True, False, False)),
        ({"velocity": 0.45}, (False, True, False)),
        ({"yaw": np.radians(11.0)}, (False, False, True)),
        # After a pause of a second motion explains more
        ({"position": 2.0, "velocity": 5.0, "yaw": 0.5, "dt": 1.0}, (False, False, False)),
        ({"position": 5.0, "velocity": 12.0, "yaw": 1.5, "dt": 1.0}, (True, True, True)),
    ],
)
def test_a_jump_is_beyond_what_followers_take_for_noise(given, expected):
    assert settled().judge(step(**given), NOT_AIDED) == expected


def test_corrections_that_are_usual_are_no_jumps_but_a_metre_always_is():
    noisy = settled(usual=0.3)
    assert noisy.judge(step(position=0.8), NOT_AIDED) == (False, False, False)
    assert noisy.judge(step(position=1.1), NOT_AIDED) == (True, False, False)
    assert JumpDetector().judge(step(position=0.8), NOT_AIDED) == (False, False, False)


def test_a_step_within_the_sigma_that_was_stated_is_no_jump():
    assert settled().judge(step(position=1.2), (1.4, 0.0, 0.0)) == (False, False, False)
    assert settled().judge(step(position=1.5), (1.4, 0.0, 0.0)) == (True, False, False)
    # The second fix of a start corrects the first by as much as both are uncertain
    assert JumpDetector().judge(step(position=4.1), (1.4, 0.0, 0.0)) == (False, False, False)
    assert JumpDetector().judge(step(position=4.3), (1.4, 0.0, 0.0)) == (True, False, False)
    assert settled().judge(step(velocity=0.9, yaw=0.3), (0.0, 1.0, 0.2)) == (False, False, True)
