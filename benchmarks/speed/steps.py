"""Microseconds per inertial sample: a whole recording, one event at a time, late ones.

PX4's EKF2 is timed beside it where a program is named that runs it. Its argument is the flight, a
.csv as ``convert`` reads it (time_us, gyro_*_rps, accel_*_mps2, mag_*_gauss, baro_alt_m, gps_*);
the last line that it prints is how many microseconds its filter took per inertial sample, the
reading of the file apart.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

from benchmarks.speed import flights, recordings
from benchmarks.speed.reference import Reference
from benchmarks.speed.result import Result
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.checkpoint import Checkpoint, Clocks, Sources, Vehicle, encode
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind, Measurement, merge
from ekf_companion.nav.state import Table
from ekf_companion.replay.smoothing import Smoothing
from sim_autopilot import events as wireless
from sim_autopilot.flight import Flight

REPEATS = 5
"""The fastest one counts: the others were disturbed."""
SETTLED = 10.0
"""s; errors and calls count from here on."""
LATE_NS = 250_000_000
REFERENCE_DURATION = 20.0
"""s; enough for a filter that takes 0.1 ms per sample."""


def measure(duration: float = 120.0, ekf2: Path | None = None) -> Iterator[Result]:
    """Time the compiled filter and the NumPy one on the same flight, and EKF2 by its program."""
    flight = flights.plan(duration)
    events = flights.events(flight)

    yield Result(
        name="in: inertial, GNSS, heading events per second of flight",
        value=len(events) / duration,
        unit="1/s",
    )
    compiled, error = _recording(flight, events)
    yield Result(
        name="compiled loop over a recording, per sample", value=compiled, unit="us", aim=2.5
    )
    usual, _, _ = _loop(events, FilterSettings())
    yield Result(name="the same with default settings, of late fixes", value=usual, unit="us")
    yield from _shares(flight)
    if ekf2 is not None:
        yield from _beside(ekf2, flight)
    yield Result(
        name="smoothing a recording, both runs, per sample",
        value=_smoothed(events),
        unit="us",
        aim=100.0,
    )
    dense, dense_error = _numpy(flight, events, min(duration, REFERENCE_DURATION))
    yield Result(name="plain NumPy, 15 dense states, per sample", value=dense, unit="us")
    yield Result(name="plain NumPy over compiled loop", value=dense / compiled, unit="times")
    yield Result(name="real time over compiled loop", value=4000.0 / compiled, unit="times")
    yield Result(name="horizontal RMS error, compiled", value=error, unit="m")
    yield Result(name="horizontal RMS error, NumPy", value=dense_error, unit="m")
    yield from _live(events)
    yield from _late(events)


def _shares(flight: Flight) -> Iterator[Result]:
    """Time the loop with a magnetometer and a barometer, and what each kind takes of that."""
    events = wireless.events(flight, has_vel_down=True)
    settled = events.t_ns > flight.first_ns + SETTLED * 1e9
    whole, _, _ = _loop(events)
    yield Result(name="the same, 50 Hz field and 25 Hz barometer", value=whole, unit="us", aim=2.0)
    rest = whole
    for kind, name in ((Kind.GNSS, "fixes"), (Kind.MAG, "field"), (Kind.BARO, "barometer")):
        saved = whole - _loop(events.take(~(settled & (events.kind == kind))))[0]
        rest -= saved
        yield Result(name=f"  of which {name}", value=saved, unit="us")
    yield Result(name="  of which motion, bank, noise, rest, estimates", value=rest, unit="us")


def _beside(ekf2: Path, flight: Flight) -> Iterator[Result]:
    """Time EKF2 and the loop in turn, on a flight with a magnetometer and a barometer."""
    found = recordings.by_kind(flight)
    del found[Kind.HEADING]
    # As a table is read: what was measured with a sample goes before it
    events = merge(*(found[kind] for kind in sorted(found)))
    ours, theirs = [], []
    with TemporaryDirectory() as folder:
        log = Path(folder) / "flight.csv"
        recordings.write_csv(log, found)
        for _ in range(REPEATS):
            ours.append(_loop(events, FilterSettings(), repeats=1)[0])
            done = subprocess.run([ekf2, log], capture_output=True, text=True, check=True)
            theirs.append(float(done.stdout.split()[-1]))
    yield Result(name="EKF2 on the flight of its own, per sample", value=min(theirs), unit="us")
    yield Result(name="  ours on it, default settings", value=min(ours), unit="us")
    yield Result(name="  EKF2 over ours", value=min(theirs) / min(ours), unit="times")


def _loop(
    events: Events, settings: FilterSettings = flights.SETTINGS, repeats: int = REPEATS
) -> tuple[float, Pipeline, Table]:
    """Return microseconds per sample of Pipeline.run, the pipeline, and its estimates."""
    count = int(np.count_nonzero(events.kind == Kind.IMU))
    best = np.inf
    for _ in range(repeats):
        pipeline = Pipeline(settings)
        began = time.perf_counter_ns()
        table = pipeline.run(events)
        best = min(best, (time.perf_counter_ns() - began) * 1e-3 / count)
    return best, pipeline, table


def _recording(flight: Flight, events: Events) -> tuple[float, float]:
    """Return microseconds per sample of Pipeline.run, and the horizontal RMS error."""
    best, pipeline, table = _loop(events)
    pos_n = np.column_stack([table.column(name) for name in ("pos_n", "pos_e")])
    truth = flight.truth_at(table.stamp_ns).pos_n[:, :2]
    origin = pipeline.origin
    assert origin is not None, "the flight was too short to find a position in"
    start = flight.trajectory.frame.to_ned(*origin)[:2]
    return best, _rms(pos_n + start - truth, flight, table.stamp_ns)


def _smoothed(events: Events) -> float:
    """Return microseconds per sample of Smoothing, from the events to the smoothed tables."""
    began = time.perf_counter_ns()
    with Smoothing(flights.SETTINGS) as estimator:
        count = len(estimator.run(events))
        for _ in estimator.tables():
            pass
    return (time.perf_counter_ns() - began) * 1e-3 / count


def _numpy(flight: Flight, events: Events, duration: float) -> tuple[float, float]:
    """Return the same of the reference, over the flight's beginning."""
    part = events.take(events.t_ns <= flight.first_ns + round(duration * 1e9))
    stamps = part.t_ns[part.kind == Kind.IMU]
    start = flight.truth_at(stamps[:1])
    reference = Reference(flight.trajectory.frame, int(stamps[0]), start)
    began = time.perf_counter_ns()
    track = reference.run(part)
    spent = (time.perf_counter_ns() - began) * 1e-3 / len(stamps)
    return spent, _rms(track[:, :2] - flight.truth_at(stamps).pos_n[:, :2], flight, stamps)


def _rms(offset: Array, flight: Flight, stamps: npt.NDArray[np.int64]) -> float:
    settled = stamps > flight.first_ns + min(SETTLED, flight.duration / 2.0) * 1e9
    return float(np.sqrt(np.nanmean(np.sum(offset[settled] ** 2, axis=1))))


def _live(events: Events) -> Iterator[Result]:
    """Time Pipeline.process, one event at a time, as the daemon calls it."""
    measurements = flights.measurements(events)
    pipeline = Pipeline(flights.SETTINGS)
    spent = _calls(pipeline.process, measurements)
    samples = events.kind == Kind.IMU
    mean = float(spent.sum()) / int(np.count_nonzero(samples))
    yield Result(name="live, all events over samples, per sample", value=mean, unit="us", aim=25.0)
    for share in (50.0, 99.0, 99.9):
        value = float(np.percentile(spent[samples], share))
        yield Result(name=f"live, one inertial sample, p{share:g}", value=value, unit="us")
    value = float(np.median(spent[events.kind == Kind.GNSS]))
    yield Result(name="live, one fix on its arrival, p50", value=value, unit="us")
    calls = _calls(lambda _: pipeline.estimate().odometry, measurements[:2000])
    yield Result(name="live, one estimate with covariances, p50", value=_median(calls), unit="us")
    calls = _calls(lambda _: encode(_checkpoint(pipeline)), measurements[:500])
    yield Result(name="live, one checkpoint as bytes, p50", value=_median(calls), unit="us")


def _checkpoint(pipeline: Pipeline) -> Checkpoint:
    vehicle, sources = Vehicle("px4", 1, 1), Sources()
    return Checkpoint(state=pipeline.state(), vehicle=vehicle, clocks=Clocks(0), sources=sources)


def _late(events: Events) -> Iterator[Result]:
    """Time fixes that arrive 250 ms late: what came after them is run again."""
    fixes = events.kind == Kind.GNSS
    order = np.argsort(events.t_ns + fixes * LATE_NS, kind="stable")
    late = flights.measurements(events.take(order))
    pipeline = Pipeline(flights.SETTINGS)
    spent = _calls(pipeline.process, late)[fixes[order]]
    settled = spent[len(spent) // 4 :]
    yield Result(name="late by 250 ms, one fix, p50", value=float(np.median(settled)), unit="us")
    value = float(np.percentile(settled, 99.0))
    yield Result(name="late by 250 ms, one fix, p99", value=value, unit="us")
    assert pipeline.health().reruns > 0, "no fix was late"


def _calls(function: Callable[[Measurement], object], items: list[Measurement]) -> Array:
    """Return microseconds of each call."""
    clock = time.perf_counter_ns
    stamps = np.empty((len(items), 2))
    for index, item in enumerate(items):
        began = clock()
        function(item)
        stamps[index] = began, clock()
    return np.asarray((stamps[:, 1] - stamps[:, 0]) * 1e-3)


def _median(values: Array) -> float:
    return float(np.median(values))
