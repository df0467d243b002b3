"""The way of a lidar as an aid of the main filter over a log whose fixes end."""

import csv
import functools
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.lidar_aid import BOOT, CONFIG, LATE, Flight
from ekf_companion.cli import app
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import lines_of, solve
from ekf_companion.logs import poses
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.review.convert import estimate
from sim_autopilot.lidar.record import simulate
from sim_autopilot.lidar.write import write_sequence
from tests.paths import DATA

CUT = (10.0, 25.0)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A walk in a simulated room: a log whose fixes end, and what the lidar makes of it."""
    folder = tmp_path_factory.mktemp("aid")
    write_sequence(folder / "room", simulate("room", 11, duration=26.0))
    flight = Flight.of(folder / "room")
    flight.write(folder / "log.csv", 1, CUT)
    solution = solve(read(folder / "room"), Settings())
    for kind in (".csv", ".tum", "rel"):
        path = folder / ("rel.csv" if kind == "rel" else f"pose{kind}")
        path.write_text("\n".join(lines_of(solution, kind)) + "\n")
    return folder, flight, solution


def away(flight, log, aid, cut):
    """Return the largest error since the fixes ended, m, and of all in sigmas of an axis."""
    table, _ = estimate(log, CONFIG, None, aid)
    t, error, sigma = flight.errors(table)
    inside = (t >= cut[0]) & (t < cut[1])
    since = np.linalg.norm(error[inside] - error[inside][0], axis=1)
    return since, np.abs(error[inside] / sigma[inside]).max()


@pytest.mark.parametrize(
    ("name", "offset", "most"),
    [("pose.csv", None, 0.2), ("pose.tum", None, 0.3), ("rel.csv", BOOT, 0.5)],
)
def test_a_walk_without_fixes_is_held_by_the_lidar(walk, name, offset, most):
    folder, flight, _ = walk
    aid = PoseFile(folder / name, offset)
    since, sigmas = away(flight, folder / "log.csv", aid, CUT)
    assert since.max() < most
    assert sigmas < 3.0
    assert away(flight, folder / "log.csv", None, CUT)[0].max() > 5.0


def test_the_csv_holds_what_the_relative_poses_state(walk):
    folder, _, solution = walk
    found = poses.read(folder / "pose.csv")
    alone = poses.read(folder / "rel.csv")
    assert len(found.t_ns) == len(solution.track)
    assert found.drift.level == pytest.approx(solution.level, rel=1e-6)
    at = np.searchsorted(found.t_ns, alone.t_ns)
    # by other worlds, so that what does not depend on them is compared
    for name in ("way", "turn"):
        sizes = [np.linalg.eigvalsh(getattr(one.drift, name)) for one in (found, alone)]
        np.testing.assert_allclose(sizes[0][at[1:]], sizes[1][1:], rtol=1e-4)


def test_the_commands_take_it(walk, tmp_path):
    folder, _, _ = walk
    run = CliRunner()
    config = tmp_path / "config.yaml"
    config.write_text(f"gnss: {{delay: {LATE}}}\nbaro: {{use: false}}\n")
    given = [str(folder / "log.csv"), "-c", str(config), "--aid", str(folder / "pose.csv")]
    out = tmp_path / "estimate.csv"
    done = run.invoke(app, ["convert", *given, "-o", str(out), "--json"])
    assert done.exit_code == 0, done.output
    assert any("pose.csv: +10.000 s" in one for one in json.loads(done.stdout)["notes"])
    with out.open() as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["sd_pos_n"]) < 2.0
    smoothed = ["convert", *given, "--smooth", "-o", str(out), "-o", str(tmp_path / "sent.tlog")]
    assert run.invoke(app, smoothed).exit_code == 2  # a .tlog holds what was sent
    assert run.invoke(app, smoothed[:-2]).exit_code == 0
    again = ["convert", *given, "-o", str(tmp_path / "sent.tlog")]
    assert run.invoke(app, again).exit_code == 0
    compared = run.invoke(app, ["compare", *given, "--reference", str(out), "--skip", "12"])
    assert compared.exit_code == 0, compared.output
    page = tmp_path / "report.html"
    assert run.invoke(app, ["report", *given, "-o", str(page)]).exit_code == 0
    assert "visual_odometry" in page.read_text()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--aid-offset", "3"], 2, "--aid names"),
        (["--aid", "{log}", "--filter", "euler"], 2, "eskf only"),
        (["--aid", "{log}"], 3, "unknown form"),
        (["--aid", "nowhere.csv"], 3, "no such file"),
        (["--aid", "{pose}", "--aid-offset", "1e6"], 3, "share no time"),
        (["--aid", "{pose}", "-o", "{pose}"], 2, "is the poses"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_sentence(walk, tmp_path, options, code, words):
    folder, _, _ = walk
    names = {"log": folder / "log.csv", "pose": folder / "pose.csv"}
    given = [one.format(**names) for one in options]
    command = ["convert", str(names["log"]), "-o", str(tmp_path / "out.csv"), *given]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == code, done.output
    assert words in done.stderr
    assert not (tmp_path / "out.csv").exists()


# The sequences of ../shared

has_data = pytest.mark.skipif(not (DATA / "lidar").is_dir(), reason="needs ../shared")


@functools.cache
def solved(name):
    return solve(read(DATA / "lidar" / name), Settings())


def sequence(name, tmp_path, seed, cut):
    """Return a sequence, its log and the lidar's poses."""
    flight = Flight.of(DATA / "lidar" / name)
    flight.write(tmp_path / "log.csv", seed, cut)
    (tmp_path / "pose.csv").write_text("\n".join(lines_of(solved(name), ".csv")) + "\n")
    return flight, tmp_path / "log.csv", PoseFile(tmp_path / "pose.csv")


@has_data
@pytest.mark.campaign
@pytest.mark.parametrize(("name", "seeds"), [("street_drive", 6), ("forest_flight", 6)])
def test_half_a_minute_without_fixes(name, seeds, tmp_path):
    found = []
    for seed in range(1, 1 + seeds):
        end = Flight.of(DATA / "lidar" / name).end
        cut = (end - 31.0, end - 1.0)
        flight, log, aid = sequence(name, tmp_path, seed, cut)
        since, sigmas = away(flight, log, aid, cut)
        assert sigmas < 3.0
        assert away(flight, log, None, cut)[0].max() > 10.0
        found.append(np.sqrt(np.mean(since**2)))
    assert max(found) < 0.5  # what is not known of yaw at the last fix


@has_data
@pytest.mark.campaign
def test_a_tunnel_widens_along_it_only(tmp_path):
    cut = (14.0, 44.0)
    flight, log, aid = sequence("tunnel_run", tmp_path, 1, cut)
    since, sigmas = away(flight, log, aid, cut)
    assert since.max() < 1.0
    assert sigmas < 3.0


@has_data
@pytest.mark.campaign
def test_over_a_plain_it_is_no_worse_than_fixes_alone(tmp_path):
    for seed in (1, 2, 3):
        flight, log, aid = sequence("plain_flight", tmp_path, seed, None)
        errors = []
        for given in (aid, None):
            table, _ = estimate(log, CONFIG, None, given)
            t, error, _ = flight.errors(table)
            errors.append(np.sqrt(np.nanmean(error[t > 5.0] ** 2)))
        assert errors[0] < 1.05 * errors[1]
