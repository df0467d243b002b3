"""Several filters over one log: the command, its table and JSON, and the library of README."""

import json
import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion import open_log, run_filter
from ekf_companion.analysis import comparison, trajectory_figure
from ekf_companion.cli import app
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.logs.estimate import of_table
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.filters_by_name import FILTERS
from sim_autopilot.__main__ import app as simulator
from tests.calibrate.recordings import without
from tests.filters.swings import Swing, swing
from tests.filters.walks import make
from tests.paths import DATA, ROOT

pytestmark = pytest.mark.campaign

TRIAL = DATA / "broad-attitude" / "01_undisturbed_slow_rotation_A.mat"
README = ROOT / "README.md"
NAVIGATORS = ("eskf", "euler", "iterated", "iterated:robocentric", "ukf")


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Fly 32 s at 25 Hz, with a truth."""
    folder = tmp_path_factory.mktemp("flight")
    log, truth, config = (folder / name for name in ("flight.tlog", "truth.csv", "sim.yaml"))
    config.write_text("imu: {rate: 25.0}\n")
    words = ["generate", "--scenario", "figure-eight", "--duration", "32", "--seed", "5"]
    words += ["--config", str(config), "-o", str(log), "--truth", str(truth)]
    result = CliRunner().invoke(simulator, words)
    assert result.exit_code == 0, result.output
    return log, truth


def command(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_all_navigators_stand_in_one_table_one_figure_and_one_json(flight, tmp_path):
    log, truth = flight
    figure = tmp_path / "all.png"
    asked = ["compare", log, "--filters", ",".join(NAVIGATORS), "--reference", truth]
    result = command(*asked, "--skip", "15", "--plot", figure, "--json")
    assert result.exit_code == 0, result.output
    assert figure.read_bytes().startswith(b"\x89PNG")
    found = json.loads(result.stdout)
    assert [one["filter"] for one in found] == list(NAVIGATORS)
    for one in found:
        assert one["estimates"] > 750
        assert math.hypot(one["rms"]["north_m"], one["rms"]["east_m"]) < 1.5
        assert one["rms"]["roll_deg"] < 1.5
        assert one["rms"]["pitch_deg"] < 1.5
        assert one["rms"]["yaw_deg"] < 4.0
        assert 0.0 < one["nees"]["attitude"] < 10.0
        assert one["us_per_sample"] > 0.0
    # Alone it is compared at all of its stamps, beside others at those that all have
    asked = ["compare", log, "--filters", "eskf", "--reference", truth, "--skip", "15"]
    (alone,) = json.loads(command(*asked, "--json").stdout)
    printed = command(*asked)
    cells = {line[:26].strip(): line[26:].split() for line in printed.output.splitlines()}
    assert cells[""] == []
    assert cells["north, m"] == [f"{alone['rms']['north_m']:.3f}"]


def test_an_unknown_filter_or_option_ends_with_2_and_says_what_is_known(flight):
    log, truth = flight
    for words in (
        ["compare", log, "--reference", truth, "--filters", "eskf,kalman"],
        ["compare", log, "--reference", truth, "--filters", "euler:wrong"],
        ["convert", log, "-o", "x.csv", "--filter", "kalman"],
        ["convert", log, "-o", "x.csv", "--frame", "robocentric"],
        ["convert", log, "-o", "x.csv", "--filter", "euler:article", "--preset", "article"],
    ):
        result = command(*words)
        assert result.exit_code == 2, result.output
        assert "filter" in result.output or "option" in result.output


def test_a_filter_that_lacks_what_it_needs_stands_empty_beside_the_others(flight, tmp_path):
    recording = without(open_log(flight[0]), Kind.MAG, Kind.HEADING)
    with pytest.raises(LogError, match="heading"):
        run_filter(recording, "iterated")
    assert len(run_filter(recording, "eskf").table) > 750
    with pytest.raises(LogError, match="GNSS"):
        run_filter(without(open_log(flight[0]), Kind.GNSS), "iterated")
    with pytest.raises(ConfigError, match="eskf"):
        run_filter(recording, "esfk")


@pytest.mark.parametrize("name", ["eskf", "iterated"])
def test_the_same_log_gives_the_same_bits_again(flight, name):
    recording = open_log(flight[0])
    early = recording.events.t_ns < recording.events.t_ns[0] + 14_000_000_000
    recording = replace(recording, events=recording.events.take(early))
    first, second = (run_filter(recording, name) for _ in range(2))
    assert first.table.values.tobytes() == second.table.values.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_the_estimator_in_pieces_gives_the_bits_of_the_conversion(flight, tmp_path):
    out = tmp_path / "estimate.csv"
    assert command("convert", flight[0], "-o", out).exit_code == 0
    solution = run_filter(open_log(flight[0]), "eskf")
    rows = out.read_text().splitlines()
    assert len(rows) == 1 + len(solution.table)
    north = rows[0].split(",").index("pos_n")
    last = float(rows[-1].split(",")[north])
    assert last == solution.table.column("pos_n")[-1]


def test_another_filter_converts_too(flight, tmp_path):
    out = tmp_path / "iterated.csv"
    result = command("convert", flight[0], "-o", out, "--filter", "iterated", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["estimates"] == len(out.read_text().splitlines()) - 1
    assert command("compare", out, "--reference", flight[1], "--skip", "15").exit_code == 0
    assert (
        command("convert", flight[0], "-o", tmp_path / "x.tlog", "--filter", "ukf").exit_code == 2
    )


def test_the_library_does_what_the_readme_shows(flight, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    shown = [block for block in blocks if "open_log" in block]
    assert len(shown) == 1
    monkeypatch.chdir(flight[0].parent)
    exec(compile(shown[0], "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["eskf", "euler", "iterated", "ukf"]


def test_a_walk_without_a_truth_is_measured_by_its_closure(tmp_path):
    log, figure = tmp_path / "walk.csv", tmp_path / "walk.png"
    imu = make(np.random.default_rng(3), rate=100.0, strides=8).events
    units = (("gyro", "rps"), ("accel", "mps2"))
    names = [f"{sensor}_{axis}_{unit}" for sensor, unit in units for axis in "xyz"]
    rows = np.column_stack([imu.t_ns * 1e-9, imu.values[:, :6]])
    np.savetxt(log, rows, delimiter=",", header=",".join(["time_s", *names]), comments="")
    result = command("compare", log, "--filters", "zupt,zupt:are,eskf", "--plot", figure)
    assert result.exit_code == 0, result.output
    assert figure.read_bytes().startswith(b"\x89PNG")
    cells = {line[:26].strip(): line[26:].split() for line in result.output.splitlines()}
    assert float(cells["closure in space, m"][0]) < 0.1
    assert cells["closure in space, m"][2] == "-"


@pytest.mark.skipif(not TRIAL.is_file(), reason="BROAD's trials are not here")
def test_attitude_alone_is_scored_where_the_truth_is_of_nothing_else():
    recording = open_log(TRIAL)
    entries = comparison.run_filters(recording, ["ahrs", "mahony"], FilterSettings())
    assert recording.truth is not None
    ours, theirs = comparison.score_filters(entries, recording.truth, 0.0, None, recording.counted)
    assert 0.0 < ours.rms["turn in all"] < theirs.rms["turn in all"] < 90.0
    total = math.hypot(ours.rms["turn in heading"], ours.rms["turn in inclination"])
    assert ours.rms["turn in all"] == pytest.approx(total, rel=0.01)  # small angles


def test_every_filter_has_a_name():
    assert {"eskf", "euler", "iterated", "ukf", "zupt", "ahrs", "mahony", "vqf"} == set(FILTERS)


def test_a_filter_whose_package_is_missing_says_so_in_its_row(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "vqf", None)
    events, truth = swing(Swing(seconds=20.0))
    recording = Recording(family="unknown", events=events, truth=truth)
    missing, there = comparison.score_filters(
        comparison.run_filters(recording, ["vqf", "mahony"], FilterSettings()), truth, 0.0, None
    )
    assert missing.solution is None
    assert "needs vqf, which is not installed" in missing.notes[0]
    assert there.rms["turn in all"] < 90.0
    with pytest.raises(LogError, match="needs vqf, which is not installed"):
        comparison.run_filters(recording, ["vqf"], FilterSettings())


def test_blanks_about_a_name_do_not_count():
    events, _ = swing(Swing(seconds=5.0))
    found = run_filter(Recording(family="unknown", events=events), " mahony ")
    assert found.name == "mahony"


def test_time_is_counted_by_the_samples_that_a_filter_went_through(flight):
    """Aids that come late make few estimates, but the samples before them cost too."""
    recording = open_log(flight[0])
    events = recording.events
    begin = int(events.t_ns[0])
    is_aid = np.isin(events.kind, (Kind.MAG, Kind.HEADING, Kind.GNSS))
    late = events.take(~(is_aid & (events.t_ns < begin + 24_000_000_000)))
    solution = run_filter(replace(recording, events=late), "iterated")
    samples = np.count_nonzero(events.kind == Kind.IMU)
    assert len(solution.table) < 0.4 * samples
    assert comparison.processed(recording, solution) == pytest.approx(samples, abs=3)


SLOW_PACKAGE = """
import time
import numpy as np
begin = time.process_time()
while time.process_time() < begin + 0.4:
    pass

class VQF:
    def __init__(self, step):
        pass

    def updateBatch(self, gyro, accel, mag):
        n = len(gyro)
        quat = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        return {"quat9D": quat, "bias": 0.0 * gyro, "restDetected": np.zeros(n)}
"""


def test_what_a_filter_imports_is_not_its_cost(tmp_path, monkeypatch):
    (tmp_path / "vqf.py").write_text(SLOW_PACKAGE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "vqf", raising=False)
    events, _ = swing(Swing(seconds=20.0))
    recording = Recording(family="unknown", events=events)
    (entry,) = comparison.run_filters(recording, ["vqf"], FilterSettings())
    sys.modules.pop("vqf")  # not by monkeypatch, which would put it back
    assert entry.us < 1e6 * 0.2 / 2000


def test_what_is_before_time_zero_is_drawn_too(tmp_path):
    pytest.importorskip("matplotlib")
    events, truth = swing(Swing(seconds=20.0))
    table = run_filter(Recording(family="unknown", events=events), "mahony").table
    drawn = []
    for shift in (0, 100_000_000_000):
        early = replace(truth, att_t_ns=truth.att_t_ns - shift)
        estimate = of_table(replace(table, stamp_ns=table.stamp_ns - shift), "mahony")
        trajectory_figure.plot(tmp_path / "all.png", [estimate, early], with_errors=True)
        drawn.append((tmp_path / "all.png").read_bytes())
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize("victim", ["log", "reference", "configuration"])
def test_nothing_that_is_read_is_overwritten(flight, tmp_path, victim):
    log, truth = flight
    config = tmp_path / "c.yaml"
    config.write_text("window: 1.0\n")
    target = {"log": log, "reference": truth, "configuration": config}[victim]
    before = target.read_bytes()
    words = ["compare", log, "--reference", truth, "--config", config, "--filters", "eskf"]
    result = command(*words, "--plot", target)
    assert result.exit_code == 2, result.output
    assert "name another file" in result.output
    assert target.read_bytes() == before


def test_an_output_without_a_folder_is_refused_before_the_work(flight, tmp_path):
    words = ("compare", flight[0], "--reference", flight[1], "--plot", tmp_path / "no" / "x.png")
    result = command(*words)
    assert result.exit_code == 2
    assert "there is no such folder" in result.output
