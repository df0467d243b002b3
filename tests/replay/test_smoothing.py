"""Smoothed flights: nearer to the truth than the live filter, and honest about how near."""

import tracemalloc

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_companion.core.memory.enums import E_ATT, E_BA, E_BARO, E_HEADING, E_POS, E_VEL
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.state import BLOCK
from ekf_companion.core.rts import Smoother
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import (
    BaroSettings,
    FilterSettings,
    GateSettings,
    GnssSettings,
    HeadingSettings,
    ImuSettings,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Status, Table, join
from ekf_companion.replay import smoothing
from ekf_companion.replay.smoothing import Smoothing, smooth
from sim_autopilot.scenarios import SCENARIOS
from tests.core.flights import between, changed, flight, without
from tests.engine.estimation import errors, rms

KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.02, white_share=1.0))
TRUE = FilterSettings(
    imu=ImuSettings(
        gyro_noise=5e-4,
        accel_noise=5e-3,
        gyro_bias_walk=4e-6,
        accel_bias_walk=1.6e-4,
        accel_bias=0.03,
    ),
    gnss=GnssSettings(delay=0.12, delay_std=0.02, height_std=0.1, white_share=1.0),
    heading=HeadingSettings(magnetometer_std=0.01),
    baro=BaroSettings(std=0.1, walk=0.04),
)
"""What the simulator's sensors are (sim_autopilot.config)."""


def both(events: Events, settings: FilterSettings = KNOWN) -> tuple[Table, Table]:
    """Return the live estimates and the smoothed ones."""
    with Smoothing(settings) as estimator:
        live = estimator.run(events)
        return live, join(list(estimator.tables()))


def same_rows(live: Table, smoothed: Table) -> bool:
    return np.array_equal(live.stamp_ns, smoothed.stamp_ns)


# at rest the tilt is as unknown in the end as at the start: there is nothing to learn
@pytest.mark.parametrize("name", sorted(set(SCENARIOS) - {"static"}))
def test_it_is_nearer_to_the_truth_than_the_live_filter_in_every_axis(name):
    squares: dict[str, list[list[np.ndarray]]] = {"pos": [], "vel": [], "euler": []}
    for seed in range(1, 9):
        events, truth = flight(name, duration=60.0, seed=seed, rate=50.0)
        tables = both(events, TRUE)
        assert same_rows(*tables)
        late = [errors(table, truth, 10.0) for table in tables]
        for block in squares:
            squares[block].append([np.mean(np.square(one[block]), axis=0) for one in late])
    for block, flights in squares.items():
        live, smoothed = np.sqrt(np.mean(flights, axis=0))
        assert (smoothed < live).all(), (block, live, smoothed)
        if block == "vel":
            assert (smoothed < 0.75 * live).all(), (live, smoothed)


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["hover", "square-spiral"])
def test_its_covariance_is_that_of_its_errors(name):
    seeds, times = 16, (15.0, 30.0, 45.0, 55.0)
    settings = FilterSettings(
        imu=ImuSettings(
            gyro_noise=3e-4,
            accel_noise=3e-3,
            gyro_bias_walk=4e-6,
            accel_bias_walk=1.6e-4,
            gyro_bias=5e-3,
            accel_bias=0.03,
            learn_noise=False,
        ),
        gnss=GnssSettings(delay=0.12, delay_std=0.0, height_std=0.1, white_share=1.0),
        heading=HeadingSettings(source="gnss"),
        baro=TRUE.baro,
    )
    nees = np.zeros((len(times), 3))
    for seed in range(1, seeds + 1):
        events, truth = flight(name, 60.0, seed, rate=50.0, yaw=True)
        blocks = smoothed_blocks(events, settings)
        for i, at_s in enumerate(times):
            row = round(at_s * 50.0) - 1
            nees[i] += normalised(blocks[row], truth, row)
    # each time has independent flights; 1 in 1e4 of a true covariance would fall out
    for dof, sums in ((9, nees[:, 0]), (6, nees[:, 1]), (3, nees[:, 2])):
        low, high = chi2.ppf([5e-5, 1.0 - 5e-5], dof * seeds)
        assert (sums > low).all(), (dof, sums)
        assert (sums < high).all(), (dof, sums)


def smoothed_blocks(events: Events, settings: FilterSettings) -> np.ndarray:
    pipeline = Pipeline(settings, keeps_history=True)
    pipeline.run(events)
    rows = np.concatenate([part[3] for part in pipeline.history(is_over=True)])
    return Smoother(parameters(settings, "unknown")).smooth(np.zeros(BLOCK), rows, None)[1:]


def normalised(block: np.ndarray, truth, row: int) -> list[float]:
    """Return the error squared over its covariance: of all nine, of the motion, of the attitude."""
    x = as_state(block.copy())
    frame = LocalFrame(x.origin.lat, x.origin.lon, x.origin.alt)
    error = np.concatenate(
        [
            so3.log(so3.multiply(truth.q_nb[row], so3.conjugate(np.array(x.q_nb)))),
            truth.vel_n[row] - np.array(x.vel_n),
            np.ravel(frame.to_ned(truth.lat[row], truth.lon[row], truth.alt[row]))
            - np.array(x.pos_n),
        ]
    )
    P = np.array(x.P)[:9, :9]
    parts = (slice(0, 9), slice(3, 9), slice(0, 3))
    return [error[part] @ np.linalg.solve(P[part, part], error[part]) for part in parts]


@pytest.mark.parametrize("name", ["figure-eight", "loiter"])
def test_with_the_default_settings_it_claims_no_more_than_is_true(name):
    squares: dict[str, list[float]] = {"pos": [], "vel": [], "euler": []}
    for seed in range(1, 7):
        events, truth = flight(name, duration=50.0, seed=seed, rate=50.0)
        late = errors(smooth(events, KNOWN), truth, 10.0)
        for block in squares:
            squares[block].append(float(np.mean(np.square(late[block] / late[f"sd_{block}"]))))
    for block, each in squares.items():
        # defaults are for vibrating sensors, so sigma is too large here, never too small
        assert 0.1 < np.sqrt(np.mean(each)) < 1.2, block


def test_an_outage_is_bridged_from_both_ends():
    squares = []
    for seed in (1, 2, 3, 4, 5, 6):
        events, truth = flight("figure-eight", duration=90.0, seed=seed, rate=50.0)
        lost = between(events, 30.0, 60.0) & (events.kind == Kind.GNSS)
        live, smoothed = both(events.take(~lost))
        late = [errors(table, truth, 30.0) for table in (live, smoothed)]
        during = slice(250, 1500)
        squares.append([np.mean(np.square(one["pos"][during])) for one in late])
        assert rms(late[1]["pos"][during]) < 1.0
        assert (np.abs(late[1]["pos"][during]) < 4.0 * late[1]["sd_pos"][during]).all()
        # the status is the live filter's: nobody aided it
        t = (smoothed.stamp_ns - smoothed.stamp_ns[0]) * 1e-9
        assert (smoothed.column("status")[(t > 35.0) & (t < 59.0)] == Status.DEAD_RECKONING).all()
    live_rms, smoothed_rms = np.sqrt(np.mean(squares, axis=0))
    assert smoothed_rms < 0.16 * live_rms  # what is left is the receiver's slow error at the ends


def test_a_short_gap_of_inertial_samples_is_bridged_too():
    live, smoothed = [], []
    for seed in (1, 2, 3):
        events, truth = flight("figure-eight", duration=40.0, seed=seed)
        gap = between(events, 20.0, 20.8) & (events.kind == Kind.IMU)
        found = np.searchsorted(truth.pos_t_ns, events.t_ns[0]) + 2080
        for errors_of, table in zip((live, smoothed), both(events.take(~gap)), strict=True):
            row = np.searchsorted(table.stamp_ns, truth.pos_t_ns[found])
            error = [
                table.column(f"vel_{axis}")[row : row + 20] - truth.vel_n[found : found + 20, i]
                for i, axis in enumerate("ned")
            ]
            errors_of.append(rms(np.array(error)))
    assert rms(np.array(smoothed)) < 0.2 * rms(np.array(live))


def test_what_comes_after_a_reset_says_nothing_of_the_position_before_it():
    events, truth = flight("hover", duration=70.0)
    jumped = changed(events, between(events, 15.0, 99.0) & (events.kind == Kind.GNSS), 0, 5e-5)
    live, smoothed = both(jumped)
    assert live.column("reset_count")[-1] == 1
    reset = int(np.flatnonzero(smoothed.column("reset_count") == 1)[0])
    t = (smoothed.stamp_ns - smoothed.stamp_ns[0]) * 1e-9
    assert 45.0 < t[reset] < 51.0
    late = errors(smoothed, truth, 0.0)["pos"]
    before = slice(1000, reset)
    assert np.abs(late[before]).max() < 1.0
    assert np.abs(late[reset:, 0] - 5e-5 * 6.367e6).max() < 5.0
    assert errors(smoothed, truth, 0.0)["sd_pos"][before].max() < 1.5


@pytest.mark.parametrize(
    ("kind", "column", "size", "axis"),
    [(Kind.GNSS, 0, 20.0 / 6.367e6, 0), (Kind.GNSS, 2, 15.0, 2), (Kind.BARO, 0, 8.0, 2)],
    ids=["position", "height", "barometer"],
)
def test_a_fault_that_was_repaired_is_smoothed_as_if_it_had_never_been(kind, column, size, axis):
    """Its repair jumps; what was shown before that is as near to the truth as without the fault."""
    events, truth = flight("figure-eight", duration=60.0, rate=50.0)
    settings = FilterSettings(gnss=KNOWN.gnss, weigh_faults="act")
    faulty = changed(events, between(events, 30.0, 99.0) & (events.kind == kind), column, size)
    live, smoothed = both(faulty, settings)
    assert same_rows(live, smoothed)
    right, wrong = (errors(table, truth, 5.0) for table in (both(events, settings)[1], smoothed))
    assert np.isfinite(wrong["pos"]).all()
    assert rms(wrong["pos"][:, axis]) < rms(right["pos"][:, axis]) + 1.0
    assert (np.abs(wrong["pos"]) < 5.0 * wrong["sd_pos"] + 1.0).all()


def test_fault_hypotheses_that_decide_smooth_to_the_same_in_pieces_of_any_length(monkeypatch):
    events, _ = flight("figure-eight", duration=40.0, rate=50.0)
    events = changed(events, between(events, 20.0, 99.0) & (events.kind == Kind.BARO), 0, 8.0)
    settings = FilterSettings(gnss=KNOWN.gnss, weigh_faults="act")
    whole = smooth(events, settings)
    monkeypatch.setattr(smoothing, "STRETCH", 100)
    parts = smooth(events, settings)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-9, atol=1e-11)


def test_an_attitude_found_anew_begins_a_new_stretch():
    events, truth = flight("figure-eight", duration=50.0)
    hit = between(events, 20.0, 20.5) & (events.kind == Kind.IMU)
    live, smoothed = both(changed(events, hit, 0, 6.0))  # 3 rad that never were
    t = (smoothed.stamp_ns - smoothed.stamp_ns[0]) * 1e-9
    assert live.column("reset_count")[-1] >= 1
    assert np.isnan(smoothed.column("roll")[smoothed.column("status") <= Status.ALIGNING]).all()
    for start, end in ((10.0, 19.0), (32.0, 50.0)):
        part = [errors(table, truth, start) for table in (live, smoothed)]
        count = np.count_nonzero((t >= start) & (t < end))
        angles = [rms(one["euler"][:count]) for one in part]
        assert angles[1] < angles[0]
        assert np.degrees(angles[1]) < 1.0


def test_a_heading_that_jumps_does_not_turn_the_yaw_before_it():
    events, truth = flight("static", duration=40.0, rate=50.0)
    yaw = so3.to_euler(truth.q_nb)[4::5, 2]
    count = len(yaw)
    source, std = np.full(count, 2.0), np.full(count, 0.05)
    headings = Events.from_columns(truth.att_t_ns[4::5], Kind.HEADING, yaw, std, source)
    late = between(headings, 15.0, 99.0)
    told = merge(without(events, Kind.MAG), changed(headings, late, 0, 0.8))
    settings = FilterSettings(gnss=KNOWN.gnss, gate=GateSettings(timeout_heading=5.0))
    live, smoothed = both(told, settings)
    assert live.column("reset_count")[-1] >= 1
    t = (smoothed.stamp_ns - smoothed.stamp_ns[0]) * 1e-9
    turned = errors(smoothed, truth, 0.0)["euler"][:, 2]
    reset = t[np.argmax(smoothed.column("reset_count") > 0)]
    assert 19.0 < reset < 25.0
    before = (t > 10.0) & (t < reset - 0.1)
    assert np.degrees(np.abs(turned[before]).max()) < 5.0
    # nor is it any less sure for what nobody knows just after
    sd = [table.column("sd_yaw") for table in (live, smoothed)]
    assert sd[0][(t > reset) & (t < reset + 0.5)].min() > 2.0 * sd[1][before].max()
    assert (sd[1][before] < 1.02 * sd[0][before]).all()


def test_what_is_drawn_anew_is_counted():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0)
    block = smoothed_blocks(events, KNOWN)[-1]
    redrawn = as_state(block.copy()).redrawn
    for state in (E_ATT, E_VEL, E_POS, E_POS + 2, E_BA, E_BARO, E_HEADING):
        assert redrawn[state] >= 1.0, state


def test_without_gnss_the_attitude_is_still_better():
    squares = []
    for seed in (1, 2, 3, 4, 5, 6):
        events, truth = flight("figure-eight", duration=60.0, seed=seed, rate=50.0)
        tables = both(without(events, Kind.GNSS))
        assert set(tables[1].column("status")) == {Status.ALIGNING, Status.ATTITUDE}
        assert np.array_equal(*(np.isnan(table.values) for table in tables))
        assert np.isnan(tables[1].column("lat_deg")).all()
        true = so3.to_euler(truth.q_nb[np.searchsorted(truth.att_t_ns, tables[0].stamp_ns)])[:, :2]
        tilts = [
            np.stack([table.column(name) for name in ("roll", "pitch")], axis=1) - true
            for table in tables
        ]
        squares.append([np.mean(np.square(tilt[500:2500])) for tilt in tilts])
    live, smoothed = np.sqrt(np.mean(squares, axis=0))
    assert smoothed < 0.7 * live


def test_rows_before_the_alignment_know_nothing():
    events, _ = flight("figure-eight", duration=15.0)
    live, smoothed = both(events)
    early = live.column("status") == Status.ALIGNING
    assert early.sum() > 50
    assert np.isnan(smoothed.values[early, :-3]).all()
    assert np.isfinite(smoothed.column("roll")[~early]).all()


def test_the_order_of_arrival_does_not_matter():
    events, _ = flight("figure-eight", duration=15.0, rate=50.0)
    rng = np.random.default_rng(5)
    delay = rng.uniform(0.0, 1e9, len(events)) * (events.kind != Kind.IMU)
    shuffled = events.take(np.argsort(events.t_ns + delay, kind="stable"))
    last = int(events.t_ns.max()) + 20_000_000
    end = Events.from_columns(np.array([last]), Kind.IMU, *([0.0] for _ in range(5)), [-9.8])
    tables = [smooth(merge_in_order(one, end), KNOWN) for one in (events, shuffled)]
    assert tables[0].values.tobytes() == tables[1].values.tobytes()
    assert same_rows(*tables)


def merge_in_order(first: Events, second: Events) -> Events:
    arrival = [np.arange(len(first)), np.full(len(second), len(first))]
    return merge(first, second, arrival_ns=arrival)


def test_a_clock_that_begins_anew_begins_a_new_flight():
    events, _ = flight("hover", duration=14.0, rate=50.0)
    restart = Events.from_columns(np.array([0]), Kind.RESTART)
    twice = merge_in_order(merge_in_order(events, restart), events)
    live, smoothed = both(twice)
    alone = smooth(events, KNOWN)
    count = len(alone)
    assert same_rows(live, smoothed)
    assert smoothed.values[:count].tobytes() == alone.values.tobytes()
    values = smoothed.values[count:].copy()
    assert (values[:, -2] == 1.0).all()
    # what was learnt of sensors and receiver lives on, so it is the same but not to the bit
    place = slice(3, 6)
    assert values[:, place] == pytest.approx(alone.values[:, place], abs=0.5, nan_ok=True)
    assert values[:, -3].tobytes() == alone.values[:, -3].tobytes()


def test_a_clock_that_is_set_back_parts_the_smoothing_and_loses_no_row():
    events, _ = flight("figure-eight", duration=24.0, rate=50.0)
    half = len(events) // 2
    first, second = events.take(np.arange(half)), events.take(np.arange(half, len(events)))
    step = Events.from_columns(np.array([0]), Kind.RESTART, [1.0])
    moved = Events(t_ns=second.t_ns - 500_000_000, kind=second.kind, values=second.values)
    live, smoothed = both(merge_in_order(merge_in_order(first, step), moved))
    straight, _ = both(events)
    # the first samples by the new clock wait until it is known that they are, and are not live then
    by_it = moved.t_ns[moved.kind == Kind.IMU]
    waited = np.setdiff1d(smoothed.stamp_ns, live.stamp_ns)
    assert np.isin(waited, by_it[:8]).all()
    assert len(smoothed.stamp_ns) - len(live.stamp_ns) <= 7
    assert smoothed.stamp_ns[-len(by_it) :].tolist() == by_it.tolist()
    place = slice(3, 6)
    assert live.values[-1, place] == pytest.approx(straight.values[-1, place], abs=0.2)
    before, _ = both(first)
    resets = live.values[:, -2] - straight.values[-1, -2]  # the count tells of the step
    assert (resets[: len(before)] == 0.0).all()
    assert (resets[len(before) :] == 1.0).all()


def test_events_in_chunks_and_stretches_of_any_length_give_the_same(monkeypatch):
    events, _ = flight("figure-eight", duration=20.0, rate=50.0)
    whole = smooth(events, KNOWN)
    monkeypatch.setattr(smoothing, "STRETCH", 37)
    told = []
    with Smoothing(KNOWN, in_memory=1000) as estimator:
        for part in np.array_split(np.arange(len(events)), 7):
            estimator.run(events.take(part))
        tables = list(estimator.tables(lambda done, total: told.append((done, total))))
    assert len(tables) > 20
    parts = join(tables)
    assert same_rows(whole, parts)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-9, atol=1e-11)
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1] > 1000


def test_stamps_are_those_of_the_samples_whatever_the_sensors_lag():
    events, truth = flight("figure-eight", duration=30.0, rate=50.0)
    settings = FilterSettings(gnss=KNOWN.gnss, imu=ImuSettings(lag=0.02))
    live, smoothed = both(events, settings)
    assert same_rows(live, smoothed)
    assert set(smoothed.stamp_ns) <= set(truth.pos_t_ns)
    # the lag is not true: both are ahead of the truth by what they carry on
    late = [errors(table, truth, 15.0)["vel"] for table in (live, smoothed)]
    assert rms(late[0] - late[1]) < 0.7 * rms(late[0])


def peak(seconds: float) -> int:
    """Return the most memory that smoothing takes beside its rows and results, bytes."""
    events, _ = flight("hover", duration=seconds, rate=50.0)
    with Smoothing(KNOWN, in_memory=1) as estimator:
        for part in np.array_split(np.arange(len(events)), int(seconds / 5.0)):
            estimator.run(events.take(part))
        tracemalloc.start()
        for _ in estimator.tables():
            pass
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return most


def test_memory_does_not_grow_with_the_length_of_the_recording():
    short, long = peak(40.0), peak(160.0)
    assert 5e6 < short < 50e6
    assert long < short + 1e6
