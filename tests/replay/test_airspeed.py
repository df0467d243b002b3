"""Airspeed and wind: what they are good for in an outage, and what faults of the sensor cost."""

import functools

import numpy as np
import pytest

from ekf_companion.core.settings.settings import AirspeedSettings, FilterSettings
from ekf_companion.nav.measurements import Events, Kind, VehicleState, VehicleType, merge
from sim_autopilot import events as wire
from sim_autopilot.config import AirspeedConfig, GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.replay.cut import CUT, Cut

WIND = (4.0, -3.0)
WITHOUT = FilterSettings(airspeed=AirspeedSettings(use=False))


class Flown(Cut):
    """A fixed wing in the wind, and its truth."""

    sensor = Kind.AIRSPEED

    def __init__(self, seed=1, name="square-spiral", moves=VehicleType.FIXED_WING, **sensor):
        config = SimConfig(
            imu=ImuConfig(rate=100.0),
            gnss=GnssConfig(slow_h=1.0),
            airspeed=AirspeedConfig(fitted=True, wind=WIND, **sensor),
        )
        flown = Flight.plan(name, config, seed=seed, duration=140.0)
        truth = wire.truth(flown)
        found = wire.events(flown, has_vel_down=True)
        up_ns = int(truth.pos_t_ns[np.argmax(truth.alt > truth.alt[0] + 1.0)])
        states = [
            VehicleState(t_ns=t_ns, is_armed=True, is_landed=is_landed, type=moves).row()
            for t_ns, is_landed in ((int(found.t_ns[0]) + 1_000_000_000, True), (up_ns, False))
        ]
        super().__init__(merge(found, Events.from_rows(states)), truth)


@functools.cache
def flown(seed=1):
    return Flown(seed)


def test_it_finds_the_wind_of_a_flight():
    t, table, *_ = flown().estimate(cut=None)
    late = t > 100.0  # after the first turn, which tells the wind from the scale
    for axis, wind in zip("ne", WIND, strict=True):
        off = table.column(f"wind_{axis}")[late] - wind
        assert np.abs(off).max() < 1.0
        assert np.abs(off / table.column(f"sd_wind_{axis}")[late]).max() < 3.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_fixes_it_drifts_by_less_than_a_third(seed):
    one = flown(seed)
    t, _, off, sigma = one.estimate()
    gone = (t > CUT[0]) & (t < CUT[1])
    *_, free, _ = one.estimate(WITHOUT)
    assert off[gone].max() < free[gone].max() / 3.0
    assert (off[gone] < 3.0 * sigma[gone]).all()


def test_of_a_vehicle_that_has_no_wings_it_is_not_used():
    for moves in (VehicleType.ROTARY, VehicleType.GROUND, VehicleType.OTHER):
        _, table, *_ = Flown(moves=moves).estimate(cut=None)
        assert np.isnan(table.column("wind_n")).all()


def test_on_the_ground_and_below_the_least_airspeed_there_is_no_wind():
    one = flown()
    t, table, *_ = one.estimate(cut=None)
    assert np.isnan(table.column("wind_n")[t < 8.0]).all()
    slow = FilterSettings(airspeed=AirspeedSettings(least_speed=60.0))
    _, table, *_ = one.estimate(slow, cut=None)
    assert np.isnan(table.column("wind_n")).all()


def frozen(t, speed):
    return np.where(t > 40.0, speed[np.searchsorted(t, 40.0)], speed)


FAULTS = {
    "nothing": None,
    "half": lambda t, speed: 0.5 * speed,
    "in km/h": lambda t, speed: 3.6 * speed,
    "in knots": lambda t, speed: 1.944 * speed,
    "a tenth too much": lambda t, speed: 1.1 * speed,
    "reversed": lambda t, speed: -speed,
    "open to the cabin": lambda t, speed: 0.0 * speed,
    "frozen": frozen,
    "frozen, and noise": lambda t, speed: frozen(t, speed) + 0.3 * np.sin(77.0 * t),
    "half from the middle on": lambda t, speed: np.where(t > 45.0, 0.5 * speed, speed),
    "water in the hose": lambda t, speed: speed + 5.0 * np.sin(t / 3.0),
    "late by 2 s": lambda t, speed: np.interp(t - 2.0, t, speed),
    "bursts": lambda t, speed: np.where((t * 3.7) % 1.0 < 0.2, 50.0, speed),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_with_fixes_a_sensor_that_is_wrong_makes_nothing_worse_than_its_sigma(fault):
    one = flown()
    t, _, off, sigma = one.estimate(change=FAULTS[fault], cut=None)
    *_, free, _ = one.estimate(WITHOUT, cut=None)
    late = t > 20.0
    assert (off[late] < 4.0 * sigma[late]).all()
    assert np.sqrt(np.mean(off[late] ** 2)) < 1.2 * np.sqrt(np.mean(free[late] ** 2))


WITHIN_AN_OUTAGE = {
    "frozen": lambda t, speed: np.where(t > 80.0, speed[np.searchsorted(t, 80.0)], speed),
    "half": lambda t, speed: np.where(t > 80.0, 0.5 * speed, speed),
    "nothing": lambda t, speed: np.where(t > 80.0, 0.0, speed),
    "half from the start": FAULTS["half"],
    "in km/h from the start": FAULTS["in km/h"],
    "reversed from the start": FAULTS["reversed"],
}


@pytest.mark.parametrize("fault", WITHIN_AN_OUTAGE)
def test_without_fixes_a_sensor_that_is_clearly_wrong_is_not_believed(fault):
    one = flown()
    t, _, off, sigma = one.estimate(change=WITHIN_AN_OUTAGE[fault])
    gone = (t > CUT[0]) & (t < CUT[1])
    assert (off[gone] < 3.0 * sigma[gone]).all()
    later = t > CUT[1] + 5.0
    assert off[later].max() < 3.0


def test_a_frozen_reading_is_counted_as_refused():
    one = flown()
    one.estimate(change=WITHIN_AN_OUTAGE["frozen"], cut=None)
    _, refused = one.solution.counts["airspeed"]
    assert refused > 500


def test_a_scale_that_can_be_none_leaves_no_wind():
    t, table, *_ = flown().estimate(change=FAULTS["half"], cut=None)
    assert np.isfinite(table.column("wind_n")[t < 50.0]).any()
    assert np.isnan(table.column("wind_n")[t > 80.0]).all()
