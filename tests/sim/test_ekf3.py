"""ArduPilot's filter as a follower: its origin, its source sets, what comes late."""

import math

import numpy as np
import pytest

from sim_autopilot.closed_loop import SETS
from sim_autopilot.ekf3 import Ekf3
from sim_autopilot.flight import Fix
from sim_autopilot.personality import Kind
from tests.sim.test_follower import message

LAT, LON, ALT = math.radians(47.4), math.radians(8.5), 488.0
STDS = (0.5, 0.7, 0.1)
DT = 0.008


class Stand:
    """A filter at rest with its own sensors, and ODOMETRY if it is given any."""

    def __init__(self, **parameters):
        self.own = Ekf3({**SETS[Kind.ARDUPILOT], **parameters})
        self.t = 0.0
        self.alt = 30.0
        self.texts = []
        self.has_fix = True
        self.height = ALT

    def run(self, seconds, given=lambda t: None, late=0.0):
        own = self.own
        for _ in range(round(seconds / DT)):
            self.t += DT
            n = round(self.t / DT)
            own.sample(self.t, np.zeros(3), np.array([0.0, 0.0, -9.80665]))
            if n % 5 == 0:
                own.baro(self.t, self.alt)
                own.heading(self.t, 0.0, 0.05)
            if n % 25 == 0 and self.has_fix:
                fix = Fix(0, LAT, LON, self.height, (0.0, 0.0, 0.0), math.nan)
                own.receiver(self.t - 0.1, fix, STDS)
            if n % 4 == 0 and (m := given(self.t)) is not None:
                own.odometry(message(self.t, **m), self.t + late)
            self.texts += [one.text for one in own.texts()]
        return self


def at(*pos_n, counter=1, **more):
    return lambda t: {"pos_n": pos_n, "counter": counter, **more}


def test_it_sets_an_origin_ten_seconds_after_its_first_fix_and_tells_it_unasked():
    stand = Stand().run(9.9)
    assert stand.own.origin is None
    stand.run(0.5)
    assert stand.own.origin.alt == pytest.approx(ALT, abs=0.3)
    assert stand.own.is_origin_new
    assert stand.texts == ["EKF3 IMU0 origin set", "EKF3 IMU0 is using GPS"]


def test_an_origin_that_is_given_first_stays():
    stand = Stand()
    assert stand.own.set_origin(LAT, LON + 1e-5, 400.0)
    stand.run(12.0)
    assert not stand.own.set_origin(LAT, LON, ALT)
    assert stand.own.origin.lon == LON + 1e-5
    # Its receiver is then as far off as that
    assert stand.own.pos_n[1] == pytest.approx(-1e-5 * 6378100 * math.cos(LAT), abs=0.3)


def test_on_its_own_sensors_its_height_is_the_barometers_whatever_the_receiver_says():
    stand = Stand().run(12.0)
    stand.height = ALT - 4.0
    stand.run(10.0)
    assert abs(stand.own.pos_n[2]) < 0.1
    stand.alt += 3.0
    stand.run(30.0)
    assert stand.own.pos_n[2] == pytest.approx(-3.0, abs=0.6)


def test_a_switch_sets_place_and_height_to_what_odometry_says():
    stand = Stand().run(12.0, at(6.0, -2.0, 4.0))
    assert abs(stand.own.pos_n).max() < 0.2
    stand.own.select(2)
    stand.run(1.0, at(6.0, -2.0, 4.0))
    assert stand.own.pos_n == pytest.approx([6.0, -2.0, 4.0], abs=0.05)
    assert stand.own.shift_n == pytest.approx([6.0, -2.0, 4.0], abs=0.3)
    stand.run(2.0, at(6.0, -2.0, 4.0))
    # And back: at once to the receiver, while the barometer took the height over as it was
    stand.own.select(1)
    stand.run(1.0, at(6.0, -2.0, 4.0))
    assert stand.own.pos_n == pytest.approx([0.0, 0.0, 4.0], abs=0.2)


def test_with_its_default_options_it_fuses_the_velocities_of_odometry_on_any_set():
    moving = {"vel": (1.0, 0.0, 0.0)}
    apart = Stand(EK3_SRC_OPTIONS=0.0).run(20.0, lambda t: moving)
    assert apart.own.vel_n[0] == pytest.approx(0.0, abs=0.05)
    both = Stand(EK3_SRC_OPTIONS=1.0).run(20.0, lambda t: moving)
    assert both.own.vel_n[0] > 0.2


def test_without_any_aid_for_fifteen_seconds_it_stops_aiding():
    stand = Stand().run(12.0, at(0.0, 0.0, 0.0))
    stand.own.select(2)
    stand.run(5.0, at(0.0, 0.0, 0.0))
    assert stand.own.is_aided
    stand.texts.clear()
    stand.run(14.5)
    assert stand.own.is_aided
    stand.run(1.0)
    assert stand.texts == ["EKF3 IMU0 stopped aiding"]
    stand.run(0.5, at(1.0, 2.0, 0.5))
    said = stand.texts[1:]
    assert said == [
        "EKF3 IMU0 is using external nav data",
        "EKF3 IMU0 initial pos NED = 1.0,2.0,0.5 (m)",
    ]


def test_a_second_source_by_turns_is_taken_by_its_counter_each_time():
    stand = Stand().run(12.0, at(0.0, 0.0, 0.0))
    stand.own.select(2)
    stand.run(1.0, at(0.0, 0.0, 0.0))
    turns = iter(range(10**6))

    def both(t):
        return at(2.8, 0.0, 0.0, counter=0)(t) if next(turns) % 2 else at(0.0, 0.0, 0.0)(t)

    stand.run(1.0, both)
    resets = [text for _, text in stand.own.events if text == "reset by the counter"]
    assert len(resets) > 20


def test_what_is_older_than_its_horizon_counts_as_of_the_horizon():
    stand = Stand().run(12.0, at(0.0, 0.0, 0.0))
    stand.own.select(2)
    stand.run(1.0, at(0.0, 0.0, 0.0))
    stand.run(2.0, at(3.0, 0.0, 0.0, counter=2), late=-0.5)
    assert stand.own.pos_n[0] == pytest.approx(3.0, abs=0.05)


def test_in_the_air_the_origins_altitude_is_that_of_its_start():
    stand = Stand()
    stand.has_fix = False
    stand.run(4.0)
    stand.alt += 10.0
    stand.run(30.0)
    stand.has_fix, stand.height = True, ALT + 10.0
    stand.run(11.0)
    assert stand.own.origin.alt == pytest.approx(ALT, abs=1.0)


def test_it_moves_to_a_position_from_outside_only_while_nothing_else_shows_one():
    east = 20.0 / (6378100 * math.cos(LAT))
    stand = Stand().run(5.0)
    assert not stand.own.take_position(LAT, LON + east, 1.0)  # it has no origin
    stand.run(8.0)
    assert not stand.own.take_position(LAT, LON + east, 1.0)  # its receiver is good
    stand.has_fix = False
    stand.run(0.8)
    assert not stand.own.take_position(LAT, LON + east, 1.0)
    stand.run(0.7)
    for std, sigma in ((1.0, 1.0), (0.1, 0.5), (math.nan, 0.5)):
        assert stand.own.take_position(LAT, LON + east, std)
        assert stand.own.pos_n[:2] == pytest.approx([0.0, 20.0], abs=0.1)
        assert np.diag(stand.own.P)[6:8] == pytest.approx([sigma**2] * 2)
    # Without any aid it stops, and takes none
    stand.run(15.0)
    assert not stand.own.is_aided
    assert not stand.own.take_position(LAT, LON, 1.0)
