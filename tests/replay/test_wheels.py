"""Wheels of a ground vehicle: what they are good for in an outage, and what their faults cost."""

import functools

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings, WheelSettings
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Events, Kind, VehicleState, VehicleType, merge
from ekf_companion.replay.filters_by_name import run_filter
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig, WheelConfig
from sim_autopilot.flight import Flight

WITHOUT = FilterSettings(wheel=WheelSettings(use=False))
CUT = (70.0, 130.0)
"""Without fixes, s."""


class Driven:
    """A drive, and its truth."""

    def __init__(self, seed=1, scale=1.13, moves=VehicleType.GROUND):
        config = SimConfig(
            imu=ImuConfig(rate=100.0),
            gnss=GnssConfig(slow_h=1.0),
            wheel=WheelConfig(fitted=True, scale=scale),
        )
        driven = Flight.plan("drive", config, seed=seed, duration=140.0)
        self.truth = wire.truth(driven)
        found = wire.events(driven, has_vel_down=True)
        state = VehicleState(t_ns=int(found.t_ns[0]) + 1_000_000_000, is_armed=True, type=moves)
        self.events = merge(found, Events.from_rows([state.row()]))
        self.zero_ns = int(found.t_ns.min())

    def drive(self, settings=None, change=None, cut=CUT):
        """Return the times, s, the table, and the horizontal error and its sigma, m."""
        events = self.events
        t = (events.t_ns - self.zero_ns) * 1e-9
        if change is not None:
            is_wheel, values = events.kind == Kind.WHEEL, events.values.copy()
            values[is_wheel, 0] = change(t[is_wheel], values[is_wheel, 0])
            events = Events(t_ns=events.t_ns, kind=events.kind, values=values)
        if cut is not None:
            events = events.take(~((events.kind == Kind.GNSS) & (t > cut[0]) & (t < cut[1])))
        recording = Recording(family="ardupilot", events=events)
        self.solution = run_filter(recording, "eskf", settings or FilterSettings())
        table = self.solution.table
        lat, lon = (
            np.interp(table.stamp_ns, self.truth.pos_t_ns, one)
            for one in (self.truth.lat, self.truth.lon)
        )
        off = np.hypot(
            np.radians(table.column("lat_deg")) - lat,
            (np.radians(table.column("lon_deg")) - lon) * np.cos(lat),
        )
        sigma = np.hypot(table.column("sd_pos_n"), table.column("sd_pos_e"))
        return (table.stamp_ns - self.zero_ns) * 1e-9, table, 6.37e6 * off, sigma


@functools.cache
def driven(seed=1):
    return Driven(seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_fixes_it_drifts_by_less_than_a_third(seed):
    one = driven(seed)
    t, _, off, sigma = one.drive()
    gone = (t > CUT[0]) & (t < CUT[1])
    *_, free, _ = one.drive(WITHOUT)
    assert off[gone].max() < free[gone].max() / 3.0
    assert (off[gone] < 3.0 * sigma[gone]).all()


def test_of_a_vehicle_that_does_not_roll_they_are_not_used():
    for moves in (VehicleType.ROTARY, VehicleType.FIXED_WING, VehicleType.OTHER):
        one = Driven(moves=moves)
        one.drive(cut=None)
        assert "wheel" not in one.solution.counts or one.solution.counts["wheel"][0] == 0


FAULTS = {
    "nothing": None,
    "half": lambda t, speed: 0.5 * speed,
    "in km/h": lambda t, speed: 3.6 * speed,
    "backwards": lambda t, speed: -speed,
    "frozen": lambda t, speed: np.where(t > 40.0, speed[np.searchsorted(t, 40.0)], speed),
    "still": lambda t, speed: np.where(t > 40.0, 0.0, speed),
    "spinning": lambda t, speed: np.where((t > 45.0) & (t < 60.0), speed + 4.0, speed),
    "sliding": lambda t, speed: np.where(t % 7.0 < 1.0, 0.3 * speed, speed),
    "late by 1 s": lambda t, speed: np.interp(t - 1.0, t, speed),
    "bursts": lambda t, speed: np.where((t * 3.7) % 1.0 < 0.2, 40.0, speed),
    "another tyre": lambda t, speed: np.where(t > 45.0, 1.1 * speed, speed),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_with_fixes_wheels_that_are_wrong_make_nothing_worse_than_its_sigma(fault):
    one = driven()
    t, _, off, sigma = one.drive(change=FAULTS[fault], cut=None)
    *_, free, _ = one.drive(WITHOUT, cut=None)
    late = t > 20.0
    assert (off[late] < 4.0 * sigma[late]).all()
    assert np.sqrt(np.mean(off[late] ** 2)) < 2.0 * np.sqrt(np.mean(free[late] ** 2))
