"""One judgement on a log, whoever asks, and by the witness that knows best."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Trajectory
from ekf_companion.review.evidence import evidence_of
from ekf_companion.review.report import Report
from sim_autopilot.__main__ import app as sim
from tests.review.test_track import SECOND_NS, events_of, table_of

METRE = np.rad2deg(1.0 / 6.37e6)
"""Of latitude, deg, to 0.3 %."""


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Return a log of 45 s with the autopilot's estimate in it, and its truth beside it."""
    root = tmp_path_factory.mktemp("judged")
    log, truth = root / "flight.tlog", root / "truth.csv"
    words = ("generate", "--duration", "45", "--imu-rate", "50", "-o", log, "--truth", truth)
    result = CliRunner().invoke(sim, [*map(str, words)])
    assert result.exit_code == 0, result.output
    return log, truth


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def shifted(truth, path, north, later_us=0):
    """Write a truth that lies so many metres further north, and is so much later."""
    rows = rows_of(truth)
    for row in rows:
        row["lat_deg"] = f"{float(row['lat_deg']) + north * METRE:.10f}"
        row["time_us"] = str(int(row["time_us"]) + later_us)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def said(*words):
    result = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)["verdict"]


def test_convert_report_and_batch_say_the_same(flight, tmp_path):
    log, _ = flight
    table = tmp_path / "table.csv"
    result = CliRunner().invoke(app, ["batch", str(log), "-o", str(table), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    sentence = rows_of(table)[0]["verdict"]
    assert "RMS from the truth" in sentence
    assert said("convert", log, "-o", tmp_path / "out.csv") == sentence
    assert said("report", log, "-o", tmp_path / "out.html") == sentence


def test_a_truth_beside_the_log_is_what_it_is_judged_by(flight, tmp_path):
    log, truth = flight
    far = shifted(truth, tmp_path / "far.csv", 20.0)
    for command, out in (("convert", "out.csv"), ("report", "out.html")):
        words = (command, log, "--reference", far, "-o", tmp_path / out)
        assert said(*words).startswith(("poor: 20.", "poor: 19."))


@pytest.mark.campaign
def test_a_truth_far_from_the_fixes_too_is_asked_about(flight, tmp_path):
    log, truth = flight
    other = shifted(truth, tmp_path / "other.csv", 118.0)
    doubt = "the truth is 118 m from the receiver's fixes too (is it of this flight?)"
    for command, out in (("convert", "out.csv"), ("report", "out.html")):
        sentence = said(command, log, "--reference", other, "-o", tmp_path / out)
        assert sentence.startswith("poor: 118.")
        assert doubt in sentence
    result = CliRunner().invoke(app, ["compare", str(log), "--reference", str(other)])
    assert f"note: {doubt}" in result.output
    result = CliRunner().invoke(app, ["compare", str(log), "--reference", str(truth)])
    assert "is it of this flight" not in result.output


def test_a_truth_of_another_time_is_refused(flight, tmp_path):
    log, truth = flight
    late = shifted(truth, tmp_path / "late.csv", 0.0, later_us=1_000_000_000)
    for command, out in (("convert", "out.csv"), ("report", "out.html")):
        words = (command, log, "--reference", late, "-o", tmp_path / out)
        result = CliRunner().invoke(app, [*map(str, words)])
        assert result.exit_code == 3, result.output
        assert "late.csv: has no time in common with the estimate of" in result.output
        assert "name the truth of this flight" in result.output


def test_a_truth_of_the_start_alone_is_noted(flight, tmp_path):
    log, truth = flight
    begin = tmp_path / "begin.csv"
    begin.write_text("".join(truth.read_text().splitlines(keepends=True)[:1000]))
    words = ("convert", log, "--reference", begin, "-o", tmp_path / "out.csv")
    result = CliRunner().invoke(app, [*map(str, words)])
    assert result.exit_code == 0, result.output
    assert "begin.csv has no time in common with the estimate after its first 20 s" in result.output


def standing(north, rate=10.0, seconds=60.0):
    """Return positions that stand, so many metres further north than ours."""
    t_s = np.arange(0.0, seconds, 1.0 / rate)
    return Trajectory(
        name="autopilot",
        pos_t_ns=np.rint(t_s * SECOND_NS).astype(np.int64),
        lat=np.deg2rad(47.0 + north * METRE + 0.0 * t_s),
        lon=np.deg2rad(8.0 + 0.0 * t_s),
        alt=0.0 * t_s,
    )


@pytest.mark.parametrize(("fixes_at", "expected"), [(0.5, (0.5, 5.5)), (6.0, (6.0, 0.0))])
def test_the_receiver_tells_which_of_two_estimates_is_near_it(fixes_at, expected):
    report = Report(log="x", own=standing(6.0))
    fixes = [(t_s, Kind.GNSS, np.deg2rad(47.0 + fixes_at * METRE)) for t_s in np.arange(0.5, 60.0)]
    events = events_of(fixes)
    events.values[:, 1] = np.deg2rad(8.0)
    report.track.add(events, table_of(np.arange(0.0, 60.0, 0.02)))
    evidence = evidence_of(report)
    assert evidence.autopilot.rms == pytest.approx(6.0, abs=0.05)
    assert evidence.to_fixes == pytest.approx(expected, abs=0.05)


def test_a_few_fixes_are_no_witness():
    report = Report(log="x", own=standing(6.0))
    events = events_of([(t_s, Kind.GNSS, np.deg2rad(47.0)) for t_s in range(30, 40)])
    events.values[:, 1] = np.deg2rad(8.0)
    report.track.add(events, table_of(np.arange(0.0, 60.0, 0.02)))
    assert evidence_of(report).to_fixes is None


def test_what_a_file_lost_is_in_its_verdict(flight, tmp_path):
    whole = flight[0].read_bytes()
    log = tmp_path / "hole.tlog"
    middle = len(whole) // 2
    log.write_bytes(whole[:middle] + bytes(len(whole) // 20) + whole[middle + len(whole) // 20 :])
    sentence = said("convert", log, "-o", tmp_path / "out.csv")
    assert sentence.startswith("fair: ")
    assert "a damaged place in the file (" in sentence


def test_our_own_estimate_is_no_truth(flight, tmp_path):
    log, own = flight[0], tmp_path / "own.csv"
    assert CliRunner().invoke(app, ["convert", str(log), "-o", str(own)]).exit_code == 0
    for command in ("convert", "report", "view"):
        out = () if command == "view" else ("-o", tmp_path / f"{command}.html")
        words = (command, log, "--reference", own, *out)
        result = CliRunner().invoke(app, [*map(str, words)])
        assert result.exit_code == 3, result.output
        assert (
            "own.csv: an estimate that convert wrote, and no truth; name a truth" in result.output
        )
    result = CliRunner().invoke(app, ["compare", str(log), "--reference", str(own)])
    assert result.exit_code == 0, result.output
    assert "note: own.csv: an estimate that convert wrote, and no truth: two" in result.output
