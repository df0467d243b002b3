"""Whom the estimator believes: soft and hard gates, proof by motion, rest, a field that is ours."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import AID_POSITION, E_VEL, VERDICT_FUSED, Mode
from ekf_companion.core.memory.overlay import as_parameters, as_state
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import AlignSettings, FilterSettings, HeadingSettings
from ekf_companion.engine.health import RESET_REASONS, Aid, Verdict
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Status, Table, Trajectory
from tests.core.flights import between, changed, flight, without
from tests.core.interpreted import load
from tests.engine.estimation import KNOWN, errors, rms, run, statuses

METRE = 1.0 / 6.367e6
"""Of latitude, rad."""
UNTIL_TOLD = 50
"""Rows of three fixes at 5 Hz, less one: until a bank of hypotheses is sure."""

either = pytest.mark.parametrize("weigh", ["off", "act"])
"""The gates' own rules, and the hypotheses: these go on beside what the first call degraded."""


def fixes(events: Events, start: float, end: float) -> np.ndarray:
    return between(events, start, end) & (events.kind == Kind.GNSS)


def is_lie(table: Table, truth: Trajectory, axis: int) -> np.ndarray:
    """Return where a position is called good and is wrong beyond its own sigma."""
    found = errors(table, truth, 0.0)
    is_wrong = np.abs(found["pos"][:, axis]) > np.maximum(2.0, 5.0 * found["sd_pos"][:, axis])
    return is_wrong & (table.column("status") == Status.OK)


def test_good_measurements_meet_the_soft_gate_as_often_as_it_says():
    counts = np.zeros(3)
    for seed in (1, 2, 3):
        _, pipeline = run(flight("figure-eight", duration=60.0, seed=seed, noise=(0.5, 0.0))[0])
        verdicts = pipeline.health().verdicts
        for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY):
            found = verdicts[aid]
            counts += [found[Verdict.FUSED], found[Verdict.DEWEIGHTED], found[Verdict.GATED]]
    fused, soft, gated = counts
    assert 0.001 < soft / (fused + soft) < 0.03
    # but for a few at the start, while the receiver's noise is not known yet
    assert gated <= 0.002 * fused


def test_a_doubtful_fix_moves_less_than_it_would_in_full():
    moved = []
    for probability in (0.99, 0.999998):
        settings = FilterSettings(
            gnss=KNOWN.gnss,
            gate=type(KNOWN.gate)(soft_probability=probability, probability=0.999999),
        )
        events, _ = flight("hover", duration=20.0, noise=(0.5, 0.0))
        one = np.flatnonzero(fixes(events, 15.0, 20.0))[0]
        off = changed(events, np.arange(len(events)) == one, 0, 2.1 * METRE)
        (was, _), (now, _) = run(events, settings), run(off, settings)
        moved.append(np.abs(now.column("pos_n") - was.column("pos_n"))[-300:].max())
    assert 0.0 < moved[0] < 0.8 * moved[1]


@pytest.mark.parametrize("name", ["hover", "figure-eight"])
def test_a_jump_is_not_followed_until_it_is_proved_and_then_once(name):
    events, truth = flight(name, duration=80.0)
    table, pipeline = run(changed(events, fixes(events, 30.0, 99.0), 0, 300.0 * METRE))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    north = errors(table, truth, 0.0)["pos"][:, 0]
    health = pipeline.health()
    status = table.column("status")
    assert np.abs(north[(t > 30.0) & (t < 54.0)]).max() < 2.0
    assert np.all(status[(t > 33.0) & (t < 54.0)] == Status.DEGRADED)
    assert np.abs(north[t > 65.0] - 300.0).max() < 3.0
    assert (health.resets, health.reset_reason) == (1, "position")
    assert health.reset_delta[0] == pytest.approx(300.0, abs=3.0)


@pytest.mark.parametrize("noise", [(1.0, 0.0), (0.1, 1.0)])
def test_a_receiver_dragged_off_at_a_walk_is_left_behind(noise):
    events, truth = flight("hover", duration=80.0, noise=noise)
    dragged = fixes(events, 40.0, 99.0)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values = events.values.copy()
    values[dragged, 0] += (t[dragged] - 40.0) * METRE
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert np.abs(errors(table, truth, 40.0)["pos"][:, 0]).max() < 5.0
    assert pipeline.health().resets == 0
    assert Status.DEGRADED in statuses(table)


def test_fixes_that_contradict_each_other_prove_nothing():
    events, truth = flight("hover", duration=60.0)
    wild = fixes(events, 30.0, 99.0)
    values = events.values.copy()
    rng = np.random.default_rng(1)
    values[wild, 0] += rng.normal(0.0, 200.0, wild.sum()) * METRE
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert np.abs(errors(table, truth, 30.0)["pos"][:, 0]).max() < 4.0
    assert pipeline.health().resets == 0


def test_standing_still_shows_the_gyros_bias_and_holds_the_velocity():
    events, truth = flight("static", duration=60.0)
    silent = events.take(~fixes(events, 20.0, 99.0))
    with_rest, pipeline = run(silent)
    without_rest, _ = run(
        silent, FilterSettings(gnss=KNOWN.gnss, align=AlignSettings(use_rest=False))
    )
    held, drifted = (errors(table, truth, 50.0) for table in (with_rest, without_rest))
    assert pipeline.health().verdicts[Aid.REST][Verdict.FUSED] > 50
    assert rms(held["vel"]) < 0.02
    assert rms(held["pos"][:, :2]) < 0.2 * rms(drifted["pos"][:, :2])


def test_on_the_ground_a_gyro_bias_that_runs_away_turns_no_heading():
    # PX4 takes its own bias off what it sends: with a wrong heading it ran to 0.43 deg/s in 10 s
    events, truth = flight("static", duration=60.0)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    wrong = np.radians(0.43) * np.clip((t - 15.0) / 10.0, 0.0, 1.0)
    values = events.values.copy()
    imu = events.kind == Kind.IMU
    values[imu, 2] += wrong[imu]
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    yaw = np.degrees(errors(table, truth, 10.0)["euler"][:, 2])
    assert np.ptp(yaw) < 3.0
    assert pipeline.health().verdicts[Aid.REST][Verdict.GATED] == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_at_rest_a_noisy_compass_shows_no_hard_iron(seed):
    events, truth = flight("static", duration=100.0, seed=seed, rate=50.0)
    mag = events.kind == Kind.MAG
    values = events.values.copy()
    values[mag, :3] += np.random.default_rng(seed).normal(0.0, 0.02, (mag.sum(), 3))
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert np.degrees(errors(table, truth, 10.0)["euler"][:, 2].std()) < 0.8
    sigma = np.degrees(table.column("sd_yaw"))
    assert sigma[-1] > 0.8 * sigma[between(events, 10.0, np.inf)[events.kind == Kind.IMU]][0]


@pytest.mark.parametrize("knows", [True, False])
@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_a_flight_is_never_taken_for_rest(name, knows):
    events, _ = flight(name, duration=60.0)
    if not knows:
        events = without(events, Kind.VEHICLE)
    airborne = events.take(~between(events, 0.0, 0.0))
    _, before = run(airborne.take(between(airborne, 0.0, 14.0)))
    _, after = run(airborne)
    fused = [pipeline.health().verdicts[Aid.REST][Verdict.FUSED] for pipeline in (before, after)]
    assert fused[0] == fused[1]


def test_the_vehicles_own_field_is_found_in_turns():
    events, truth = flight("figure-eight", duration=90.0)
    iron = np.array([0.015, -0.012, 0.0])
    values = events.values.copy()
    values[events.kind == Kind.MAG, :3] += iron
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert np.allclose(pipeline.health().hard_iron[:2], iron[:2], atol=0.006)
    late = errors(table, truth, 60.0)
    assert np.degrees(rms(late["euler"][:, 2])) < 1.5


@pytest.mark.parametrize("mode", ["off", "act"])
def test_a_passing_magnet_is_not_followed(mode):
    events, truth = flight("hover", duration=60.0)
    near = between(events, 30.0, 40.0) & (events.kind == Kind.MAG)
    values = events.values.copy()
    values[near, 1] += 0.2
    settings = replace(KNOWN, weigh_faults=mode)
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values), settings)
    verdicts = pipeline.health().verdicts[Aid.HEADING]
    # with the hypotheses it is fused, and the magnet known
    assert mode == "act" or verdicts[Verdict.DISTURBED] + verdicts[Verdict.GATED] > 400
    assert np.degrees(np.abs(errors(table, truth, 30.0)["euler"][:, 2]).max()) < 4.0


def test_a_compass_that_is_late_is_allowed_for():
    events, truth = flight("figure-eight", duration=60.0)
    late = np.where(events.kind == Kind.MAG, 60_000_000, 0)
    shifted = Events(t_ns=events.t_ns + late, kind=events.kind, values=events.values)
    found = []
    for delay in (0.0, 0.06):
        settings = FilterSettings(
            gnss=KNOWN.gnss, heading=HeadingSettings(magnetometer_delay=delay)
        )
        table, _ = run(shifted, settings)
        found.append(rms(errors(table, truth, 20.0)["euler"][:, 2]))
    assert found[1] < 0.7 * found[0]


def test_rotors_near_the_ground_do_not_move_the_height():
    events, truth = flight("hover", duration=40.0)
    rotors = Events.from_columns(events.t_ns[:1] + 5_000_000_000, Kind.VEHICLE, [1.0], [1.0])
    low = between(events, 5.0, 9.0) & (events.kind == Kind.BARO)
    events = merge(without(events, Kind.VEHICLE), rotors)
    low = between(events, 5.0, 9.0) & (events.kind == Kind.BARO)
    table, _ = run(changed(events, low, 0, -3.0))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    down = errors(table, truth, 0.0)["pos"][:, 2]
    sigma = table.column("sd_pos_d")
    seen = (t > 6.0) & (t < 20.0)
    assert np.abs(down[seen] / sigma[seen]).max() < 3.5


def test_a_state_out_of_bounds_is_restored_from_the_last_good_one_once():
    kernel = load().restart
    events, _ = flight("figure-eight", duration=20.0)
    _, pipeline = run(events)
    block = pipeline._timeline.block()
    good, broken = as_state(block), as_state(block.copy())
    k, now = as_parameters(parameters(KNOWN, "unknown")), good.t + 64e6
    broken.vel_n[0] = np.nan
    broken.count[AID_POSITION][VERDICT_FUSED] += 1.0
    assert not kernel.is_sound(broken)
    kernel.recover(broken, k, good, now)
    assert kernel.is_sound(broken)
    assert broken.t == now
    assert broken.resets == good.resets + 1.0
    assert RESET_REASONS[int(broken.reset_reason)] == "state out of bounds"
    fused = [x.count[AID_POSITION][VERDICT_FUSED] for x in (broken, good)]
    assert fused[0] == fused[1] + 1.0
    assert broken.P[E_VEL][E_VEL] > good.P[E_VEL][E_VEL]
    broken.pos_n[0] = np.inf
    kernel.recover(broken, k, good, now + 1e9)
    assert broken.mode == Mode.LEVEL


def test_a_receiver_that_repeats_one_fix_in_a_hover_is_not_believed():
    events, truth = flight("hover", duration=70.0, noise=(1.0, 0.0))
    frozen = np.flatnonzero(fixes(events, 45.0, 65.0))
    values = events.values.copy()
    values[frozen] = values[frozen[0]]
    table, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    status = table.column("status")
    assert np.all(status[(t > 47.0) & (t < 65.0)] == Status.DEAD_RECKONING)
    assert pipeline.health().verdicts[Aid.POSITION][Verdict.SUSPECT] > 0.9 * len(frozen)
    assert status[-1] == Status.OK
    off = np.abs(errors(table, truth, 0.0)["pos"][:, :2]) / table.columns(["sd_pos_n", "sd_pos_e"])
    assert off[t > 45.0].max() < 5.0


def test_a_receiver_that_repeats_itself_at_rest_is_heard():
    events, _ = flight("static", duration=40.0)
    held = np.flatnonzero(fixes(events, 10.0, 99.0))
    values = events.values.copy()
    values[held] = values[held[0]]
    values[held, 3:6] = 0.0  # as receivers do that hold what stands still
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert np.all(table.column("status")[-2000:] == Status.OK)


def test_a_slow_drag_is_warned_of_before_it_is_a_lie():
    events, truth = flight("hover", duration=60.0, noise=(1.0, 0.0))
    dragged = fixes(events, 40.0, 99.0)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values = events.values.copy()
    values[dragged, 0] += (t[dragged] - 40.0) * METRE
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert not np.any(is_lie(table, truth, 0))


@pytest.mark.parametrize("name", ["hover", "figure-eight"])
def test_a_velocity_that_the_positions_deny_is_held_off(name):
    events, truth = flight(name, duration=90.0, noise=(0.5, 0.0))
    biased = fixes(events, 40.0, 75.0)
    table, _ = run(changed(events, biased, 3, 1.5))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    found = errors(table, truth, 0.0)
    assert np.abs(found["vel"][t > 40.0, 0]).max() < 0.35
    assert np.abs(found["pos"][t > 40.0, 0]).max() < 3.0
    assert np.all(table.column("status")[(t > 41.0) & (t < 75.0)] == Status.DEGRADED)
    assert table.column("status")[-1] == Status.OK


def test_two_wild_velocities_are_not_held_against_the_right_ones_after_them():
    events, _ = flight("figure-eight", duration=60.0)
    wild = np.flatnonzero(fixes(events, 40.0, 99.0))[:3]
    values = events.values.copy()
    values[wild, 3] += 40.0
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    assert np.all(table.column("status")[t > 45.0] == Status.OK)


@either
def test_a_step_of_the_accelerometers_bias_is_doubted_before_it_is_a_lie(weigh):
    events, truth = flight("figure-eight", duration=120.0)
    hit = between(events, 60.0, 999.0) & (events.kind == Kind.IMU)
    table, pipeline = run(changed(events, hit, 3, 1.0), replace(KNOWN, weigh_faults=weigh))
    found = errors(table, truth, 0.0)
    off = np.linalg.norm(found["vel"], axis=1)
    sigma = np.linalg.norm(found["sd_vel"], axis=1)
    lie = (off > np.maximum(0.5, 5.0 * sigma)) & (table.column("status") == Status.OK)
    assert lie.sum() <= (UNTIL_TOLD if weigh == "act" else 0)
    assert table.column("status")[-1] == Status.OK
    assert pipeline.health().resets == 0


def led(events: Events, column: int, by: float, back: float) -> Events:
    """Shift fixes, by ``by`` more and more from 40 to 100 s, and less and less until ``back`` s."""
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values = events.values.copy()
    slid = by * np.interp(t, [40.0, 100.0, back], [0.0, 1.0, 0.0])
    values[:, column] += np.where(events.kind == Kind.GNSS, slid, 0.0)
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@either
@pytest.mark.parametrize("name", ["hover", "figure-eight"])
def test_a_position_that_slides_off_slowly_is_not_called_good_until_it_is_back(name, weigh):
    events, truth = flight(name, duration=210.0, noise=(0.5, 0.7))
    table, _ = run(led(events, 0, 15.0 * METRE, 160.0), replace(KNOWN, weigh_faults=weigh))
    assert not np.any(is_lie(table, truth, 0))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    status = table.column("status")
    assert weigh == "act" or np.all(status[(t > 75.0) & (t < 130.0)] == Status.DEGRADED)
    assert status[-1] == Status.OK


def barometer(events: Events, *, step: int = 1, end: float = 1e9) -> Events:
    """Keep one of ``step`` readings of the barometer, and none from ``end`` (s) on."""
    readings = np.flatnonzero(events.kind == Kind.BARO)
    t = (events.t_ns[readings] - events.t_ns[0]) * 1e-9
    kept = (np.arange(len(readings)) % step == 0) & (t < end)
    return events.take(np.setdiff1d(np.arange(len(events)), readings[~kept]))


@either
@pytest.mark.parametrize("baro", [{"step": 50}, {"end": 0.0}, {"end": 60.0}])
def test_a_height_that_slides_off_is_noticed_beside_a_slow_barometer_or_none(baro, weigh):
    events, truth = flight("hover", duration=180.0, noise=(0.5, 0.7))
    events = led(barometer(events, **baro), 2, 15.0, 160.0)
    table, _ = run(events, replace(KNOWN, weigh_faults=weigh))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    slid = table.column("status")[(t > 85.0) & (t < 115.0)]
    if weigh == "off":
        assert np.all(slid == Status.DEGRADED)
    else:
        assert not np.any(is_lie(table, truth, 2))
        assert np.abs(errors(table, truth, 40.0)["pos"][:, 2]).max() < 6.0


def test_a_height_that_ran_wild_is_heard_again_though_the_barometer_is_gone():
    events, truth = flight("hover", duration=170.0, noise=(0.3, 0.5))
    events = barometer(events, end=48.0)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    wild = 30.0 * np.interp(t, [40.0, 44.0, 56.0, 60.0], [0.0, 1.0, 1.0, 0.0])
    down = np.select([(t >= 40.0) & (t < 44.0), (t >= 56.0) & (t < 60.0)], [-7.5, 7.5], 0.0)
    is_fix = events.kind == Kind.GNSS
    values = events.values.copy()
    values[is_fix, 2] += wild[is_fix]
    values[is_fix, 5] += down[is_fix]
    table, _ = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert not np.any(is_lie(table, truth, 2))
    assert np.abs(errors(table, truth, 150.0)["pos"][:, 2]).max() < 4.0
