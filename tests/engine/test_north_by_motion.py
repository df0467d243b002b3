"""How soon a straight start from rest shows north, without a heading: see docs/ACCURACY.md."""

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Status

RATE, FIXES, PAUSE = 100, 5, 10.0
SECOND = 1_000_000_000
HOME = LocalFrame(np.radians(47.4), np.radians(8.5), 500.0)


def start(forward, push, seed):
    """Return the events of a level start after a pause, and its yaw: one acceleration, m/s^2."""
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-np.pi, np.pi)
    t = np.arange(0.0, PAUSE + 20.0, 1.0 / RATE)
    accel = np.where((t > PAUSE) & (t < PAUSE + push), forward, 0.0)
    speed = np.cumsum(accel) / RATE
    way = np.cumsum(speed) / RATE
    gyro = rng.normal(0.0, 6e-3, (len(t), 3)) + rng.normal(0.0, 3e-3, 3)
    force = np.stack([accel, np.zeros_like(t), np.full_like(t, -9.8066)], axis=1)
    force += rng.normal(0.0, 0.09, (len(t), 3)) + rng.normal(0.0, 0.05, 3)
    t_ns = SECOND + np.rint(t * SECOND).astype(np.int64)
    fix = np.arange(0, len(t), RATE // FIXES)
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    pos_n = way[fix, None] * ahead + rng.normal(0.0, 0.7, (len(fix), 3))
    vel_n = speed[fix, None] * ahead + rng.normal(0.0, 0.05, (len(fix), 3))
    stds = (1.0, 1.5, 0.1, np.nan, 0.0)
    second = slice(None, None, RATE)
    events = merge(
        Events.from_columns(
            t_ns[fix],
            Kind.GNSS,
            *HOME.to_geodetic(pos_n),
            *vel_n.T,
            *(np.full(len(fix), value) for value in stds),
        ),
        Events.from_columns(t_ns, Kind.IMU, *gyro.T, *force.T),
        Events.from_columns(
            t_ns[second],
            Kind.VEHICLE,
            (t[second] > PAUSE - 1.0).astype(float),
            (t[second] < PAUSE).astype(float),
        ),
    )
    return events, yaw


def found(forward, push, seed):
    """Return the seconds of the push until everything was estimated, and the yaw error, deg."""
    events, yaw = start(forward, push, seed)
    table = Pipeline(FilterSettings()).run(events)
    known = np.flatnonzero(table.column("status") >= Status.OK)
    if not len(known):
        return None
    seconds = (table.stamp_ns[known[0]] - SECOND) * 1e-9 - PAUSE
    return seconds, abs(np.degrees(so3.wrap(table.column("yaw")[known[0]] - yaw)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("forward", "latest"), [(4.0, 2.0), (2.0, 4.0), (1.5, 6.0)])
def test_a_straight_start_shows_north_within_seconds(forward, latest, seed):
    seconds, error = found(forward, 10.0, seed)
    assert 0.5 < seconds < latest
    assert error < 4.0


def test_a_gentle_push_does_not():
    assert found(1.0, 5.0, seed=1) is None
