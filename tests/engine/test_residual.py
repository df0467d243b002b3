"""What is sent less what is estimated, and the frame of what is sent."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.engine.residual import (
    NO_OFFSET,
    Residual,
    about_down,
    local_velocity,
    scale_errors,
    stds,
)
from ekf_companion.engine.step import Pose, Step, to_pose
from ekf_companion.nav import so3
from ekf_companion.nav.state import Odometry

POSE, TWIST = slice(13, 34), slice(34, 55)


def estimate(pos_n, angles, vel_b, seed=1) -> Odometry:
    rng = np.random.default_rng(seed)
    covariances = []
    for _ in range(2):
        A = rng.normal(size=(6, 6))
        covariances.append((A @ A.T)[np.triu_indices(6)])
    numbers = [
        *pos_n,
        *so3.from_euler(*angles),
        *vel_b,
        0.1,
        0.2,
        0.3,
        *np.concatenate(covariances),
    ]
    return Odometry(0, np.array(numbers, dtype="<f4").tobytes(), 3, 100)


HERE = estimate((10.0, 20.0, -30.0), (0.1, -0.2, 2.0), (5.0, 1.0, -0.5))


def numbers(odometry: Odometry) -> np.ndarray:
    return np.frombuffer(odometry.numbers, "<f4").astype(float)


def arrays(odometry: Odometry) -> Pose:
    t_ns, *parts = to_pose(odometry)
    return Pose(t_ns, *map(np.array, parts))


def matrix(triangle: np.ndarray) -> np.ndarray:
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = triangle
    return P + P.T - np.diag(np.diag(P))


def jump(pos_n=(0.0, 0.0, 0.0), vel_n=(0.0, 0.0, 0.0), yaw=0.0) -> Step:
    return Step(1 / 30, np.array(pos_n), np.array(vel_n), yaw)


def test_with_nothing_to_add_the_bytes_are_the_same():
    assert Residual().apply(HERE, to_pose(HERE)) is HERE


def test_what_is_spread_goes_on_without_a_step_and_the_variances_cover_it():
    residual = Residual()
    residual.spread(jump((3.0, 4.0, 0.0), (1.0, 0.0, 0.0), 0.5), True, True, True)
    told = residual.apply(HERE, to_pose(HERE))
    before, after = arrays(HERE), arrays(told)
    assert after.pos_n == pytest.approx(before.pos_n - [3.0, 4.0, 0.0], abs=1e-5)
    assert after.vel_n == pytest.approx(before.vel_n - [1.0, 0.0, 0.0], abs=1e-5)
    assert so3.to_euler(after.q_nb)[2] == pytest.approx(1.5, abs=1e-6)
    assert abs(np.linalg.norm(after.q_nb) - 1.0) < 1e-6
    grown = numbers(told) - numbers(HERE)
    assert np.diag(matrix(grown[POSE])) == pytest.approx([9.0, 16.0, 0, 0, 0, 0.25], abs=1e-4)
    assert np.trace(matrix(grown[TWIST])) == pytest.approx(1.0, abs=1e-4)


def test_what_is_spread_comes_to_the_estimate_at_its_speed():
    residual = Residual()
    residual.spread(jump((3.0, 4.0, 0.0), (0.0, 2.0, 0.0), -0.5), True, True, True)
    for _ in range(60):
        residual.decay(1.0 / 60.0)
    after = arrays(residual.apply(HERE, to_pose(HERE)))
    left = after.pos_n - arrays(HERE).pos_n
    assert left == pytest.approx([-2.7, -3.6, 0.0], abs=1e-4)
    assert np.linalg.norm(after.vel_n - arrays(HERE).vel_n) == pytest.approx(1.0, abs=1e-4)
    for _ in range(60 * 10):
        residual.decay(1.0 / 60.0)
    assert residual.apply(HERE, to_pose(HERE)) is HERE


def test_a_frame_takes_jumps_up_and_the_offset_leads_back():
    """Two jumps with turns: nothing steps, and R(yaw) pos + shift is the estimate."""
    residual, now = Residual(), HERE
    sent = arrays(residual.apply(now, to_pose(now)))
    for turn, moved in ((0.4, (5.0, -2.0, 1.0)), (-0.9, (-40.0, 7.0, 0.5))):
        pose = arrays(now)
        angles = so3.to_euler(pose.q_nb) + np.array([0.0, 0.0, turn])
        now = estimate(pose.pos_n + moved, angles, numbers(now)[7:10])
        residual.move_frame(jump(moved, yaw=turn), to_pose(now))
        again = arrays(residual.apply(now, to_pose(now)))
        assert again.pos_n == pytest.approx(sent.pos_n, abs=1e-4)
        assert so3.to_matrix(again.q_nb) == pytest.approx(so3.to_matrix(sent.q_nb), abs=1e-5)
    shift, yaw = residual.offset
    assert yaw == pytest.approx(-0.5)
    back = about_down(yaw) @ again.pos_n + np.array(shift)
    assert back == pytest.approx(to_pose(now).pos_n, abs=1e-4)
    assert about_down(yaw) @ again.vel_n == pytest.approx(to_pose(now).vel_n, abs=1e-4)


def test_the_covariance_turns_with_the_frame():
    residual = Residual()
    residual.move_frame(jump(yaw=0.7), to_pose(HERE))
    P, Q = (matrix(numbers(one)[POSE]) for one in (HERE, residual.apply(HERE, to_pose(HERE))))
    R = about_down(-0.7)
    assert Q[:3, :3] == pytest.approx(R @ P[:3, :3] @ R.T, rel=1e-5)
    assert Q[:3, 3:] == pytest.approx(R @ P[:3, 3:], rel=1e-4, abs=1e-5)
    assert Q[3:, 3:] == pytest.approx(P[3:, 3:])


def test_a_covariance_that_is_not_known_stays_unknown():
    told = numbers(HERE)
    told[[13, 34]] = np.nan
    unknown = HERE._replace(numbers=told.astype("<f4").tobytes())
    residual = Residual()
    residual.spread(jump((3.0, 0.0, 0.0), yaw=0.2), True, False, True)
    residual.move_frame(jump(yaw=0.7), to_pose(unknown))
    after = numbers(scale_errors(residual.apply(unknown, to_pose(unknown)), 9.0))
    assert np.isnan(after[[13, 34]]).all()
    assert after[14:34] == pytest.approx(told[14:34])
    assert stds(unknown)[0] == np.inf
    assert residual.offset != NO_OFFSET


def test_a_velocity_along_the_local_axes_is_the_same_with_its_covariance_turned():
    local, C = numbers(local_velocity(HERE)), so3.to_matrix(arrays(HERE).q_nb)
    assert local[7:10] == pytest.approx(to_pose(HERE).vel_n, rel=1e-5)
    P, Q = (matrix(one[34:55]) for one in (numbers(HERE), local))
    assert Q[:3, :3] == pytest.approx(C @ P[:3, :3] @ C.T, rel=1e-4, abs=1e-5)
    kept = [*range(7), *range(10, 34)]
    assert (local[kept] == numbers(HERE)[kept]).all()


def test_errors_are_scaled_for_position_and_velocity_and_stay_a_covariance():
    before, after = numbers(HERE), numbers(scale_errors(HERE, 9.0))
    assert stds(scale_errors(HERE, 9.0))[0] == pytest.approx(3.0 * stds(HERE)[0])
    P, Q = matrix(before[POSE]), matrix(after[POSE])
    assert Q[:3, :3] == pytest.approx(9.0 * P[:3, :3], rel=1e-5)
    assert Q[3:, 3:] == pytest.approx(P[3:, 3:])
    assert np.linalg.eigvalsh(Q).min() > 0.0
    assert before[:13] == pytest.approx(after[:13])
