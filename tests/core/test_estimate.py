"""The estimate of now: what is called good, what is known, and how well."""

import numpy as np
import pytest

from ekf_companion.core.memory.bank import Bank
from ekf_companion.core.memory.enums import (
    AIDS,
    CORE,
    E_ATT,
    E_POS,
    Aid,
    Azimuth,
    Mode,
    NeedsReset,
    Voice,
    Weigh,
)
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Estimate, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.nav import earth, so3
from ekf_companion.nav.state import Reason, Status
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy, plus, some_parameters

NOW = 1000e9


def navigating() -> State:
    """Return a state of which nothing is to be said against; fixes come five times a second."""
    x = a_state(1)
    x.t, x.mode, x.dt, x.fix_dt, x.has_yaw, x.has_aid[Aid.BARO] = (
        NOW,
        Mode.NAVIGATE,
        0.01,
        0.2,
        1.0,
        1.0,
    )
    x.azimuth, x.fix_t, x.raw_fix_t = Azimuth.FIELD, NOW, NOW
    for aid in range(AIDS):
        x.used_t[aid], x.refused_t[aid] = NOW, -1e18
    root = np.random.default_rng(1).normal(0.0, 0.02, (CORE, CORE))
    array(x.P)[:CORE, :CORE] = root @ root.T
    return x


def parameters() -> Parameters:
    k = some_parameters()
    k.limit_pos = 10.0
    return k


def reasons(x: State) -> Reason:
    return Reason(load().estimate.find_reasons(x, parameters(), Scratch()))


def write(x: State, lag: float = 0.0) -> Estimate:
    """Return an estimate; its memory and that of the step hold something else before."""
    out, k, w = Estimate(), parameters(), Scratch()
    k.lag = lag
    for numbers in (out.lla, out.pos_n, out.q_nb, w.motion.rate_slope, w.motion.force_slope):
        array(numbers)[:] = 1e5
    status = load().estimate.write_estimate(x, k, State(), w, out)
    assert status == out.status
    return out


@pytest.mark.parametrize(
    ("mode", "why", "status"),
    [
        (Mode.INIT, Reason(0), Status.INIT),
        (Mode.LEVEL, Reason(0), Status.ALIGNING),
        (Mode.ATTITUDE, Reason(0), Status.ATTITUDE),
        (Mode.NAVIGATE, Reason(0), Status.OK),
        (Mode.NAVIGATE, Reason.HEIGHT_OFF, Status.DEGRADED),
        (Mode.NAVIGATE, Reason.UNAIDED | Reason.GAP, Status.DEAD_RECKONING),
        (Mode.NAVIGATE, Reason.UNAIDED | Reason.UNCERTAIN, Status.INVALID),
    ],
)
def test_the_status_is_the_worst_of_the_reasons(mode, why, status):
    assert load().estimate.find_status(State(mode=mode), int(why)) == status


def aged(aids: list[Aid], seconds: float, is_refused: bool = False) -> State:
    """Return a state in which some aids were used last so long ago."""
    x = navigating()
    for aid in aids:
        x.used_t[aid] = NOW - seconds * 1e9
        x.refused_t[aid] = NOW - 0.5 * seconds * 1e9 if is_refused else -1e18
    return x


@pytest.mark.parametrize(
    ("aids", "seconds", "found"),
    [
        # a second beyond the receiver's interval of 0.2 s; position and height one more
        ([Aid.POSITION, Aid.VELOCITY], 1.19, Reason(0)),
        ([Aid.POSITION, Aid.VELOCITY], 1.21, Reason.UNAIDED),
        ([Aid.VELOCITY], 100.0, Reason(0)),
        ([Aid.POSITION], 2.19, Reason(0)),
        ([Aid.POSITION], 2.21, Reason.POSITION_MISSING),
        ([Aid.HEIGHT], 2.19, Reason(0)),
        ([Aid.HEIGHT], 2.21, Reason.HEIGHT_MISSING),
        ([Aid.HEADING], 4.99, Reason(0)),
        ([Aid.HEADING], 5.01, Reason.COMPASS_MISSING),
    ],
)
def test_an_aid_is_missed_once_it_is_late(aids, seconds, found):
    assert reasons(aged(aids, seconds)) == found
    if found and found != Reason.UNAIDED:
        was_refused = Reason[found.name.replace("MISSING", "REFUSED")]
        assert reasons(aged(aids, seconds, is_refused=True)) == was_refused


@pytest.mark.parametrize(
    ("since", "refusals", "is_gradual", "found"),
    [
        (0.0, 1.0, 0.0, Reason(0)),  # a glitch
        (0.0, 2.0, 0.0, Reason.VELOCITY_REFUSED),
        (0.0, 1.0, 1.0, Reason.VELOCITY_REFUSED),  # it was led up to
        (-0.5, 0.0, 1.0, Reason(0)),  # one was used since
    ],
)
def test_a_velocity_that_is_refused_is_a_reason_the_second_time(since, refusals, is_gradual, found):
    x = aged([Aid.VELOCITY], 0.2)
    x.refused_t[Aid.VELOCITY], x.is_gradual = NOW + 1e9 * since, is_gradual
    x.run[Aid.VELOCITY].n, x.run[Aid.VELOCITY].t0 = refusals, NOW
    assert reasons(x) == found


def test_a_heading_that_never_was_is_not_missed():
    x = aged([Aid.HEADING], 100.0)
    x.azimuth = Azimuth.OTHER
    assert reasons(x) == Reason.HEADING_MISSING
    x.azimuth = 0.0
    assert reasons(x) == Reason(0)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda x: None, Reason(0)),
        (lambda x: setattr(x, "needs_reset", NeedsReset.TILT), Reason.GAP),
        (lambda x: setattr(x, "dt", 0.14), Reason(0)),
        (lambda x: setattr(x, "dt", 0.16), Reason.SLOW_SAMPLES),
        (lambda x: setattr(x, "proven_t", NOW), Reason(0)),
        (lambda x: setattr(x, "proven_t", NOW + 1.0), Reason.UNPROVEN),
        (lambda x: setattr(x, "raw_fix_t", NOW - 1.0), Reason.AUTOPILOTS),
        (lambda x: setattr(x.slide, "is_sliding", 1.0), Reason.SLIDE),
        (lambda x: x.is_one_sided.__setitem__(0, 1.0), Reason.POSITION_OFF),
        (lambda x: x.is_one_sided.__setitem__(1, 1.0), Reason.HEIGHT_OFF),
        (lambda x: setattr(x.voices, "loser", Voice.HEIGHT), Reason.CLIMB_HEIGHT),
        (lambda x: setattr(x.voices, "loser", Voice.VELOCITY), Reason.CLIMB_VELOCITY),
        (lambda x: setattr(x.voices, "loser", Voice.BARO), Reason.CLIMB_BARO),
        (lambda x: setattr(x.voices, "loser", Voice.ANY), Reason.CLIMB_ANY),
        # ten degrees, and ten metres of north and east together
        (lambda x: x.P[E_ATT].__setitem__(E_ATT, np.radians(9.9) ** 2), Reason(0)),
        (lambda x: x.P[E_ATT].__setitem__(E_ATT, np.radians(10.1) ** 2), Reason.ATTITUDE),
        (lambda x: x.P[E_POS].__setitem__(E_POS, 99.9), Reason(0)),
        (lambda x: x.P[E_POS].__setitem__(E_POS, 100.1), Reason.UNCERTAIN),
        (lambda x: x.P[E_POS].__setitem__(E_POS, np.nan), Reason.UNCERTAIN),
    ],
)
def test_each_shortcoming_has_its_own_reason(change, found):
    x = navigating()
    change(x)
    assert reasons(x) == found
    x.mode = Mode.ATTITUDE
    assert reasons(x) == Reason(0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sigmas_of_the_angles_are_those_of_the_attitude_error_turned_into_them(seed):
    x = navigating()
    x.q_nb[:] = a_state(seed).q_nb
    step, n = 1e-6, len(x.P)
    slope = np.zeros((3, 3))
    for i in range(3):
        ends = [
            so3.to_euler(np.array(plus(x, sign * step * np.eye(n)[i]).q_nb)) for sign in (1, -1)
        ]
        slope[:, i] = so3.wrap(ends[0] - ends[1]) / (2.0 * step)
    expected = slope @ array(x.P)[:3, :3] @ slope.T
    out = write(x)
    np.testing.assert_allclose(out.std_euler, np.sqrt(np.diag(expected)), rtol=1e-7)
    np.testing.assert_allclose(out.euler, so3.to_euler(np.array(x.q_nb)), atol=1e-12)


def test_the_place_is_that_of_the_local_frame():
    x = navigating()
    x.pos_n[:] = [4000.0, -3000.0, -120.0]
    frame = earth.LocalFrame(x.origin.lat, x.origin.lon, x.origin.alt)
    lat, lon, alt = frame.to_geodetic(np.array(x.pos_n))
    np.testing.assert_allclose(
        write(x).lla, [np.degrees(lat), np.degrees(lon), alt], rtol=0.0, atol=1e-11
    )


def test_the_estimate_is_carried_on_by_the_lag_and_the_state_is_not():
    x, lag = navigating(), 0.02
    x.gyro_bias[:] = x.accel_bias[:] = [0.0] * 3
    x.gyro[:], x.accel[:] = [0.1, -0.2, 0.3], [1.0, 2.0, -9.0]
    before = bytes(x)
    out = write(x, lag)
    assert bytes(x) == before
    q, velocity = np.array(x.q_nb), np.array(x.vel_n)
    turned = so3.multiply(q, so3.exp(lag * np.array(x.gyro)))
    error = so3.log(so3.multiply(np.array(out.q_nb), so3.conjugate(turned)))
    np.testing.assert_allclose(error, 0.0, atol=1e-5)  # the Earth turns
    gravity = np.array([0.0, 0.0, float(earth.gravity(x.origin.lat, x.origin.alt))])
    accel = so3.rotate(q, np.array(x.accel)) + gravity
    # second order: the force turns by 0.2 rad/s lag
    np.testing.assert_allclose(out.vel_n, velocity + lag * accel, atol=1e-3)
    way = lag * velocity + 0.5 * lag * lag * accel
    np.testing.assert_allclose(out.pos_n, np.array(x.pos_n) + way, atol=1e-5)


def test_what_is_not_known_yet_is_nan():
    x = navigating()
    numbers = ("lla", "pos_n", "vel_n", "std_pos", "std_vel")
    x.has_yaw = 0.0
    out = write(x)
    assert not np.isnan([list(getattr(out, name)) for name in numbers]).any()
    assert np.isnan(out.euler).tolist() == np.isnan(out.std_euler).tolist() == [False, False, True]

    x.mode = Mode.ATTITUDE
    out = write(x)
    # height by the barometer, above the start
    assert np.isnan(out.lla).all()
    for name in numbers[1:]:
        assert np.isnan(getattr(out, name)).tolist() == [True, True, False], name
    x.has_aid[Aid.BARO] = 0.0
    assert np.isnan([list(getattr(write(x), name)) for name in numbers]).all()
    assert not np.isnan(write(x).q_nb).any()

    x.mode = Mode.LEVEL
    out = write(x)
    assert np.isnan([*out.q_nb, *out.euler, *out.gyro_bias, *out.accel_bias]).all()
    assert out.status == Status.ALIGNING


def test_both_quaternions_of_an_attitude_are_written_as_one():
    x = navigating()
    y = copy(x)
    y.q_nb[:] = [-q for q in x.q_nb]
    assert list(write(x).q_nb) == list(write(y).q_nb)
    assert write(y).q_nb[0] >= 0.0


def judged(spread: dict[int, float]) -> Reason:
    """Return the reasons of the best state if fault hypotheses decide that are so far apart."""
    b, x, k = Bank(), navigating(), parameters()
    for e, variance in spread.items():
        b.spread[e][e] = variance
    k.weighs_faults = Weigh.ACT
    core = load().estimate
    return Reason(core.judge_spread(x, k, b) | core.judge_state(x, k))


@pytest.mark.parametrize(
    ("spread", "reason"),
    [
        ({}, Reason(0)),
        ({E_POS: 60.0, E_POS + 1: 38.0}, Reason(0)),
        ({E_POS: 60.0, E_POS + 1: 40.1}, Reason.UNCERTAIN),
        ({E_POS: np.nan}, Reason.UNCERTAIN),
        ({E_POS + 2: 1e4}, Reason(0)),
        ({E_ATT: np.radians(7.0) ** 2}, Reason(0)),
        ({E_ATT + 2: np.radians(10.1) ** 2}, Reason.ATTITUDE),
    ],
)
def test_what_fault_hypotheses_leave_open_counts_in_the_status(spread, reason):
    assert judged(spread) == reason
