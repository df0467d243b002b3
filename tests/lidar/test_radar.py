"""The way of a radar by its radial speeds: velocities, covariance, and what damage does to it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from benchmarks.lidar_aid import CONFIG, Flight
from ekf_companion.cli import app
from ekf_companion.lidar import radar
from ekf_companion.lidar.doppler import ego_velocity, find_step, velocities
from ekf_companion.lidar.motion import prepare, propagate
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import InertialSamples, Mounting, Scan
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import lines_of, solve
from ekf_companion.lidar.state import DELAY, EXCESS, GYRO_BIAS, MOUNT_ATT, VEL, N, State, exp
from ekf_companion.nav import so3
from ekf_companion.nav.direction import direction_by_angles
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.review.convert import estimate
from sim_autopilot.lidar.radar import RAYS, RadarErrors, simulate_radar
from sim_autopilot.lidar.record import Lidar, Simulated, usual_lidar
from sim_autopilot.lidar.write import Messages, write_bag, write_sequence
from tests.lidar.recordings import arrays, small, write_folder, write_pcd
from tests.paths import DATA

WALK = 26.0
FRAME = 0.5 * RadarErrors().frame
"""When the speeds of a scan are true, s after its stamp."""


MOVING = State(
    C_wb=exp(np.array([0.3, -0.5, 1.0])),
    vel_w=np.array([1.0, -2.0, 0.4]),
    C_bl=exp(np.array([0.2, 0.4, -0.7])),
    pos_b=np.array([0.3, -0.2, 0.5]),
    gyro_bias=np.array([0.01, -0.02, 0.03]),
)


@lru_cache
def walk(seed: int = 3, **errors: float) -> Simulated:
    """A walk in a room, at rest for three seconds."""
    return simulate_radar("room", seed, duration=WALK, errors=RadarErrors(**errors))


def written(path, flown, edit=None, *, has_mounting=True):
    """Write a recording after `edit(lidar, imu)`."""
    write_sequence(path, flown)
    lidar, imu = arrays(flown)
    lidar["doppler"] = flown.doppler.copy()
    if edit is not None:
        edit(lidar, imu)
    np.savez(path / "lidar.npz", **lidar)
    np.savez(path / "imu.npz", **imu)
    if not has_mounting:
        (path / "calib.json").unlink()
    return path


def true_velocity(flown, stamp):
    """Return the true velocity of the sensor in its own axes at times, shape (n, 3)."""
    t = np.asarray(stamp)
    C, motion = flown.motion.rotation(t), flown.motion
    body = np.einsum("nji,nj->ni", C, motion.velocity(t))
    return (body + np.cross(motion.gyro(t), flown.lidar.position)) @ flown.lidar.rotation


def errors_of(flown, solution):
    """Return errors of the positions since the first pose, in its axes, and their covariances."""
    t = solution.track.stamp
    place = flown.motion.position(t)
    truth = (place - place[0]) @ flown.motion.rotation(t[:1])[0]
    return solution.track.pos_w - truth, solution.track.covariance[:, 3:6, 3:6]


def scans_of(flown):
    """Return the scans as a reader does."""
    return [
        Scan(
            float(stamp),
            flown.xyz[a:b] * 0.003,
            np.zeros(b - a),
            None,
            flown.doppler[a:b].astype(float),
        )
        for stamp, a, b in zip(flown.stamp, flown.first[:-1], flown.first[1:], strict=True)
    ]


@pytest.mark.parametrize("world", ["room", "forest", "street"])
def test_the_velocity_of_a_scan_is_true_within_its_covariance(world):
    nees, errors = [], []
    for seed in (1, 2):
        flown = simulate_radar(world, seed, duration=14.0)
        found = [one for one in velocities(scans_of(flown), Settings()) if one.used]
        assert len(found) > 0.98 * len(flown.stamp)
        true = true_velocity(flown, [one.stamp + FRAME for one in found])
        for one, vel in zip(found, true, strict=True):
            if np.linalg.norm(vel) > 0.3:
                error = one.vel - vel
                errors.append(error)
                nees.append(error @ one.information @ error / 3.0)
    # Where most points are of a car that passes nothing but the inertial samples can tell
    errors, nees = np.array(errors), np.array(nees)
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.12
    assert np.percentile(nees, 97) < 3.0
    # 0.05 m/s of each scan is more than this simulator has at a walk, and less than at 5 m/s
    assert 0.05 < np.median(nees) < 1.2


def test_movers_and_ghosts_are_left_out():
    flown = simulate_radar(
        "street", 4, duration=16.0, errors=RadarErrors(ghosts=0.0, shared_angle=0.0)
    )
    found = list(velocities(scans_of(flown), Settings()))
    moving = np.add.reduceat(flown.label == 1, flown.first[:-1])
    left = np.array([one.points - one.used for one in found])
    assert (left >= 0.6 * moving).mean() > 0.9
    assert moving.sum() > 100
    still = moving == 0
    assert np.mean(left[still]) < 1.5


def test_the_step_of_the_speeds_is_found():
    assert find_step(scans_of(walk())) == pytest.approx(0.125, rel=1e-5)
    assert find_step(scans_of(walk(step=0.0))) == 0.0
    assert find_step([]) == 0.0


def test_what_is_slower_than_a_step_is_covered_by_the_covariance():
    rng = np.random.default_rng(2)
    alone, step, nees = Settings(doppler_scan=0.0), 0.125, []
    for _ in range(200):
        u = rng.normal(size=(60, 3)) * (0.3, 0.6, 0.3) + (1.0, 0.0, 0.0)
        u /= np.linalg.norm(u, axis=1)[:, None]
        vel = rng.uniform(-0.06, 0.06, 3)
        exact = np.round(-u @ vel / step) * step
        scan = Scan(0.0, 5.0 * u, np.zeros(60), None, exact)
        found = ego_velocity(scan, alone, step, np.zeros(3))
        error = found.vel - vel
        nees.append(error @ found.information @ error / 3.0)
    # As if each point's rounding were its own it would be some ten
    assert 0.2 < np.mean(nees) < 1.5


def test_a_scan_with_few_points_shows_no_velocity():
    scan = scans_of(walk())[200]
    for count in (4, 0):
        few = Scan(
            scan.stamp,
            scan.points[:count],
            scan.times[:count],
            None,
            scan.doppler[:count],
        )
        (found,) = velocities([few], Settings())
        assert found.used == 0
        assert not found.information.any()


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 30), st.floats(-3, 30), st.floats(-6, 6))
def test_any_scan_shows_a_finite_velocity_or_none(seed, count, size, spread):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-abs(spread), 1.0, 3)
    speeds = np.round(rng.normal(size=count) * 10.0**size, rng.integers(0, 9))
    scan = Scan(0.0, points, np.zeros(count), None, speeds)
    for one in velocities([scan, scan], Settings(most_doppler=float(rng.integers(2)))):
        assert np.isfinite(one.vel).all()
        assert np.linalg.eigvalsh(one.information)[0] >= -1e-9 * np.abs(one.information).max()
        assert 0 <= one.used <= one.points <= count


def test_a_radar_without_elevation_shows_two_axes():
    u = np.stack([np.cos(a := np.linspace(-1.0, 1.0, 40)), np.sin(a), np.zeros(40)], axis=1)
    vel = np.array([1.0, -0.5, 0.3])
    (found,) = velocities([Scan(0.0, 4.0 * u, np.zeros(40), None, -u @ vel)], Settings())
    np.testing.assert_allclose(found.vel, [1.0, -0.5, 0.0], atol=1e-9)
    assert np.linalg.matrix_rank(found.information) == 2
    assert not found.information[2].any()


def test_the_jacobian_of_the_velocity_is_its_difference():
    stamp = np.arange(0.0, 1.0, 0.002)
    gyro, accel = np.tile([0.4, -0.3, 0.8], (500, 1)), np.tile([0.5, 1.0, 9.6], (500, 1))
    samples = prepare(InertialSamples(stamp, gyro, accel))
    x = MOVING
    middle, _, _, path = propagate(x, samples, 0.4, 0.5, Settings())

    def predicted(dx):
        """Return what the radar measures at an error state."""
        there = replace(path, rate_b=path.rate_b - dx[GYRO_BIAS])
        return -radar.observe(middle.plus(dx), np.zeros(3), np.eye(3), there).z

    H = radar.observe(middle, np.zeros(3), np.eye(3), path).H
    for column in range(N):
        if column == DELAY or column in range(*EXCESS.indices(N)):
            continue
        step = np.zeros(N)
        step[column] = 1e-6
        slope = (predicted(step) - predicted(-step)) / 2e-6
        np.testing.assert_allclose(H[:, column], slope, atol=1e-7)
    later = [propagate(x, samples, 0.4, 0.5 + d, Settings())[0] for d in (1e-5, -1e-5)]
    ahead, back = (-radar.observe(one, np.zeros(3), np.eye(3), path).z for one in later)
    # The acceleration is that of the middle of the last step, 1 ms before
    np.testing.assert_allclose(H[:, DELAY], (ahead - back) / 2e-5, atol=0.01)


def test_what_the_body_sees_stays_the_same_by_a_correction():
    rng = np.random.default_rng(2)
    before = replace(MOVING, down_w=exp(np.array([0.2, -0.1, 0.0])) @ np.array([0.0, 0.0, -1.0]))
    x = before.plus(0.1 * rng.normal(size=N))

    # Across its direction: the length of gravity is no part of the state
    across = direction_by_angles(x.down_w).T @ x.C_wb

    def seen(x):
        """Return velocity and gravity in the body."""
        return np.concatenate([x.C_wb.T @ x.vel_w, across @ x.C_wb.T @ x.down_w])

    G = radar.same_in_body(before, x)
    for e in np.eye(N):
        slopes = [
            (seen(there.plus(1e-6 * by)) - seen(there.plus(-1e-6 * by))) / 2e-6
            for there, by in ((before, e), (x, G @ e))
        ]
        np.testing.assert_allclose(*slopes, atol=1e-7)


def in_motion(recording, begin):
    """Return what is left of a recording from a time after its first scan on, s."""
    t = recording.inertial.stamp
    begin += next(iter(recording.scans)).stamp
    kept = t >= begin
    parts = (getattr(recording.inertial, name)[kept] for name in ("stamp", "gyro", "accel"))
    scans = [one for one in recording.scans if one.stamp >= begin]
    return replace(recording, scans=scans, inertial=InertialSamples(*parts))


def test_a_start_in_motion_shows_no_heading_that_nothing_shows(tmp_path):
    """A car's heading is known by the gyro alone: its bias is what was known before."""
    for seed in (502, 504):
        flown = simulate_radar("street", seed, duration=30.0)
        recording = in_motion(read(written(tmp_path / str(seed), flown)), 8.0)
        solution = solve(recording, Settings())
        last = solution.track.last
        sigma = np.sqrt(last.P[GYRO_BIAS, GYRO_BIAS][2, 2])
        assert 0.005 < sigma < 0.011
        assert abs(last.state.gyro_bias[2] - flown.gyro_bias[-1, 2]) < 2.0 * sigma
        assert np.linalg.norm(errors_of(flown, solution)[0][-1]) < 2.0 * solution.sigma


def test_a_start_has_the_error_of_its_mounting():
    flown = simulate_radar("street", 502, duration=10.0)
    given = Mounting(exp(np.array([0.0, 0.13, 0.0])) @ flown.lidar.rotation, flown.lidar.position)
    gyro, accel = flown.gyro.astype(float), flown.accel.astype(float)
    samples = prepare(InertialSamples(flown.imu_stamp, gyro, accel))
    found = [one for one in velocities(scans_of(flown), Settings()) if one.stamp > 7.0][:11]
    x, P = radar.find_start(found, samples, given, Settings())
    t = np.array([found[0].stamp + FRAME])
    true = flown.motion.rotation(t)[0].T @ flown.motion.velocity(t)[0]
    error = x.vel_w - true
    assert np.linalg.norm(error) > 0.3
    assert error @ np.linalg.solve(P[VEL, VEL], error) / 3.0 < 2.0
    # That of the mounting is what it is by
    blind = P[VEL, VEL] - P[VEL, MOUNT_ATT] @ np.linalg.solve(
        P[MOUNT_ATT, MOUNT_ATT], P[MOUNT_ATT, VEL]
    )
    assert np.trace(blind) < 0.5 * np.trace(P[VEL, VEL])


def test_costs_at_all_delays_are_of_the_same_scans(tmp_path):
    """A bouncing car half a period late is one upside down; a bus fills the view of some scans."""
    for seed in (501, 506):
        flown = simulate_radar("street", seed, duration=40.0)
        mounting = read(written(tmp_path / str(seed), flown)).mounting
        np.testing.assert_allclose(mounting.rotation, flown.lidar.rotation)


@pytest.mark.parametrize("world", ["room", pytest.param("forest", marks=pytest.mark.campaign)])
def test_the_way_is_true_within_its_covariance(tmp_path, world):
    nees, ends = [], []
    for seed in range(1, 5):
        flown = simulate_radar(world, seed, duration=30.0)
        solution = solve(read(written(tmp_path / str(seed), flown)), Settings())
        error, P = errors_of(flown, solution)
        nees += [e @ np.linalg.solve(p, e) / 3.0 for e, p in zip(error[60:], P[60:], strict=True)]
        ends.append(np.linalg.norm(error[-1]) / solution.way)
        assert solution.sigma < 0.03 * solution.way
    assert max(ends) < 0.02
    assert 0.1 < np.mean(nees) < 1.5


RECORDED = pytest.mark.skipif(
    not (DATA / "radar-inertial-walk").is_dir(), reason="no recorded radar"
)


@RECORDED
def test_a_recorded_walk_that_begins_and_ends_in_motion_is_that_of_the_whole():
    given = Mounting(
        so3.to_matrix(so3.from_euler(*np.radians([-179.6, 9.1, -45.7]).tolist())),
        np.array([0.03, 0.03, -0.06]),
    )
    recording = read(DATA / "radar-inertial-walk" / "demo.bag", mounting=given)
    whole = solve(recording, Settings()).track
    for begin in (14.5, 15.0, 17.0):
        part = in_motion(recording, begin)
        scans = [one for one in part.scans if one.stamp < whole.stamp[0] + 33.5]
        solution = solve(replace(part, scans=scans), Settings())
        track = solution.track
        first, last = np.abs(whole.stamp[:, None] - track.stamp[[0, -1]]).argmin(axis=0)
        away = whole.attitude[first].T @ (whole.pos_w[last] - whole.pos_w[first])
        error, P = track.pos_w[-1] - away, track.covariance[-1, 3:6, 3:6]
        assert np.linalg.norm(error) < 0.02 * solution.way
        assert error @ np.linalg.solve(P, error) / 3.0 < 2.0


@RECORDED
@pytest.mark.parametrize(
    "mounting", [None, "0.03,0.03,-0.06,-179.6,9.1,-45.7"], ids=["found", "as published"]
)
def test_a_recorded_walk_returns_to_its_begin(tmp_path, mounting):
    out = tmp_path / "walk.csv"
    given = [] if mounting is None else ["--lidar-pose", mounting]
    bag = str(DATA / "radar-inertial-walk" / "demo.bag")
    done = CliRunner().invoke(app, ["lidar", bag, "-o", str(out), *given])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("good: 24 m")
    assert "radar_right/trigger with the same number" in done.output
    rows = np.genfromtxt(out, delimiter=",", skip_header=1)
    place, sigma = rows[:, 1:4], rows[-1, 11:14]
    way = np.linalg.norm(np.diff(place, axis=0), axis=1).sum()
    away = place[-1] - place[0]
    assert np.linalg.norm(away) < 0.02 * way
    assert (np.abs(away) < 3.0 * sigma).all()


def reversed_speeds(lidar, imu):
    lidar["doppler"] = -lidar["doppler"]


def in_kmh(lidar, imu):
    lidar["doppler"] = lidar["doppler"] * np.float32(3.6)


def exchanged(lidar, imu):
    lidar["xyz"] = lidar["xyz"][:, [1, 0, 2]] * np.array([1, -1, 1], np.int16)


def mirrored(lidar, imu):
    lidar["xyz"] = lidar["xyz"] * np.array([1, -1, 1], np.int16)


def upside_down(lidar, imu):
    lidar["xyz"] = lidar["xyz"] * np.array([1, -1, -1], np.int16)


def stamps_of_arrival(lidar, imu):
    lidar["stamp"] = lidar["stamp"] + 0.15


def doubled(lidar, imu):
    lidar["stamp"][31::20] = lidar["stamp"][30:-1:20][: len(lidar["stamp"][31::20])]


def last_first(lidar, imu):
    rearrange(lidar, np.arange(len(lidar["stamp"]))[::-1])
    lidar["stamp"] = lidar["stamp"][::-1]


def rearrange(lidar, order):
    """Put the points of other scans into each."""
    parts = [np.arange(lidar["first"][k], lidar["first"][k + 1]) for k in order]
    for name in ("xyz", "dt", "ring", "doppler"):
        lidar[name] = lidar[name][np.concatenate(parts)]
    lidar["first"] = np.concatenate(([0], np.cumsum([len(part) for part in parts])))


def not_finite(lidar, imu):
    lidar["doppler"][::7] = np.nan


def empty(lidar, imu):
    a, b = lidar["first"][100], lidar["first"][110]
    lidar["first"][101:110] = a
    lidar["first"][110:] -= b - a
    for name in ("xyz", "dt", "ring", "doppler"):
        lidar[name] = np.delete(lidar[name], np.s_[a:b], 0)


def in_g(lidar, imu):
    imu["accel"] = imu["accel"] / np.float32(9.80665)


def truck(lidar, imu):
    """For two seconds most points are of a thing that comes nearer at 3 m/s."""
    a, b = lidar["first"][150], lidar["first"][170]
    ahead = lidar["xyz"][a:b, 0] > np.abs(lidar["xyz"][a:b, 1])
    lidar["doppler"][a:b][ahead] -= 3.0


def frozen(lidar, imu):
    """For three seconds the radar repeats a scan."""
    order = np.arange(len(lidar["stamp"]))
    order[150:180] = 150
    rearrange(lidar, order)


MENDED = [
    (reversed_speeds, "positive towards the sensor"),
    (in_kmh, "km/h"),
    (stamps_of_arrival, "late by the motion"),
    (doubled, "repeat the stamp"),
    (last_first, "last first"),
    (not_finite, ""),
    (empty, "10 scans are empty"),
    (in_g, "specific force is in g"),
    (truck, "contradict the inertial samples"),
    (frozen, "29 scans show no velocity"),
]


@pytest.mark.parametrize(("edit", "word"), MENDED, ids=lambda one: getattr(one, "__name__", ""))
def test_what_is_damaged_is_mended_and_named(tmp_path, edit, word):
    flown = walk()
    solution = solve(read(written(tmp_path / "r", flown, edit)), Settings())
    assert any(word in one for one in solution.remarks()), solution.remarks()
    error, _ = errors_of(flown, solution)
    assert np.linalg.norm(error[-1]) < 0.02 * solution.way


@pytest.mark.parametrize("edit", [exchanged, mirrored, upside_down])
def test_axes_that_do_not_belong_together_are_named_with_those_that_do(tmp_path, edit):
    path = written(tmp_path / "r", walk(), edit)
    done = CliRunner().invoke(app, ["lidar", str(path), "-o", str(tmp_path / "o.tum")])
    assert done.exit_code == 3
    assert "do not belong together" in done.output
    assert "Traceback" not in done.output
    # Without a mounting there is nothing to contradict: it is found
    found = read(written(tmp_path / "s", walk(), edit, has_mounting=False))
    if edit is exchanged:
        turn = found.mounting.rotation @ exp(np.array([0.0, 0.0, -0.5 * np.pi]))
        assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) < 8.0
    elif edit is mirrored:
        assert any("mirrored" in one for one in found.decisions)
    solution = solve(found, Settings())
    error, _ = errors_of(walk(), solution)
    assert np.linalg.norm(error[-1]) < 0.02 * solution.way


def test_a_radar_without_elevation_is_believed_as_it_is_mounted(tmp_path):
    def flat(lidar, imu):
        lidar["xyz"] = lidar["xyz"] * np.array([1, 1, 0], np.int16)

    level = Lidar(replace(RAYS, low=-0.001, high=0.001), position=np.array([0.05, 0.0, 0.08]))
    flown = simulate_radar("room", 3, duration=WALK, radar=level)
    found = read(written(tmp_path / "r", flown, flat))
    assert any("the motion does not show" in one for one in found.decisions)
    error, P = errors_of(flown, solution := solve(found, Settings()))
    assert np.linalg.norm(error[-1, :2]) < 0.02 * solution.way
    assert error[-1] @ np.linalg.solve(P[-1], error[-1]) / 3.0 < 3.0


def test_speeds_that_wrap_go_on_where_it_is_said(tmp_path):
    flown = walk(most_speed=0.55, step=0.1)
    assert np.abs(flown.doppler).max() < 0.61
    path = written(tmp_path / "r", flown)
    told = Settings(most_doppler=0.55)
    error, _ = errors_of(flown, held := solve(read(path, most_speed=0.55), told))
    assert np.linalg.norm(error[-1]) < 0.02 * held.way
    lost = solve(read(path), Settings())
    assert any("wrap" in one for one in lost.remarks()) or not lost.verdict().startswith("good")


def without_speeds(lidar, imu):
    lidar["doppler"][:] = np.nan


def of_a_lidar(lidar, imu):
    del lidar["doppler"]


def sparse(lidar, imu):
    for begin, end in zip(lidar["first"][:-1] + 4, lidar["first"][1:], strict=True):
        lidar["xyz"][begin:end] = 0


def cut_short(lidar, imu):
    lidar["doppler"] = lidar["doppler"][:-3]


@pytest.mark.parametrize(
    ("edit", "word"),
    [
        (without_speeds, "are empty"),
        (of_a_lidar, "not all points have radial speeds"),
        (sparse, "0 scans show a velocity"),
        (cut_short, "doppler has"),
    ],
)
def test_a_recording_that_shows_nothing_is_refused(tmp_path, edit, word):
    path = written(tmp_path / "r", walk(), edit)
    done = CliRunner().invoke(app, ["lidar", str(path), "--filter", "doppler"])
    assert done.exit_code == 3, done.output
    assert word in done.output
    assert "Traceback" not in done.output


def test_speeds_that_mean_nothing_are_called_poor(tmp_path):
    def noise(lidar, imu):
        lidar["doppler"] = np.random.default_rng(1).uniform(-9, 9, len(lidar["doppler"]))

    solution = solve(read(written(tmp_path / "r", walk(), noise)), Settings())
    assert solution.verdict().startswith("poor: ")
    assert any("contradict the inertial samples" in one for one in solution.remarks())


def test_a_vehicle_that_does_not_move_shows_no_mounting(tmp_path):
    def at_rest(lidar, imu):
        lidar["doppler"][:] = 0.0

    flown = simulate_radar("room", 1, duration=3.0)
    path = written(tmp_path / "r", flown, at_rest, has_mounting=False)
    assert not read(path).by_doppler  # the driver of a lidar leaves such a field empty
    found = read(path, by_doppler=True)
    np.testing.assert_array_equal(found.mounting.rotation, np.eye(3))
    assert any("nor does the motion show it" in one for one in found.decisions)
    assert solve(found, Settings()).verdict().startswith("good")


def test_all_forms_give_the_same_velocities(tmp_path):
    flown = simulate_radar("room", 5, duration=8.0)
    write_sequence(tmp_path / "one", flown)
    for name in ("two.bag", "three.mcap"):
        write_bag(tmp_path / name, flown)
    write_folder(tmp_path / "four", flown, "npz")
    for file, scan in zip(sorted((tmp_path / "four").glob("*.npz")), scans_of(flown), strict=True):
        np.savez(file, xyz=scan.points.astype(np.float32), velocity=scan.doppler)
    write_folder(tmp_path / "five", flown, "binary")
    for file, scan in zip(sorted((tmp_path / "five").glob("*.pcd")), scans_of(flown), strict=True):
        kinds = [(name, "<f4") for name in ("x", "y", "z", "doppler")]
        rows = np.zeros(len(scan.points), kinds)
        rows["doppler"] = scan.doppler
        for axis, name in enumerate("xyz"):
            rows[name] = scan.points[:, axis]
        write_pcd(file, rows, "binary")
    ways = []
    for name in ("one", "two.bag", "three.mcap", "four", "five"):
        found = read(tmp_path / name)
        assert found.by_doppler
        ways.append(np.array([one.vel for one in velocities(found.scans, Settings())]))
    for other in ways[1:]:
        np.testing.assert_allclose(other, ways[0], atol=1e-5)  # points are float32


LATENCY = 0.12
"""Of a scan's arrival, s."""


def write_unstamped(path, flown, *, has_trigger):
    """Write a bag of ROS 1 whose clouds have no stamps, as a driver of TI's boards does."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types, made, epoch = store.types, Messages(store, True), 1_700_000_000_000_000_000

    def head(ns, number):
        time = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        return types["std_msgs/msg/Header"](seq=number, stamp=time, frame_id="")

    rows = []
    for k, stamp in enumerate(flown.stamp):
        ns = round(stamp * 1e9)
        cloud = made.cloud(ns, flown, slice(flown.first[k], flown.first[k + 1]))
        cloud.header = head(0, 40 + k)
        rows.append((ns + round(LATENCY * 1e9), "/radar", cloud))
        if has_trigger:
            rows.append((ns, "/trigger", head(ns, 40 + k)))
    for stamp, gyro, accel in zip(flown.imu_stamp, flown.gyro, flown.accel, strict=True):
        ns = round(stamp * 1e9)
        rows.append((ns, "/imu", made.imu(ns, gyro, accel)))
    with Writer(path) as writer:
        connections = {}
        for ns, topic, message in sorted(rows, key=lambda row: row[0]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], epoch + ns, store.serialize_ros1(message, kind))


@pytest.mark.parametrize("has_trigger", [True, False], ids=["trigger", "arrival"])
def test_scans_without_stamps_get_those_of_their_trigger_or_of_arrival(tmp_path, has_trigger):
    write_unstamped(tmp_path / "r.bag", walk(), has_trigger=has_trigger)
    tilted = Mounting(walk().lidar.rotation, walk().lidar.position)
    found = read(tmp_path / "r.bag", mounting=tilted)
    stamps = [scan.stamp for scan in found.scans]
    word = "/trigger with the same number" if has_trigger else "their arrival is taken"
    assert any(word in one for one in found.decisions)
    if has_trigger:
        np.testing.assert_allclose(stamps, walk().stamp, atol=1e-8)
    else:
        # The motion shows the latency, to what the filter finds itself
        np.testing.assert_allclose(stamps, walk().stamp + FRAME, atol=radar.LATE)


def test_the_command_writes_velocities_and_refuses_a_map(tmp_path):
    path = written(tmp_path / "r", walk())
    out = tmp_path / "velocity.csv"
    done = CliRunner().invoke(app, ["lidar", str(path), "--velocity", str(out)])
    assert done.exit_code == 0, done.output
    rows = np.genfromtxt(out, delimiter=",", names=True)
    assert len(rows) == len(walk().stamp)
    true = true_velocity(walk(), rows["t_s"] + FRAME)
    error = np.stack([rows[f"v{axis}_m_s"] for axis in "xyz"], axis=1) - true
    assert np.sqrt(np.mean(error**2)) < 0.06
    for option in ("--map", "--stamp"):
        value = str(tmp_path / "map.ply") if option == "--map" else "end"
        refused = CliRunner().invoke(app, ["lidar", str(path), option, value])
        assert refused.exit_code == 2
    other = tmp_path / "lidar"
    write_sequence(other, small(4.0))
    refused = CliRunner().invoke(app, ["lidar", str(other), "--velocity", str(out)])
    assert refused.exit_code == 2


def test_a_mounting_and_its_lever_arm_are_used(tmp_path):
    tilted = usual_lidar("plain", RAYS)
    flown = simulate_radar("room", 6, duration=WALK, radar=tilted)
    path = written(tmp_path / "r", flown, has_mounting=False)
    mounting = Mounting(tilted.rotation, tilted.position)
    error, _ = errors_of(flown, one := solve(read(path, mounting=mounting), Settings()))
    assert np.linalg.norm(error[-1]) < 0.02 * one.way


def test_a_flight_whose_fixes_end_for_half_a_minute_is_held_by_the_radar(tmp_path):
    flown = simulate_radar("forest", 9, duration=42.0)
    solution = solve(read(written(tmp_path / "forest", flown)), Settings())
    pose, log, cut = tmp_path / "pose.csv", tmp_path / "log.csv", (9.0, 39.0)
    pose.write_text("\n".join(lines_of(solution, ".csv")) + "\n")
    flight = Flight.of(tmp_path / "forest")
    flight.write(log, 1, cut)
    away = {}
    for name, aid in (("radar", PoseFile(pose)), ("none", None)):
        t, error, sigma = flight.errors(estimate(log, CONFIG, None, aid)[0])
        inside = (t >= cut[0]) & (t < cut[1])
        away[name] = np.linalg.norm(error[inside] - error[inside][0], axis=1).max()
        assert np.abs(error[inside] / sigma[inside]).max() < 3.0
    assert away["radar"] < 1.5  # 2 % of 90 m
    assert away["none"] > 10.0


def test_the_report_and_the_mcap_of_a_radar_are_written(tmp_path):
    path = written(tmp_path / "r", walk())
    outs = [tmp_path / "way.html", tmp_path / "way.mcap"]
    done = CliRunner().invoke(
        app, ["lidar", str(path), "--report", str(outs[0]), "-o", str(outs[1])]
    )
    assert done.exit_code == 0, done.output
    assert all(one.stat().st_size > 10_000 for one in outs)
