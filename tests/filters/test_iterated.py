from dataclasses import replace

import numpy as np
import pytest

from benchmarks.matched import matched
from ekf_companion.core.settings.settings import FilterSettings, GateSettings
from ekf_companion.filters.alignment import InitialEstimate
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.iterated import Iterated, run
from ekf_companion.filters.observation import Position
from ekf_companion.filters.robocentric import FULL, RobocentricState
from ekf_companion.filters.sequence import MeasurementSequence, Setup, advance
from ekf_companion.filters.strapdown import ATT, Earth, Interval, N, Noise, Nominal
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.filters.differences import central, some_state
from tests.filters.far_starts import (
    FILTERS,
    QUIET,
    Open,
    Sortie,
    antennas,
    at_rest,
    field,
    flown,
    turned,
)
from tests.filters.sighting import Sighting

EARTH = Earth(gravity=9.81, gradient=3e-6, rate_n=np.array([5e-5, 0.0, -5e-5]))
OVER = Interval(
    dt=0.01,
    gyro0=np.array([0.3, -0.5, 0.2]),
    gyro1=np.array([0.2, -0.4, 0.3]),
    accel0=np.array([1.0, 2.0, -9.0]),
    accel1=np.array([1.5, 1.0, -9.5]),
)


def relative(seed=1):
    rng = np.random.default_rng(seed)
    down_n = np.array([0.1, -0.2, 1.0])
    return RobocentricState(
        local=some_state(seed),
        q_nr=so3.exp(rng.uniform(-1.0, 1.0, 3)),
        pos_nr=rng.uniform(-9.0, 9.0, 3),
        down_n=down_n / np.linalg.norm(down_n),
    )


def begun(P=None, gate=None, **options):
    start = InitialEstimate(t_ns=0, state=some_state(), P=0.01 * np.eye(N) if P is None else P)
    noise = Noise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4)
    gate = gate or Gate(GateSettings())
    return Iterated(Setup(start=start, earth=EARTH, noise=noise, gate=gate), **options)


class TestRobocentricState:
    def test_minus_undoes_plus(self):
        dx = np.linspace(-0.8, 0.8, FULL)
        np.testing.assert_allclose(relative().plus(dx).minus(relative()), dx, atol=1e-12)

    def test_its_jacobian_is_that_of_the_way_to_another(self):
        x, y = relative(), relative().plus(np.linspace(-0.8, 0.8, FULL))
        seen = central(lambda d: x.plus(d).minus(y), FULL)
        np.testing.assert_allclose(x.jacobian(y), seen, atol=1e-8)

    def test_the_state_in_n_moves_as_its_jacobian_says(self):
        x = relative()
        seen = central(lambda d: x.plus(d).in_n().minus(x.in_n()), FULL)
        np.testing.assert_allclose(x.in_n_jacobian(), seen, atol=1e-7)

    def test_a_new_anchor_changes_nothing_in_n_and_moves_as_its_jacobian_says(self):
        x = relative()
        after, G = x.recentred()
        np.testing.assert_allclose(after.in_n().minus(x.in_n()), 0.0, atol=1e-12)
        seen = central(lambda d: x.plus(d).recentred()[0].minus(after), FULL)
        np.testing.assert_allclose(G, seen, atol=1e-7)

    def test_the_motion_has_the_derivative_that_it_says(self):
        x = relative()
        after, Phi = x.integrated(OVER, EARTH)
        seen = central(lambda d: x.plus(d).integrated(OVER, EARTH)[0].minus(after), FULL)
        # Coriolis and the gradient are left out: 1e-4 1/s times 0.01 s
        np.testing.assert_allclose(Phi, seen, atol=1.5e-5)

    def test_the_motion_in_n_does_not_ask_for_the_anchor(self):
        x = replace(relative(), down_n=np.array([0.0, 0.0, 1.0]))
        bare = RobocentricState(local=x.in_n())
        gap = x.integrated(OVER, EARTH)[0].in_n().minus(bare.integrated(OVER, EARTH)[0].in_n())
        np.testing.assert_allclose(gap, 0.0, atol=1e-12)


@pytest.mark.parametrize("error", [60.0, 90.0, 120.0, 150.0])
@pytest.mark.parametrize("aids", [field, antennas])
def test_a_heading_far_off_is_found_in_one_update_and_not_by_one_linear_step(aids, error):
    iterated, linear = (
        np.array([at_rest(aids, error, seed, 1, most) for seed in range(8)]) for most in (20, 1)
    )
    assert (iterated[:, 0] < np.maximum(3.5 * iterated[:, 1], np.radians(1.0))).all()
    assert (iterated[:, 0] < np.radians(10.0)).all()
    assert np.median(linear[:, 0]) > np.radians(5.0)
    assert np.median(linear[:, 0] / linear[:, 1]) > 4.0


@pytest.mark.parametrize("error", [90.0, -150.0])
def test_a_fix_after_a_sprint_shows_north_to_the_robocentric_filter_only(error):
    one = Sortie.plan(2, QUIET, 14.0)
    found = {
        name: np.degrees(flown(one, Iterated(turned(one.setup, error), **options), QUIET[1], [5]))
        for name, options in FILTERS.items()
        if name != "linear"  # as the iterated one: what a global filter sees of a fix is linear
    }
    assert found.pop("iterated, robocentric")[0, 0] < 2.0
    assert min(other[0, 0] for other in found.values()) > 5.0


def test_an_aid_that_only_bends_is_not_taken_for_a_wrong_one():
    known_n = np.array([0.2, 0.0, 0.4])
    seen_b = so3.to_matrix(so3.from_euler(0.0, 0.0, 2.4)).T @ known_n
    sigmas = np.diag([1e-4, 1e-4, 4.0, *np.full(12, 1e-4)])
    level = replace(some_state(), q_nb=np.array([1.0, 0.0, 0.0, 0.0]))
    for most, fused in ((1, 0), (20, 1)):
        gate = Gate(GateSettings())
        start = InitialEstimate(t_ns=0, state=level, P=sigmas)
        noise = Noise(gyro=1e-3, accel=1e-2, gyro_walk=0.0, accel_walk=0.0)
        tried = Iterated(
            Setup(start=start, earth=EARTH, noise=noise, gate=gate), max_iterations=most
        )
        tried.correct(0, [Sighting(seen_b=seen_b, known_n=known_n, std=0.005)])
        assert gate.counts["heading"] == (fused, 1 - fused)
    assert so3.to_euler(tried.state.q_nb)[2] == pytest.approx(2.4, abs=0.02)


def test_an_aid_that_is_wrong_is_refused_and_leaves_no_trace():
    tried = begun()
    before, P = tried.state, tried.P.copy()
    far = Position(pos_n=np.full(3, 1e3), std=np.ones(3), lever_b=np.zeros(3))
    tried.correct(0, [far])
    assert (tried.state.q_nb == before.q_nb).all()
    assert (tried.state.pos_n == before.pos_n).all()
    assert (tried.P == P).all()


def test_the_order_of_aids_of_one_time_does_not_matter():
    aids = [
        Position(pos_n=some_state().pos_n + 0.1, std=np.ones(3), lever_b=np.array([0.5, 0.0, 0.0])),
        Sighting(seen_b=np.array([0.2, 0.1, 0.4]), known_n=np.array([0.2, 0.0, 0.4]), std=0.3),
    ]
    one, other = begun(gate=Open(GateSettings())), begun(gate=Open(GateSettings()))
    one.correct(0, aids)
    other.correct(0, aids[::-1])
    np.testing.assert_allclose(one.state.minus(other.state), 0.0, atol=1e-10)


@pytest.mark.campaign
def test_both_forms_and_both_frames_give_one_flight():
    config = SimConfig(imu=ImuConfig(rate=50.0))
    flight = Flight.plan("figure-eight", config, seed=3, duration=13.0)
    course = MeasurementSequence(wire.events(flight, has_vel_down=True), matched(config))
    setup, ends = course.setup(), []
    for options in ({}, {"form": "information"}, {"form": "innovation"}, {"frame": "robocentric"}):
        tried = Iterated(setup, **options)
        for step in course.steps(setup.start.t_ns):
            advance(tried, step, setup.earth)
        ends.append((tried.state, tried.covariance()))
    state, P = ends[0]
    for other, P_other in ends[1:3]:
        np.testing.assert_allclose(other.minus(state), 0.0, atol=1e-9)
        np.testing.assert_allclose(P_other, P, atol=1e-9)
    sigmas = np.sqrt(np.diag(P))
    assert (np.abs(ends[3][0].minus(state)[:9]) < 0.1 * sigmas).all()
    np.testing.assert_allclose(np.sqrt(np.diag(ends[3][1])), sigmas, rtol=0.05)


def squares(flight):
    """Return NEES over dof of attitude, velocity and position, 0.1, 5 and 15 s after the start."""
    course = MeasurementSequence(wire.events(flight, has_vel_down=True), matched(flight.config))
    setup = course.setup()
    tried, due, found = Iterated(setup), [0.1, 5.0, 15.0], []
    for step in course.steps(setup.start.t_ns):
        advance(tried, step, setup.earth)
        if due and step.is_sample and (step.t_ns - setup.start.t_ns) * 1e-9 >= due[0]:
            due.pop(0)
            now, P = flight.truth_at(np.array([step.t_ns])), tried.covariance()
            pos_n = course.frame.to_ned(now.lat, now.lon, now.alt)[0]
            turn_n = so3.log(so3.multiply(now.q_nb[0], so3.conjugate(tried.state.q_nb)))
            gaps = (turn_n, now.vel_n[0] - tried.state.vel_n, pos_n - tried.state.pos_n)
            parts = (slice(0, 3), slice(3, 6), slice(6, 9))
            found.append(
                [
                    gap @ np.linalg.solve(P[part, part], gap) / 3.0
                    for gap, part in zip(gaps, parts, strict=True)
                ]
            )
    return np.array(found)


@pytest.mark.campaign
def test_the_errors_are_as_large_as_it_says():
    config = SimConfig(imu=ImuConfig(rate=25.0))
    flights = [
        Flight.plan("figure-eight", config, seed=seed, duration=17.0) for seed in range(9, 12)
    ]
    found = np.mean([squares(one) for one in flights], axis=0)
    # attitude, velocity, position at three instants, of nine degrees of freedom each
    assert (found.mean(axis=0) < 2.0).all()
    assert (found.mean(axis=0) > 0.4).all()


@pytest.mark.parametrize("frame", ["global", "robocentric"])
def test_gravity_is_found_where_the_world_is_the_first_body_frame(frame):
    # As a lidar gives positions: in the frame of the first pose, which is not level
    rng = np.random.default_rng(4)
    down_n = so3.rotate(so3.from_euler(0.12, -0.09, 0.0), np.array([0.0, 0.0, 1.0]))
    true = Nominal(
        q_nb=np.array([1.0, 0.0, 0.0, 0.0]),
        vel_n=np.zeros(3),
        pos_n=np.zeros(3),
        accel_bias=np.array([0.02, -0.03, 0.01]),
    )
    P = np.diag(np.square(np.repeat([1e-4, 0.01, 0.01, 1e-3, 0.05], 3)))
    noise = Noise(gyro=1e-4, accel=1e-2, gyro_walk=1e-6, accel_walk=1e-5)
    setup = Setup(
        start=InitialEstimate(t_ns=0, state=replace(true, accel_bias=np.zeros(3)), P=P),
        earth=Earth.flat(9.81),
        noise=noise,
        gate=Gate(GateSettings()),
    )
    tried = Iterated(setup, frame=frame, gravity="sphere", gravity_std=0.2)
    x = RobocentricState(local=true, down_n=down_n)
    for k in range(700):
        t, dt = 0.04 * k, 0.04
        gyro = np.array([0.3 * np.sin(t), 0.3 * np.cos(1.3 * t), 0.5])
        drive = np.array([2.0 * np.cos(t), np.sin(0.7 * t), 0.5 * np.sin(2.0 * t)])
        force = so3.to_matrix(x.local.q_nb).T @ (drive - 9.81 * down_n) + true.accel_bias
        x, _ = x.integrated(
            Interval(dt=dt, gyro0=gyro, gyro1=gyro, accel0=force, accel1=force), Earth.flat(9.81)
        )
        gyro = gyro + rng.normal(0.0, 1e-4 / np.sqrt(dt), 3)
        force = force + rng.normal(0.0, 1e-2 / np.sqrt(dt), 3)
        tried.predict(Interval(dt=dt, gyro0=gyro, gyro1=gyro, accel0=force, accel1=force))
        if k % 4 == 3:
            seen = x.local.pos_n + rng.normal(0.0, 0.02, 3)
            aid = Position(pos_n=seen, std=np.full(3, 0.02), lever_b=np.zeros(3))
            tried.correct(round(t * 1e9), [aid])
    apart = np.degrees(np.arccos(min(1.0, float(tried.down_n @ down_n))))
    assert np.degrees(np.arccos(down_n[2])) > 8.0
    assert apart < 0.3
    assert np.linalg.norm(tried.down_n) == pytest.approx(1.0)
    assert np.linalg.norm(tried.state.pos_n - x.local.pos_n) < 0.1


def test_the_covariance_stays_symmetric_and_positive():
    tried = begun(frame="robocentric", gravity="sphere")
    aid = Position(pos_n=some_state().pos_n, std=np.full(3, 0.01), lever_b=np.zeros(3))
    for k in range(50):
        tried.predict(OVER)
        tried.correct(k, [aid])
        tried.predict(OVER)
    np.testing.assert_allclose(tried.P, tried.P.T, atol=1e-15)
    assert np.linalg.eigvalsh(tried.P).min() > 0.0
    assert np.linalg.eigvalsh(tried.covariance()[ATT, ATT]).min() > 0.0


def test_a_run_gives_an_estimate_per_sample():
    flight = Flight.plan("hover", SimConfig(imu=ImuConfig(rate=25.0)), seed=1, duration=4.0)
    events = wire.events(flight, has_vel_down=True)
    for frame in ("global", "robocentric"):
        found = run(MeasurementSequence(events, FilterSettings()), frame=frame)
        assert found.name.startswith("iterated")
        assert np.isfinite(found.table.column("yaw")).all()
        assert len(found.table) > 50
        assert found.counts["position"][0] > 10
