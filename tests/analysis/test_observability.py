"""Observability against motions whose answer is known, and against other ways to compute it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy.seed import draw_42, settings, truth
from benchmarks.accuracy.seed import events as events_of
from ekf_companion.analysis.observability import STATES, analyse, prior, run
from ekf_companion.analysis.observability_filter import (
    STEP_NS,
    Covariance,
    ObservabilityFilter,
    to_level_axes,
)
from ekf_companion.analysis.observability_motion import Motion
from ekf_companion.analysis.observability_report import lines, summarise, to_dict
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.sequence import MeasurementSequence
from ekf_companion.filters.strapdown import integrate_strapdown
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY, LocalFrame
from ekf_companion.nav.measurements import Events, HeadingSource, Kind, merge
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.paths import DATA

pytestmark = pytest.mark.campaign

SETTINGS = FilterSettings()
RATE = 50.0
FRAME = LocalFrame(0.8, 0.15, 100.0)
LEVEL_PAIRS = [("accelerometer x bias", "pitch"), ("accelerometer y bias", "roll")]


def drive(seconds, *, yaw=lambda t: 0.0 * t, vel_n=lambda t: np.zeros((len(t), 3))):
    """Return the events of a vehicle that stays level, without noise: yaw (rad), velocity (m/s)."""
    dt = 1.0 / RATE
    t = dt * np.arange(1, int(seconds * RATE) + 1)
    middle, h = t - 0.5 * dt, 1e-3
    q_nb = so3.from_euler(0.0 * t, 0.0 * t, yaw(middle))
    accel_n = (vel_n(middle + h) - vel_n(middle - h)) / (2.0 * h) - [0.0, 0.0, STANDARD_GRAVITY]
    rate = (yaw(t) - yaw(t - dt)) / dt
    fixes = t[9::10]
    pos_n = np.cumsum(vel_n(middle) * dt, axis=0)[9::10]
    stds = np.outer([1.0, 1.5, 0.1, np.nan], np.ones(len(fixes)))
    return merge(
        Events.from_columns(
            stamps(fixes),
            Kind.GNSS,
            *FRAME.to_geodetic(pos_n),
            *vel_n(fixes).T,
            *stds,
        ),
        Events.from_columns(
            stamps(t[4::5]),
            Kind.HEADING,
            so3.wrap(yaw(t[4::5])),
            np.full(len(t[4::5]), 0.03),
            np.full(len(t[4::5]), float(HeadingSource.GNSS)),
        ),
        Events.from_columns(
            stamps(t), Kind.IMU, 0.0 * t, 0.0 * t, rate, *so3.rotate(so3.conjugate(q_nb), accel_n).T
        ),
    )


def stamps(t):
    return np.rint(t * 1e9).astype(np.int64)


def found_in(events, **more):
    course = MeasurementSequence(events, SETTINGS)
    return analyse(course, course.setup(), SETTINGS, **more)


def simulated(name, seconds, *, noise=1.0, yaw=True):
    """Return a course along a flight of the simulator, its receiver without delay."""
    nominal = ImuConfig()
    names = [key for key in ImuConfig.__dataclass_fields__ if "noise" in key or "bias" in key]
    imu = {key: noise * getattr(nominal, key) for key in names if not key.endswith("time")}
    config = SimConfig(
        imu=replace(nominal, rate=RATE, **imu),
        gnss=GnssConfig(
            noise_h=noise, noise_v=noise, noise_vel=0.1 * noise, delay=0.0, yaw=yaw, noise_yaw=0.03
        ),
    )
    flight = Flight.plan(name, config, seed=3, duration=seconds)
    return MeasurementSequence(wire.events(flight, has_vel_down=True), SETTINGS)


def said(found):
    return {one.state: one for one in summarise(found)}


def ramp(t, begin, seconds):
    x = np.clip((t - begin) / seconds, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def straight(t):
    return np.stack([6.0 + 0.0 * t, 3.0 + 0.0 * t, 0.0 * t], axis=1)


@pytest.fixture(scope="module")
def standing():
    return found_in(drive(20.0))


@pytest.mark.parametrize("motion", [None, straight], ids=["standing", "straight"])
def test_level_accelerometer_biases_cannot_be_told_from_tilt_without_a_turn(motion, standing):
    found = standing if motion is None else found_in(drive(20.0, vel_n=motion))
    told = said(found)
    for bias, angle in LEVEL_PAIRS:
        assert told[bias].since is None
        assert told[angle].since is None
        assert "no turn, no change of tilt and no horizontal acceleration" in told[bias].sentence
        # All is left of the bias, and as much tilt as it makes of a level
        assert found.sigma[-1, STATES.index(bias)] == pytest.approx(1.0, abs=0.02)
        assert f"it cannot be separated from a {angle} error of 1.2 deg" in told[bias].sentence
    for name in ("gyro x bias", "gyro y bias", "gyro z bias", "accelerometer z bias", "heading"):
        assert told[name].since - found.begin < 6.0
        assert "not observable" not in told[name].sentence


def test_at_rest_two_directions_of_a_window_show_nothing_and_are_the_pairs(standing):
    assert (standing.singular[-1, -2:] < 1e-3).all()
    assert standing.singular[-1, -3] > 1.0
    null = standing.direction[-1, -2:]
    for bias, angle in LEVEL_PAIRS:
        mixed = np.zeros(15)
        mixed[STATES.index(bias)] = np.sqrt(0.5)
        for sign in (-1.0, 1.0):
            mixed[STATES.index(angle)] = sign * np.sqrt(0.5)
            if np.linalg.norm(null @ mixed) > 0.9:
                break
        assert np.linalg.norm(null @ mixed) == pytest.approx(1.0, abs=1e-2)


def test_a_turn_of_90_degrees_shows_them_and_is_named(standing):
    found = found_in(drive(35.0, yaw=lambda t: np.pi / 2.0 * ramp(t, 24.0, 4.0)))
    told = said(found)
    for pair in LEVEL_PAIRS:
        for name in pair:
            assert 24.0 < told[name].since < 32.0
            assert f"{name}: not observable before " in told[name].sentence
            assert ", no turn until " in told[name].sentence
            assert "acceleration" not in told[name].sentence
    # Until the turn, it is as if it stood
    before = found.t < 20.0
    assert found.sigma[before] == pytest.approx(found.at_rest[before], rel=0.01)


def circles(begin):
    """Return yaw and velocity of a turn of 18 deg/s, with the nose along the way."""

    def yaw(t):
        s = np.maximum(t - begin, 0.0)
        return np.radians(18.0) * np.where(s < 1.0, s * s * s * (1.0 - 0.5 * s), s - 0.5)

    def vel_n(t):
        return 8.0 * np.stack([np.cos(yaw(t)), np.sin(yaw(t)), 0.0 * t], axis=1)

    return {"yaw": yaw, "vel_n": vel_n}


def test_a_turn_after_a_straight_shows_the_level_biases():
    found = found_in(drive(27.0, **circles(15.0)))
    for name in [name for pair in LEVEL_PAIRS for name in pair]:
        assert 15.0 < said(found)[name].since < 25.0
        assert "no turn and no horizontal acceleration until 14 s" in said(found)[name].sentence


def test_a_turn_that_is_all_there_is_does_not_show_them():
    # What stands still in b is a tilt that a gyro bias turns along, and an accelerometer bias
    found = found_in(drive(22.0, **circles(-1.0)))
    for bias, angle in LEVEL_PAIRS:
        told = said(found)[bias]
        assert told.since is None
        assert "no change of tilt; it cannot be separated from a gyro " in told.sentence
        assert f"a {angle} error of " in told.sentence
    assert (found.singular[-1, -2:] < 1e-3).all()


def test_acceleration_shows_the_heading_without_any_aid_for_it():
    def dash(t):
        return np.stack([8.0 * ramp(t, 14.0, 5.0), 0.0 * t, 0.0 * t], axis=1)

    found = found_in(drive(23.0, vel_n=dash))
    free = np.degrees(found.free_heading)
    assert (free[found.t < 14.0] > 90.0).all()
    assert free.min() < 3.0
    assert "no horizontal acceleration until" in said(found)["heading"].sentence
    # Forward acceleration leans with the pitch, and never with the roll
    assert said(found)["pitch"].since is not None
    assert said(found)["roll"].since is None
    assert "no turn and no change of tilt;" in said(found)["accelerometer y bias"].sentence


def test_a_rest_shows_no_heading_without_an_aid(standing):
    assert (np.degrees(standing.free_heading) > 90.0).all()
    assert "motion would not show it" in said(standing)["heading"].sentence


@pytest.mark.parametrize("name", ["static", "figure-eight", "loiter"])
def test_the_gramian_is_that_of_differences_through_the_motion(name):
    course = simulated(name, 21.0, noise=1e-6)
    setup = course.setup()
    steps = list(course.steps(setup.start.t_ns))
    # Where the flight moves, from the filter's state on
    tried = ObservabilityFilter(setup, prior(setup, SETTINGS))
    begin_ns = None
    for step in steps:
        if step.over is not None:
            tried.predict(step.over)
        for aid in step.aids:
            tried.correct(step.t_ns, aid)
        if step.is_sample:
            tried.end_sample(step.t_ns)
            if len(tried.steps) == 24 and begin_ns is None:
                begin_ns, state = step.t_ns, tried._state
    ends = tried.steps[24:34]
    W = ends[-1].W
    for one in reversed(ends[:-1]):
        W = one.W + one.Phi.T @ W @ one.Phi

    def residuals(x):
        rows = []
        for step in steps:
            if begin_ns < step.t_ns <= ends[-1].t_ns:
                if step.over is not None:
                    x = integrate_strapdown(x, step.over, setup.earth)
                for aid in step.aids:
                    rows.append(aid.innovation(x) / np.sqrt(np.diagonal(aid.covariance())))
        return np.concatenate(rows)

    size = np.repeat([1e-4, 1e-3, 1e-2, 1e-5, 1e-3], 3)
    columns = [
        (residuals(state.plus(dx)) - residuals(state.plus(-dx))) / (2.0 * dx.max())
        for dx in np.diag(size)
    ]
    J = np.stack(columns, axis=1)
    unit = np.repeat([0.02, 0.1, 1.0, 0.02, 0.2], 3)
    ours, other = (np.linalg.eigvalsh(A * np.outer(unit, unit)) for A in (W, J.T @ J))
    # Second differences of the motion, and the filter's small corrections on the way
    assert ours[-13:] == pytest.approx(other[-13:], rel=0.03)
    rank = [np.count_nonzero(values > 0.1) for values in (ours, other)]
    # The loiter still flies straight
    assert rank == ([15, 15] if name == "figure-eight" else [13, 13])


def test_the_covariance_is_that_of_the_filter():
    course = simulated("figure-eight", 20.0)
    setup = course.setup()
    found = analyse(course, setup, SETTINGS)
    again = course.setup()
    again = replace(again, start=replace(again.start, P=prior(again, SETTINGS)))
    tried = Iterated(again)
    last_ns = int(course.t_ns[0]) + round(found.t[-1] * 1e9)
    for step in course.steps(again.start.t_ns):
        if step.t_ns > last_ns:
            break
        if step.over is not None:
            tried.predict(step.over)
        tried.correct(step.t_ns, step.aids)
    T = to_level_axes(tried.state)
    sigma = np.sqrt(np.diagonal(T @ tried.P @ T.T))
    # An update that iterates, or takes aids together, linearises a little elsewhere
    assert found.sigma[-1] * found.unit == pytest.approx(sigma, rel=0.02)


def test_biases_that_count_as_observable_are_known_that_well():
    errors = []
    for seed in (1, 2):
        config = SimConfig(imu=ImuConfig(rate=RATE), gnss=GnssConfig(delay=0.0, yaw=True))
        flight = Flight.plan("loiter", config, seed=seed, duration=30.0)
        course = MeasurementSequence(wire.events(flight, has_vel_down=True), SETTINGS)
        setup = course.setup()
        tried = run(course, ObservabilityFilter(setup, prior(setup, SETTINGS)))
        off = tried._state.accel_bias - flight.imu.accel_bias_b[-1]
        errors += list(off / np.sqrt(np.diagonal(tried.steps[-1].P)[12:]))
    assert np.abs(errors).max() < 3.5
    assert np.sqrt(np.mean(np.square(errors))) > 0.1


def test_a_start_that_the_gate_would_not_survive_is_told_and_survived():
    config = SimConfig(imu=ImuConfig(rate=RATE))
    flight = Flight.plan("figure-eight", config, seed=1, duration=20.0, skip=20.0)
    course = MeasurementSequence(wire.events(flight, has_vel_down=True), SETTINGS, "px4")
    start = course.setup().start
    # Off by 40 degrees, and as sure of itself as of a thirtieth of its sigmas
    tilted = so3.multiply(start.state.q_nb, so3.exp(np.radians([40.0, 0.0, 0.0])))
    off = replace(start, state=replace(start.state, q_nb=tilted), P=1e-3 * start.P)
    setup = replace(course.setup(), start=off)
    assert run(course, ObservabilityFilter(setup, prior(setup, SETTINGS))).is_lost
    found = analyse(course, replace(course.setup(), start=off), SETTINGS)
    assert "with its gate the filter loses its way here: nothing is refused" in found.notes
    t_ns = int(course.t_ns[0]) + np.rint(found.motion.t * 1e9).astype(np.int64)
    off = so3.wrap(found.motion.yaw - flight.truth_at(t_ns).euler[:, 2])
    assert np.degrees(np.abs(off[found.motion.t > 10.0])).max() < 5.0
    assert said(found)["accelerometer x bias"].since < 15.0


def test_an_aid_that_is_silent_until_late_is_named():
    events = drive(20.0)
    is_late = (events.kind == Kind.HEADING) & (events.t_ns > 1.05e9) & (events.t_ns < 12e9)
    found = found_in(events.take(~is_late))
    for name in ("heading", "gyro z bias"):
        assert 12.0 <= said(found)[name].since < 18.0
        assert ", no heading fused until 12 s" in said(found)[name].sentence


def test_the_last_straight_stretch_before_a_manoeuvre_is_found():
    t = 0.05 * np.arange(1200)
    yaw = np.radians(30.0) * ramp(t, 10.0, 2.0) + np.radians(90.0) * ramp(t, 40.0, 3.0)
    motion = Motion(t=t, yaw=yaw, tilt=0.0 * t, speed=0.0 * t, acceleration=0.0 * t)
    first, last = motion.quiet_before(44.0)
    assert (first, last) == (pytest.approx(13.0, abs=1.0), pytest.approx(39.5, abs=1.0))
    assert motion.onsets()["turn"] == pytest.approx(9.5, abs=1.0)
    assert motion.onsets()["change of tilt"] == np.inf
    assert motion.quiet_before(5.0) is None


def test_rows_are_fused_as_by_the_textbook():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((15, 15))
    P, H = A @ A.T, rng.standard_normal((3, 15))
    covariance = Covariance(P)
    covariance.correct(H)
    expected = np.linalg.inv(np.linalg.inv(P) + H.T @ H)
    np.testing.assert_allclose(covariance.P, expected, atol=1e-6)


def test_everything_is_told_and_fits_json(standing):
    data = to_dict(standing)
    assert set(data["states"]) == set(STATES[:3] + STATES[9:])
    assert data["states"]["accelerometer x bias"]["observable_since_s"] is None
    assert len(data["t_s"]) == len(data["singular_values"]) == len(standing.t)
    assert data["singular_values"][0] == [None] * 15
    text = lines(standing)
    assert any(line.startswith("poorest window of 10 s: ") for line in text)
    assert any("the mean of the gyro" in line for line in text)
    assert len(text) == len(set(text))


def test_a_recording_that_ends_at_once_is_refused():
    with pytest.raises(LogError, match=r"less than 0\.5 s"):
        found_in(drive(1.3))


def test_a_recording_without_a_whole_window_is_told_so():
    found = found_in(drive(8.0))
    assert np.isnan(found.singular).all()
    assert "the recording holds no whole window of 10 s" in lines(found)
    assert found.t[0] - found.begin == pytest.approx(STEP_NS * 1e-9, abs=0.03)


@pytest.mark.skipif(not (DATA / "seed-basicekf-sim").is_dir(), reason="no recorded flights")
def test_the_seeds_flight_shows_its_level_accelerometer_biases_in_its_second_turn():
    course = MeasurementSequence(events_of(truth(DATA), draw_42(DATA)), settings())
    found = analyse(course, course.setup(), settings())
    for name in ("accelerometer x bias", "accelerometer y bias"):
        # It turns from 47 s on, and again from 109 s on
        assert 109.0 < said(found)[name].since < 118.0
        assert "then it was straight and steady until 107 s" in said(found)[name].sentence
        before = found.sigma[found.t < 46.0, STATES.index(name)]
        assert before.min() > 0.98
