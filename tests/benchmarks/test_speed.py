"""The benchmarks run, on sizes too small to mean anything."""

import sys

import numpy as np
import pytest

from benchmarks.speed import __main__ as speed
from benchmarks.speed import daemon, flights, logs, page, steps
from benchmarks.speed.reference import Reference
from benchmarks.speed.result import Result, table
from ekf_companion.nav.measurements import Kind

pytestmark = pytest.mark.campaign


def test_both_filters_are_timed_on_a_flight_that_both_can_follow():
    results = {result.name: result.value for result in steps.measure(duration=12.0)}

    # m; fixes of 1 m and 0.1 m/s ten times a second, from six seconds on
    assert results["horizontal RMS error, compiled"] < 1.0
    assert results["horizontal RMS error, NumPy"] < 1.0
    assert results["plain NumPy over compiled loop"] > 1.0


def test_a_program_that_runs_ekf2_is_timed_beside_ours_on_the_same_flight(tmp_path):
    program = tmp_path / "ekf2"
    program.write_text(
        f"#!{sys.executable}\nimport sys\n"
        "head, *rows = open(sys.argv[1]).read().splitlines()\n"
        'assert head.startswith(\'"time_us","gyro_x_rps"\'), head\n'
        "print('EKF2 of so and so')\nprint(len(rows) / 1000)\n",
        encoding="utf-8",
    )
    program.chmod(0o755)
    results = {one.name: one.value for one in steps.measure(duration=12.0, ekf2=program)}

    assert results["EKF2 on the flight of its own, per sample"] == 3.0
    ours = results["  ours on it, default settings"]
    assert results["  EKF2 over ours"] == pytest.approx(3.0 / ours)


def test_the_flight_has_the_rates_that_the_aims_speak_of():
    events = flights.events(flights.plan(10.0))

    counts = {kind: np.count_nonzero(events.kind == kind) for kind in Kind}
    assert (counts[Kind.IMU], counts[Kind.GNSS], counts[Kind.HEADING]) == (2500, 100, 500)
    assert len(events) == 3100
    assert (np.diff(events.t_ns) >= 0).all()


def test_objects_say_what_the_rows_say():
    events = flights.events(flights.plan(1.0))

    for index, measurement in enumerate(flights.measurements(events)):
        t_ns, kind, values = measurement.row()
        assert (t_ns, kind) == (events.t_ns[index], events.kind[index])
        known = 9 if kind == Kind.GNSS else len(values)
        np.testing.assert_array_equal(values[:known], events.values[index, :known])


def test_the_reference_keeps_a_covariance():
    flight = flights.plan(4.0)
    events = flights.events(flight)
    start = flight.truth_at(events.t_ns[:1])
    reference = Reference(flight.trajectory.frame, int(events.t_ns[0]), start)

    reference.run(events)

    np.testing.assert_allclose(reference.P, reference.P.T, atol=1e-12)  # rounding of dense sums
    assert np.linalg.eigvalsh(reference.P).min() > 0.0


def test_the_daemon_answers_what_the_benchmark_sends(monkeypatch):
    monkeypatch.setattr(daemon, "WARM_UP", 2.5)
    results = {
        result.name: result for result in daemon.measure(duration=0.5, starts=1, sustained=0.5)
    }

    assert results["samples answered by an ODOMETRY"].value > 50.0
    assert results["daemon's resident memory, largest"].value > 1.0


def test_the_load_of_the_page_is_measured(monkeypatch):
    monkeypatch.setattr(daemon, "WARM_UP", 0.5)
    monkeypatch.setattr(page, "VIEWER_START", 0.0)
    results = {result.name: result.value for result in page.measure(duration=1.0)}
    assert results["watched page over none"] > 0.0


def test_generated_logs_are_converted_from_and_to_each_format():
    results = {result.name: result for result in logs.measure(durations=(6.0,), rounds=1)}
    for suffix in (".tlog", ".bin", ".ulg", ".csv"):
        for how in ("by the clock", "processor time"):
            assert results[f"0.1 min {suffix} to .csv, {how}, per row"].value > 0.0
    assert results["0.1 min .ulg to .mcap, peak memory"].value > 10.0
    assert results["0.1 min .tlog to .csv over mavutil, reading, by the clock"].value > 0.0
    assert results["start: a log of 2 s to CSV, processor time"].aim == 0.35


def test_a_figure_above_its_aim_says_so():
    _, good, bad = table(
        [
            Result(name="good", value=1.0, unit="us", aim=2.0),
            Result(name="bad", value=3.0, unit="us", aim=2.0),
        ]
    )

    assert "above" not in good
    assert bad.endswith("us  <- above the aim")


def test_an_unknown_part_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["speed", "stepps"])

    with pytest.raises(SystemExit):
        speed.main()
    assert "stepps: no such part; known are steps, logs, daemon, page" in capsys.readouterr().err
