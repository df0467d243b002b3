from dataclasses import replace

import numpy as np
import pytest

from benchmarks.matched import matched
from ekf_companion.core.settings.settings import (
    FilterSettings,
    GnssSettings,
    HeadingSettings,
    ImuSettings,
)
from ekf_companion.errors import LogError
from ekf_companion.filters import iterated
from ekf_companion.filters.euler import Euler
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.observation import Azimuth, Position, Velocity
from ekf_companion.filters.sequence import MeasurementSequence, run_sequence
from ekf_companion.filters.ukf import Unscented
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, GnssFlag, HeadingSource, Kind, merge
from ekf_companion.replay.filters_by_name import run_filter
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

MS = 1_000_000


def imu(stamps_ms, rates=None):
    n = len(stamps_ms)
    t_ns = np.array(stamps_ms, dtype=np.int64) * MS
    rates = np.zeros(n) if rates is None else np.array(rates, dtype=float)
    none = np.zeros(n)
    return Events.from_columns(t_ns, Kind.IMU, rates, none, none, none, none, none - 9.8)


def fixes(stamps_ms, vel_down=0.0, flags=0, vel=1.0):
    position, stds, field = (0.8, 0.1, 100.0), (1.0, 2.0, 0.1), (0.0, flags, 1.1, 0.48)
    values = [*position, vel, 0.0, vel_down, *stds, *field]
    one = np.ones(len(stamps_ms))
    return Events.from_columns(
        np.array(stamps_ms, dtype=np.int64) * MS,
        Kind.GNSS,
        *np.outer(values, one),
    )


def headings(stamps_ms, source=HeadingSource.GNSS, angle=0.5):
    one = np.ones(len(stamps_ms))
    t_ns = np.array(stamps_ms, dtype=np.int64) * MS
    return Events.from_columns(t_ns, Kind.HEADING, angle * one, 0.03 * one, int(source) * one)


def steps(sequence, after_ms=0):
    return list(sequence.steps(after_ms * MS))


def test_an_aid_splits_the_interval_of_its_time():
    sequence = MeasurementSequence(
        merge(imu([0, 10, 20]), fixes([5]), headings([13, 20])), FilterSettings(), "unknown"
    )
    found = [(s.t_ns // MS, s.is_sample, [a.aid for a in s.aids]) for s in steps(sequence)]
    assert found == [
        (5, False, ["position", "velocity"]),
        (10, True, []),
        (13, False, ["heading"]),
        (20, True, ["heading"]),
    ]
    assert [round(s.over.dt * 1e3, 9) for s in steps(sequence)] == [5.0, 5.0, 3.0, 7.0]


def test_readings_within_an_interval_are_means_or_on_the_line_between_samples():
    events = merge(imu([0, 10, 20], [0.0, 1.0, 3.0]), fixes([14]), headings([0]))
    for samples, ends in (("mean", (3.0, 3.0)), ("instant", (1.0, 1.8))):
        sequence = MeasurementSequence(
            events, FilterSettings(imu=ImuSettings(samples=samples)), "unknown"
        )
        over = steps(sequence)[1].over
        assert (over.gyro0[0], over.gyro1[0]) == pytest.approx(ends)
        assert sequence.is_mean is (samples == "mean")


def test_intervals_lie_end_to_end():
    flight = Flight.plan("hover", SimConfig(imu=ImuConfig(rate=50.0)), seed=1, duration=5.0)
    sequence = MeasurementSequence(wire.events(flight, has_vel_down=True), FilterSettings())
    now = begin = sequence.setup().start.t_ns
    for step in sequence.steps(begin):
        now += 0 if step.over is None else round(step.over.dt * 1e9)
        assert now == step.t_ns
        assert step.aids or step.is_sample
    assert now == sequence.t_ns[-1]
    assert sum(step.is_sample for step in sequence.steps(begin)) == (sequence.t_ns > begin).sum()


def test_the_order_of_arrival_does_not_matter():
    flight = Flight.plan("hover", SimConfig(imu=ImuConfig(rate=50.0)), seed=1, duration=4.0)
    events = wire.events(flight, has_vel_down=True)
    order = np.random.default_rng(1).permutation(len(events))
    one, other = (MeasurementSequence(e, FilterSettings()) for e in (events, events.take(order)))
    assert (one.t_ns == other.t_ns).all()
    assert [(t, aid.aid) for t, aid in one.aids] == [(t, aid.aid) for t, aid in other.aids]
    gaps = [
        np.abs(
            a.innovation(one.setup().start.state) - b.innovation(other.setup().start.state)
        ).max()
        for (_, a), (_, b) in zip(one.aids[:20], other.aids[:20], strict=True)
    ]
    assert max(gaps) == 0.0


def test_a_fix_counts_when_it_was_true():
    settings = FilterSettings(gnss=GnssSettings(delay=0.1))
    events = merge(imu([0, 10]), fixes([107]), headings([0]))
    for delay, at in ((settings, 7), (FilterSettings(), 107)):
        sequence = MeasurementSequence(events, delay, "unknown")
        assert [t // MS for t, aid in sequence.aids if isinstance(aid, Position)] == [at]


def test_of_two_headings_the_better_source_speaks():
    events = merge(
        imu([0, 10]),
        fixes([1]),
        headings([2], HeadingSource.AUTOPILOT, 1.0),
        headings([3], HeadingSource.GNSS, 2.0),
    )
    for source, angle in (("auto", 2.0), ("gnss", 2.0), ("autopilot", 1.0)):
        settings = FilterSettings(heading=HeadingSettings(source=source))
        sequence = MeasurementSequence(events, settings)
        assert [a.azimuth for _, a in sequence.aids if isinstance(a, Azimuth)] == [angle]
    with pytest.raises(LogError, match="no heading"):
        MeasurementSequence(events, FilterSettings(heading=HeadingSettings(source="magnetometer")))


def test_the_autopilots_own_position_speaks_only_where_the_receiver_is_silent():
    derived = fixes([3], flags=int(GnssFlag.DERIVED))
    both = merge(imu([0, 10]), fixes([2]), derived, headings([1]))
    alone = merge(imu([0, 10]), derived, headings([1]))
    for events, source, at in ((both, "auto", 2), (both, "global", 3), (alone, "auto", 3)):
        sequence = MeasurementSequence(events, FilterSettings(gnss=GnssSettings(source=source)))
        assert [t // MS for t, aid in sequence.aids if isinstance(aid, Position)] == [at]
    with pytest.raises(LogError, match="no GNSS fix"):
        MeasurementSequence(alone, FilterSettings(gnss=GnssSettings(source="raw")))


def test_a_receiver_that_reports_spoofing_is_not_heard():
    bad = fixes([3], flags=int(GnssFlag.SUSPECT))
    with pytest.raises(LogError, match="no GNSS fix"):
        MeasurementSequence(merge(imu([0, 10]), bad, headings([1])), FilterSettings())


@pytest.mark.parametrize(
    ("vel_down", "vel", "axes"), [(0.2, 1.0, [3]), (np.nan, 1.0, [2]), (0.0, np.nan, [])]
)
def test_a_velocity_has_the_axes_that_were_told(vel_down, vel, axes):
    sequence = MeasurementSequence(
        merge(imu([0, 10]), fixes([2], vel_down, 0, vel), headings([1])), FilterSettings()
    )
    assert [len(a.vel_n) for _, a in sequence.aids if isinstance(a, Velocity)] == axes


def test_without_inertial_samples_there_is_nothing_to_integrate():
    with pytest.raises(LogError, match="no inertial samples"):
        MeasurementSequence(merge(imu([0]), fixes([1]), headings([1])), FilterSettings())


def test_a_field_of_another_strength_shows_no_north():
    config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(rate=5.0))
    events = wire.events(Flight.plan("hover", config, seed=1, duration=3.0), has_vel_down=True)
    values = events.values.copy()
    values[events.kind == Kind.MAG, :3] *= 2.0
    with pytest.raises(LogError, match="no heading"):
        MeasurementSequence(
            Events(t_ns=events.t_ns, kind=events.kind, values=values), FilterSettings()
        )


def test_over_a_gap_that_cannot_be_bridged_only_the_longest_part_counts():
    stamps = [*range(0, 200, 10), *range(60_000, 60_500, 10)]
    events = merge(imu(stamps), fixes([5, 60_005]), headings([5, 60_005]))
    sequence = MeasurementSequence(events, FilterSettings())
    assert len(sequence.t_ns) == 50
    assert sequence.t_ns[0] == 60_000 * MS
    assert [t // MS for t, _ in sequence.aids] == [60_005] * 3
    assert len(sequence.notes) == 1
    assert "59.8 s" in sequence.notes[0]
    bridged = MeasurementSequence(
        merge(imu(range(0, 200, 50)), fixes([5]), headings([5])), FilterSettings()
    )
    assert bridged.notes == ()


@pytest.mark.parametrize(("column", "value"), [(0, 201.0), (4, -2001.0), (2, np.nan)])
def test_what_no_sensor_can_say_is_no_sample(column, value):
    samples = imu([0, 10, 20, 30])
    samples.values[1, column] = value
    sequence = MeasurementSequence(merge(samples, fixes([5]), headings([5])), FilterSettings())
    assert (sequence.t_ns // MS).tolist() == [0, 20, 30]


def test_a_heading_that_is_no_number_is_not_heard():
    bad = headings([2, 4])
    bad.values[0, 0] = np.nan
    bad.values[1, 1] = np.nan
    with pytest.raises(LogError, match="no heading"):
        MeasurementSequence(merge(imu([0, 10]), fixes([1]), bad), FilterSettings())
    sequence = MeasurementSequence(
        merge(imu([0, 10]), fixes([1]), bad, headings([6])), FilterSettings()
    )
    assert [t // MS for t, a in sequence.aids if isinstance(a, Azimuth)] == [6]


def test_where_the_better_source_falls_silent_another_speaks():
    stamps = range(0, 30_000, 100)
    events = merge(
        imu(stamps),
        fixes([1]),
        headings(range(0, 30_000, 1000), HeadingSource.AUTOPILOT, 1.0),
        headings([500, 1500, 2500, 25_500], HeadingSource.GNSS, 2.0),
    )
    found = [
        (t // MS, a.azimuth)
        for t, a in MeasurementSequence(events, FilterSettings()).aids
        if a.aid == "heading"
    ]
    better = [(t, 2.0) for t in (500, 1500, 2500, 25_500)]
    other = [(t, 1.0) for t in range(13_000, 26_000, 1000)]
    assert found == sorted(better + other)


def test_a_field_along_the_vertical_is_passed_over():
    config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(rate=5.0))
    events = wire.events(Flight.plan("hover", config, seed=1, duration=6.0), has_vel_down=True)
    values = events.values.copy()
    late = (events.kind == Kind.MAG) & (events.t_ns > events.t_ns[0] + 3_000_000_000)
    size = np.linalg.norm(values[late, :3], axis=1)
    values[late, :3] = np.column_stack([0.0 * size, 0.0 * size, size])
    spoiled = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    solution = iterated.run(MeasurementSequence(spoiled, FilterSettings()))
    fused, refused = solution.counts["heading"]
    # Level as it is, it takes those of the first seconds for all there are
    assert fused + refused < 0.7 * (events.kind == Kind.MAG).sum()
    assert np.isfinite(solution.table.column("yaw")).all()


@pytest.mark.parametrize("name", ["euler", "iterated", "iterated:robocentric", "ukf"])
def test_a_jump_of_the_fixes_is_taken_after_the_time_out_and_tilts_nothing(name):
    config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(rate=5.0, delay=0.0))
    flight = Flight.plan("hover", config, seed=4, duration=20.0)
    events = wire.events(flight, has_vel_down=True)
    jumped = (events.kind == Kind.GNSS) & (events.t_ns > events.t_ns[0] + 6_000_000_000)
    values = events.values.copy()
    values[jumped, 0] += 300.0 / 6.371e6
    recording = Recording(
        family="unknown", events=Events(t_ns=events.t_ns, kind=events.kind, values=values)
    )
    solution = run_filter(recording, name, matched(config))
    t = (solution.table.stamp_ns - events.t_ns[0]) * 1e-9
    north = solution.table.column("pos_n")
    assert np.abs(north[(t > 6.0) & (t < 12.0)]).max() < 20.0
    assert north[t > 15.0] == pytest.approx(300.0, abs=10.0)
    truth = flight.truth_at(solution.table.stamp_ns)
    q_nb = np.stack([solution.table.column(f"q_{one}") for one in "wxyz"], axis=1)
    down = [so3.to_matrix(q)[:, 2, :] for q in (q_nb, truth.q_nb)]
    tilt = np.degrees(np.arccos(np.clip((down[0] * down[1]).sum(axis=1), -1.0, 1.0)))
    assert tilt[t > 6.0].max() < 2.0
    assert solution.table.column("reset_count")[-1] == 1.0
    assert "position was taken anew 1 times" in " ".join(solution.notes)
    assert np.abs(solution.table.column("vel_n")[t > 6.0]).max() < 3.0


@pytest.mark.campaign
@pytest.mark.parametrize("make", [Euler, Iterated, Unscented])
def test_a_sure_but_tilted_start_finds_level_again_by_the_reset_of_the_velocity(make):
    config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(rate=5.0, delay=0.0))
    flight = Flight.plan("hover", config, seed=4, duration=20.0)
    sequence = MeasurementSequence(wire.events(flight, has_vel_down=True), matched(config))
    setup = sequence.setup()
    tilted = so3.multiply(setup.start.state.q_nb, so3.exp(np.radians([25.0, 0.0, 0.0])))
    P = setup.start.P.copy()
    P[:3, :] = P[:, :3] = 0.0
    P[:3, :3] = np.radians(0.5) ** 2 * np.eye(3)
    start = replace(setup.start, state=replace(setup.start.state, q_nb=tilted), P=P)
    setup = replace(setup, start=start)
    table = run_sequence("tried", make(setup), sequence, setup).table
    assert setup.gate.resets.get("velocity", 0) >= 1
    truth = flight.truth_at(table.stamp_ns[-50:])
    q_nb = np.stack([table.column(f"q_{one}")[-50:] for one in "wxyz"], axis=1)
    off = so3.log(so3.multiply(truth.q_nb, so3.conjugate(q_nb)))
    assert np.degrees(np.abs(off[:, :2]).max()) < 1.0
