"""The benchmarks run, on sizes too small to mean anything."""

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
        assert results[f"0.1 min {suffix} to .csv, per row"].value > 0.0
    assert results["0.1 min .ulg to .mcap, peak memory"].value > 10.0
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
