"""What one sensor says wrong the others show: no estimate is called good that is off by its sigmas.

A lie is a row with status OK that is off by 5 of its own sigmas and by 2 m or 0.5 m/s.
"""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, changed, flight
from tests.engine.estimation import KNOWN, errors, run

METRE = 1.0 / 6.367e6
"""Of latitude, rad."""
ALT, VEL_DOWN = 2, 5
"""Columns of a fix."""
NOISE = (0.4, 0.5)
LEARNT = 100
"""Rows of the second over which a bank of hypotheses learns how noisy the samples are."""

either = pytest.mark.parametrize("weigh", ["off", "act"])
"""The gates' own rules, and the hypotheses: who refuses whom is a matter of the first alone."""


def of(events: Events, kind: Kind, start: float, end: float) -> np.ndarray:
    return between(events, start, end) & (events.kind == kind)


def seconds(events: Events) -> np.ndarray:
    return (events.t_ns - events.t_ns[0]) * 1e-9


def judge(events, truth, weigh=KNOWN.weigh_faults):
    """Run events; return the table, its errors, and how many rows lie."""
    table, pipeline = run(events, replace(KNOWN, weigh_faults=weigh))
    late = errors(table, truth, 0.0)
    ok = table.column("status")[-len(late["pos"]) :] == Status.OK
    lies = 0
    for block, floor in (("pos", 2.0), ("vel", 0.5)):
        off = np.abs(late[block])
        lies += np.count_nonzero(
            ok & ((off > 5.0 * late[f"sd_{block}"]) & (off > floor)).any(axis=1)
        )
    return table, late, lies, pipeline


@either
def test_a_barometer_that_drifts_away_is_left_to_itself(weigh):
    events, truth = flight("figure-eight", duration=110.0, noise=NOISE)
    drift = 0.35 * np.clip(seconds(events) - 30.0, 0.0, 60.0)
    values = events.values.copy()
    rows = events.kind == Kind.BARO
    values[rows, 0] += drift[rows]
    _, late, lies, pipeline = judge(
        Events(t_ns=events.t_ns, kind=events.kind, values=values), truth, weigh
    )
    assert lies == 0
    assert np.nanmax(np.abs(late["pos"][:, 2])) < 5.0
    assert weigh == "act" or pipeline.health().verdicts[Aid.BARO][Verdict.SUSPECT] > 100


@either
def test_a_vertical_velocity_that_runs_wild_does_not_take_the_height_along(weigh):
    events, truth = flight("hover", duration=80.0, noise=NOISE)
    wild = changed(events, of(events, Kind.GNSS, 30.0, 45.0), VEL_DOWN, 9.0)
    table, late, lies, pipeline = judge(wild, truth, weigh)
    assert lies == 0
    assert np.nanmax(np.abs(late["pos"][:, 2])) < 4.0
    assert pipeline.health().resets == 0
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    wrong = table.column("status")[(t > 32.0) & (t < 45.0)]
    assert weigh == "act" or (wrong == Status.DEGRADED).all()


def test_a_receivers_height_that_wanders_off_is_not_heard_until_it_is_back():
    events, truth = flight("hover", duration=160.0, noise=NOISE)
    t = seconds(events)
    values = events.values.copy()
    rows = events.kind == Kind.GNSS
    values[rows, ALT] += np.interp(t, [30.0, 75.0, 120.0], [0.0, 15.0, 0.0])[rows]
    table, late, lies, _ = judge(Events(t_ns=events.t_ns, kind=events.kind, values=values), truth)
    assert lies == 0
    assert np.nanmax(np.abs(late["pos"][:, 2])) < 6.0
    assert table.column("status")[-1] == Status.OK


@either
def test_a_receiver_that_returns_wrong_is_refused_while_its_velocity_denies_it(weigh):
    events, truth = flight("figure-eight", duration=75.0, noise=NOISE)
    events = events.take(~of(events, Kind.GNSS, 25.0, 40.0))
    wrong = changed(events, of(events, Kind.GNSS, 40.0, 58.0), 0, 300.0 * METRE)
    table, late, lies, pipeline = judge(wrong, truth, weigh)
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    assert lies == 0
    assert np.nanmax(np.abs(late["pos"][:, :2])) < 20.0
    denied = table.column("status")[(t > 27.0) & (t < 57.5)]
    assert weigh == "act" or not (denied == Status.OK).any()
    assert pipeline.health().resets == 0


def test_a_receiver_that_returns_right_is_followed_at_once():
    events, truth = flight("figure-eight", duration=60.0, noise=NOISE)
    table, late, lies, _ = judge(events.take(~of(events, Kind.GNSS, 20.0, 45.0)), truth)
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    back = t[-len(late["pos"]) :] > 47.0
    assert lies == 0
    assert np.abs(late["pos"][back]).max() < 3.0
    assert (table.column("status")[t > 47.0] == Status.OK).mean() > 0.95


@either
@pytest.mark.parametrize("frequency", [0.4, 1.0, 2.5])
def test_vibration_that_samples_as_a_slow_wave_is_doubted(frequency, weigh):
    events, truth = flight("figure-eight", duration=80.0, noise=NOISE)
    t = seconds(events)
    wave = np.sin(2.0 * np.pi * frequency * t) * np.clip((t - 20.0) / 5.0, 0.0, 1.0)
    values = events.values.copy()
    rows = of(events, Kind.IMU, 20.0, 99.0)
    values[rows, 3] += 1.5 * wave[rows]
    values[rows, 0] += 0.02 * wave[rows]
    events = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    _, late, lies, _ = judge(events, truth, weigh)
    assert lies <= (LEARNT if weigh == "act" else 0)
    assert np.nanmax(np.abs(late["pos"][:, :2])) < 5.0


def test_an_accelerometer_at_the_end_of_its_range_is_doubted():
    events, truth = flight("figure-eight", duration=80.0, noise=NOISE)
    values = events.values.copy()
    rows = events.kind == Kind.IMU
    values[rows, 5] = np.clip(values[rows, 5], -11.6, 11.6)
    assert 0.05 < np.mean(values[rows, 5] == -11.6) < 0.6
    _, late, lies, _ = judge(Events(t_ns=events.t_ns, kind=events.kind, values=values), truth)
    assert lies == 0
    assert np.nanmax(np.abs(late["vel"])) < 1.5


def test_a_drift_too_quiet_for_the_samples_is_no_rest_where_the_receiver_shows_it():
    events, _ = flight("static", duration=60.0, noise=NOISE)
    t = seconds(events)
    moved = 0.3 * np.clip(t - 15.0, 0.0, None)
    values = events.values.copy()
    rows = (events.kind == Kind.GNSS) & (t > 15.0)
    values[rows, 0] += moved[rows] * METRE
    values[rows, 3] += 0.3
    events = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    table, _ = run(events.take(events.kind != Kind.VEHICLE))
    late = (table.stamp_ns - table.stamp_ns[0]) * 1e-9 > 30.0
    assert abs(table.column("vel_n")[late].mean() - 0.3) < 0.03


@either
def test_a_receiver_that_falls_and_leaps_as_no_accelerometer_felt_is_wrong_itself(weigh):
    """Position and velocity agree with each other, and the samples are in doubt by vibration."""
    events, truth = flight("hover", duration=60.0, noise=NOISE)
    t, values = seconds(events), events.values.copy()
    imu = events.kind == Kind.IMU
    values[imu, 3:6] += 2.0 * np.sin(2.0 * np.pi * 0.4 * t[imu])[:, None]
    gnss = events.kind == Kind.GNSS
    after = np.clip(t[gnss] - 40.0, 0.0, None)
    gained = np.where(after < 2.0, 12.0 * after, np.clip(24.0 - 48.0 * (after - 2.0), 0.0, None))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (gained[1:] + gained[:-1]) * np.diff(t[gnss]))])
    back = np.where(after > 3.0, np.exp(-(after - 3.0) / 3.0), 1.0)
    values[gnss, 3] += 3.0 * gained
    values[gnss, VEL_DOWN] += gained
    values[gnss, 0] += 3.0 * way * back * METRE
    values[gnss, ALT] -= way * back
    assert way.max() > 25.0
    events = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    _, late, lies, _ = judge(events, truth, weigh)
    assert lies <= (LEARNT if weigh == "act" else 0)
    assert np.nanmax(np.abs(late["pos"][:, 2])) < 20.0
