"""Estimates in every format, read back by the format's own maintained reader."""

import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import Config
from ekf_companion.errors import LogError, MissingPackageError
from ekf_companion.logs import ulog
from ekf_companion.logs.writer import WRITERS, Thinning, open_writer, with_position
from ekf_companion.nav import reason
from ekf_companion.nav.state import (
    COLUMNS,
    GEODETIC,
    POSITION,
    QUATERNION,
    WIND,
    WIND_SIGMA,
    Status,
    Table,
)
from ekf_companion.review.convert import convert, estimate, estimate_and_smooth
from sim_autopilot.__main__ import app as sim
from tests.daemon.waiting import LIMIT


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return a simulated flight, its estimates, and the same in a file of each kind."""
    folder = tmp_path_factory.mktemp("flight")
    log = folder / "flight.tlog"
    words = ("generate", "--scenario", "figure-eight", "--duration", "25", "--imu-rate", "100")
    result = CliRunner().invoke(sim, [*words, "-o", str(log)])
    assert result.exit_code == 0, result.output
    outs = [*(f"out{suffix}" for suffix in WRITERS), "out.tlog"]
    arguments = [part for out in outs for part in ("-o", str(folder / out))]
    result = CliRunner().invoke(app, ["convert", str(log), *arguments])
    assert result.exit_code == 0, result.output
    return folder, estimate(log, Config())[0]


def test_all_are_written_in_one_go_and_as_if_alone(flown, tmp_path):
    folder, _ = flown
    for suffix in (*WRITERS, ".tlog"):
        alone = tmp_path / f"out{suffix}"
        convert(folder / "flight.tlog", alone, Config())
        assert alone.read_bytes() == (folder / f"out{suffix}").read_bytes()


def test_parquet_has_every_bit_units_and_frames(flown):
    from pyarrow import parquet

    folder, table = flown
    read = parquet.read_table(folder / "out.parquet")
    assert read.column_names == COLUMNS
    assert read.column("time_us").to_pylist() == (table.stamp_ns // 1000).tolist()
    for name in COLUMNS[1:-3]:
        ours, theirs = table.column(name), read.column(name).to_numpy()
        assert read.column(name).null_count == np.isnan(ours).sum()
        assert np.where(np.isnan(ours), 0.0, ours).tobytes() == np.nan_to_num(theirs).tobytes()
    words = [Status(int(one)).name.lower() for one in table.column("status")]
    assert read.column("status").to_pylist() == words
    sets = [reason.from_names(text) for text in read.column("reasons").to_pylist()]
    assert sets == table.column("reasons").tolist()
    said = {field.name: field.metadata for field in read.schema}
    assert said["vel_d"] == {b"unit": b"m/s", b"frame": b"north-east-down of the origin"}
    assert said["gyro_bias_x"][b"unit"] == b"rad/s"
    assert set(said) == set(COLUMNS)


def test_mcap_holds_poses_fixes_transforms_plots_and_log_lines(flown):
    from mcap.reader import make_reader

    folder, table = flown
    with (folder / "out.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema.encoding == "jsonschema"
            assert channel.message_encoding == "json"
            content = json.loads(message.data)
            properties = json.loads(schema.data)["properties"]
            if channel.topic == "/estimate":
                # One type a number, which Foxglove asks for; what is not known is left out
                assert content.keys() <= properties.keys()
                assert all(isinstance(one["type"], str) for one in properties.values())
                assert None not in content.values()
            else:
                assert content.keys() == properties.keys()
            if "timestamp" in content:
                stamp = content["timestamp"]
                assert stamp["sec"] * 1_000_000_000 + stamp["nsec"] == message.log_time
            found.setdefault((channel.topic, schema.name), []).append((message.log_time, content))
    assert {name for _, name in found} == {
        "ekf_companion.Estimate",
        "foxglove.PoseInFrame",
        "foxglove.FrameTransform",
        "foxglove.LocationFix",
        "foxglove.Log",
    }
    plots = found["/estimate", "ekf_companion.Estimate"]
    assert [stamp for stamp, _ in plots] == table.stamp_ns.tolist()
    assert plots[-1][1]["vel_n"] == table.column("vel_n")[-1]
    assert "vel_n" not in plots[0][1]
    assert set(COLUMNS[1:]) - set(plots[-1][1]) <= {*WIND, *WIND_SIGMA}
    stamps = table.stamp_ns.tolist()
    for stamp, pose in found["/pose", "foxglove.PoseInFrame"]:
        row = stamps.index(stamp)
        north, east, down = (table.column(name)[row] for name in POSITION)
        assert pose["pose"]["position"] == {"x": east, "y": north, "z": -down}
    times = np.diff([stamp for stamp, _ in found["/pose", "foxglove.PoseInFrame"]])
    assert 1e9 / np.median(times) == pytest.approx(25.0, rel=0.01)
    fix = found["/location", "foxglove.LocationFix"][-1][1]
    row = stamps.index(found["/location", "foxglove.LocationFix"][-1][0])
    place = [fix["latitude"], fix["longitude"], fix["altitude"]]
    assert place == [table.column(name)[row] for name in GEODETIC]
    assert fix["position_covariance"][0] == table.column("sd_pos_e")[row] ** 2
    lines = [one["message"] for _, one in found["/log", "foxglove.Log"]]
    assert lines[0].startswith("status aligning, 0 resets")
    assert any(line.startswith("status ok") for line in lines)


def test_tum_is_a_trajectory_to_evo(flown):
    from evo.tools import file_interface

    folder, table = flown
    found = file_interface.read_tum_trajectory_file(str(folder / "out.tum"))
    assert found.check()[0]
    table = with_position(table)
    assert found.num_poses == len(table)
    np.testing.assert_allclose(found.timestamps * 1e9, table.stamp_ns, atol=500)  # a float's digits
    north, east, down = (table.column(name) for name in POSITION)
    np.testing.assert_allclose(found.positions_xyz.T, [east, north, -down], atol=1e-6)
    # The nose and the left wing, east, north and up
    C_nb = Rotation.from_quat(np.roll(table.columns(QUATERNION), -1, axis=1)).as_matrix()
    q = np.roll(found.orientations_quat_wxyz, -1, axis=1)
    C_enu_flu = Rotation.from_quat(q).as_matrix()
    to_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(C_enu_flu[:, :, 0], (to_enu @ C_nb)[:, :, 0], atol=1e-7)
    np.testing.assert_allclose(C_enu_flu[:, :, 1], -(to_enu @ C_nb)[:, :, 1], atol=1e-7)


def test_gpx_is_a_track_with_times_and_heights(flown):
    import gpxpy

    folder, table = flown
    with (folder / "out.gpx").open() as file:
        track = gpxpy.parse(file, version="1.1").tracks[0]
    points = [point for segment in track.segments for point in segment.points]
    kept = Thinning(5.0).thin(table)
    kept = with_position(kept)
    assert len(points) == len(kept)
    assert points[-1].elevation == pytest.approx(kept.column("alt_m")[-1], abs=6e-4)
    assert points[-1].latitude == pytest.approx(kept.column("lat_deg")[-1], abs=1e-9)
    boot_s = 1_780_000_000.0  # by the clock of the recorder
    assert points[-1].time.timestamp() - boot_s == pytest.approx(kept.stamp_ns[-1] * 1e-9, abs=1e-6)


def test_kml_keeps_to_its_schema_and_says_how_high(flown):
    import fastkml
    from fastkml.validator import validate

    folder, table = flown
    assert validate(file_to_validate=folder / "out.kml")
    document = fastkml.KML.parse(folder / "out.kml", strict=True).features[0]
    text = (folder / "out.kml").read_text()
    assert text.count("<altitudeMode>absolute</altitudeMode>") == len(document.features)
    kept = with_position(Thinning(5.0).thin(table))
    words = {Status(int(one)).name.lower() for one in kept.column("status")}
    assert {feature.name for feature in document.features} == words
    # One stretch begins where the one before ends
    assert text.count("<when>") == len(kept) + len(document.features) - 1
    lon, lat, alt = (float(one) for one in text.rsplit("<gx:coord>")[-1].split("<")[0].split())
    assert [lat, lon, alt] == pytest.approx([kept.column(name)[-1] for name in GEODETIC], abs=6e-4)


def test_ulog_has_px4s_topics_for_pyulog_and_for_us(flown, capsys):
    from pyulog import ULog

    folder, table = flown
    log = ULog(str(folder / "out.ulg"))
    assert not log.file_corruption
    assert capsys.readouterr().out == ""
    assert log.msg_info_dict["sys_name"] == "ekf-companion"
    attitude = log.get_dataset("vehicle_attitude").data
    known = np.isfinite(table.column("q_w"))
    assert attitude["timestamp"].tolist() == (table.stamp_ns[known] // 1000).tolist()
    np.testing.assert_array_equal(attitude["q[3]"], table.column("q_z")[known].astype(np.float32))
    local = log.get_dataset("vehicle_local_position").data
    assert local["vx"][-1] == np.float32(table.column("vel_n")[-1])
    assert local["xy_valid"][-1] == 1
    world = log.get_dataset("vehicle_global_position").data
    assert world["lat"][-1] == table.column("lat_deg")[-1]
    # It holds no sensor: as a log it says so, as a trajectory it is read
    with pytest.raises(LogError, match="an estimate that convert wrote, and no log"):
        convert(folder / "out.ulg", folder / "again.csv", Config())
    reference = ulog.read(folder / "out.ulg").reference
    assert reference.lat[-1] == pytest.approx(np.deg2rad(table.column("lat_deg")[-1]), abs=1e-12)


def test_csv_goes_to_a_pipe_and_the_summary_beside_it(flown):
    folder, _ = flown
    command = (sys.executable, "-m", "ekf_companion", "convert", folder / "flight.tlog")
    done = subprocess.run([*command, "-o", "-"], capture_output=True, check=True, timeout=LIMIT)
    assert done.stdout == (folder / "out.csv").read_bytes()
    assert b"estimates" in done.stderr


def test_a_pipe_that_closes_early_is_no_bug(flown):
    folder, _ = flown
    command = f"{sys.executable} -m ekf_companion convert {folder / 'flight.tlog'} -o - | head -n 1"
    done = subprocess.run(["sh", "-c", command], capture_output=True, timeout=LIMIT, check=True)
    assert done.stdout.startswith(b"time_us,")
    assert b"Traceback" not in done.stderr


def test_smoothed_estimates_go_to_all_kinds(flown, tmp_path):
    from pyarrow import parquet

    folder, _ = flown
    outs = [tmp_path / "a.csv", tmp_path / "a.parquet"]
    convert(folder / "flight.tlog", outs, Config(), is_smoothed=True)
    smoothed = estimate_and_smooth(folder / "flight.tlog", Config())[1]
    read = parquet.read_table(outs[1])
    assert read.column("vel_n").to_numpy()[-1] == smoothed.column("vel_n")[-1]
    assert len(outs[0].read_text().splitlines()) == len(smoothed) + 1


@pytest.mark.parametrize("suffix", [".mcap", ".ulg"])
def test_what_cannot_hold_negative_times_says_so(tmp_path, suffix):
    table = Table(stamp_ns=np.array([-1_000_000]), values=np.zeros((1, len(COLUMNS) - 1)))
    with open_writer(tmp_path / f"out{suffix}") as writer, pytest.raises(LogError, match="zero"):
        writer.write(table)


def test_a_missing_package_is_named_with_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.data_stream", None)
    for name in ("mcap_writer", "mcap_file"):
        monkeypatch.delitem(sys.modules, f"ekf_companion.logs.{name}", raising=False)
    with pytest.raises(MissingPackageError, match=r"out\.mcap: needs mcap.*\[formats\]"):
        open_writer(tmp_path / "out.mcap")


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_file_that_cannot_be_opened_is_named(tmp_path, suffix):
    with pytest.raises(LogError, match="cannot be written"):
        open_writer(tmp_path / "none" / f"out{suffix}")


def test_an_unknown_kind_of_output_is_refused_with_all_that_are_known(flown):
    folder, _ = flown
    result = CliRunner().invoke(app, ["convert", str(folder / "flight.tlog"), "-o", "out.xyz"])
    assert result.exit_code == 2
    assert "known are .csv, .gpx, .kml, .mcap, .parquet, .tum, .ulg, .tlog" in result.output


@pytest.mark.parametrize("suffix", WRITERS)
def test_what_fails_leaves_no_file_and_an_older_one_as_it_was(tmp_path, suffix):
    log = tmp_path / "log.csv"
    log.write_text("time_us,baro_alt_m\n1000,7\n2000,8\n")
    out = tmp_path / f"out{suffix}"
    out.write_bytes(b"older")
    with pytest.raises(LogError, match="no inertial samples"):
        convert(log, [out, tmp_path / "new.csv"], Config())
    assert out.read_bytes() == b"older"
    assert {path.name for path in tmp_path.iterdir()} == {"log.csv", out.name}
