"""Gaps within ``imu.gap_reset``: the motion in them is unknown, and the sigmas say so."""

import numpy as np
import pytest

from benchmarks.matched import matched
from ekf_companion.core.memory.enums import E_ATT, E_POS, E_VEL, N
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.filters import ahrs, gap, mahony, zupt
from ekf_companion.filters.gap import lost_motion, over_gap, seen_share
from ekf_companion.filters.strapdown import Earth, Interval, Nominal, integrate_strapdown
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.filters_by_name import run_filter
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.filters import walks
from tests.filters.swings import Swing, swing

pytestmark = pytest.mark.campaign

CONFIG = SimConfig(imu=ImuConfig(rate=50.0))


COARSE = SimConfig(imu=ImuConfig(rate=25.0))


def flown(name="figure-eight", config=CONFIG, seconds=30.0):
    flight = Flight.plan(name, config, seed=2, duration=seconds)
    return flight, wire.events(flight, has_vel_down=True)


def without(events, begin_ns, span):
    """Return events without inertial samples in a time, s."""
    gone = (events.t_ns > begin_ns) & (events.t_ns < begin_ns + span * 1e9)
    return events.take(~(gone & (events.kind == Kind.IMU)))


@pytest.mark.parametrize("span", [0.3, 0.46, 0.8])
def test_a_gap_hides_as_much_as_the_main_estimator_takes_it_to(span):
    _, events = flown("hover")
    events = events.take((events.kind == Kind.IMU) | (events.t_ns < events.t_ns[0] + 10e9))
    imu = events.t_ns[events.kind == Kind.IMU]
    first = np.searchsorted(imu, imu[0] + 20_000_000_000)
    last = first + round(span * 50.0)
    pipeline, P = Pipeline(matched(CONFIG)), np.zeros((2, N, N))
    gone = (events.t_ns > imu[first]) & (events.t_ns < imu[last])
    kept = events.take(~gone)
    # the sample after a gap waits for the next one
    for k, t_ns in enumerate((imu[first], imu[last + 1])):
        upto = kept.t_ns <= t_ns if k == 0 else (kept.t_ns > imu[first]) & (kept.t_ns <= t_ns)
        pipeline.run(kept.take(upto))
        P[k] = np.array(as_state(pipeline.state().block).P)
    lost = lost_motion((imu[last] - imu[first]) * 1e-9)
    gain = np.diagonal(P[1] - P[0])
    # Beside what it adds in any such time, by its own noise and uncertainty
    assert gain[E_ATT] == pytest.approx(lost.tilt**2, rel=0.05)
    assert gain[E_ATT + 2] == pytest.approx(lost.yaw**2, rel=0.05)
    assert gain[E_VEL] == pytest.approx(lost.velocity**2, rel=0.2)
    assert gain[E_POS] > lost.position**2


@pytest.mark.parametrize("span", [0.3, 0.6, 1.0, 2.0])
def test_what_a_gap_hides_is_what_a_process_of_first_order_does_between_its_ends(span):
    """Share and sigma of the mean of both ends, against samples of such a process."""
    noise, step, time = np.random.default_rng(3), 0.01, gap.MOTION_TIME
    count, kept = round(span / step), np.exp(-step / time)
    rate = np.empty((count + 1, 20_000))
    rate[0] = noise.standard_normal(rate.shape[1])
    for k in range(count):
        new = noise.standard_normal(rate.shape[1])
        rate[k + 1] = kept * rate[k] + np.sqrt(1.0 - kept**2) * new
    turned = step * (rate.sum(axis=0) - 0.5 * (rate[0] + rate[-1]))
    ends = 0.5 * span * (rate[0] + rate[-1])
    share = float(ends @ turned / (ends @ ends))
    assert seen_share(span) == pytest.approx(share, abs=0.03)
    sigma = float(np.std(turned - share * ends))
    assert lost_motion(span).velocity == pytest.approx(gap.FORCE_STD * sigma, rel=0.05)


def test_a_step_within_the_configured_gap_hides_nothing():
    assert lost_motion(0.19) is None
    assert lost_motion(0.19, 0.1) is not None


def test_without_motion_nothing_turns_or_falls():
    state = Nominal(
        q_nb=so3.from_euler(0.3, -0.2, 1.0),
        vel_n=np.array([3.0, 1.0, -0.5]),
        pos_n=np.zeros(3),
        gyro_bias=np.array([0.01, 0.02, -0.01]),
        accel_bias=np.array([0.1, -0.2, 0.3]),
    )
    earth, wild = Earth.flat(9.8), np.array([3.0, -2.0, 5.0])
    over = Interval(dt=0.7, gyro0=wild, gyro1=wild, accel0=wild, accel1=wild)
    after = integrate_strapdown(state, over_gap(over, state, earth, 0.0), earth)
    np.testing.assert_allclose(after.q_nb, state.q_nb, atol=1e-12)
    np.testing.assert_allclose(after.vel_n, state.vel_n, atol=1e-12)


@pytest.mark.parametrize("name", ["euler", "iterated", "iterated:robocentric", "ukf"])
@pytest.mark.parametrize("span", [0.4, 0.9])
def test_after_a_gap_the_errors_are_within_their_sigmas(name, span):
    flight, events = flown(config=COARSE, seconds=27.5)
    begin = int(events.t_ns[0]) + 18_000_000_000
    events = without(events, begin, span)
    # Neither is there a fix until a second later
    fixes = (events.kind == Kind.GNSS) & (events.t_ns > begin)
    events = events.take(~(fixes & (events.t_ns < begin + (span + 1.0) * 1e9)))
    table = run_filter(Recording(family="unknown", events=events), name, matched(COARSE)).table
    at = int(np.searchsorted(table.stamp_ns, begin + round(span * 1e9)))
    truth = flight.truth_at(table.stamp_ns[at : at + 1])
    for axis, letter in enumerate("ned"):
        off = table.column(f"vel_{letter}")[at] - truth.vel_n[0, axis]
        assert abs(off) < 3.0 * table.column(f"sd_vel_{letter}")[at]
    assert table.column("sd_vel_n")[at] > 2.0 * span
    assert table.column("sd_yaw")[at] > 0.2 * span
    late = table.stamp_ns > begin + 8_000_000_000
    true = flight.truth_at(table.stamp_ns[late])
    assert np.abs(table.column("vel_n")[late] - true.vel_n[:, 0]).max() < 1.0


@pytest.mark.parametrize("run", [ahrs.run, mahony.run])
@pytest.mark.parametrize("span", [0.4, 0.9])
def test_a_turn_at_the_end_of_a_gap_is_not_taken_for_the_whole_of_it(run, span):
    """Still until the gap's end, then a fast turn: one step with its rate would be off by more."""
    events, truth = swing(Swing(seconds=30.0, still=50.0, turn=0.0))
    begin = 20_000_000_000
    events = without(events, begin, span)
    values = events.values.copy()
    end = np.flatnonzero((events.kind == Kind.IMU) & (events.t_ns >= begin + span * 1e9))[0]
    values[end, 2] += 3.0
    solution = run(type(events)(t_ns=events.t_ns, kind=events.kind, values=values))
    at = int(np.searchsorted(solution.table.stamp_ns, begin + round(span * 1e9)))
    yaw = solution.table.column("yaw")
    off = abs(float(so3.wrap(yaw[at] - yaw[at - 1])))
    assert off < (1.7 * span if span < 0.5 else 0.1)
    assert np.abs(so3.wrap(yaw[-1] - yaw[at - 1])) < 0.3
    assert len(truth.att_t_ns)


@pytest.mark.parametrize("span", [0.4, 0.9])
def test_a_gap_in_a_walk_is_in_its_sigmas(span):
    walk = walks.make(np.random.default_rng(1), rate=100.0, strides=6)
    begin = int(walk.events.t_ns[0]) + 5_300_000_000
    events = without(walk.events, begin, span)
    table = zupt.run(events).table
    at = int(np.searchsorted(table.stamp_ns, begin + round(span * 1e9)))
    assert table.column("sd_pos_n")[at] > 0.2 * span
    whole = np.isin(walk.events.t_ns, table.stamp_ns)
    off = np.stack([table.column(f"pos_{axis}") for axis in "ned"], axis=1) - walk.pos_n[whole]
    sigma = np.stack([table.column(f"sd_pos_{axis}") for axis in "ned"], axis=1)
    # The track begins along the sensor's forward axis: only heights compare
    assert (np.abs(off[:, 2]) < 4.0 * sigma[:, 2] + 0.02).all()
