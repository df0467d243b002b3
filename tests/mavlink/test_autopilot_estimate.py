"""The autopilot's own estimate: what of it is believed, and for how long."""

import math

import pytest

from ekf_companion.mavlink.autopilot_estimate import AutopilotEstimate
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Splitter

MS = 1_000_000
PLACE = {"lat": 470_000_000, "lon": 80_000_000, "alt": 400_000}


@pytest.fixture
def estimate():
    return AutopilotEstimate()


def say(estimate, name, now_ns=0, **fields):
    (frame,) = Splitter().feed(Sender(1, 1).message(name, **fields))
    estimate.keep(frame, now_ns)


def test_a_reboot_makes_it_forgotten(estimate):
    say(estimate, "ATTITUDE", time_boot_ms=1, yaw=0.5)
    assert estimate.attitude(0).euler[2] == 0.5
    estimate.begin(PeerFound(1, 1, Family.PX4))
    assert estimate.attitude(0) is None


@pytest.mark.parametrize("fields", [{"roll": math.nan}, {"yaw": math.inf}])
def test_what_is_no_number_is_no_attitude(estimate, fields):
    say(estimate, "ATTITUDE", time_boot_ms=1, **fields)
    assert estimate.attitude(0) is None


def test_a_quaternion_that_is_none_is_no_attitude(estimate):
    say(estimate, "ATTITUDE_QUATERNION", time_boot_ms=1)
    assert estimate.attitude(0) is None


def test_of_two_attitudes_the_newer_counts(estimate):
    say(estimate, "ATTITUDE_QUATERNION", time_boot_ms=1, q1=1.0)
    say(estimate, "ATTITUDE", 20 * MS, time_boot_ms=2, yaw=0.5)
    found = estimate.attitude(120 * MS)
    assert (found.message, found.age) == ("ATTITUDE", pytest.approx(0.1))


def test_no_place_is_no_position(estimate):
    say(estimate, "GLOBAL_POSITION_INT", time_boot_ms=1, alt=400_000)
    assert estimate.position(0) is None


def test_a_local_position_counts_where_the_global_one_comes_no_more(estimate):
    say(estimate, "GLOBAL_POSITION_INT", time_boot_ms=1, **PLACE)
    origin = {"latitude": 470_000_000, "longitude": 80_000_000, "altitude": 400_000}
    say(estimate, "GPS_GLOBAL_ORIGIN", **origin)
    say(estimate, "LOCAL_POSITION_NED", 900 * MS, time_boot_ms=2, z=-5.0)
    assert estimate.position(1_000 * MS).message == "GLOBAL_POSITION_INT"
    later = estimate.position(1_100 * MS)
    assert (later.message, later.alt) == ("LOCAL_POSITION_NED", 405.0)


def test_a_local_position_without_an_origin_is_none(estimate):
    say(estimate, "LOCAL_POSITION_NED", time_boot_ms=2, z=-5.0)
    assert estimate.position(0) is None


def test_an_origin_that_has_moved_counts_though_its_latitude_is_the_same(estimate):
    for altitude in (400_000, 500_000):
        origin = {"latitude": 470_000_000, "longitude": 80_000_000, "altitude": altitude}
        say(estimate, "GPS_GLOBAL_ORIGIN", **origin)
    say(estimate, "LOCAL_POSITION_NED", time_boot_ms=2, z=-5.0)
    assert estimate.position(0).alt == 505.0


def test_a_stated_sigma_counts_for_three_seconds(estimate):
    say(estimate, "ESTIMATOR_STATUS", time_usec=1, pos_horiz_accuracy=2.0, pos_vert_accuracy=-1.0)
    say(estimate, "GLOBAL_POSITION_INT", time_boot_ms=1, **PLACE)
    found = estimate.position(2_900 * MS)
    assert found.std_horizontal == 2.0
    assert math.isnan(found.std_vertical)
    assert math.isnan(estimate.position(3_100 * MS).std_horizontal)
