"""The Euler-angle filter against the seed's own output, and where its angles end."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.accuracy.seed import rmse, truth
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import FilterError
from ekf_companion.filters import euler, euler_article
from ekf_companion.filters.euler import Euler
from ekf_companion.filters.observation import Azimuth
from ekf_companion.filters.sequence import MeasurementSequence
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import (
    Interval,
    N,
    covariance_in_n,
    integrate_strapdown,
    transition,
)
from ekf_companion.logs import csv
from ekf_companion.nav import so3
from ekf_companion.nav.earth import SIMULATED
from tests.filters.steep import Flight, climb, fly, loops, score
from tests.paths import DATA

pytestmark = pytest.mark.campaign

SEED = DATA / "seed-basicekf-sim"
with_seed = pytest.mark.skipif(
    not SEED.is_dir(), reason="the seed article's flight is not on this machine"
)


def sequence(events, family="unknown"):
    return MeasurementSequence(events, FilterSettings(), family)


STATE = np.array(
    [0.4, -0.9, 2.5, 30.0, -20.0, 100.0, 11.0, -7.0, 2.0, 0.01, -0.02, 0.03, 0.1, -0.2, 0.3]
)
RATE, FORCE = np.array([0.5, -0.8, 1.1]), np.array([1.5, -2.0, -11.0])
FALL = np.array([0.0, 0.0, 9.81])


def as_article(solution: Solution) -> np.ndarray:
    """Return the fifteen states of an answer, shape (n, 15), as the article's file has them."""
    table = solution.table
    place = (np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg")))
    pos_n = SIMULATED.to_ned(*place, table.column("alt_m")) * [1.0, 1.0, -1.0]
    biases = [f"{sensor}_bias_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    names = ["roll", "pitch", "yaw", "vel_n", "vel_e", "vel_d", *biases]
    columns = np.stack([table.column(name) for name in names], axis=1)
    return np.concatenate([columns[:, :3], pos_n, columns[:, 3:]], axis=1)


def rms_errors(solution: Solution) -> np.ndarray:
    """Return the RMSE from 20 s on by the columns of the seed: deg, m, m/s."""
    t = np.asarray(solution.table.stamp_ns * 1e-9)
    return rmse(truth(SEED.parent), t, as_article(solution)[:, :9])


def test_the_jacobian_is_the_difference_of_the_motion():
    F = euler.jacobian(STATE, RATE, FORCE)
    step = 1e-6
    for column in range(N):
        dx = np.zeros(N)
        dx[column] = step
        ahead = euler.derivative(STATE + dx, RATE, FORCE, FALL)
        behind = euler.derivative(STATE - dx, RATE, FORCE, FALL)
        slope = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(F[:, column], slope, atol=1e-7)  # central difference


def test_angles_change_as_a_small_turn_in_b_changes_them():
    q_nb = so3.from_euler(*STATE[:3])
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = 1e-6
        ends = [so3.to_euler(so3.multiply(q_nb, so3.exp(way * turn))) for way in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / 2e-6
        found = euler.by_error_state(STATE)[:3, axis]
        np.testing.assert_allclose(found, slope, atol=1e-8)  # central difference


def test_a_state_survives_the_way_through_a_quaternion():
    np.testing.assert_allclose(euler.from_nominal(euler.to_nominal(STATE)), STATE, atol=1e-12)


def test_van_loan_is_the_integral_of_the_noise_carried_to_the_end():
    F = euler.jacobian(STATE, RATE, FORCE)
    Q = np.diag(np.linspace(0.5, 2.0, N) * 1e-2)
    dt, steps = 0.1, 2000
    Phi, found = euler.van_loan(F, Q, dt)
    # Fine steps of the Lyapunov equation by the midpoint rule, and of the transition
    h = dt / steps
    one = np.eye(N) + F * h + F @ F * (h * h / 2.0)
    half = np.eye(N) + F * (h / 2.0)
    expected, carried = np.zeros((N, N)), np.eye(N)
    for _ in range(steps):
        expected = one @ expected @ one.T + half @ Q @ half.T * h
        carried = one @ carried
    np.testing.assert_allclose(Phi, carried, atol=1e-7)  # h^2 of the fine steps
    np.testing.assert_allclose(found, expected, atol=1e-10)
    np.testing.assert_allclose(found, found.T, atol=1e-15)


@with_seed
def test_the_articles_run_is_reproduced_in_every_state():
    recording = csv.read(SEED / "uavSensors.csv")
    solution = euler_article.run(sequence(recording.events, recording.family))
    theirs = np.genfromtxt(SEED / "uavEst.csv", delimiter=",", skip_header=1)
    assert len(solution.table) == len(theirs)
    difference = as_article(solution) - theirs[:, 1:]
    difference[:, :3] = so3.wrap(difference[:, :3])
    # Printed to ten digits: half a digit of the positions is 5e-7
    np.testing.assert_allclose(difference, 0.0, atol=1e-6)


@cache
def published(constants: euler_article.Constants) -> np.ndarray:
    """Return our states over the draw that the author published, begun as the C++ edition is."""
    S = np.loadtxt(SEED / "published-cpp" / "UavData_SquareSpiral.txt", delimiter=",")
    begun = [-2.72343926657247, -0.0161376263168116, 0.104874716016494, 109.623435014780]
    begun += [-18.1430696059217, -3.30602783578041, 0.0849970564432384]
    tried = euler_article.Direct([0.0, 0.0, *begun, *np.zeros(6)], constants)
    # The edition keeps times in single precision, so its intervals are off by 1e-5 s
    t = S[:, 0].astype(tried.x.dtype)
    rows = []
    for k in range(len(S)):
        tried.predict(float(t[max(k, 1)] - t[max(k, 1) - 1]), S[k, 1:4], S[k, 4:7])
        tried.correct_heading(float(np.radians(S[k, 8])))
        if S[k, 9]:
            tried.correct_fix(S[k, 10:16])
        rows.append(tried.x.astype(float))
    return np.array(rows)


@with_seed
def test_the_published_run_is_reproduced_as_far_as_its_digits_go():
    printed = np.loadtxt(
        SEED / "published-cpp" / "EstInsGpsEulerDirectEKF.txt", delimiter=",", usecols=range(1, 16)
    )
    ours = published(euler_article.PUBLISHED)
    half_digit = 0.5 * 10.0 ** (np.floor(np.log10(np.maximum(np.abs(printed), 1e-12))) - 5)
    # Beyond half a digit: rounding in single precision, which no order of sums repeats
    rounding = np.repeat([2e-6, 1e-4, 1e-4, 1e-6, 1e-5], 3)
    late = slice(200, None)
    assert (np.abs(ours - printed)[late] <= half_digit[late] + rounding).all()


@with_seed
def test_the_exact_exponential_moves_the_published_run_by_little():
    printed = np.loadtxt(
        SEED / "published-cpp" / "EstInsGpsEulerDirectEKF.txt", delimiter=",", usecols=range(1, 16)
    )
    apart = np.abs(published(euler_article.ARTICLE) - printed)[200:].max(axis=0)
    assert apart[:3].max() < np.radians(0.05)
    assert apart[3:6].max() < 0.02
    assert apart[3:6].max() > 0.01  # m: it is seen, so the edition does take 1 + A dt


@with_seed
def test_each_slip_costs_what_the_document_says():
    course = MeasurementSequence(csv.read(SEED / "uavSensors.csv").events, FilterSettings())
    both, without_q, without_r = (
        rms_errors(euler_article.run(course, constants))
        for constants in (
            euler_article.Constants(),
            euler_article.Constants(bias_walk=1e-5),
            euler_article.Constants(heading_variance=4e-4),
        )
    )
    yaw, vel_n = 2, 6
    assert both[yaw] == pytest.approx(0.650, abs=0.001)  # as the seed's own README has it
    assert without_q[yaw] == pytest.approx(0.364, abs=0.002)
    assert without_q[vel_n] < both[vel_n]
    # The yaw of a magnetometer taken as level is wrong by far more than 0.02 rad in turns
    assert without_r[yaw] == pytest.approx(1.383, abs=0.002)


@cache
def steep(peak: float) -> Flight:
    return loops(float(np.radians(peak)), seed=1, count=1)


def test_the_covariance_is_true_in_gentle_flight():
    flight = climb(0.0, seed=1, seconds=12.0)
    found = score(fly("euler", flight), flight)
    assert found.tilt < 0.8
    assert found.position < 0.3
    assert found.nees < 6.0


def test_the_yaw_goes_on_counting_past_south():
    flight = climb(0.0, seed=2, seconds=0.0)
    measured = sequence(flight.events)
    setup = measured.setup()
    turning = Euler(setup)
    turning.x[2] = np.pi - 1e-4
    spin = np.array([0.0, 0.0, 1.0])
    up = np.array([0.0, 0.0, -9.81])
    turning.predict(Interval(dt=0.01, gyro0=spin, gyro1=spin, accel0=up, accel1=up))
    assert turning.x[2] == pytest.approx(np.pi + 0.0099, abs=1e-3)
    # A heading just past south, told as minus 180 degrees and a bit, is near
    seen = Azimuth(seen_b=np.array([1.0, 0.0, 0.0]), azimuth=-np.pi + 0.0099, std=0.02)
    before = turning.x.copy()
    turning.correct(setup.start.t_ns, [seen])
    assert turning.x[2] == pytest.approx(before[2], abs=1e-3)
    assert setup.gate.counts["heading"] == (1, 0)


def test_a_loop_stops_it_with_a_note_and_keeps_what_was_estimated():
    flight = steep(90.0)
    solution = fly("euler", flight, euler.PITCH_LIMIT)
    assert 0 < len(solution.table) < len(flight.q_nb)
    (note,) = solution.notes
    assert "the estimates end at 14." in note
    assert "s of the log: the pitch is 8" in note
    assert "eskf or iterated" in note
    assert np.abs(solution.table.column("pitch")).max() < euler.PITCH_LIMIT
    assert score(solution, flight).worst < 4.0  # deg; what stands is good


def test_the_articles_run_stops_likewise():
    solution = euler_article.run(sequence(steep(90.0).events))
    assert 0 < len(solution.table) < len(steep(90.0).q_nb)
    assert "eskf or iterated" in solution.notes[0]


def test_a_quaternion_flies_the_same_loop_through():
    flight = steep(90.0)
    solution = fly("iterated", flight)
    assert solution.notes == ()
    assert solution.table.stamp_ns[-1] == flight.events.t_ns.max()
    assert score(solution, flight).worst < 4.0


def test_a_start_on_the_tail_is_refused_outright():
    flight = climb(0.0, seed=1, seconds=0.0)
    setup = sequence(flight.events).setup()
    steeply = replace(setup.start.state, q_nb=so3.from_euler(0.0, np.radians(89.0), 0.0))
    setup = replace(setup, start=replace(setup.start, state=steeply))
    with pytest.raises(FilterError, match=r"the pitch is 89\.0 deg.*use eskf or iterated"):
        Euler(setup)


def test_in_quick_turns_the_error_grows_with_the_pitch_and_a_quaternions_does_not():
    angles = [score(fly("euler", steep(peak)), steep(peak)).tilt for peak in (0.0, 60.0, 85.0)]
    quaternions = [score(fly("iterated", steep(peak)), steep(peak)).tilt for peak in (0.0, 85.0)]
    assert angles[0] < angles[1] < angles[2]
    assert angles[2] > 2.0 * angles[0]
    assert quaternions[1] < 1.3 * quaternions[0]


def test_a_short_step_is_that_of_the_quaternion():
    setup = sequence(climb(0.0, seed=1, seconds=0.0).events).setup()
    steeply = replace(setup.start.state, q_nb=so3.from_euler(*STATE[:3]), gyro_bias=STATE[9:12])
    setup = replace(setup, start=replace(setup.start, state=steeply))
    tried = Euler(setup)
    over = Interval(dt=1e-4, gyro0=RATE, gyro1=RATE, accel0=FORCE, accel1=FORCE)
    tried.predict(over)
    apart = tried.state.minus(integrate_strapdown(steeply, over, setup.earth))
    np.testing.assert_allclose(apart, 0.0, atol=2e-7)  # dt^2 by rates of 10 per second
    Phi = transition(steeply, over, setup.earth)
    expected = covariance_in_n(Phi @ setup.start.P @ Phi.T, tried.state.q_nb)
    np.testing.assert_allclose(tried.covariance(), expected, atol=2e-6)  # likewise


def test_noise_adds_what_it_adds_to_a_turn_in_b():
    setup = sequence(climb(0.0, seed=1, seconds=0.0).events).setup()
    steeply = replace(setup.start.state, q_nb=so3.from_euler(*STATE[:3]))
    setup = replace(setup, start=replace(setup.start, state=steeply, P=np.zeros((N, N))))
    tried = Euler(setup)
    tried.predict(Interval(dt=1e-3, gyro0=RATE, gyro1=RATE, accel0=FORCE, accel1=FORCE))
    expected = np.diag(covariance_in_n(setup.noise.covariance(1e-3), tried.state.q_nb))
    np.testing.assert_allclose(np.diag(tried.covariance()), expected, rtol=5e-3)  # rate by dt


@with_seed
def test_the_corrected_filter_is_as_good_as_the_article_on_its_flight():
    recording = csv.read(SEED / "uavSensors.csv")
    solution = euler.run(sequence(recording.events, recording.family))
    assert solution.name == "euler"
    assert (rms_errors(solution) < [0.8, 0.7, 1.3, 0.8, 0.6, 0.35, 0.1, 0.1, 0.06]).all()
    assert solution.counts["heading"][1] < 0.02 * solution.counts["heading"][0]
