import csv
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.errors import LogError
from ekf_companion.logs import tlog
from ekf_companion.logs.recording import Recording
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav.measurements import (
    BaroSample,
    Events,
    GnssFix,
    HeadingSample,
    HeadingSource,
    ImuSample,
    MagSample,
    VehicleState,
)
from sim_autopilot import replay
from sim_autopilot.__main__ import app
from sim_autopilot.recording import TRUTH_HEADER


def command(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def generated(folder, *options):
    result = command(
        "generate", "--scenario", "hover", "-o", folder / "a.tlog", "--truth", folder / "a.csv",
        "--duration", 8, *options,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return folder / "a.tlog", folder / "a.csv"


def messages(frames, name):
    for _, raw in frames:
        for frame in Splitter().feed(raw):
            if frame.message_id == IDS[name]:
                yield unpack(frame)


def test_a_generated_log_reads_back_with_its_times(tmp_path):
    path, _ = generated(tmp_path)
    frames = list(replay.frames(path))
    stamps = [message.time_usec for message in messages(frames, "HIGHRES_IMU")]
    assert stamps == [20_004_000 + 4000 * k for k in range(2000)]
    sent = [t for t, raw in frames if Splitter().feed(raw)[0].message_id == IDS["HIGHRES_IMU"]]
    assert sent == [1_780_000_000_000_000_000 + stamp * 1000 for stamp in stamps]
    assert tlog.read(path).damaged == 0


def test_the_truth_file_agrees_with_the_truth_on_the_wire(tmp_path):
    path, truth = generated(tmp_path)
    with truth.open() as file:
        rows = list(csv.DictReader(file))
    assert ",".join(rows[0]) == TRUTH_HEADER
    assert len(rows) == 2000
    states = list(messages(replay.frames(path), "SIM_STATE"))
    for state, row in zip(states, rows[::10], strict=True):
        assert state.lat_int == pytest.approx(float(row["lat_deg"]) * 1e7, abs=1)
        assert state.yaw == pytest.approx(float(row["yaw_rad"]), abs=1e-6)
        assert state.vn == pytest.approx(float(row["vn_mps"]), abs=1e-5)
        assert state.alt == pytest.approx(float(row["alt_m"]), abs=1e-4)


def test_generating_twice_gives_the_same_file_and_another_seed_another(tmp_path):
    files = []
    for name, seed in (("one", 3), ("again", 3), ("other", 4)):
        (tmp_path / name).mkdir()
        files.append(generated(tmp_path / name, "--seed", seed)[0].read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_numbers_come_from_the_configuration_and_wrong_ones_are_refused(tmp_path):
    good, bad, worse = (tmp_path / name for name in ("good.yaml", "bad.yaml", "worse.yaml"))
    good.write_text("imu: {rate: 100}\ngnss: {rate: 10, noise_h: 2.5}\n")
    bad.write_text("gnss: {raet: 10}\n")
    worse.write_text("gnss: {rate: fast}\n")
    path, _ = generated(tmp_path, "--config", good)
    frames = list(replay.frames(path))
    assert sum(1 for _ in messages(frames, "HIGHRES_IMU")) == 800
    fixes = list(messages(frames, "GPS_RAW_INT"))
    assert (len(fixes), fixes[0].h_acc) == (80, 2500)
    for file, word in ((bad, "gnss.raet"), (worse, "gnss.rate")):
        result = command("generate", "-o", tmp_path / "b.tlog", "--config", file)
        assert result.exit_code == 2
        assert word in result.output.replace("\n", "")


def test_an_unknown_scenario_is_refused_with_those_that_there_are(tmp_path):
    result = command("generate", "--scenario", "loop", "-o", tmp_path / "b.tlog")
    assert result.exit_code == 2
    assert "figure-eight" in result.output


@pytest.mark.parametrize(
    "options",
    [
        ("-o", "b.csv"),
        ("-o", "none/b.tlog"),
        ("-o", "b.tlog", "--seed", -1),
        ("-o", "b.tlog", "--duration", "inf"),
        ("-o", "b.tlog", "--skip", "inf"),
        ("-o", "b.tlog", "--imu-rate", 100_000),
    ],
)
def test_what_cannot_be_generated_is_a_sentence(tmp_path, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    result = command("generate", *options)
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)
    assert "Errno" not in result.output
    assert not any(tmp_path.iterdir())


def test_scenarios_are_listed():
    assert "square-spiral" in command("scenarios").output


def test_a_log_without_frames_becomes_the_messages_of_its_autopilot():
    imu = {"gyro_x": 0.1, "gyro_y": 0.2, "gyro_z": 0.3}
    imu |= {"accel_x": 1.0, "accel_y": 2.0, "accel_z": -9.0}
    rows = [
        VehicleState(t_ns=0, is_armed=True, is_landed=False),
        MagSample(t_ns=1_000_000, mag_x=0.2, mag_y=0.0, mag_z=0.4),
        BaroSample(t_ns=1_000_000, alt=100.0),
        ImuSample(t_ns=4_000_000, **imu),
        ImuSample(t_ns=8_000_000, **imu),
        HeadingSample(t_ns=8_000_000, heading=0.0, std=0.03, source=HeadingSource.GNSS),
        GnssFix(
            t_ns=9_000_000,
            lat=math.radians(47.0),
            lon=math.radians(8.0),
            alt=500.0,
            vel_north=0.0,
            vel_east=-3.0,
            std_h=1.5,
            std_v=2.5,
            std_vel=0.2,
        ),
    ]
    recording = Recording(family="px4", events=Events.from_rows([row.row() for row in rows]))
    frames = list(replay.of_recording(recording))
    first, second = messages(frames, "HIGHRES_IMU")
    assert (first.time_usec, second.time_usec) == (4000, 8000)
    assert first.fields_updated & 64
    assert first.fields_updated & 512
    assert second.fields_updated == 0x3F
    assert (first.xgyro, first.zacc) == (pytest.approx(0.1), pytest.approx(-9.0))
    (fix,) = messages(frames, "GPS_RAW_INT")
    assert (fix.lat, fix.lon, fix.alt) == (470_000_000, 80_000_000, 500_000)
    assert (fix.vel, fix.cog, fix.yaw) == (300, 27000, 36000)
    assert (fix.h_acc, fix.v_acc, fix.vel_acc) == (1500, 2500, 200)
    assert next(messages(frames, "HEARTBEAT")).autopilot == 12
    times = [t for t, _ in frames]
    assert times == sorted(times)
    assert np.all(np.diff(times) >= 0)


def test_a_heading_of_no_receiver_goes_out_as_the_autopilots_own():
    heading = HeadingSample(t_ns=0, heading=1.5, std=0.1, source=HeadingSource.MAGNETOMETER)
    recording = Recording(family="unknown", events=Events.from_rows([heading.row()]))
    (attitude,) = messages(replay.of_recording(recording), "ATTITUDE")
    assert attitude.yaw == pytest.approx(1.5)


def test_a_log_that_counts_from_1970_begins_like_an_autopilot():
    start_ns = 1_400_000_000_000_000_000
    rows = [
        HeadingSample(t_ns=start_ns, heading=1.0, std=0.1, source=HeadingSource.AUTOPILOT),
        BaroSample(t_ns=start_ns + 5_000_000_000, alt=0.0),
        HeadingSample(
            t_ns=start_ns + 5_000_000_000, heading=1.0, std=0.1, source=HeadingSource.AUTOPILOT
        ),
    ]
    recording = Recording(family="unknown", events=Events.from_rows([row.row() for row in rows]))
    frames = list(replay.of_recording(recording))
    assert [one.time_boot_ms for one in messages(frames, "ATTITUDE")] == [1000, 6000]
    assert [t for t, _ in frames][-1] == 6_000_000_000


def test_what_cannot_be_replayed_is_refused_with_what_can():
    with pytest.raises(LogError, match=r"\.tlog, \.bin, \.ulg, \.csv"):
        replay.frames(Path("flight.mcap"))


def test_personalities_and_faults_are_generated_and_repeat(tmp_path):
    files = []
    for name in ("one", "again"):
        (tmp_path / name).mkdir()
        files.append(
            generated(
                tmp_path / name,
                *("--personality", "ardupilot", "--fault", "loss:start=2,duration=3,share=0.5"),
                *("--fault", "gnss-outage:start=4,duration=2"),
            )[0]
        )
    assert files[0].read_bytes() == files[1].read_bytes()
    frames = list(replay.frames(files[0]))
    stamps = np.array([m.time_usec for m in messages(frames, "HIGHRES_IMU")]) * 1e-6 - 20.0
    inside = ((stamps > 2.0) & (stamps < 5.0)).sum()
    assert 300 < inside < 450  # of 750: somebody asked, and half of it was lost
    assert ((stamps > 5.0) & (stamps < 8.0)).sum() > 740


def test_the_rate_that_is_asked_for_goes_before_the_personalitys(tmp_path):
    path, _ = generated(tmp_path, "--personality", "ardupilot", "--imu-rate", 250)
    stamps = np.array([m.time_usec for m in messages(replay.frames(path), "HIGHRES_IMU")])
    assert ((stamps - 20_000_000) % 4000 <= 2000).all()  # samples of 4 ms, each sent late


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--personality", "px5"), "no such personality"),
        (("--fault", "fire"), "no such fault"),
        (("--fault", "cut:start=99"), "flight ends at 8 s"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, options, words):
    result = command("generate", "-o", tmp_path / "a.tlog", "--duration", 8, *options)
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())
    assert not any(tmp_path.iterdir())


def test_personalities_and_faults_are_listed():
    assert "px4-old" in command("personalities").output
    listed = command("faults").output
    assert "gnss-drag" in listed
    assert "speed=1" in listed


@pytest.mark.parametrize("option", ["--duration", "--imu-rate"])
def test_a_number_that_is_none_is_refused(tmp_path, option):
    result = command("generate", "-o", tmp_path / "flight.tlog", option, "nan")
    assert result.exit_code == 2
    assert "nan is no number" in result.stderr
