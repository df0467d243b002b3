import numpy as np
import pytest

from ekf_companion.analysis import attitude
from ekf_companion.errors import LogError
from ekf_companion.filters import ahrs, mahony
from ekf_companion.filters.ahrs import USUAL
from ekf_companion.filters.marg import marg_samples
from ekf_companion.logs.recording import Counted
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, GnssFix, Kind, merge
from ekf_companion.nav.state import Status
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.filters.swings import Swing, swing
from tests.filters.trials import TRIALS, trial

pytestmark = pytest.mark.campaign

DEG = np.radians(1.0)
VQF = {TRIALS[0]: (1.99, 1.89, 0.60), TRIALS[1]: (2.31, 2.26, 0.47)}
"""Total, heading, inclination of vqf 2.1, deg."""


def degrees(score):
    return np.degrees([score.total, score.heading, score.inclination])


def after(truth, seconds):
    return Counted(t_ns=truth.att_t_ns, is_counted=truth.att_t_ns > seconds * 1e9)


def scored(what, seconds=10.0, settings=USUAL):
    events, truth = swing(what)
    solution = ahrs.run(events, settings)
    return solution, truth, degrees(attitude.score(solution.table, truth, after(truth, seconds)))


@pytest.mark.parametrize("name", TRIALS)
def test_a_recorded_hand_is_followed_as_well_as_by_vqf_and_far_better_than_by_mahony(name):
    recording = trial(name)
    solution = ahrs.run(recording.events)
    found = degrees(attitude.score(solution.table, recording.truth, recording.counted))
    rival = mahony.run(recording.events)
    beaten = degrees(attitude.score(rival.table, recording.truth, recording.counted))
    assert (found <= 1.1 * np.array(VQF[name])).all(), found
    assert (found < beaten).all()


@pytest.mark.parametrize(
    ("what", "heading", "inclination"),
    [
        (Swing(seconds=50.0, turn=0.7, push=0.2, pace=0.3), 1.0, 0.7),
        (Swing(seconds=50.0, turn=3.0, push=2.0), 1.0, 0.8),
        (Swing(seconds=50.0, turn=1.2, push=6.0, pace=1.2), 1.0, 0.9),
        (Swing(seconds=50.0, start=(2.5, 1.2, -2.0)), 1.0, 0.6),
        (Swing(rate=50.0, mag_rate=10.0, turn=2.0), 1.0, 0.6),
        (Swing(rate=286.0, seconds=30.0, turn=2.0), 1.0, 0.6),
        (Swing(gyro_bias=(2 * DEG, -2 * DEG, 1.5 * DEG)), 1.0, 0.8),
        (Swing(magnets=((40.0, 60.0, (0.1, 0.25, -0.1)),)), 1.5, 0.6),
        (Swing(magnets=((40.0, 60.0, (0.0, 0.04, -0.03)),)), 3.0, 0.6),
    ],
    ids=["slow", "fast", "pushed", "tilted", "50 Hz", "286 Hz", "bias", "magnet", "weak magnet"],
)
def test_one_setting_follows_every_motion(what, heading, inclination):
    _, _, found = scored(what)
    assert found[1] < heading
    assert found[2] < inclination


@pytest.mark.parametrize("bias", [0.5, 1.0, 2.0])
def test_a_start_in_motion_finds_the_attitude_and_the_bias(bias):
    what = Swing(still=0.0, seconds=70.0, gyro_bias=(bias * DEG, -bias * DEG, bias * DEG))
    solution, _, found = scored(what, seconds=45.0)
    last = [solution.table.column(f"gyro_bias_{axis}")[-1] for axis in "xyz"]
    assert np.abs(np.array(last) - what.gyro_bias).max() < 0.1 * DEG
    assert found[1] < 3.0
    assert found[2] < 0.6


def test_a_magnet_at_the_start_is_forgotten_about_a_minute_after_it_was_left():
    solution, truth, _ = scored(Swing(seconds=100.0, magnets=((-1.0, 10.5, (0.1, 0.15, -0.1)),)))
    errors = attitude.errors(solution.table, truth)
    t = errors.t_ns * 1e-9
    assert np.abs(errors.heading[(t > 12.0) & (t < 30.0)]).min() > 15 * DEG
    assert np.abs(errors.heading[t > 70.0]).max() < 3 * DEG


def test_what_it_states_of_its_errors_holds():
    """Within factors: motion and field are no white noise, so what is stated is cautious."""
    tilt, yaw, bias = [], [], []
    for seed, kind in enumerate(({}, {"turn": 3.0, "push": 2.0}, {"still": 0.0}, {"push": 4.0})):
        what = Swing(seconds=40.0, seed=seed, **kind)
        events, truth = swing(what)
        found = ahrs.track(marg_samples(events))
        table = ahrs.run(events)
        error = so3.log(so3.multiply(truth.q_nb, so3.conjugate(found.q_nb)))
        at = np.searchsorted(truth.att_t_ns, table.covariance_ns)[20:]
        P = table.covariance[20:, :3, :3]
        tilt += [
            e @ np.linalg.solve(p, e) / 2 for e, p in zip(error[at, :2], P[:, :2, :2], strict=True)
        ]
        yaw += list(error[at, 2] ** 2 / P[:, 2, 2])
        off = np.array(what.gyro_bias) - found.bias[at]
        bias += [
            e @ np.linalg.solve(p, e) / 3
            for e, p in zip(off, found.covariance[at, 3:, 3:], strict=True)
        ]
    assert 0.2 < np.mean(tilt) < 3.0
    assert 0.001 < np.mean(yaw) < 1.5
    assert 0.002 < np.mean(bias) < 1.5


def turning(events, rate, begin=0.0):
    """Turn a still sensor about its own down axis at a rate, rad/s, from a time on, s."""
    values = events.values.copy()
    t = np.maximum(events.t_ns * 1e-9 - begin, 0.0)
    q = so3.exp(np.outer(rate * t, [0.0, 0.0, 1.0]))
    imu, mag = events.kind == Kind.IMU, events.kind == Kind.MAG
    values[imu & (t > 0.0), 2] += rate
    values[mag, :3] = so3.rotate(so3.conjugate(q[mag]), values[mag, :3])
    values[imu, 3:6] = so3.rotate(so3.conjugate(q[imu]), values[imu, 3:6])
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


LEVEL = {"still": 50.0, "turn": 0.0, "start": (0.0, 0.0, 0.0)}


def test_a_slow_turn_after_a_rest_is_not_taken_for_a_bias():
    events, _ = swing(Swing(seconds=40.0, **LEVEL))
    solution = ahrs.run(turning(events, 0.5 * DEG, begin=20.0))
    assert abs(solution.table.column("gyro_bias_z")[-1] - 0.008) < 0.1 * DEG


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_a_slow_turn_from_the_start_is_seen_by_the_field(rate):
    events, _ = swing(Swing(seconds=40.0, **LEVEL))
    table = ahrs.run(turning(events, rate * DEG)).table
    off = table.column("gyro_bias_z")[1000:] - 0.008
    assert np.abs(off).max() < 0.3 * DEG


def test_a_slow_turn_that_nothing_shows_is_in_the_sigma_of_the_yaw():
    events, _ = swing(Swing(seconds=40.0, **LEVEL))
    turned = turning(events, 1.0 * DEG)
    table = ahrs.run(turned.take(turned.kind == Kind.IMU)).table
    yaw = np.unwrap(table.column("yaw"))
    t = table.stamp_ns * 1e-9
    off = (yaw - yaw[0]) - 1.0 * DEG * (t - t[0])
    assert (np.abs(off) < 3.0 * table.column("sd_yaw")).all()


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
def test_a_tilt_by_accelerations_that_last_is_within_its_sigma(name):
    """A level acceleration turns the specific force, and hardly changes its length."""
    flight = Flight.plan(name, SimConfig(imu=ImuConfig(rate=50.0)), seed=1, duration=60.0)
    solution = ahrs.run(wire.events(flight, has_vel_down=True))
    late = solution.covariance_ns > solution.covariance_ns[0] + 10_000_000_000
    at = np.searchsorted(solution.table.stamp_ns, solution.covariance_ns[late])
    q_nb = np.stack([solution.table.column(f"q_{one}")[at] for one in "wxyz"], axis=1)
    truth = flight.truth_at(solution.covariance_ns[late]).q_nb
    error = so3.log(so3.multiply(truth, so3.conjugate(q_nb)))
    sigma = np.sqrt(np.diagonal(solution.covariance[late], axis1=1, axis2=2))
    tilt = np.hypot(error[:, 0], error[:, 1])
    assert tilt.max() > 4.0 * DEG
    assert (tilt / np.hypot(sigma[:, 0], sigma[:, 1])).max() < 3.0
    assert (np.abs(error[:, 2]) / sigma[:, 2]).max() < 3.0


def test_over_a_gap_the_attitude_becomes_uncertain_and_is_found_again():
    events, truth = swing(Swing(seconds=60.0))
    lost = (events.t_ns > 30e9) & (events.t_ns < 33e9)
    solution = ahrs.run(events.take(~lost))
    stamps = solution.table.stamp_ns
    sigma = solution.table.column("sd_yaw")
    assert sigma[np.searchsorted(stamps, 33_000_000_000)] > 30 * DEG
    errors = attitude.errors(solution.table, truth)
    late = errors.t_ns > 45e9
    assert errors.total[late].max() < 10 * DEG


def test_yaw_counts_from_true_north_where_a_fix_tells_the_declination():
    events, _ = swing(Swing(seconds=5.0))
    fix = GnssFix(t_ns=0, lat=0.0, lon=0.0, alt=0.0, std_h=1.0, std_v=1.0, declination=0.2)
    plain, turned = ahrs.run(events), ahrs.run(merge(Events.from_rows([fix.row()]), events))
    off = so3.wrap(turned.table.column("yaw") - plain.table.column("yaw"))
    np.testing.assert_allclose(off, 0.2, atol=1e-9)
    assert "magnetic north" in plain.notes[0]
    assert turned.notes == ()


def test_without_a_magnetometer_roll_and_pitch_stay_and_yaw_is_not_claimed():
    events, truth = swing(Swing(seconds=60.0))
    solution = ahrs.run(events.take(events.kind == Kind.IMU))
    errors = attitude.errors(solution.table, truth)
    assert np.degrees(errors.inclination[1000:]).max() < 1.5
    assert solution.table.column("sd_yaw")[-1] > 1.0
    assert set(solution.table.column("status")) == {Status.ATTITUDE}
    assert "no magnetometer" in solution.notes[0]
    assert np.isnan(solution.table.column("pos_n")).all()


def test_estimates_do_not_know_what_comes_later():
    events, _ = swing(Swing(seconds=30.0))
    part = ahrs.run(events.take(events.t_ns <= 15_000_000_000))
    whole = ahrs.run(events)
    np.testing.assert_array_equal(whole.table.values[: len(part.table)], part.table.values)


def test_a_log_without_inertial_samples_is_refused():
    events, _ = swing(Swing(seconds=2.0))
    with pytest.raises(LogError, match="no inertial samples"):
        ahrs.run(events.take(events.kind == Kind.MAG))
