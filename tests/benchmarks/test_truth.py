"""The independent truth: its mechanics, its cases, its judge."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import truth
from benchmarks.truth import earth, judge, log, paths
from benchmarks.truth.__main__ import MARKS, main
from benchmarks.truth.cases import CASES, generate
from benchmarks.truth.cases.sources import KINDS
from benchmarks.truth.draw import DEG, Draw
from benchmarks.truth.motion import FINE, fly
from benchmarks.truth.run import Job, run
from ekf_companion.nav import earth as nav_earth

pytestmark = pytest.mark.campaign

PLACE = (47.4 * DEG, 8.5 * DEG, 500.0)


def strapdown(flight, step):
    """Integrate increments, `step` at a time, in latitude, longitude, height (Groves, ch. 5.4)."""
    dt = step / FINE
    count = len(flight.dtheta_b) // step
    dtheta_b = flight.dtheta_b[: count * step].reshape(count, step, 3).sum(axis=1)
    dvel_b = flight.dvel_b[: count * step].reshape(count, step, 3).sum(axis=1)
    dvel_b = dvel_b + 0.5 * np.cross(dtheta_b, dvel_b)
    turns = Rotation.from_rotvec(dtheta_b).as_matrix()
    lat, lon, alt = (float(x) for x in earth.to_geodetic(flight.pos_e[0]))
    vel_n, C_nb = flight.vel_n[0].copy(), flight.C_nb[0].copy()
    for k in range(count):
        w2 = 1.0 - earth.E2 * math.sin(lat) ** 2
        meridian = earth.A * (1.0 - earth.E2) / w2**1.5 + alt
        normal = earth.A / math.sqrt(w2) + alt
        n, e, d = vel_n
        earth_n = earth.RATE * np.array([math.cos(lat), 0.0, -math.sin(lat)])
        moved_n = np.array([e / normal, -n / meridian, -e * math.tan(lat) / normal])
        (wn, we, wd), (tn, te, td) = 2.0 * earth_n + moved_n, (earth_n + moved_n) * dt
        acc_n = np.array([wd * e - we * d, wn * d - wd * n, we * n - wn * e])
        acc_n[2] += earth.gravity(lat, alt)
        before_n, C_half = vel_n, np.array([[1, td, -te], [-td, 1, tn], [te, -tn, 1]])
        vel_n = vel_n + C_nb @ dvel_b[k] + acc_n * dt
        C_nb = C_half @ C_nb @ turns[k]
        n, e, d = 0.5 * (before_n + vel_n)
        alt -= d * dt
        lon += e / (normal * math.cos(lat)) * dt
        lat += n / meridian * dt
    pos_e = earth.to_ecef(np.float64(lat), np.float64(lon), np.float64(alt))
    return pos_e, vel_n, C_nb, count * step


def test_the_generator_and_the_judge_know_nothing_of_the_estimator():
    folder = Path(truth.__file__).parent
    files = [path for path in folder.rglob("*.py") if path.name not in ("run.py", "__main__.py")]
    assert len(files) > 10
    known = re.compile(r"^\s*(import|from) (ekf_companion|sim_autopilot)", re.MULTILINE)
    assert [path for path in files if known.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("motion", [paths.figure_eights, paths.aerobatics])
def test_the_increments_integrate_to_the_truth(motion):
    flight = fly(motion(Draw(1, "increments")), 60.0, PLACE)
    pos_e, vel_n, C_nb, k = strapdown(flight, 2)
    assert np.linalg.norm(pos_e - flight.pos_e[k]) < 0.02
    assert np.linalg.norm(vel_n - flight.vel_n[k]) < 1e-3
    assert Rotation.from_matrix(C_nb @ flight.C_nb[k].T).magnitude() < 1e-5


def test_at_rest_the_specific_force_is_gravity_and_the_rate_is_the_earths():
    flight = fly(paths.resting(Draw(1, "rest")), 2.0, PLACE)
    C_nb = flight.C_nb[0]
    force_n, rate_n = flight.dvel_b * FINE @ C_nb.T, flight.dtheta_b * FINE @ C_nb.T
    assert np.allclose(force_n, [0.0, 0.0, -nav_earth.gravity(*PLACE[::2])], atol=1e-6)
    turn = earth.RATE * np.array([math.cos(PLACE[0]), 0.0, -math.sin(PLACE[0])])
    # Differences of attitudes in double precision, by FINE
    assert np.allclose(rate_n, turn, atol=1e-12 * FINE)


def test_geodetic_positions_come_back():
    lat, lon = (
        np.radians([-80.0, -17.8, 0.0, 47.4, 64.1]),
        np.radians([179.9, -180.0, 0.0, 8.5, -21.9]),
    )
    alt = np.array([-100.0, 0.0, 30.0, 500.0, 9000.0])
    found = earth.to_geodetic(earth.to_ecef(lat, lon, alt))
    # Bowring's formula is off by 1e-11 rad at 9 km
    assert np.allclose(found[0], lat, atol=1e-10)
    assert np.allclose(np.sin(found[1]), np.sin(lon), atol=1e-14)
    assert np.allclose(found[2], alt, atol=1e-6)
    assert earth.gravity(np.radians(45.0), 0.0) == pytest.approx(9.80619777, abs=1e-7)


def test_cases_without_a_fault_are_honest(tmp_path):
    for name in ("fig8", "hover"):
        verdict = run(Job(name, 3, logs=tmp_path)).verdict
        assert verdict.lie == 0.0
        assert verdict.ok == 1.0
        assert verdict.rms["pos_h"] < 3.0
        assert verdict.rms["tilt"] < 0.5 * DEG
        # Kept, for the next run
        assert (tmp_path / f"{name}-03.csv").exists()


@pytest.mark.parametrize("name", KINDS)
def test_a_source_that_is_right_is_better_than_none(name, tmp_path):
    """A minute without a receiver: no lie, and no worse than the same flight without the source."""
    verdict = run(Job(name, 3, logs=tmp_path)).verdict
    assert verdict.lie == 0.0
    log_path = tmp_path / f"{name}-03.csv"
    head, *rows = log_path.read_text(encoding="utf-8").splitlines()
    known = len(",".join(log.COLUMNS).split(","))
    kept = [row for row in rows if row.rstrip(",").count(",") < known]
    log_path.write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")
    without = run(Job(name, 3, logs=tmp_path)).verdict
    better = "pos_d" if name == "range" else "pos_h"
    assert verdict.rms[better] <= 1.05 * without.rms[better]


def test_a_fault_of_a_source_acts_in_its_time_only():
    for name, kind in KINDS.items():
        right = generate(name, 1).sources[-1]
        for fault in kind.faults:
            assert generate(f"{name}-{fault}", 1).sources[-1].columns == right.columns
    steady, roof = (
        case(Draw(1, "range")).sources[-1] for case in (CASES["range"], CASES["range-roof"])
    )
    off = np.flatnonzero(steady.values[:, 0] != roof.values[:, 0])
    assert 35.0 < roof.t[off[-1]] - roof.t[off[0]] < 45.0
    assert np.median((roof.values - steady.values)[off]) == pytest.approx(-5.0, abs=1.6)


def test_the_table_goes_between_its_marks(monkeypatch, tmp_path, capsys):
    document = tmp_path / "doc.md"
    document.write_text("<!-- independent truth -->\n<!-- end -->\n", encoding="utf-8")
    command = ["truth", "--only", "fig8", "--seeds", "1", "--jobs", "1", "--logs", str(tmp_path)]
    monkeypatch.setattr("sys.argv", [*command, "--write", str(document)])
    assert main() == 0
    head, rule, row = document.read_text(encoding="utf-8").splitlines()[1:-1]
    assert row in capsys.readouterr().out
    assert row.startswith("| fig8 | ")
    assert row.endswith("| 0 of 1 | 0.0 |")
    assert head.count("|") == rule.count("|") == row.count("|")

    # A log that cannot be read is no honest one
    (tmp_path / "fig8-00.csv").write_text("time_us\n", encoding="utf-8")
    assert main() == 1
    row = document.read_text(encoding="utf-8").splitlines()[3]
    assert row.startswith("| fig8 | fails in 1 of 1: ")
    assert head.count("|") == row.count("|")


def test_the_rows_of_sources_have_a_table_of_their_own(monkeypatch, tmp_path):
    document = tmp_path / "doc.md"
    marks = "".join(f"<!-- {mark} -->\n<!-- end -->\n" for mark in MARKS)
    document.write_text(marks, encoding="utf-8")
    command = ["truth", "--only", "fig8", "range", "--seeds", "1", "--jobs", "1", "--each"]
    monkeypatch.setattr("sys.argv", [*command, "--logs", str(tmp_path), "--write", str(document)])
    assert main() == 0
    lines = document.read_text(encoding="utf-8").splitlines()
    assert [line.split(" ")[1] for line in lines if line.startswith("| ")] == [
        *("case", "fig8-00", "fig8"),
        *("case", "range-00", "range"),
    ]


def test_a_seed_is_a_flight():
    one, same, other = (generate("jump-80", seed) for seed in (1, 1, 2))
    assert np.array_equal(one.inertial.gyro, same.inertial.gyro)
    assert np.array_equal(one.fixes.pos_error_n, same.fixes.pos_error_n)
    assert not np.array_equal(one.fixes.pos_error_n, other.fixes.pos_error_n)


@pytest.mark.parametrize("name", CASES)
def test_a_case_says_what_it_is(name):
    assert CASES[name].__doc__.endswith(".")


def as_estimate(true, error_north=0.0):
    """Return the truth as an estimate that is sure to a metre, m/s or degree."""
    count = len(true.stamp_us)
    roll, pitch, _ = Rotation.from_matrix(true.C_nb).as_euler("xyz").T
    columns = {
        "lat_deg": np.degrees(true.lat + error_north / 6.4e6),
        "lon_deg": np.degrees(true.lon),
        "alt_m": true.alt,
        "roll": roll,
        "pitch": pitch,
        "reset_count": np.zeros(count),
    }
    columns |= dict(zip(("vel_n", "vel_e", "vel_d"), true.vel_n.T, strict=True))
    quaternions = Rotation.from_matrix(true.C_nb).as_quat()[:, [3, 0, 1, 2]]
    columns |= dict(zip(("q_w", "q_x", "q_y", "q_z"), quaternions.T, strict=True))
    for name in ("pos_n", "pos_e", "pos_d", "vel_n", "vel_e", "vel_d"):
        columns[f"sd_{name}"] = np.ones(count)
    for name in ("roll", "pitch", "yaw"):
        columns[f"sd_{name}"] = np.full(count, DEG)
    return judge.Estimate(columns, np.full(count, "ok"))


def test_a_lie_is_an_ok_beyond_five_sigma():
    true = log.truth_of(generate("slow-yaw", 1))
    exact = judge.judge(as_estimate(true), true)
    assert exact.lie == 0.0
    assert exact.ok == 1.0
    assert max(exact.rms.values()) < 1e-6
    # The sigma of the horizontal position is the root of two variances
    within, beyond = (judge.judge(as_estimate(true, x), true) for x in (7.0, 7.2))
    assert within.lie == 0.0
    assert beyond.lies["pos_h"] == beyond.lie == pytest.approx(200.0)
    assert beyond.worst["pos_h"] == pytest.approx(7.2 / math.sqrt(2.0), rel=0.01)
    assert beyond.nees_pos == pytest.approx(7.2**2 / 3.0, rel=0.02)


def test_an_ok_without_a_number_is_a_lie_and_a_warning_is_none():
    true = log.truth_of(generate("slow-yaw", 1))
    estimate = as_estimate(true, 100.0)
    status = np.full(len(true.stamp_us), "degraded")
    assert judge.judge(replace(estimate, status=status), true).lie == 0.0
    without = dict(as_estimate(true).columns, q_w=np.full(len(true.stamp_us), np.nan))
    found = judge.judge(judge.Estimate(without, estimate.status), true)
    assert found.lies["yaw"] == found.lie > 0.0
    assert found.lies["tilt"] == 0.0
