"""PX4's filter as a follower: the offset that it keeps, and an origin that comes too late."""

import math

import numpy as np
import pytest

from sim_autopilot.ekf2 import Ekf2
from sim_autopilot.flight import Fix
from tests.sim.test_follower import message

LAT, LON, ALT = math.radians(47.4), math.radians(8.5), 488.0
ALONE = {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0}
BESIDE = {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 7.0}
DT = 0.008


def run(own, begin, seconds, given=None, counter=1):
    for n in range(round(begin / DT), round((begin + seconds) / DT)):
        t = n * DT
        own.sample(t, np.zeros(3), np.array([0.0, 0.0, -9.80665]))
        if n % 5 == 0:
            own.baro(t, 30.0)
            own.heading(t, 0.0, 0.05)
        if n % 25 == 0:
            fix = Fix(0, LAT, LON, ALT, (0.0, 0.0, 0.0), math.nan)
            own.receiver(t - 0.1, fix, (0.5, 0.7, 0.1))
        if n % 4 == 0 and given is not None:
            own.odometry(message(t, pos_n=given, counter=counter), t)


def test_on_odometry_alone_it_is_where_that_says_and_has_no_place():
    own = Ekf2(ALONE)
    run(own, 0.0, 12.0, (6.0, -2.0, -4.0))
    assert own.pos_n == pytest.approx([6.0, -2.0, -4.0], abs=0.05)
    assert own.origin is None


def test_beside_its_receiver_it_keeps_the_offset():
    own = Ekf2(BESIDE)
    run(own, 0.0, 12.0)
    run(own, 12.0, 3.0, (60.0, 0.0, 0.0))
    assert own.pos_n[0] == pytest.approx(0.0, abs=0.2)
    run(own, 15.0, 2.0, (20.0, 0.0, 0.0), counter=2)
    assert own.pos_n[0] == pytest.approx(0.0, abs=0.2)
    assert not own.shift_n.any()


def test_an_origin_on_the_ground_before_odometry_is_its_place():
    own = Ekf2(ALONE)
    run(own, 0.0, 1.0)
    assert own.set_origin(LAT, LON, ALT)
    run(own, 1.0, 2.0, (10.0, 0.0, 0.0))
    assert own.place(own.motion())[0] == pytest.approx(LAT + 10.0 / 6371000.0, abs=1e-8)
    assert own.misplaced == 0


def test_an_origin_while_it_fuses_odometry_is_5300_km_off():
    own = Ekf2(ALONE)
    run(own, 0.0, 2.0, (10.0, 0.0, 0.0))
    own.set_origin(LAT, LON, ALT)
    assert own.misplaced == 1
    assert abs(own.place(own.motion())[0] - LAT) > 0.8
