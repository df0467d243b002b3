"""Simulated flights for the estimator's tests, and small ways to change them."""

from dataclasses import replace
from functools import cache

import numpy as np

from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, SimConfig
from sim_autopilot.flight import Flight


@cache
def flight(
    name: str,
    duration: float = 30.0,
    seed: int = 1,
    rate: float = 100.0,
    skip: float = 0.0,
    yaw: bool = False,
    noise: tuple[float, float] = (1.0, 0.0),
) -> tuple[Events, Trajectory]:
    """Return the events of a flight, and the truth; noise of fixes: white and slow, m."""
    white, slow = noise
    receiver = GnssConfig(
        yaw=yaw, noise_h=white, slow_h=slow, noise_v=1.5 * white, slow_v=1.5 * slow
    )
    config = SimConfig(gnss=receiver)
    config = replace(config, imu=replace(config.imu, rate=rate))
    flown = Flight.plan(name, config, seed=seed, duration=duration, skip=skip)
    return wire.events(flown, has_vel_down=True), wire.truth(flown)


def without(events: Events, *kinds: Kind) -> Events:
    """Leave out some kinds."""
    return events.take(~np.isin(events.kind, kinds))


def between(events: Events, start: float, end: float) -> np.ndarray:
    """Say which events have stamps from start to end, s after the first."""
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    return (t >= start) & (t < end)


def changed(events: Events, mask: np.ndarray, column: int, by: float) -> Events:
    """Add to one column of some events."""
    values = events.values.copy()
    values[mask, column] += by
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)
