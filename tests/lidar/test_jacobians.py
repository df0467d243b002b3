from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.lidar.deskew import deskew
from ekf_companion.lidar.gap import Lost, joined, turn_between
from ekf_companion.lidar.motion import prepare, propagate
from ekf_companion.lidar.odometry import recentred
from ekf_companion.lidar.recording import InertialSamples
from ekf_companion.lidar.relative import by_axes
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import ATT, DOWN, POS, POSE, VEL, N, State, exp
from ekf_companion.lidar.update import SEEN_WITH_MOUNTING, shift_by_state

STEP = 1e-5


def central(function, size=N):
    """Return the derivative of a function of an error state at zero."""
    columns = [
        (function(STEP * axis) - function(-STEP * axis)) / (2.0 * STEP) for axis in np.eye(size)
    ]
    return np.stack(columns, axis=-1)


def some_state(seed=1):
    rng = np.random.default_rng(seed)
    down = rng.standard_normal(3)
    return State(
        C_wb=exp(rng.uniform(-1.0, 1.0, 3)),
        pos_w=rng.uniform(-20.0, 20.0, 3),
        vel_w=rng.uniform(-5.0, 5.0, 3),
        gyro_bias=rng.uniform(-0.02, 0.02, 3),
        accel_bias=rng.uniform(-0.2, 0.2, 3),
        down_w=down / np.linalg.norm(down),
        C_bl=exp(rng.uniform(-0.5, 0.5, 3)),
        pos_b=rng.uniform(-0.3, 0.3, 3),
        delay=0.004,
    )


def some_samples():
    rng = np.random.default_rng(2)
    t = np.arange(0.0025, 1.0, 0.005)
    wave = np.sin(np.outer(t, rng.uniform(3.0, 9.0, 6)) + rng.uniform(0.0, 6.0, 6))
    gyro = wave[:, :3]
    accel = 2.0 * wave[:, 3:] + np.array([0.0, 0.0, 9.8])
    return prepare(InertialSamples(t, gyro, accel))


def test_a_state_comes_back_from_where_it_was_moved():
    x, dx = some_state(), np.random.default_rng(3).uniform(-0.3, 0.3, N)
    np.testing.assert_allclose(x.plus(dx).minus(x), dx, atol=1e-12)


def test_the_motion_has_the_derivative_that_it_says():
    x, samples, settings = some_state(), some_samples(), Settings()
    after, Phi, _, _ = propagate(x, samples, 0.3, 0.4, settings)
    seen = central(lambda dx: propagate(x.plus(dx), samples, 0.3, 0.4, settings)[0].minus(after))
    # The covariance takes five samples in one step: 25 ms of a turn that changes by 9 rad/s2
    np.testing.assert_allclose(Phi, seen, atol=4e-3)
    assert abs(Phi - seen).max() > 0.0


def test_points_have_the_derivatives_that_the_rows_use():
    x, samples, settings = some_state(), some_samples(), Settings()
    end, _, _, path = propagate(x, samples, 0.3, 0.4, settings)
    rng = np.random.default_rng(4)
    points, times = rng.uniform(-10.0, 10.0, (6, 3)), rng.uniform(0.3, 0.4, 6)
    scan = deskew(points, times, path, end, end)
    normal = rng.standard_normal((6, 3))
    H = scan.derivatives(end, normal, has_mounting=True)
    seen = central(lambda dx: np.einsum("ni,ni->n", normal, scan.placed(end.plus(dx))[1]))
    np.testing.assert_allclose(H[:, :19], seen[:, SEEN_WITH_MOUNTING], atol=1e-6)
    short = scan.derivatives(end, normal, has_mounting=False)
    np.testing.assert_array_equal(short, np.delete(H, np.arange(12, 19), axis=1))

    def moved(d):
        lever = scan.placed(end)[1] - end.pos_w
        return np.einsum("ni,ni->n", normal, (lever + d[:3]) @ exp(d[3:]).T)

    np.testing.assert_allclose(H[:, 19:], central(moved, POSE), atol=1e-8)


def test_a_point_is_where_the_path_was_at_its_time():
    x, samples, settings = some_state(), some_samples(), Settings()
    end, _, _, path = propagate(x, samples, 0.3, 0.4, settings)
    there, _, _, _ = propagate(x, samples, 0.3, 0.3425, settings)
    point = np.array([[3.0, -2.0, 1.0]])
    expected = there.C_wb @ (x.C_bl @ point[0] + x.pos_b) + there.pos_w
    scan = deskew(point, np.array([0.3425]), path, end, end)
    np.testing.assert_allclose(scan.placed(end)[1][0], expected, atol=1e-9)


def test_errors_of_pose_mounting_and_delay_move_a_scan_as_a_rigid_body():
    x, about = some_state(), np.array([4.0, -7.0, 2.0])
    rate_b = np.array([0.3, -0.2, 0.5])
    T = shift_by_state(x, about, rate_b)
    seen = x.C_bl.T @ (x.C_wb.T @ (about - x.pos_w) - x.pos_b)

    def moved(d):
        there = x.plus(d)
        late = there.delay - x.delay
        pos_w, C_wb = there.pos_w + late * there.vel_w, there.C_wb @ exp(late * rate_b)
        return C_wb @ (there.C_bl @ seen + there.pos_b) + pos_w - about

    np.testing.assert_allclose(T[:3], central(moved), atol=1e-8)


def test_a_new_world_has_the_derivative_that_it_says():
    x = some_state()
    here, G = recentred(x)
    seen = central(lambda dx: recentred(x.plus(dx))[0].minus(here))
    np.testing.assert_allclose(G, seen, atol=1e-8)
    assert not here.pos_w.any()
    np.testing.assert_array_equal(here.C_wb, np.eye(3))


def test_samples_at_the_end_of_their_range_are_found_and_widen_the_noise():
    rng = np.random.default_rng(5)
    t = np.arange(0.0025, 1.0, 0.005)
    gyro = rng.normal(0.0, 0.003, (len(t), 3))
    gyro[:, 2] += np.clip(6.0 * np.sin(6.0 * t), -4.36, 4.36)
    clipped = gyro.copy()
    clipped[:, 2] = np.clip(gyro[:, 2], -4.36, 4.36)
    accel = np.tile([0.0, 0.0, 9.8], (len(t), 1))
    quiet = prepare(InertialSamples(t, gyro, accel))
    found = prepare(InertialSamples(t, clipped, accel))
    assert not quiet.is_clipped.any()
    assert found.is_clipped[:, 2].sum() > 20
    assert not found.is_clipped[:, [0, 1, 3, 4, 5]].any()
    Q, plain = (propagate(State(), one, 0.2, 0.3, Settings())[2] for one in (found, quiet))
    assert Q[ATT, ATT][2, 2] > 10.0 * plain[ATT, ATT][2, 2]


@pytest.mark.parametrize("gap", [0.1, 0.5])
def test_a_gap_in_the_samples_widens_the_noise(gap):
    samples = some_samples()
    t = samples.stamp
    kept = (t < 0.4) | (t > 0.4 + gap)
    holed = prepare(InertialSamples(t[kept], samples.gyro[kept], samples.accel[kept]))
    whole = propagate(State(), samples, 0.35, 0.95, Settings())
    lost = propagate(State(), holed, 0.35, 0.95, Settings())
    assert lost[3].lost == pytest.approx(gap, abs=0.011)
    error = lost[0].minus(whole[0])
    sigma = np.sqrt(np.diag(lost[2]))
    assert (np.abs(error[:9]) < 3.0 * sigma[:9]).all()
    assert sigma[POS].min() > 5.0 * np.sqrt(np.diag(whole[2]))[POS].max()


def test_axes_of_a_body_that_are_not_those_of_the_gyro_move_what_is_returned():
    x = some_state(3)

    def turned(axes):
        E = exp(axes).T
        there = replace(
            x.moved(E @ x.C_wb @ E.T, E @ x.pos_w, E @ x.vel_w), C_bl=E @ x.C_bl, pos_b=E @ x.pos_b
        )
        return there.minus(x)

    # Central differences of 1e-5, of 20 m
    assert np.allclose(by_axes(x), central(turned, 3), atol=1e-8)


def test_a_motion_that_was_found_anew_has_the_derivatives_that_it_says():
    x = some_state()
    motion = State(vel_w=np.array([3.0, -1.0, 0.5]), down_w=x.C_wb.T @ x.down_w)

    def after(before, motion):
        C = exp(turn_between(before.C_wb @ motion.down_w, before.down_w)) @ before.C_wb
        return before.moved(C, before.pos_w, C @ motion.vel_w)

    whole = after(x, motion)
    T, M = joined(x.C_wb, motion, x.down_w)
    seen = central(lambda dx: after(x.plus(dx), motion).minus(whole))
    np.testing.assert_allclose(seen, T, atol=1e-7)  # central difference, step 1e-5
    seen = central(lambda dx: after(x, motion.plus(dx)).minus(whole))
    np.testing.assert_allclose(seen[:, VEL], M[:, VEL], atol=1e-7)
    np.testing.assert_allclose(seen[:, DOWN], M[:, DOWN], atol=1e-7)


def test_the_error_of_a_pose_at_which_a_map_began_is_that_of_all_after_it():
    begin, x = some_state(4), some_state(5)

    def moved(dx):
        turn = begin.C_wb @ exp(dx[ATT]) @ begin.C_wb.T
        pos = begin.pos_w + dx[POS] + turn @ (x.pos_w - begin.pos_w)
        return x.moved(turn @ x.C_wb, pos, turn @ x.vel_w)

    seen = central(lambda dx: moved(dx).minus(x), POSE)
    P = np.diag([0.01, 0.02, 0.5, 1.0, 2.0, 3.0])
    added = Lost(begin.C_wb, begin.pos_w, P).added(x, np.zeros((N, N)))
    np.testing.assert_allclose(added, seen @ P @ seen.T, atol=1e-5)  # of some 100 m^2
