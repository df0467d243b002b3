from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.lidar import start
from ekf_companion.lidar.motion import prepare
from ekf_companion.lidar.odometry import run
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.sampling import evenly, grouped, thin
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import DOWN, VEL, exp
from ekf_companion.nav.direction import direction_minus
from sim_autopilot.lidar.motion import MOTIONS
from sim_autopilot.lidar.record import simulate
from sim_autopilot.lidar.write import write_sequence


def cut(recording, begin, end):
    """Return a part of a recording."""
    inertial = recording.inertial
    kept = (inertial.stamp >= begin) & (inertial.stamp < end)
    part = replace(
        inertial,
        stamp=inertial.stamp[kept],
        gyro=inertial.gyro[kept],
        accel=inertial.accel[kept],
    )
    scans = [one for one in recording.scans if begin <= one.stamp < end - 0.1]
    return replace(recording, scans=scans, inertial=part)


def recorded(folder, world, seed, begin, end):
    write_sequence(folder, simulate(world, seed, duration=end))
    return cut(read(folder), begin, end)


def truth(world, stamp):
    """Return velocity, m/s, and direction of gravity in the body."""
    motion = MOTIONS[world]
    C = motion.rotation(np.array([stamp]))[0].T
    return C @ motion.velocity(np.array([stamp]))[0], C @ np.array([0.0, 0.0, -1.0])


@pytest.mark.parametrize("world", ["forest", "street", "room"])
def test_a_start_in_motion_is_found_within_its_own_sigma(tmp_path, world):
    recording = recorded(tmp_path, world, 61, 8.0, 9.3)
    samples = prepare(recording.inertial)
    x, P = start.find(recording.scans, samples, recording.mounting, Settings())
    vel, down = truth(world, recording.scans[0].stamp)
    assert np.linalg.norm(vel) > 0.5
    assert np.linalg.norm(x.vel_w - vel) < 0.3
    assert (np.abs(x.vel_w - vel) < 4.0 * np.sqrt(np.diag(P)[VEL])).all()
    away = direction_minus(down, x.down_w)
    assert np.linalg.norm(away) < np.radians(3.0)
    assert (np.abs(away) < 4.0 * np.sqrt(np.diag(P)[DOWN])).all()


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [62, 63, 64])
def test_a_recording_that_begins_between_trees_is_solved(tmp_path, seed):
    recording = recorded(tmp_path, "forest", seed, 8.0, 16.0)
    recording = replace(recording, scans=list(recording.scans))
    estimates = list(run(recording, Settings()))
    for one in estimates:
        after = one.stamp - recording.scans[0].stamp
        if not 0.4 < after < 0.7:
            continue
        vel, down = truth("forest", one.stamp)
        C = one.state.C_wb.T
        assert np.linalg.norm(C @ one.state.vel_w - vel) < 0.3
        assert np.arccos(np.clip(C @ one.state.down_w @ down, -1.0, 1.0)) < np.radians(3.0)
    motion = MOTIONS["forest"]
    first = motion.rotation(np.array([estimates[0].stamp]))[0]
    stamps = np.array([one.stamp for one in estimates])
    way = (motion.position(stamps) - motion.position(stamps[:1])) @ first
    C = estimates[0].state.C_wb
    found = np.array([one.state.pos_w - estimates[0].state.pos_w for one in estimates]) @ C
    # With planes of the first scan alone it is lost: 11 to 20 m on such flights
    assert np.linalg.norm(found - way, axis=1).max() < 0.5


def test_a_start_over_bare_ground_does_not_claim_a_velocity_along_it(tmp_path):
    recording = recorded(tmp_path, "plain", 61, 8.0, 9.3)
    samples = prepare(recording.inertial)
    x, P = start.find(recording.scans, samples, recording.mounting, Settings())
    vel, down = truth("plain", recording.scans[0].stamp)
    error = x.vel_w - vel
    assert error @ np.linalg.solve(P[VEL, VEL], error) < 3.0 * 3.0
    along = error - down * (down @ error)
    along /= np.linalg.norm(along)
    # The noise of normals alone claims 0.3 m/s where the error is 3
    assert np.sqrt(along @ P[VEL, VEL] @ along) > 2.0


def test_a_start_without_points_knows_nothing(tmp_path):
    recording = recorded(tmp_path, "room", 61, 4.0, 5.3)
    empty = [replace(one, points=np.zeros((0, 3)), times=np.zeros(0)) for one in recording.scans]
    samples = prepare(recording.inertial)
    P = start.find(empty, samples, recording.mounting, Settings())[1]
    assert (np.sqrt(np.diag(P)[VEL]) > start.SPEED).all()


def test_points_move_as_their_derivatives_say():
    rng = np.random.default_rng(3)
    C = exp(rng.normal(0.0, 0.5, (30, 3)))
    points = start._Points(
        after=rng.uniform(0.0, 1.0, 30),
        C=C,
        y=rng.normal(0.0, 5.0, (30, 3)),
        q=rng.normal(0.0, 5.0, (30, 3)),
    )
    motion = np.array([1.0, -2.0, 0.3, 0.4, 0.2, -9.7, 0.0, 0.0, 0.0])
    normal = rng.normal(size=(30, 3))
    H = points.derivatives(motion, normal)
    for k in range(9):
        step = 1e-6 * np.eye(9)[k]
        change = (points.placed(motion + step) - points.placed(motion - step)) / 2e-6
        # Central differences of 1e-6, of distances of some 10 m
        assert np.allclose(H[:, k], np.einsum("ni,ni->n", normal, change), atol=1e-7)


def test_points_are_grouped_by_their_cells():
    cell = np.array([[0, 0, 0], [1, -2, 3], [0, 0, 0], [-1, 0, 0], [1, -2, 3], [0, 0, 0]])
    order, first, count = grouped(cell)
    parts = {tuple(sorted(order[a : a + n].tolist())) for a, n in zip(first, count, strict=True)}
    assert parts == {(0, 2, 5), (1, 4), (3,)}
    assert all(len(one) == 0 for one in grouped(np.zeros((0, 3), dtype=np.int64)))


def test_thinned_points_are_one_a_voxel_and_spread_evenly():
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (5000, 3))
    index = thin(points, 0.5, 10_000)
    cells = np.floor(points / 0.5).astype(int)
    assert len(index) == len(np.unique(cells, axis=0)) == len(np.unique(cells[index], axis=0))
    few = evenly(index, 100)
    assert len(few) == 100
    assert (few[0], few[-1]) == (index[0], index[-1])
    assert (np.diff(few) > 0).all()
