"""Poses of a file beside a log: clocks, axes, drift, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion import with_poses
from ekf_companion.config.config import Config
from ekf_companion.core.memory.enums import Aid, Verdict
from ekf_companion.core.settings.settings import FilterSettings, VisualOdometrySettings
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.relative_pose import UPPER
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.review.convert import convert, estimate
from tests import euroc
from tests.euroc import BODY
from tests.paths import DATA

RATE, SECONDS = 100.0, 60.0
GRAVITY = np.array([0.0, 0.0, 9.80665])
GYRO_BIAS = np.array([0.01, -0.02, 0.03])
FLIP = np.diag([1.0, -1.0, -1.0])
TILTED = so3.to_matrix(so3.from_euler(0.05, 0.35, 0.8)) @ FLIP
"""A body forward, left, up that is turned on the vehicle, in its axes."""


class Flown:
    """A motion of sines, as a log and as poses; times are s of the log."""

    def __init__(self, seed=1, turns=0.4):
        rng = np.random.default_rng(seed)
        rates, phases = rng.uniform(0.2, 1.1, (3, 6, 1)), rng.uniform(0.0, 6.0, (3, 6, 1))
        self.t = 5.0 + np.arange(int(SECONDS * RATE)) / RATE

        def sines(size):
            return (size * np.sin(rates * self.t + phases)).mean(axis=0)

        motion = sines(np.array([6.0, 6.0, 2.0, turns, turns, 4.0 * turns])[None, :, None])
        self.pos, euler = motion[:3].T, motion[3:]
        self.q = so3.from_euler(*euler)
        accel = np.gradient(np.gradient(self.pos, self.t, axis=0), self.t, axis=0)
        step = so3.log(so3.multiply(so3.conjugate(self.q[:-1]), self.q[1:])) * RATE
        gyro = np.vstack([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]]) + GYRO_BIAS
        force = so3.rotate(so3.conjugate(self.q), accel - GRAVITY)
        t_ns = np.round(self.t * 1e9).astype(int)
        self.events = Events.from_columns(t_ns, Kind.IMU, *gyro.T, *force.T)
        self.log = Recording(family="unknown", events=self.events)

    def write(self, path, late=0.0, C_bp=FLIP, up=True, every=10, begin=1.0, end=SECONDS):
        """Write TUM poses of a body that is turned on the vehicle; its world's z is up or down."""
        k = np.arange(int(begin * RATE), int(end * RATE), every)
        to_w = FLIP if up else np.eye(3)
        pos = self.pos[k] @ to_w.T
        q = so3.from_matrix(to_w @ so3.to_matrix(self.q[k]) @ C_bp)
        lines = [
            " ".join([f"{t - late:.6f}", *(f"{one:.9f}" for one in (*p, *r[[1, 2, 3, 0]]))])
            for t, p, r in zip(self.t[k], pos, q, strict=True)
        ]
        path.write_text("\n".join(lines) + "\n")
        return path


def poses_of(log):
    return log.events.take(log.events.kind == Kind.POSE)


def compared(flown, rows):
    """Return how far places (m) and yaw (rad) of rows are from the truth's, but for a constant."""
    t = rows.t_ns * 1e-9
    true = np.stack([np.interp(t, flown.t, one) for one in flown.pos.T], axis=1)
    yaw = np.interp(t, flown.t, np.unwrap(so3.to_euler(flown.q)[:, 2]))
    off = so3.wrap(rows.values[:, 3] - yaw)
    turn = np.angle(np.exp(1j * off).mean())
    return np.abs(rows.values[:, :3] - true).max(), np.abs(so3.wrap(off - turn)).max()


@pytest.mark.parametrize("late", [0.0, 3.2173, -0.113, -1.7e9, 40.0])
def test_the_clocks_are_found_by_the_turns(tmp_path, late):
    flown = Flown()
    path = flown.write(tmp_path / "poses.tum", late=late, C_bp=TILTED)
    log, settings = with_poses(flown.log, path, FilterSettings())
    rows = poses_of(log)
    assert rows.t_ns[0] * 1e-9 == pytest.approx(6.0, abs=0.003)
    assert "by the turns" in log.notes[-1]
    assert settings.visual_odometry.use
    assert settings.visual_odometry.delay_std == 0.01


def test_a_part_of_a_flight_is_found_in_it(tmp_path):
    flown = Flown(seed=2)
    path = flown.write(tmp_path / "poses.tum", late=100.0, begin=20.0, end=40.0)
    rows = poses_of(with_poses(flown.log, path, FilterSettings())[0])
    assert rows.t_ns[0] * 1e-9 == pytest.approx(25.0, abs=0.003)


@pytest.mark.parametrize(
    ("C_bp", "up"),
    [
        (FLIP, True),
        (np.eye(3), False),
        (np.eye(3), True),
        (TILTED, True),
        (TILTED, False),
        (BODY.T, True),
    ],
    ids=["flu", "ned", "frd in a world up", "tilted", "tilted in ned", "camera"],
)
def test_its_axes_become_those_of_the_vehicle(tmp_path, C_bp, up):
    flown = Flown(seed=3)
    path = flown.write(tmp_path / "poses.tum", C_bp=C_bp, up=up)
    place, yaw = compared(flown, poses_of(with_poses(flown.log, path, FilterSettings())[0]))
    assert place < 0.02  # 5 ms at 2 m/s are 1 cm
    assert yaw < 0.01


def test_what_hardly_turns_is_taken_as_it_is_usual(tmp_path):
    flown = Flown(seed=4, turns=0.0)
    path = flown.write(tmp_path / "poses.tum")
    log, settings = with_poses(flown.log, path, FilterSettings())
    place, yaw = compared(flown, poses_of(log))
    assert max(place, yaw) < 0.02
    assert "taken for the log's" in log.notes[-1]
    assert settings.visual_odometry.delay_std == VisualOdometrySettings().delay_std


def test_without_turns_and_common_time_it_needs_an_offset(tmp_path):
    flown = Flown(seed=4, turns=0.0)
    path = flown.write(tmp_path / "poses.tum", late=1000.0)
    with pytest.raises(LogError, match="--aid-offset"):
        with_poses(flown.log, path, FilterSettings())
    log, _ = with_poses(flown.log, path, FilterSettings(), 1000.0)
    assert poses_of(log).t_ns[0] * 1e-9 == pytest.approx(6.0, abs=1e-6)
    log, _ = with_poses(replace(flown.log, utc_zero_ns=-1000 * 10**9), path, FilterSettings())
    assert poses_of(log).t_ns[0] * 1e-9 == pytest.approx(6.0, abs=1e-6)
    with pytest.raises(LogError, match="share no time"):
        with_poses(flown.log, path, FilterSettings(), 1e6)


@pytest.mark.parametrize("offset", [None, 0.0])
def test_poses_of_another_flight_are_refused(tmp_path, offset):
    path = Flown(seed=5).write(tmp_path / "poses.tum")
    with pytest.raises(LogError, match="another flight"):
        with_poses(Flown(seed=6).log, path, FilterSettings(), offset)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_world_is_refused(tmp_path, axis):
    flown = Flown(seed=10)
    path = flown.write(tmp_path / "poses.tum")
    rows = np.loadtxt(path)
    rows[:, 1 + axis] *= -1.0
    imaginary = [4, 5, 6]
    imaginary.remove(4 + axis)
    rows[:, imaginary] *= -1.0
    np.savetxt(path, rows)
    with pytest.raises(LogError, match="mirrored"):
        with_poses(flown.log, path, FilterSettings())


def test_poses_of_the_log_itself_are_left_out(tmp_path):
    flown = Flown(seed=7)
    path = flown.write(tmp_path / "poses.tum")
    of_log = Events.from_columns(np.arange(6, 9) * 10**9, Kind.POSE, *np.zeros((7, 3)))
    log = replace(flown.log, events=merge(flown.events, of_log))
    found, _ = with_poses(log, path, FilterSettings())
    assert len(poses_of(found)) == (SECONDS - 1.0) * RATE / 10
    assert any("3 poses of the log itself" in note for note in found.notes)


def test_what_it_states_of_its_drift_replaces_the_walks(tmp_path):
    flown = Flown(seed=8)
    k = np.arange(100, int(SECONDS * RATE), 50)
    to_w = so3.to_matrix(flown.q[k]) @ TILTED
    step = np.einsum("nji,nj->ni", to_w[:-1], np.diff(flown.pos[k], axis=0))
    turn = so3.from_matrix(to_w[:-1].transpose(0, 2, 1) @ to_w[1:])[:, [1, 2, 3, 0]]
    root = np.random.default_rng(8).normal(0.0, 0.01, (6, 6))
    P = root @ root.T
    ends = np.column_stack([flown.t[k[:-1]], flown.t[k[1:]]])
    upper = np.tile(P[UPPER], (len(step), 1))
    path = tmp_path / "rel.csv"
    np.savetxt(path, np.column_stack([ends, step, turn, upper]), delimiter=",")
    log, settings = with_poses(flown.log, path, FilterSettings())
    rows = poses_of(log)
    assert compared(flown, rows)[1] < 0.02
    used = settings.visual_odometry
    assert (used.walk, used.speed_walk, used.yaw_walk, used.scale_std) == (0.0,) * 4
    # by our attitude, but for where its frame points
    L = np.zeros((len(rows), 3, 3))
    lower = np.tril_indices(3)
    L[:, lower[0], lower[1]] = rows.values[:, 7:13]
    stated = (L @ L.transpose(0, 2, 1))[1:]
    true = to_w[:-1] @ P[:3, :3] @ to_w[:-1].transpose(0, 2, 1)
    np.testing.assert_allclose(
        stated[:, 0, 0] + stated[:, 1, 1], true[:, 0, 0] + true[:, 1, 1], rtol=0.1
    )
    assert (stated[:, 2, 2] > true[:, 2, 2] - 1e-5).all()  # and what a tilt makes of the way
    about_down = (to_w[1:] @ P[3:, 3:] @ to_w[1:].transpose(0, 2, 1))[:, 2, 2]
    np.testing.assert_allclose(rows.values[1:, 5] ** 2, about_down, rtol=0.1)


def test_the_settings_stay_where_it_states_nothing(tmp_path):
    flown = Flown(seed=9)
    own = VisualOdometrySettings(scale_std=0.07, delay=0.1, delay_std=0.004)
    path = flown.write(tmp_path / "poses.tum")
    _, settings = with_poses(flown.log, path, FilterSettings(visual_odometry=own))
    assert settings.visual_odometry == replace(own, use=True, delay=0.0)  # it is in what was found
    _, settings = with_poses(flown.log, path, FilterSettings(visual_odometry=own), 0.0)
    assert settings.visual_odometry == replace(own, use=True)


def test_a_log_without_inertial_samples_is_refused(tmp_path):
    flown = Flown()
    path = flown.write(tmp_path / "poses.tum")
    baro = Events.from_columns(flown.events.t_ns, Kind.BARO, np.zeros(len(flown.t)))
    with pytest.raises(LogError, match="no inertial samples"):
        with_poses(replace(flown.log, events=baro), path, FilterSettings())


@pytest.mark.skipif(not euroc.FOLDER.exists(), reason="needs ../shared")
def test_a_real_visual_odometry_is_aligned_and_holds_a_minute_without_fixes():
    flight, cut = euroc.Flight(), (110.0, 170.0)
    log = Recording(
        family="unknown", events=merge(flight.fixes(1, cut=cut), flight.imu), notes=("a log",)
    )
    found, settings = with_poses(log, euroc.FOLDER / "vio_mono.tum", FilterSettings())
    rows = poses_of(found)
    ours = flight.poses()  # by the known axes and clock
    assert "by the turns" in found.notes[-1]
    assert abs(int(rows.t_ns[-1] - ours.t_ns[-1])) < 50e6  # as late as the source itself is
    yaw = so3.wrap(rows.values[-len(ours) :, 3] - ours.values[:, 3])
    assert np.abs(so3.wrap(yaw - np.median(yaw))).max() < 0.1
    chosen = settings.visual_odometry
    flown = flight.fly(found.events.take(found.events.kind != Kind.IMU), delay_std=chosen.delay_std)
    inside = (flown.t >= cut[0]) & (flown.t < cut[1])
    away = flown.error[inside] - flown.error[inside][0]
    assert euroc.rms(away) < 0.3


LOGS = [
    "px4-ulg-x500-mission/x500_mission_2023.ulg",
    "ardupilot-bin-copter-netherlands/spark404_log.bin",
    "tlog-transcoded-x500-mission/x500_mission_highres.tlog",
]


@pytest.mark.parametrize("name", LOGS)
def test_real_logs_of_each_kind_take_poses_of_another_clock(tmp_path, name):
    path = DATA / name
    if not path.exists():
        pytest.skip("needs ../shared")
    convert(path, tmp_path / "own.tum", Config(), rate=10.0)
    rows = np.loadtxt(tmp_path / "own.tum")
    rows[:, 0] += 5000.0
    np.savetxt(tmp_path / "poses.tum", rows, fmt="%.9f")
    table, report = estimate(path, Config(), None, PoseFile(tmp_path / "poses.tum"))
    note = next(note for note in report.notes if note.startswith("poses.tum: "))
    assert float(note.split()[1]) == pytest.approx(-5000.0, abs=0.02)
    fused = report.health.verdicts[Aid.VISUAL_ODOMETRY][Verdict.FUSED]
    assert fused > len(rows)  # position, then yaw
    assert len(table) > 1000
