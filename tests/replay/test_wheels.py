"""Wheels of a ground vehicle: what they are good for in an outage, and what their faults cost."""

import functools

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings, WheelSettings
from ekf_companion.nav.measurements import Events, Kind, VehicleState, VehicleType, merge
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig, WheelConfig
from sim_autopilot.flight import Flight
from tests.replay.cut import CUT, Cut

WITHOUT = FilterSettings(wheel=WheelSettings(use=False))


class Driven(Cut):
    """A drive, and its truth."""

    sensor = Kind.WHEEL

    def __init__(self, seed=1, scale=1.13, moves=VehicleType.GROUND):
        config = SimConfig(
            imu=ImuConfig(rate=100.0),
            gnss=GnssConfig(slow_h=1.0),
            wheel=WheelConfig(fitted=True, scale=scale),
        )
        driven = Flight.plan("drive", config, seed=seed, duration=140.0)
        found = wire.events(driven, has_vel_down=True)
        state = VehicleState(t_ns=int(found.t_ns[0]) + 1_000_000_000, is_armed=True, type=moves)
        super().__init__(merge(found, Events.from_rows([state.row()])), wire.truth(driven))


@functools.cache
def driven(seed=1):
    return Driven(seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_fixes_it_drifts_by_less_than_a_third(seed):
    one = driven(seed)
    t, _, off, sigma = one.estimate()
    gone = (t > CUT[0]) & (t < CUT[1])
    *_, free, _ = one.estimate(WITHOUT)
    assert off[gone].max() < free[gone].max() / 3.0
    assert (off[gone] < 3.0 * sigma[gone]).all()


def test_of_a_vehicle_that_does_not_roll_they_are_not_used():
    for moves in (VehicleType.ROTARY, VehicleType.FIXED_WING, VehicleType.OTHER):
        one = Driven(moves=moves)
        one.estimate(cut=None)
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
    t, _, off, sigma = one.estimate(change=FAULTS[fault], cut=None)
    *_, free, _ = one.estimate(WITHOUT, cut=None)
    late = t > 20.0
    assert (off[late] < 4.0 * sigma[late]).all()
    assert np.sqrt(np.mean(off[late] ** 2)) < 2.0 * np.sqrt(np.mean(free[late] ** 2))
