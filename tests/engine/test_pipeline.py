import math

import numpy as np
import pytest

from ekf_companion.core.memory.enums import CORE
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.settings import (
    FilterSettings,
    GateSettings,
    GnssSettings,
    HeadingSettings,
)
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import COLUMNS, WIND, WIND_SIGMA, Status
from tests.core.flights import between, changed, flight, without
from tests.engine.estimation import KNOWN, errors, rms, run, statuses


def test_a_flight_is_followed_from_rest_to_the_end():
    events, truth = flight("figure-eight", duration=40.0)
    table, pipeline = run(events)
    assert statuses(table)[-1] is Status.OK
    late = errors(table, truth, 15.0)
    assert rms(late["pos"]) < 0.6
    assert rms(late["vel"]) < 0.15
    assert np.degrees(rms(late["euler"][:, :2])) < 0.5
    assert np.degrees(rms(late["euler"][:, 2])) < 1.5
    health = pipeline.health()
    assert health.resets == 0
    assert all(counts[Verdict.GATED] == 0 for counts in health.verdicts.values())


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
def test_sigma_is_true_over_seeded_flights(name):
    ratios: dict[str, list[float]] = {"pos": [], "vel": [], "euler": []}
    for seed in range(1, 7):
        events, truth = flight(name, duration=50.0, seed=seed, rate=50.0)
        table, _ = run(events)
        late = errors(table, truth, 25.0)
        for block in ratios:
            ratios[block].append(float(np.mean(np.square(late[block] / late[f"sd_{block}"]))))
    for block, squares in ratios.items():
        # of 6 flights, each with a few independent errors a block: a factor of 1.6 either way
        assert 0.3 < math.sqrt(np.mean(squares)) < 1.6, block


def test_sigma_counts_in_what_of_a_receivers_error_is_slow():
    squares = []
    for seed in range(1, 9):
        events, truth = flight("figure-eight", 60.0, seed, rate=50.0, noise=(0.05, 2.0))
        table, _ = run(events)
        late = errors(table, truth, 30.0)
        squares.append(float(np.mean(np.square(late["pos"] / late["sd_pos"]))))
    # a slow error of 100 s gives one independent draw an axis: 24 in all
    assert 0.5 < math.sqrt(np.mean(squares)) < 1.5


def test_live_and_table_give_the_same_bits():
    events, _ = flight("figure-eight", duration=12.0)
    table, _ = run(events)
    pipeline = Pipeline(KNOWN)
    rows = []
    for row in zip(events.t_ns.tolist(), events.kind.tolist(), events.values.tolist(), strict=True):
        if (estimate := pipeline.process_row(row)) is not None:
            rows.append(estimate.values)
    assert np.array(rows).tobytes() == table.values.tobytes()


def test_a_start_in_flight_finds_down_and_north():
    events, truth = flight("figure-eight", duration=25.0, skip=15.0)
    table, _ = run(events)
    assert Status.OK in statuses(table)
    first = np.flatnonzero(table.column("status") == Status.OK)[0]
    assert (table.stamp_ns[first] - table.stamp_ns[0]) * 1e-9 < 4.0
    late = errors(table, truth, 15.0)
    assert np.degrees(rms(late["euler"])) < 2.0
    assert rms(late["pos"]) < 1.0


def test_upside_down_on_the_ground_is_an_attitude_like_any_other():
    events, _ = flight("static", duration=8.0)
    values = events.values.copy()
    for kind in (Kind.IMU, Kind.MAG):
        rows = events.kind == kind
        for column in (1, 2, 4, 5) if kind is Kind.IMU else (1, 2):
            values[rows, column] *= -1.0  # turned half round about the forward axis
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert statuses(table)[-1] is Status.OK
    assert abs(np.degrees(table.column("roll")[-1])) > 170.0


def test_without_gnss_there_is_an_attitude_and_a_height_but_no_position():
    events, truth = flight("hover", duration=20.0)
    table, pipeline = run(without(events, Kind.GNSS))
    assert set(statuses(table)) == {Status.ALIGNING, Status.ATTITUDE}
    assert np.isnan(table.column("lat_deg")).all()
    assert np.isfinite(table.column("pos_d")[-1])
    tilt = so3.to_euler(truth.q_nb[-1])[:2] - [table.column("roll")[-1], table.column("pitch")[-1]]
    assert np.degrees(np.abs(tilt)).max() < 3.0
    assert pipeline.estimate().odometry is None


def test_without_a_heading_and_a_manoeuvre_nothing_is_navigated_by():
    events, _ = flight("hover", duration=15.0)
    table, pipeline = run(without(events, Kind.MAG))
    assert statuses(table)[-1] is Status.ATTITUDE
    assert np.isnan(table.column("yaw")).all()
    assert np.isfinite(table.column("roll")[-1])
    assert pipeline.health().verdicts[Aid.POSITION][Verdict.BEFORE_ALIGNMENT] > 0


def test_a_jump_of_the_receiver_is_refused_and_then_believed_with_one_reset():
    events, _ = flight("hover", duration=60.0)
    jumped = changed(events, between(events, 15.0, 99.0) & (events.kind == Kind.GNSS), 0, 5e-5)
    table, pipeline = run(jumped)
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    north = table.column("pos_n")
    before = north[(t > 10.0) & (t < 15.0)].mean()
    refused = (t > 15.0) & (t < 44.0)
    assert np.abs(north[refused] - before).max() < 5.0
    assert (table.column("status")[refused & (t > 18.0)] == Status.DEGRADED).all()
    assert abs(north[-1] - before - 5e-5 * 6.367e6) < 5.0
    health = pipeline.health()
    assert (health.resets, health.reset_reason) == (1, "position")
    assert table.column("reset_count")[-1] == 1
    assert health.verdicts[Aid.POSITION][Verdict.GATED] >= 140


def test_an_outage_is_announced_and_its_error_covered():
    events, truth = flight("figure-eight", duration=40.0)
    lost = between(events, 20.0, 30.0) & (events.kind == Kind.GNSS)
    table, _ = run(events.take(~lost))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    status = table.column("status")
    assert (status[(t > 21.6) & (t < 29.9)] == Status.DEAD_RECKONING).all()
    assert status[-1] == Status.OK
    late = errors(table, truth, 20.0)
    during = slice(0, np.count_nonzero((t >= 20.0) & (t < 30.0)))
    inside = np.abs(late["pos"][during]) < 3.0 * late["sd_pos"][during]
    assert inside.mean() > 0.9


def test_a_gap_of_inertial_samples_begins_velocity_anew():
    events, truth = flight("figure-eight", duration=40.0)
    table, pipeline = run(events.take(~(between(events, 20.0, 22.1) & (events.kind == Kind.IMU))))
    health = pipeline.health()
    assert health.gaps == 1
    assert health.reset_reason == "inertial gap"
    found = np.searchsorted(truth.pos_t_ns, table.stamp_ns)
    north_error = table.column("vel_n") - truth.vel_n[found, 0]
    assert rms(north_error[-800:]) < 0.5


def test_a_suspect_receiver_is_not_heard():
    events, _ = flight("hover", duration=20.0)
    marked = changed(events, between(events, 10.0, 99.0) & (events.kind == Kind.GNSS), 10, 2.0)
    table, pipeline = run(marked)
    assert statuses(table)[-1] is Status.DEAD_RECKONING
    assert pipeline.health().verdicts[Aid.POSITION][Verdict.SUSPECT] > 40


def test_a_dual_antenna_is_preferred_to_the_compass():
    events, _ = flight("hover", duration=20.0, yaw=True)
    _, pipeline = run(events)
    verdicts = pipeline.health().verdicts[Aid.HEADING]
    assert verdicts[Verdict.SUPERSEDED] > 800
    _, compass = run(events, FilterSettings(heading=HeadingSettings(source="magnetometer")))
    assert compass.health().verdicts[Aid.HEADING][Verdict.FUSED] > 800


def test_a_field_that_is_not_the_earths_gives_no_heading():
    events, _ = flight("hover", duration=20.0)
    values = events.values.copy()
    values[events.kind == Kind.MAG, :3] *= 1.5
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert Status.OK not in statuses(table)
    assert pipeline.health().verdicts[Aid.HEADING][Verdict.DISTURBED] > 500


def test_a_lasting_wrong_heading_is_taken_over_with_a_reset():
    events, _ = flight("hover", duration=40.0, yaw=True)
    turned = changed(events, between(events, 15.0, 99.0) & (events.kind == Kind.HEADING), 0, 0.8)
    settings = FilterSettings(gate=GateSettings(timeout_heading=5.0), weigh_faults="off")
    _, pipeline = run(turned, settings)
    assert pipeline.health().reset_reason in ("heading", "velocity", "position")
    assert pipeline.health().resets >= 1


def test_a_state_that_cannot_be_is_left_for_a_new_start():
    events, truth = flight("static", duration=40.0)
    mad = changed(events, between(events, 10.0, 13.0) & (events.kind == Kind.IMU), 3, 1900.0)
    table, pipeline = run(mad)
    health = pipeline.health()
    assert np.nanmax(np.abs(table.column("vel_n"))) <= 1000.0
    assert health.resets >= 1
    assert statuses(table)[-1] is Status.OK
    late = errors(table, truth, 35.0)
    assert rms(late["vel"]) < 0.5
    known = [name for name in COLUMNS[1:] if name not in (*WIND, *WIND_SIGMA)]
    assert np.isfinite(table.columns(known)[-1]).all()


def test_samples_without_any_noise_level_as_well():
    t_ns = np.arange(0, 6_000_000_000, 10_000_000)
    level = np.full(len(t_ns), -9.80665)
    zero = np.zeros(len(t_ns))
    table, pipeline = run(Events.from_columns(t_ns, Kind.IMU, zero, zero, zero, zero, zero, level))
    assert statuses(table) == [Status.ALIGNING, Status.ATTITUDE]
    assert pipeline.health().resets == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_an_attitude_that_is_upset_in_flight_is_found_again(axis):
    events, truth = flight("figure-eight", duration=50.0)
    hit = between(events, 20.0, 20.3) & (events.kind == Kind.IMU)
    table, pipeline = run(changed(events, hit, axis, 6.0))  # 1.8 rad that never were
    assert pipeline.health().resets <= 3
    assert statuses(table)[-1] is Status.OK
    late = errors(table, truth, 40.0)
    assert np.degrees(rms(late["euler"][:, :2])) < 3.0
    assert rms(late["vel"]) < 0.5


def test_a_wild_first_fix_after_an_outage_does_not_cost_the_attitude():
    events, truth = flight("figure-eight", duration=50.0)
    lost = between(events, 15.0, 25.0) & (events.kind == Kind.GNSS)
    first = between(events, 25.0, 25.3) & (events.kind == Kind.GNSS)
    table, _ = run(changed(events, first, 3, 60.0).take(~lost))
    after = table.stamp_ns > table.stamp_ns[0] + 25_000_000_000
    assert np.isfinite(table.column("roll")[after]).all()
    late = errors(table, truth, 40.0)
    assert np.degrees(rms(late["euler"])) < 3.0


def test_an_armed_flight_without_gnss_is_not_taken_for_rest():
    events, truth = flight("loiter", duration=90.0)
    armed = Events.from_columns(
        np.array([events.t_ns[0] + 4_000_000_000]), Kind.VEHICLE, [1.0], [0.0]
    )
    table, _ = run(merge(without(events, Kind.GNSS), armed))
    late = errors(table, truth, 30.0)
    squares = np.square(late["euler"][:, :2] / late["sd_euler"][:, :2])
    assert math.sqrt(np.mean(squares)) < 2.0


def test_covariance_stays_symmetric_and_positive():
    events, _ = flight("figure-eight", duration=40.0)
    _, pipeline = run(events)
    x = as_state(pipeline._timeline.block())
    P, n = np.array(x.P), CORE + int(x.begun)
    assert np.array_equal(P, P.T)
    assert not P[n:].any()
    assert np.linalg.eigvalsh(P[:n, :n]).min() > 0.0


def test_the_origin_is_the_first_fix_used_and_odometry_tells_the_state():
    events, _ = flight("figure-eight", duration=12.0)
    table, pipeline = run(events)
    lat, lon, _ = pipeline.origin
    odometry = pipeline.estimate().odometry
    assert abs(np.degrees(lat) - table.column("lat_deg")[-1]) < 1e-3
    assert abs(np.degrees(lon) - table.column("lon_deg")[-1]) < 1e-3
    assert odometry.t_ns == table.stamp_ns[-1]
    numbers = np.frombuffer(odometry.numbers, dtype="<f4")
    assert numbers[:3].tolist() == table.values[-1, 3:6].astype(np.float32).tolist()
    assert odometry.quality == 100
    assert np.isfinite(numbers).all()


SOFT = ((1.1, 0.02, -0.03), (0.02, 0.9, 0.04), (-0.03, 0.04, 1.05))
IRON = FilterSettings(
    gnss=KNOWN.gnss, heading=HeadingSettings(hard_iron=(0.2, -0.1, 0.05), soft_iron=SOFT)
)


def test_a_vehicles_iron_is_taken_off_before_anything_is_judged():
    events, _ = flight("hover", duration=10.0)
    mag = events.kind == Kind.MAG
    values = events.values.copy()
    values[mag, :3] = np.linalg.solve(SOFT, values[mag, :3].T).T + np.array([0.2, -0.1, 0.05])
    spoilt = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    clean, _ = run(events)
    assert np.allclose(run(spoilt, IRON)[0].values, clean.values, atol=1e-6, equal_nan=True)
    assert not np.allclose(
        run(spoilt)[0].column("yaw")[-1], clean.column("yaw")[-1], atol=0.1, equal_nan=True
    )


def test_iron_leaves_live_and_table_the_same_bits():
    events, _ = flight("figure-eight", duration=12.0)
    table, _ = run(events, IRON)
    pipeline = Pipeline(IRON)
    rows = []
    for row in zip(events.t_ns.tolist(), events.kind.tolist(), events.values.tolist(), strict=True):
        if (estimate := pipeline.process_row(row)) is not None:
            rows.append(estimate.values)
    assert np.array(rows).tobytes() == table.values.tobytes()
    assert np.isfinite(table.column("yaw")[-1])


def test_the_right_delay_is_the_likelier():
    events, _ = flight("figure-eight", duration=30.0)
    told = [
        run(events, FilterSettings(gnss=GnssSettings(delay=delay, delay_std=0.0)))[1]
        for delay in (0.06, 0.12, 0.18)
    ]
    assert told[1].log_likelihood > 20.0 + max(told[0].log_likelihood, told[2].log_likelihood)
