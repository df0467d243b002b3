"""The converter and the comparison through the command line, over flights of our own simulator."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.logs import tlog
from ekf_companion.nav.state import COLUMNS, WIND, WIND_SIGMA
from sim_autopilot.__main__ import app as sim

SECONDS = 25.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with flight.tlog and truth.csv of a figure-eight."""
    folder = tmp_path_factory.mktemp("flight")
    result = CliRunner().invoke(
        sim,
        [
            *("generate", "--scenario", "figure-eight", "--duration", str(SECONDS)),
            *("-o", str(folder / "flight.tlog"), "--truth", str(folder / "truth.csv")),
            *("--imu-rate", "100"),
        ],
    )
    assert result.exit_code == 0, result.output
    return folder


def command(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_row_for_each_sample_with_the_promised_columns(flown, tmp_path):
    out = tmp_path / "out.csv"
    result = command("convert", flown / "flight.tlog", "-o", out)
    assert result.exit_code == 0, result.output
    rows = rows_of(out)
    assert list(rows[0]) == COLUMNS
    stamps = [int(row["time_us"]) for row in rows]
    assert len(rows) == pytest.approx(SECONDS * 100, abs=2)
    assert stamps == sorted(set(stamps))
    assert rows[0]["status"] == "aligning"
    assert rows[0]["lat_deg"] == ""
    assert rows[-1]["status"] == "ok"
    assert rows[-1].pop("reasons") == ""
    assert {rows[-1].pop(name) for name in (*WIND, *WIND_SIGMA)} == {""}
    assert all(rows[-1].values())
    assert "status: aligning" in result.output


def test_numbers_in_the_file_are_the_numbers_of_the_filter(flown, tmp_path):
    from ekf_companion.config.config import Config
    from ekf_companion.review.convert import estimate

    out = tmp_path / "out.csv"
    command("convert", flown / "flight.tlog", "-o", out)
    table, *_ = estimate(flown / "flight.tlog", Config())
    read = np.array([[float(row[name] or "nan") for name in COLUMNS[1:-3]] for row in rows_of(out)])
    assert read.tobytes() == np.ascontiguousarray(table.values[:, :-3]).tobytes()


def test_the_rate_thins_and_the_json_says_what_was_found(flown, tmp_path):
    out = tmp_path / "out.csv"
    result = command("convert", flown / "flight.tlog", "-o", out, "--rate", 10, "--json")
    assert result.exit_code == 0, result.output
    assert len(rows_of(out)) == pytest.approx(SECONDS * 10, abs=2)
    report = json.loads(result.stdout)
    assert report["family"] == "px4"
    assert report["rates_hz"]["imu"] == pytest.approx(100.0, rel=0.01)
    assert report["estimates"] == pytest.approx(SECONDS * 100, abs=2)
    assert report["aids"]["position"]["fused"] > 50
    assert report["seconds"]["ok"] > SECONDS - 5.0


def long_csv(path: Path, start: float) -> Path:
    """Write 450 s at rest, 50 Hz: more events than one chunk of the converter holds."""
    axes = [f"gyro_{axis}_rps" for axis in "xyz"] + [f"accel_{axis}_mps2" for axis in "xyz"]
    with path.open("w") as file:
        file.write(",".join(["time_s", *axes, "heading_deg"]) + "\n")
        for step in range(22_500):
            wobble = 0.01 * (step % 3 - 1)
            file.write(f"{start + step * 0.02:.2f},0,0,0,{wobble},0,-9.8,10\n")
    return path


def test_the_rate_thins_over_the_whole_length_of_a_log(tmp_path):
    out = tmp_path / "out.csv"
    result = command("convert", long_csv(tmp_path / "long.csv", 0.0), "-o", out, "--rate", 0.0625)
    assert result.exit_code == 0, result.output
    periods = [int(row["time_us"]) // 16_000_000 for row in rows_of(out)]
    assert periods == list(range(29))


def test_times_before_zero_make_a_csv_but_no_tlog(tmp_path):
    log = long_csv(tmp_path / "long.csv", -100.0)
    assert command("convert", log, "-o", tmp_path / "out.csv").exit_code == 0
    result = command("convert", log, "-o", tmp_path / "out.tlog")
    assert result.exit_code == 3
    assert "times before zero" in result.output
    assert not (tmp_path / "out.tlog").exists()


def test_a_telemetry_log_gets_our_messages_beside_its_own(flown, tmp_path):
    out = tmp_path / "out.tlog"
    result = command("convert", flown / "flight.tlog", "-o", out)
    assert result.exit_code == 0, result.output
    before, after = tlog.read(flown / "flight.tlog"), tlog.read(out)
    ours = after.columns(["ODOMETRY"], 1, 194)["ODOMETRY"]
    assert len(ours) == pytest.approx((SECONDS - 1.2) * 30, abs=20)  # levelling takes a second
    assert set(ours["estimator_type"]) == {ardupilotmega.MAV_ESTIMATOR_TYPE_VIO}
    assert len(after) > len(before) + len(ours) - 1
    again = tmp_path / "again.tlog"
    command("convert", out, "-o", again)
    assert again.read_bytes() == out.read_bytes()


def test_the_estimate_compares_to_the_truth_and_to_the_autopilot(flown, tmp_path):
    figure = tmp_path / "figure.png"
    result = command(
        "compare", flown / "flight.tlog", "--reference", flown / "truth.csv", "--skip", 12,
        "--plot", figure, "--json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    ours, autopilot = json.loads(result.stdout)
    assert ours["horizontal_m"]["rms"] < 0.6
    assert ours["yaw_deg"]["rms"] < 1.5
    assert autopilot["horizontal_m"]["rms"] > 0.0
    assert figure.read_bytes().startswith(b"\x89PNG")

    out = tmp_path / "out.csv"
    command("convert", flown / "flight.tlog", "-o", out)
    result = command("compare", out, "--reference", flown / "truth.csv", "--skip", 12, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)[0]["horizontal_m"]["rms"] == pytest.approx(
        ours["horizontal_m"]["rms"], rel=1e-6
    )


def test_what_is_left_out_of_a_comparison_is_said(flown):
    words = ("compare", flown / "flight.tlog", "--reference", flown / "truth.csv", "--skip")
    left = "the first {} s are left out (--skip 0 counts them)"
    assert left.format(12) in command(*words, 12).stdout
    assert "are left out" not in command(*words, 0).stdout
    several = command(*words, 12, "--filters", "eskf,euler:article")
    assert left.format(12) in several.stdout


def without(source: Path, out: Path, names: set[str]) -> Path:
    """Copy a .tlog without some messages."""
    from ekf_companion.mavlink.messages import IDS

    left = {IDS[name] for name in names}
    log = tlog.read(source)
    with out.open("wb") as file:
        for (stamp, frame), number in zip(
            log.frames(), log.records.all()["message_id"].tolist(), strict=True
        ):
            if number not in left:
                file.write(stamp.to_bytes(8, "big") + frame)
    return out


GNSS = {"GPS_RAW_INT", "GLOBAL_POSITION_INT"}
IMU = {"HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"}


def test_no_gnss_is_said_and_attitude_is_still_estimated(flown, tmp_path):
    log = without(flown / "flight.tlog", tmp_path / "log.tlog", GNSS)
    result = command("convert", log, "-o", tmp_path / "out.csv")
    assert result.exit_code == 0, result.output
    assert "no GNSS fix: attitude is estimated" in result.output
    last = rows_of(tmp_path / "out.csv")[-1]
    assert (last["status"], last["lat_deg"]) == ("attitude", "")
    assert last["roll"]


def test_no_inertial_samples_is_said_and_exits_with_3(flown, tmp_path):
    log = without(flown / "flight.tlog", tmp_path / "log.tlog", IMU)
    result = command("convert", log, "-o", tmp_path / "out.csv")
    assert result.exit_code == 3
    assert "no inertial samples" in result.output
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("missing.tlog", None, "missing.tlog"),
        ("empty.bin", b"", "empty"),
        ("noise.ulg", b"this is no log at all" * 50, "noise.ulg"),
        ("flight.doc", b"1 2 3", "unknown kind of log; known are .tlog, .bin, .ulg, .csv, .txt"),
    ],
)
def test_what_cannot_be_read_is_said_in_a_sentence(tmp_path, name, content, sentence):
    log = tmp_path / name
    if content is not None:
        log.write_bytes(content)
    result = command("convert", log, "-o", tmp_path / "out.csv")
    assert result.exit_code == 3
    assert sentence in result.output
    assert "Traceback" not in result.output


def test_an_output_of_no_known_kind_or_the_log_itself_is_refused(flown, tmp_path):
    log = flown / "flight.tlog"
    assert (
        "unknown kind of output; known are .csv"
        in command("convert", log, "-o", tmp_path / "out.mat").output
    )
    assert command("convert", log, "-o", log).exit_code == 2
    assert command("convert", log, "-o", tmp_path / "no" / "out.csv").exit_code == 2


def test_a_log_cut_anywhere_still_converts(flown, tmp_path):
    data = (flown / "flight.tlog").read_bytes()
    rng = np.random.default_rng(5)
    for cut in rng.integers(len(data) // 2, len(data), 4):
        log = tmp_path / "cut.tlog"
        log.write_bytes(data[: int(cut)])
        result = command("convert", log, "-o", tmp_path / "out.csv")
        assert result.exit_code == 0, result.output


def test_smoothed_rows_are_those_of_the_live_estimate_and_nearer_to_the_truth(flown, tmp_path):
    live, out = tmp_path / "live.csv", tmp_path / "out.csv"
    command("convert", flown / "flight.tlog", "-o", live)
    result = command("convert", flown / "flight.tlog", "-o", out, "--smooth")
    assert result.exit_code == 0, result.output
    assert "status: aligning" in result.output
    ours, theirs = rows_of(out), rows_of(live)
    assert [row["time_us"] for row in ours] == [row["time_us"] for row in theirs]
    assert list(ours[0]) == COLUMNS
    assert ours[0]["lat_deg"] == ""
    result = command(
        "compare", flown / "flight.tlog", "--smooth", "--reference", flown / "truth.csv",
        "--skip", 8, "--json", "--plot", tmp_path / "figure.png",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    scores = json.loads(result.stdout)
    names = [score["estimate"].split(" (")[0] for score in scores]
    assert names[:2] == ["ekf-companion, smoothed", "ekf-companion, live"]
    assert len(names) == 3
    assert scores[0]["velocity_mps"]["rms"] < 0.7 * scores[1]["velocity_mps"]["rms"]
    assert scores[0]["horizontal_m"]["rms"] < scores[1]["horizontal_m"]["rms"]


def test_the_rate_thins_smoothed_rows_over_the_whole_length_of_a_log(tmp_path):
    out = tmp_path / "out.csv"
    log = long_csv(tmp_path / "long.csv", 0.0)
    result = command("convert", log, "-o", out, "--smooth", "--rate", 0.0625)
    assert result.exit_code == 0, result.output
    assert [int(row["time_us"]) // 16_000_000 for row in rows_of(out)] == list(range(29))


def test_what_cannot_be_smoothed_is_refused_with_a_remedy(flown, tmp_path):
    out = tmp_path / "out.tlog"
    result = command("convert", flown / "flight.tlog", "-o", out, "--smooth")
    assert result.exit_code == 2
    assert "name a .csv" in result.output
    assert not out.exists()
    estimate = tmp_path / "estimate.csv"
    command("convert", flown / "flight.tlog", "-o", estimate)
    result = command("compare", estimate, "--reference", flown / "truth.csv", "--smooth")
    assert result.exit_code == 2
    assert "is an estimate already" in result.output


def test_progress_goes_through_both_runs_and_ends(flown):
    from ekf_companion.config.config import Config
    from ekf_companion.review.convert import estimate_and_smooth

    told: list[tuple[int, int]] = []
    estimate_and_smooth(flown / "flight.tlog", Config(), lambda *share: told.append(share))
    shares = [done / total for done, total in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert any(0.5 < share < 0.9 for share in shares)


def test_a_reboot_is_named_as_one(flown, tmp_path):
    twice, again = tmp_path / "twice.tlog", tmp_path / "again.tlog"
    asked = ["generate", "--duration", str(SECONDS), "--imu-rate", "100", "--seed", "2"]
    assert CliRunner().invoke(sim, [*asked, "-o", str(again)]).exit_code == 0
    twice.write_bytes((flown / "flight.tlog").read_bytes() + again.read_bytes())
    result = command("convert", twice, "-o", tmp_path / "out.csv")
    said = " ".join(result.output.split())
    assert (
        "note: the autopilot rebooted once: its clock began anew, and the estimate with it" in said
    )
    once = command("convert", flown / "flight.tlog", "-o", tmp_path / "out.csv")
    assert "rebooted" not in once.output


def test_a_log_of_a_moment_is_said_to_be_one(tmp_path):
    """The example of README, copied: its four rows are no flight."""
    header, *rows = [
        "time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2",
        *(f"{1_000_000 + 10_000 * n},0.01,0,0,0.1,0,-9.8" for n in range(4)),
    ]
    log = tmp_path / "moment.csv"
    log.write_text("\n".join([header, *rows]) + "\n")
    done = command("convert", log, "-o", tmp_path / "out.csv")
    assert done.exit_code == 3
    assert "nothing could be estimated: its inertial samples last 0.0" in done.output
    assert "a second of rest" in done.output
    assert "roll and pitch are estimated" not in done.output
