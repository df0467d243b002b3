"""The unscented filter: its points, its means, and the cases where it must equal what is known."""

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.matched import matched
from ekf_companion.analysis.consistency import nees
from ekf_companion.core.settings.settings import GateSettings
from ekf_companion.filters import sigma_points, strapdown, ukf
from ekf_companion.filters.alignment import InitialEstimate
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.observation import Azimuth, Position, Velocity
from ekf_companion.filters.sequence import MeasurementSequence, Setup
from ekf_companion.filters.strapdown import Earth, Interval, Noise, Nominal
from ekf_companion.filters.ukf import Unscented
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.filters.wrong_attitudes import Case, fly

EARTH = Earth(gravity=9.81, gradient=3e-6, rate_n=np.array([5e-5, 0.0, -5e-5]))
QUIET = Noise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4)


def some_state(rng: np.random.Generator) -> Nominal:
    return Nominal(
        q_nb=so3.exp(rng.normal(size=3)),
        vel_n=10.0 * rng.normal(size=3),
        pos_n=1000.0 * rng.normal(size=3),
        gyro_bias=0.01 * rng.normal(size=3),
        accel_bias=0.1 * rng.normal(size=3),
    )


def some_covariance(rng: np.random.Generator, attitude: float) -> np.ndarray:
    sigma = np.repeat([attitude, 0.5, 2.0, 1e-3, 0.05], 3)
    samples = rng.normal(size=(60, 15)) * sigma
    return samples.T @ samples / 60


def some_interval(rng: np.random.Generator) -> Interval:
    gyro, accel = rng.normal(size=(2, 3)), 5.0 * rng.normal(size=(2, 3))
    return Interval(dt=0.02, gyro0=gyro[0], gyro1=gyro[1], accel0=accel[0], accel1=accel[1])


def one_of(points: Nominal, row: int) -> Nominal:
    return Nominal(
        q_nb=points.q_nb[row],
        vel_n=points.vel_n[row],
        pos_n=points.pos_n[row],
        gyro_bias=points.gyro_bias[row],
        accel_bias=points.accel_bias[row],
    )


def a_filter(
    state: Nominal, P: np.ndarray, earth: Earth = EARTH, noise: Noise = QUIET
) -> Unscented:
    start = InitialEstimate(t_ns=0, state=state, P=P)
    return Unscented(Setup(start=start, earth=earth, noise=noise, gate=Gate(GateSettings())))


def test_points_move_as_single_states_do():
    rng = np.random.default_rng(1)
    state, over, dx = some_state(rng), some_interval(rng), 0.3 * rng.normal(size=(31, 15))
    points = sigma_points.add(state, dx)
    moved = sigma_points.integrate(points, over, EARTH)
    for row in range(31):
        assert np.abs(one_of(points, row).minus(state.plus(dx[row]))).max() < 1e-12
        alone = strapdown.integrate_strapdown(state.plus(dx[row]), over, EARTH)
        assert np.abs(one_of(moved, row).minus(alone)).max() < 1e-12


@pytest.mark.parametrize(
    "aid",
    [
        Position(pos_n=np.ones(3), std=np.ones(3), lever_b=np.array([0.3, -0.2, 0.1])),
        Velocity(vel_n=np.ones(3), std=0.1, swing_b=np.array([0.3, -0.2, 0.1])),
        Velocity(vel_n=np.ones(2), std=0.1, swing_b=np.array([0.3, -0.2, 0.1])),
        Azimuth(seen_b=np.array([0.2, 0.1, 0.4]), azimuth=3.0, std=0.02),
    ],
)
def test_points_see_what_single_states_see(aid):
    rng = np.random.default_rng(2)
    points = sigma_points.add(some_state(rng), rng.normal(size=(31, 15)))
    alone = [aid.innovation(one_of(points, row)) for row in range(31)]
    np.testing.assert_allclose(aid.innovation(points), alone, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("attitude", [1e-3, 0.1, 0.5, 1.6])
def test_the_points_have_the_mean_and_covariance_that_they_were_drawn_from(attitude):
    rng = np.random.default_rng(3)
    state, P = some_state(rng), some_covariance(rng, attitude)
    points = sigma_points.draw(P)
    mean, dx = sigma_points.average(sigma_points.add(state, points.dx), points.mean)
    assert not points.is_repaired
    assert np.abs(mean.minus(state)).max() < 1e-9
    np.testing.assert_allclose((dx.T * points.covariance) @ dx, P, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("attitude", [0.1, 0.5, 1.0])
def test_the_mean_is_where_the_rotation_vectors_cancel_and_no_variance_is_negative(attitude):
    rng = np.random.default_rng(4)
    for _ in range(50):
        # A posterior is drawn beside the state, so its points are not symmetric on the sphere
        state, beside = some_state(rng), np.r_[rng.normal(size=3), np.zeros(12)]
        points = sigma_points.draw(some_covariance(rng, attitude))
        placed = sigma_points.add(state, beside + points.dx)
        mean, dx = sigma_points.average(placed, points.mean)
        assert np.abs(points.mean @ dx).max() < 1e-8
        assert np.linalg.eigvalsh((dx.T * points.covariance) @ dx).min() > 0.0
    assert np.abs(mean.minus(state.plus(beside))).max() > 1e-4
    for row in range(31):
        np.testing.assert_allclose(one_of(placed, row).minus(mean), dx[row], rtol=0.0, atol=1e-9)


def test_a_covariance_that_is_none_is_repaired_and_counted():
    rng = np.random.default_rng(6)
    P = some_covariance(rng, 0.1)
    P[:, 7] = P[7] = P[6]  # two positions known to be one: singular
    P[7, 7] = P[6, 6] * (1.0 - 1e-9)
    S, is_repaired = sigma_points.root(P)
    assert is_repaired
    np.testing.assert_allclose(S @ S.T, P, rtol=0.0, atol=1e-6)
    tried = a_filter(some_state(rng), P)
    tried.predict(some_interval(rng))
    assert tried.repaired == 1
    assert np.linalg.eigvalsh(tried.P).min() > 0.0


def test_on_a_linear_problem_it_is_the_kalman_filter():
    """Level, not turning, attitude and gyro bias known: velocity, position, accel bias are left."""
    rng = np.random.default_rng(7)
    noise = Noise(gyro=0.0, accel=0.05, gyro_walk=0.0, accel_walk=1e-3)
    known = 1e-24  # variance of what is known: its square root is 1e-12 rad
    P = np.diag(np.repeat([known, 0.25, 4.0, known, 0.01], 3))
    still = Nominal(q_nb=so3.exp(np.zeros(3)), vel_n=np.zeros(3), pos_n=np.zeros(3))
    tried = a_filter(still, P, Earth.flat(9.81), noise)
    dt, one, none = 0.01, np.eye(3), np.zeros((3, 3))
    Phi = np.block(
        [[one, none, -dt * one], [dt * one, one, -0.5 * dt * dt * one], [none, none, one]]
    )
    kept = np.r_[3:9, 12:15]
    x, P = np.zeros(9), P[np.ix_(kept, kept)]
    Q, push = noise.covariance(dt)[np.ix_(kept, kept)], np.r_[dt * one, 0.5 * dt * dt * one]
    for k in range(300):
        accel_b = np.array([0.3, -0.2, -9.81]) + 0.1 * rng.normal(size=3)
        nothing = np.zeros(3)
        tried.predict(Interval(dt=dt, gyro0=nothing, gyro1=nothing, accel0=accel_b, accel1=accel_b))
        x = Phi @ x
        x[:6] += push @ (accel_b + np.array([0.0, 0.0, 9.81]))
        P = Phi @ P @ Phi.T + Q
        if k % 10 == 0:
            aid = Position(pos_n=x[3:6] + rng.normal(size=3), std=np.ones(3), lever_b=nothing)
            tried.correct(k * 10_000_000, [aid])
            K = np.linalg.solve(P[3:6, 3:6] + np.eye(3), P[3:6]).T
            x = x + K @ (aid.pos_n - x[3:6])
            P = P - K @ P[3:6]
    state = tried.state
    ours = np.concatenate([state.vel_n, state.pos_n, state.accel_bias])
    np.testing.assert_allclose(ours, x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(tried.P[np.ix_(kept, kept)], P, rtol=0.0, atol=1e-9)
    assert np.abs(x).max() > 0.1


@pytest.mark.campaign
def test_it_is_as_wrong_as_it_says_over_seeded_flights():
    found = [
        fly(Case(scenario=name), seed, Unscented).nees
        for name in ("figure-eight", "loiter", "hover")
        for seed in (1, 2)
    ]
    # The flights are independent, the instants of one are not: 3 components a flight
    low, high = chi2.ppf([0.005, 0.995], 3 * len(found)) / (3 * len(found))
    for block in ("position", "velocity", "attitude"):
        assert low < np.mean([getattr(one, block) for one in found]) < high


def test_a_recording_is_run_from_its_own_start():
    config = SimConfig(imu=ImuConfig(rate=50.0))
    flight = Flight.plan("hover", config, seed=2, duration=12.0)
    solution = ukf.run(MeasurementSequence(wire.events(flight, has_vel_down=True), matched(config)))
    assert solution.name == "ukf"
    assert solution.notes == ()
    assert solution.counts["position"][1] == 0
    assert len(solution.table) > 500
    found = nees(solution, wire.truth(flight), 0, flight.to_ns(12.0))
    assert found.position < chi2.ppf(0.999, 3) / 3.0
    assert found.velocity < chi2.ppf(0.999, 3) / 3.0


@pytest.mark.campaign
@pytest.mark.parametrize(
    "case", [Case(tilt=60.0), Case(heading=120.0, is_compassless=True)], ids=["tilt", "heading"]
)
def test_a_wrong_attitude_with_an_honest_prior_is_found_where_the_linear_filter_fails(case):
    linear, unscented = (fly(case, 2, make) for make in (Iterated, Unscented))
    assert unscented.has_north
    assert unscented.nees.attitude < 4.0
    assert linear.nees.attitude > 5.0 * unscented.nees.attitude


def test_a_heading_on_the_other_side_of_south_is_near():
    south = so3.from_euler(0.0, 0.0, np.deg2rad(179.0))
    state = Nominal(q_nb=south, vel_n=np.zeros(3), pos_n=np.zeros(3))
    tried = a_filter(state, np.diag(np.repeat([0.09, 0.01, 0.01, 1e-8, 1e-4], 3)))
    forward = np.array([1.0, 0.0, 0.0])
    tried.correct(0, [Azimuth(seen_b=forward, azimuth=np.deg2rad(-177.0), std=0.03)])
    yaw = np.rad2deg(so3.to_euler(tried.state.q_nb)[2])
    assert -178.0 < yaw < -176.8
    assert 0.02 < np.sqrt(tried.P[2, 2]) < 0.04


def test_a_wide_prior_of_heading_shrinks_the_velocity_and_inflates_its_variance():
    """A push whose direction has a sigma of 57 deg: by the integral its mean is exp(-1/2) of it."""
    state = Nominal(q_nb=so3.exp(np.zeros(3)), vel_n=np.zeros(3), pos_n=np.zeros(3))
    sigma = np.repeat([1e-6, 1e-3, 1e-3, 1e-9, 1e-6], 3)
    sigma[2] = 1.0
    tried = a_filter(state, np.diag(sigma**2), Earth.flat(9.81))
    push = np.array([1.0, 0.0, -9.81])
    for _ in range(50):
        nothing = np.zeros(3)
        tried.predict(Interval(dt=0.02, gyro0=nothing, gyro1=nothing, accel0=push, accel1=push))
    north, east = np.exp(-0.5), np.sqrt(0.5 * (1.0 - np.exp(-2.0)))
    assert tried.state.vel_n[0] == pytest.approx(north, abs=0.02)
    assert np.sqrt(tried.P[4, 4]) == pytest.approx(east, abs=0.03)
