"""Fixes brought to the inertial sensor: those of an antenna that is there."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.fleet.tune_antenna import Antenna
from ekf_companion.nav.measurements import GNSS_VELOCITY, Events, Kind
from sim_autopilot.config import GnssConfig, ImuConfig
from tests.calibrate.recordings import fly, without

ARM = np.array([0.6, -0.4, -0.3])
DELAY = 0.25


def flown(arm):
    """Return a flight whose antenna has an arm; all noise is the same for every arm."""
    gnss = GnssConfig(delay=DELAY, lever_arm=tuple(arm))
    return fly("figure-eight", 60.0, imu=ImuConfig(rate=50.0, gyro_noise=0.003), gnss=gnss)


def antenna(recording):
    return Antenna(recording, Pipeline(Config()).run(recording.events), Config())


def off(values, expected, is_fix):
    """Return the RMS of the differences of fixes: north, east, up, m; then of velocity, m/s."""
    found = (values - expected)[is_fix, :6]
    lat = expected[is_fix, 0][:1]
    found = found * np.concatenate([[6.37e6], 6.37e6 * np.cos(lat), np.ones(4)])
    return np.sqrt((found[25:] ** 2).mean(axis=0))  # the attitude is known by then


def test_fixes_are_brought_to_where_an_antenna_without_an_arm_has_them():
    with_arm, without_arm = flown(ARM), flown(np.zeros(3))
    expected, is_fix = without_arm.events.values, without_arm.events.kind == Kind.GNSS
    before = off(with_arm.events.values, expected, is_fix)
    after = off(antenna(with_arm).brought(ARM, DELAY), expected, is_fix)
    assert (after < 0.1 * before).all()  # what is left are attitude and rate, as they are known
    late = off(antenna(with_arm).brought(ARM, 0.0), expected, is_fix)
    assert (late[3:] > 2.0 * after[3:]).all()


def test_no_arm_changes_nothing():
    recording = flown(ARM)
    brought = antenna(recording).brought(np.zeros(3), DELAY)
    assert np.array_equal(brought, recording.events.values, equal_nan=True)


def test_the_smoothed_rate_has_the_variance_that_is_told():
    quiet = flown(np.zeros(3))
    values, is_imu = quiet.events.values.copy(), quiet.events.kind == Kind.IMU
    values[is_imu, :3] += (
        0.003 * np.sqrt(50.0) * np.random.default_rng(1).normal(size=(np.count_nonzero(is_imu), 3))
    )
    noisy = replace(quiet, events=replace(quiet.events, values=values))
    table = Pipeline(Config()).run(quiet.events)
    fits = [Antenna(one, table, Config()) for one in (quiet, noisy)]
    arm = np.array([1.0, 0.0, 0.0])
    is_fix = quiet.events.kind == Kind.GNSS
    with_noise, without = (one.brought(arm, DELAY)[is_fix, GNSS_VELOCITY] for one in reversed(fits))
    var = ((with_noise - without) ** 2).sum(axis=1).mean() / 2.0  # of two axes
    assert var == pytest.approx(0.003**2 * fits[0].bandwidth, rel=0.2)


def test_a_velocity_that_is_not_known_stays_unknown():
    recording = flown(ARM)
    values = recording.events.values.copy()
    is_fix = recording.events.kind == Kind.GNSS
    values[is_fix, GNSS_VELOCITY.stop - 1] = np.nan
    recording = replace(recording, events=replace(recording.events, values=values))
    brought = antenna(recording).brought(ARM, DELAY)[is_fix]
    assert np.isnan(brought[:, GNSS_VELOCITY.stop - 1]).all()
    assert np.isfinite(brought[:, :5]).all()


@pytest.mark.parametrize("wrong", ["back", "twice", "slow", "gap"])
def test_stamps_that_are_out_of_order_leave_fixes_finite(wrong):
    recording = flown(ARM)
    events = recording.events
    t_ns, keep = events.t_ns.copy(), np.ones(len(events), dtype=bool)
    imu = np.flatnonzero(events.kind == Kind.IMU)
    if wrong == "back":
        t_ns[len(t_ns) // 2 :] -= 1_000_000_000
    elif wrong == "twice":
        t_ns[imu[1::2]] = t_ns[imu[:-1:2]]
    elif wrong == "slow":
        keep[imu] = np.arange(len(imu)) % 10 == 0
    else:
        keep[imu[1000:1200]] = False
    events = Events(t_ns=t_ns[keep], kind=events.kind[keep], values=events.values[keep])
    recording = replace(without(recording), events=events)
    brought = antenna(recording).brought(ARM, DELAY)
    is_fix = events.kind == Kind.GNSS
    assert np.isfinite(brought[is_fix, :6]).all()
    assert (np.abs(brought - events.values)[is_fix, 3:6] < 2.0 * np.linalg.norm(ARM)).all()
