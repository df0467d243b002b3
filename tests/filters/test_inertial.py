"""What the filters without fixes make of gaps, delays and nonsense in a recording."""

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters import (
    ahrs,
    ahrs_article,
    mahony,
    vqf_adapter,
    zupt,
)
from ekf_companion.filters.ahrs_sensors import GravityFilter
from ekf_companion.filters.inertial import inertial_samples, longest_part
from ekf_companion.filters.marg import marg_samples
from ekf_companion.filters.solution import Recorder
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, Restart, merge
from ekf_companion.replay.filters_by_name import run_filter
from tests.filters import walks
from tests.filters.swings import Swing, swing

HAND = Swing(seconds=30.0)


def spoiled(events, column, value, row=500):
    values = events.values.copy()
    values[np.flatnonzero(events.kind == Kind.IMU)[row], column] = value
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize("run", [mahony.run, ahrs_article.run, vqf_adapter.run])
def test_no_gap_is_integrated_as_one_step(run):
    if run is vqf_adapter.run:
        pytest.importorskip("vqf", reason="the package vqf is not installed")
    events, _ = swing(HAND)
    lost = (events.t_ns > 10e9) & (events.t_ns < 13e9)
    solution = run(events.take(~lost))
    assert solution.table.stamp_ns[0] >= 13_000_000_000
    assert len(solution.table) == np.count_nonzero(
        (events.kind == Kind.IMU) & (events.t_ns >= 13e9)
    )
    assert "1 gaps of more than 1 s" in solution.notes[0]


def test_a_walk_ends_at_a_gap():
    events = walks.make(np.random.default_rng(1), rate=100.0, strides=6).events
    lost = (events.t_ns > events.t_ns[-600]) & (events.t_ns < events.t_ns[-300])
    solution = zupt.run(events.take(~lost))
    assert solution.table.stamp_ns[-1] <= events.t_ns[-600]
    assert "gaps of more than 1 s" in solution.notes[0]
    events = walks.make(np.random.default_rng(1), rate=100.0, strides=14).events
    late = (events.t_ns > events.t_ns[150]) & (events.t_ns < events.t_ns[450])
    with pytest.raises(LogError, match=r"gaps of more than 1 s.*stand still for"):
        zupt.run(events.take(~late))


def test_the_first_sample_of_a_walk_counts():
    events = walks.make(np.random.default_rng(1), rate=100.0, strides=2).events
    solution = zupt.run(events)
    assert solution.table.stamp_ns[0] == events.t_ns[0]
    assert len(solution.table) == len(events)


@pytest.mark.parametrize(("column", "value"), [(0, 201.0), (4, -2001.0), (2, np.nan)])
def test_what_no_sensor_can_say_is_nowhere_a_sample(column, value):
    events, _ = swing(HAND)
    bad = spoiled(events, column, value)
    assert len(marg_samples(bad).t_ns) == len(marg_samples(events).t_ns) - 1
    walk = walks.make(np.random.default_rng(1), rate=100.0, strides=2).events
    assert len(zupt.run(spoiled(walk, column, value)).table) == len(walk) - 1


@pytest.mark.parametrize("name", ["ahrs", "mahony", "ahrs:corrected"])
def test_estimates_are_of_the_time_when_the_samples_were_true(name):
    events, _ = swing(HAND)
    late, now = (
        run_filter(Recording(family=family, events=events), name).table
        for family in ("ardupilot", "unknown")
    )
    assert (now.stamp_ns - late.stamp_ns == 11_500_000).all()


def test_a_field_that_is_told_late_is_taken_when_it_was_true():
    """ArduPilot's fields are late by 0.05 s, its samples by 0.0115 s (``core/settings``)."""
    events, truth = swing(Swing(seconds=30.0, turn=2.0, mag_noise=0.0))
    late = np.where(events.kind == Kind.MAG, 50_000_000, 11_500_000)
    told = Events(t_ns=events.t_ns + late, kind=events.kind, values=events.values)
    known = run_filter(Recording(family="ardupilot", events=told), "mahony").table
    assert (known.stamp_ns == truth.att_t_ns).all()
    plain = run_filter(Recording(family="unknown", events=events), "mahony").table
    off = so3.wrap(known.column("yaw") - plain.column("yaw"))[10:-10]
    assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("name", ["mahony", "zupt", "ahrs:article"])
def test_after_a_restart_of_the_clock_the_longest_part_counts(name):
    events = walks.make(np.random.default_rng(1), rate=100.0, strides=3).events
    cut = len(events) // 4
    restart = Events.from_rows([Restart().row()])
    # The first quarter is run again, on a clock that begins anew
    parts = [events, restart, events.take(np.arange(cut))]
    both = merge(
        *parts,
        arrival_ns=[np.full(n, k) for k, n in enumerate((len(events), 1, cut))],
    )
    once, twice = (
        run_filter(Recording(family="unknown", events=each), name) for each in (events, both)
    )
    assert twice.table.values.tobytes() == once.table.values.tobytes()
    assert "clock begins anew" in twice.notes[-1]


def test_without_gravity_nothing_is_divided_by_it():
    events, _ = swing(HAND)
    values = events.values.copy()
    values[events.kind == Kind.IMU, 3:6] = 0.0
    dead = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    solution = ahrs.run(dead)
    assert np.isfinite(solution.table.column("roll")).all()
    values[:, :3] *= events.kind[:, None] != Kind.IMU
    still = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    with pytest.raises(LogError, match=r"reads 0\.00 m/s\^2 at rest"):
        zupt.run(still)
    gravity = GravityFilter(3.0, 15.0)
    for _ in range(400):
        gravity.add(0.0, 0.0, 0.0, 0.01)
        gravity.sigma(0.01)
    assert gravity.gravity == 0.0


def test_sigmas_of_the_angles_know_how_the_errors_are_tied():
    """Tied fully to north, an error about down moves yaw and roll by what both add up to."""
    q_nb = so3.from_euler(0.0, 0.6, 0.0)
    recorder = Recorder("made", None)
    P = 1e-6 * np.eye(9)
    tied = np.array([0.03, 0.0, 0.02])
    P[:3, :3] = np.outer(tied, tied)
    state = Nominal(q_nb=q_nb, vel_n=np.zeros(3), pos_n=np.zeros(3))
    recorder.add(0, state, P)
    table = recorder.solution().table
    moved = so3.to_euler(so3.multiply(so3.exp(1e-4 * tied), q_nb)) - so3.to_euler(q_nb)
    found = [table.column(f"sd_{name}")[0] for name in ("roll", "pitch", "yaw")]
    np.testing.assert_allclose(found, np.abs(moved) * 1e4, atol=1e-5)  # one-sided difference


def test_a_recording_without_gaps_stays_whole():
    events, _ = swing(HAND)
    imu = inertial_samples(events)
    whole, notes = longest_part(imu, FilterSettings().imu.gap_reset)
    assert len(whole) == len(imu)
    assert notes == ()
