"""Visual odometry on a real flight and on simulated ones: its worth, and what its faults cost."""

import functools

import numpy as np
import pytest

from ekf_companion import estimate
from ekf_companion.core.memory.enums import Aid, Verdict
from ekf_companion.core.settings.settings import (
    BaroSettings,
    FilterSettings,
    VisualOdometrySettings,
    VisualVelocitySettings,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs import csv, dataflash, ulog
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Status
from tests import euroc
from tests.core.flights import flight
from tests.euroc import rms
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_dataflash import of_kind
from tests.logs.test_ulog import COMBINED
from tests.logs.test_ulog import Writer as ULogWriter

has_data = pytest.mark.skipif(not euroc.FOLDER.exists(), reason="needs ../shared")
OWN = 0.215
"""RMS of the visual odometry's own error over the real flight, moved and turned to fit best, m."""


@functools.cache
def real():
    return euroc.Flight()


@functools.cache
def alone(**changes):
    """Return the real flight by its poses alone."""
    return real().fly(real().poses(**changes))


# The real flight, without fixes


@has_data
def test_without_fixes_it_navigates_by_the_poses():
    flown = alone()
    assert rms(flown.aligned()) < 0.26
    assert (flown.status[flown.t > 10.0] == Status.DEGRADED).all()
    assert np.isnan(flown.error).all()  # where on the Earth nobody knows
    assert flown.resets[-1] == 0.0


@has_data
def test_where_the_scale_is_known_it_is_as_good_as_the_poses():
    flown = real().fly(real().poses(), scale_std=0.0, scale_walk=0.0)
    assert rms(flown.aligned()) < 1.02 * OWN


@has_data
@pytest.mark.parametrize("delay", [0.05, 0.1, 0.2, 0.3])
def test_a_delay_is_found(delay):
    found, before = (one.state.visual_odometry_delay for one in (alone(delay=delay), alone()))
    assert found - before == pytest.approx(delay, abs=0.005)


@has_data
@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_a_scale_is_found(scale):
    found, before = (
        1.0 + real().fly(real().poses(scale=one), scale_std=0.1).state.visual_odometry_scale
        for one in (scale, 1.0)
    )
    assert found * scale == pytest.approx(before, abs=0.005)


@has_data
@pytest.mark.parametrize("is_told", [True, False])
def test_a_reset_of_3_m_and_40_degrees_moves_nothing(is_told):
    flown = alone(reset=(90.0, 3.0, 40.0), is_told=is_told)
    step = np.abs(np.diff(flown.local[flown.t > 10.0], axis=0)).max()
    assert step < 0.05
    assert rms(flown.aligned()) < 1.05 * rms(alone().aligned())


@has_data
@pytest.mark.parametrize("yaw", [1.0, -2.5])
def test_its_frame_may_be_turned_anyhow(yaw):
    assert rms(alone(yaw=yaw).aligned()) == pytest.approx(rms(alone().aligned()), rel=0.01)


# The real flight, with fixes

CUT = (110.0, 170.0)


@functools.cache
def cut(seed):
    """Return the real flight whose fixes end for a minute."""
    return real().fly(real().fixes(seed, cut=CUT), real().poses())


@has_data
@pytest.mark.parametrize("seed", range(6))
def test_a_minute_without_fixes_costs_what_the_poses_drift(seed):
    flown = cut(seed)
    inside = (flown.t >= CUT[0]) & (flown.t < CUT[1])
    away = flown.error[inside] - flown.error[inside][0]
    assert rms(away) < 0.3
    assert (flown.status[inside & (flown.t > CUT[0] + 4.0)] == Status.DEGRADED).all()


@has_data
def test_the_errors_are_as_large_as_their_sigmas():
    nees = []
    for seed in range(6):
        flown = cut(seed)
        late = flown.t > 100.0
        nees.append(np.mean((flown.error[late] / flown.std[late]) ** 2))
    # six slow errors of fixes, in three axes, are 18 samples of chi-square
    assert 0.4 < np.mean(nees) < 1.8


@has_data
def test_a_receiver_that_comes_back_300_m_off_is_refused():
    fixes = real().fixes(1, cut=(110.0, 150.0), false=(150.0, 165.0))
    flown = real().fly(fixes, real().poses())
    inside = (flown.t > 110.0) & (flown.t < 165.0)
    assert rms(flown.error[inside] - flown.error[inside][0]) < 0.5
    assert (flown.status[(flown.t > 152.0) & (flown.t < 165.0)] != Status.OK).all()
    assert flown.status[flown.t > 170.0].min() == Status.OK


@has_data
def test_when_fixes_come_the_local_frame_becomes_theirs():
    flown = real().fly(real().fixes(1), real().poses())
    first = np.flatnonzero(np.isfinite(flown.error[:, 0]))[0]
    assert flown.status[first - 1] == Status.DEGRADED
    assert flown.resets[-1] == 1.0
    assert np.all(np.abs(flown.error[first:] / flown.std[first:]) < 4.0)


def mirrored(t, pos, yaw):
    return t, pos[:, [1, 0, 2]] * [1.0, 1.0, -1.0], np.pi / 2.0 - yaw


def freezes(t, pos, yaw):
    at = np.flatnonzero((t > 100.0) & (t < 120.0))
    pos[at], yaw[at] = pos[at[0]], yaw[at[0]]
    return t, pos, yaw


def strays(t, pos, yaw):
    rng = np.random.default_rng(2)
    stray = rng.random(len(t)) < 0.02
    pos[stray] += rng.normal(0.0, 5.0, (stray.sum(), 3))
    return t, pos, yaw


def jitters(t, pos, yaw):
    return t + np.random.default_rng(3).normal(0.0, 0.02, len(t)), pos, yaw


def trembles(t, pos, yaw):
    return t, pos + np.random.default_rng(4).normal(0.0, 0.2, pos.shape), yaw


def slips(t, pos, yaw):
    turn = np.deg2rad(2.0) * np.clip(t - 100.0, 0.0, 20.0)
    steps = np.diff(pos, axis=0, prepend=pos[:1])
    c, s = np.cos(turn), np.sin(turn)
    north, east = c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]
    return t, pos[0] + np.cumsum(np.column_stack([north, east, steps[:, 2]]), axis=0), yaw + turn


def drifts(t, pos, yaw):
    return t, pos + np.outer(0.1 * np.clip(t - 100.0, 0.0, 20.0), [1.0, 0.0, 0.0]), yaw


@has_data
@pytest.mark.parametrize(
    "fault", [mirrored, freezes, strays, jitters, trembles, slips, drifts], ids=lambda f: f.__name__
)
def test_beside_fixes_no_fault_of_it_is_a_lie(fault):
    flown = real().fly(real().fixes(1), real().poses(change=fault))
    ok = (flown.t > 90.0) & (flown.status == Status.OK)
    assert ok.sum() > 1000
    assert np.max(np.abs(flown.error[ok] / flown.std[ok])) < 4.0


# A simulated flight: the velocity alone


class Simulated:
    """A figure of eight, whose fixes end after 30 s, with velocities of another estimator."""

    def __init__(self, seed):
        events, truth = flight("figure-eight", 70.0, seed)
        self.truth = truth
        begin_ns = events.t_ns[0]
        is_cut = (events.kind == Kind.GNSS) & (events.t_ns - begin_ns > 40e9)
        self.events = events.take(~is_cut)
        self.t_ns = np.arange(begin_ns, events.t_ns.max(), 50_000_000)
        self.vel_n = np.stack(
            [np.interp(self.t_ns, truth.vel_t_ns, one) for one in truth.vel_n.T], axis=1
        )
        at = np.clip(np.searchsorted(truth.att_t_ns, self.t_ns), 0, len(truth.q_nb) - 1)
        self.q_nb = truth.q_nb[at]
        self.rng = np.random.default_rng(seed)

    def velocities(self, *, is_level, scale=1.0, yaw=0.0):
        c, s = np.cos(yaw), np.sin(yaw)
        said = self.vel_n @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        if not is_level:
            said = so3.rotate(so3.conjugate(self.q_nb), self.vel_n)
        said = scale * said + self.rng.normal(0.0, 0.1, said.shape)
        unknown = np.full(len(said), np.nan)
        level = np.full(len(said), float(is_level))
        return Events.from_columns(self.t_ns, Kind.VELOCITY, *said.T, unknown, level)

    def fly(self, *others):
        settings = FilterSettings(visual_velocity=VisualVelocitySettings(use=bool(others)))
        pipeline = Pipeline(settings, "px4", None)
        table = pipeline.run(merge(self.events, *others))
        frame = LocalFrame(self.truth.lat[0], self.truth.lon[0], self.truth.alt[0])
        lat, lon = (np.deg2rad(table.column(one)) for one in ("lat_deg", "lon_deg"))
        ours = frame.to_ned(lat, lon, table.column("alt_m"))
        true = frame.to_ned(self.truth.lat, self.truth.lon, self.truth.alt)
        true = np.stack(
            [np.interp(table.stamp_ns, self.truth.pos_t_ns, one) for one in true.T], axis=1
        )
        late = table.stamp_ns > self.t_ns[0] + 40e9
        std = table.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])
        return (ours - true)[late], std[late], pipeline


@pytest.mark.parametrize("is_level", [True, False])
def test_a_velocity_alone_holds_the_position_without_fixes(is_level):
    one = Simulated(1)
    error, std, pipeline = one.fly(one.velocities(is_level=is_level))
    without_it = one.fly()[0]
    assert np.linalg.norm(error[-1, :2]) < 0.2 * np.linalg.norm(without_it[-1, :2])
    assert np.max(np.abs(error / std)) < 4.0
    assert pipeline.filter_state.count[Aid.VISUAL_VELOCITY][Verdict.FUSED] > 500


@pytest.mark.parametrize("is_level", [True, False])
def test_its_scale_and_the_yaw_of_its_frame_are_found(is_level):
    one = Simulated(2)
    x = one.fly(one.velocities(is_level=is_level, scale=0.9, yaw=0.2))[2].filter_state
    assert (1.0 + x.visual_velocity_scale) * 0.9 == pytest.approx(1.0, abs=0.02)
    if is_level:
        assert x.visual_velocity_frame_yaw == pytest.approx(-0.2, abs=0.05)


# Logs and arrays


OLD = "TimeUS,RTimeUS,CTimeMS,PX,PY,PZ,Roll,Pitch,Yaw,PErr,AErr,RstCnt"
NEW = "TimeUS,RTimeUS,CTimeMS,PX,PY,PZ,R,P,Y,PErr,AErr,Rst,Ign,Q"


@pytest.mark.parametrize("columns", [OLD, NEW])
def test_a_dataflash_log_holds_poses_and_velocities(tmp_path, columns):
    is_new = columns is NEW
    log = DataFlashWriter()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "VISP", "QQIffffffffBBb" if is_new else "QQIffffffffB", columns)
    log.define(3, "VISV", "QQIffffBBb", "TimeUS,RTimeUS,CTimeMS,VX,VY,VZ,VErr,Rst,Ign,Q")
    for k in range(20):
        t_us = 1_000_000 + 10_000 * k
        log.row("IMU", t_us, 0, *[0.0] * 5, -9.8)
        ignored, quality = int(k == 3), -1 if k == 5 else 50
        pose = (k, 2.0, 3.0, 0.0, 0.0, 270.0, 0.1, 0.1)
        log.row("VISP", t_us, 5, 6, *pose, 4, *((ignored, quality) if is_new else ()))
        log.row("VISV", t_us, 5, 6, 1.0, 2.0, 3.0, 0.1, 4, ignored, quality)
    path = tmp_path / "vision.bin"
    path.write_bytes(log.data)
    recording = dataflash.read(path)
    poses, velocities = (of_kind(recording, kind) for kind in (Kind.POSE, Kind.VELOCITY))
    left_out = (3, 5) if is_new else ()
    assert poses.values[:, 0].tolist() == [k for k in range(20) if k not in left_out]
    assert poses.values[0, 1:4].tolist() == pytest.approx([2.0, 3.0, -np.pi / 2.0])
    assert np.isnan(poses.values[0, 4:6]).all()
    assert poses.values[0, 6] == 4.0
    assert len(velocities) == 18
    assert velocities.values[0, [0, 1, 2, 4]].tolist() == [1.0, 2.0, 3.0, 1.0]


def test_a_ulog_holds_poses_and_velocities(tmp_path):
    fields = [
        ("uint64_t", "timestamp"),
        ("uint64_t", "timestamp_sample"),
        ("float[3]", "position"),
        ("float[4]", "q"),
        ("float[3]", "velocity"),
        ("float[3]", "position_variance"),
        ("float[3]", "velocity_variance"),
        ("uint8_t", "velocity_frame"),
        ("uint8_t", "reset_counter"),
        ("int8_t", "quality"),
    ]
    log = ULogWriter([COMBINED, ("vehicle_visual_odometry", fields)])
    q = so3.from_euler(0.0, 0.0, 0.5)
    nowhere = [np.nan] * 3
    for k in range(20):
        t_us = 1_000_000 + 10_000 * k
        log.row(0, t_us, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        place = nowhere if k == 4 else [float(k), 2.0, 3.0]
        rest = [*[0.04] * 3, *[0.09] * 3, 3 if k % 2 else 1, 7, -1 if k == 6 else 80]
        log.row(1, t_us, t_us - 5000, *place, *q, 1.0, 2.0, 3.0, *rest)
    path = tmp_path / "vision.ulg"
    path.write_bytes(log.data)
    recording = ulog.read(path)
    poses, velocities = (of_kind(recording, kind) for kind in (Kind.POSE, Kind.VELOCITY))
    assert poses.values[:, 0].tolist() == [k for k in range(20) if k not in (4, 6)]
    assert poses.t_ns[0] == 995_000_000
    assert poses.values[0, 3:5].tolist() == pytest.approx([0.5, 0.2], rel=1e-6)
    assert poses.values[0, 6] == 7.0
    assert len(velocities) == 19
    assert velocities.values[:2, 4].tolist() == [1.0, 0.0]
    assert velocities.values[0, 3] == pytest.approx(0.3, rel=1e-6)


def test_a_csv_holds_poses_and_velocities(tmp_path):
    header = "time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,"
    header += "odometry_x_m,odometry_y_m,odometry_z_m,odometry_yaw_deg,odometry_counter,"
    header += "odometry_vx_mps,odometry_vy_mps,odometry_vz_mps"
    rows = [header]
    for k in range(20):
        pose = f"{k},2,3,90,1,4,5,6" if k % 2 else ",,,,,,,"
        rows.append(f"{0.01 * k:.2f},0,0,0,0,0,-9.8,{pose}")
    path = tmp_path / "poses.csv"
    path.write_text("\n".join(rows) + "\n")
    recording = csv.read(path)
    poses, velocities = (of_kind(recording, kind) for kind in (Kind.POSE, Kind.VELOCITY))
    assert poses.values[:, 0].tolist() == [*range(1, 20, 2)]
    assert poses.values[0, [1, 2, 3, 6]].tolist() == pytest.approx([2.0, 3.0, np.pi / 2.0, 1.0])
    assert velocities.values[:, :3].tolist() == [[4.0, 5.0, 6.0]] * 10
    assert np.isnan(velocities.values[0, 4])  # in the body, unless it says otherwise


def test_a_csv_holds_the_drift_from_pose_to_pose(tmp_path):
    lower = ("xx", "yx", "yy", "zx", "zy", "zz")
    header = "time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,"
    header += "odometry_x_m,odometry_y_m,odometry_z_m,odometry_yaw_drift_deg,"
    header += ",".join(f"odometry_drift_{one}_cm" for one in lower)
    path = tmp_path / "drift.csv"
    rows = [f"{0.01 * k:.2f},0,0,0,0,0,-9.8,{k},0,0,90,1,2,3,4,5,{6 + k}" for k in range(20)]
    path.write_text("\n".join([header, *rows]) + "\n")
    poses = of_kind(csv.read(path), Kind.POSE)
    assert poses.values[1, 5] == pytest.approx(np.pi / 2.0)
    assert poses.values[1, 7:13].tolist() == pytest.approx([0.01, 0.02, 0.03, 0.04, 0.05, 0.07])


@has_data
def test_arrays_of_poses_are_an_aid_by_name():
    one, poses = real(), real().poses()
    part = slice(0, 8000)
    columns = dict(zip(("x", "y", "z", "yaw"), poses.values.T, strict=False))
    columns["time"] = poses.t_ns * 1e-9
    found = estimate(
        one.imu_ns[part] * 1e-9,
        one.gyro[part],
        one.accel[part],
        aids={"visual_odometry": {name: one[:700] for name, one in columns.items()}},
        settings=FilterSettings(
            baro=BaroSettings(use=False),
            visual_odometry=VisualOdometrySettings(use=True),
        ),
    )
    assert np.isfinite(found.pos_n[-1]).all()
