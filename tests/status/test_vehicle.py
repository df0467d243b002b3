"""Where the vehicle is, by our estimate and the autopilot's, and what aids the estimate."""

import json
import math

import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.status.judge import to_json
from sim_autopilot.config import AirspeedConfig, FlowConfig, RangeFinderConfig, WheelConfig
from sim_autopilot.personality import Kind
from tests.status.test_observer import MS, Watched

AUTOPILOT = Sender(1, 1)


@pytest.fixture(scope="module")
def flown():
    return Watched().fly(8.0)


@pytest.fixture(scope="module")
def vehicle(flown):
    return flown.snapshot().vehicle


def test_the_status_says_where_the_vehicle_is_and_how_sure_that_is(flown, vehicle):
    values = flown.companion.pipeline.values()
    assert (vehicle.lat_deg, vehicle.lon_deg, vehicle.alt_m) == tuple(values[:3])
    assert vehicle.vel_ned_m_s == tuple(values[6:9])
    roll, pitch, yaw = map(math.degrees, values[13:16])
    assert (vehicle.roll_deg, vehicle.pitch_deg) == (roll, pitch)
    assert vehicle.heading_deg == yaw % 360.0
    sigma = vehicle.sigma
    assert (sigma.north_m, sigma.east_m, sigma.alt_m) == tuple(values[22:25])
    assert sigma.horizontal_m == pytest.approx(flown.snapshot().estimator.std_horizontal)
    assert sigma.heading_deg == math.degrees(values[30])


def test_the_autopilot_s_own_estimate_stands_beside_it(vehicle):
    other = vehicle.autopilot
    assert other.lat_deg == pytest.approx(vehicle.lat_deg, abs=5e-5)
    assert other.heading_deg == pytest.approx(vehicle.heading_deg, abs=10.0)
    assert (other.attitude_message, other.position_message) == ("ATTITUDE", "GLOBAL_POSITION_INT")
    assert 0.0 <= other.attitude_age_s <= other.age_s < 0.3


def test_json_has_what_the_page_reads(flown):
    data = json.loads(to_json(flown.snapshot()))
    vehicle = data["vehicle"]
    for key in ("lat_deg", "lon_deg", "alt_m", "roll_deg", "pitch_deg", "heading_deg"):
        assert isinstance(vehicle[key], float)
        assert isinstance(vehicle["autopilot"][key], float)
    assert len(vehicle["vel_ned_m_s"]) == 3
    assert {"ready", "sentence", "reasons"} <= set(data["preflight"])
    assert data["preflight"]["reasons"][0].startswith("armed already: ")


AIRSPEED, WHEEL = AirspeedConfig(fitted=True), WheelConfig(fitted=True)


def test_before_anything_is_heard_nothing_is_known():
    data = json.loads(to_json(Watched().snapshot()))
    assert data["vehicle"]["lat_deg"] is None
    assert data["vehicle"]["vel_ned_m_s"] == [None, None, None]
    assert data["vehicle"]["autopilot"] is None
    assert data["preflight"]["ready"] is False


ABSENT = (
    *("range_finder", "airspeed", "wheel", "optical_flow", "anchor_range"),
    *("visual_odometry", "visual_velocity"),
)
"""Sensors that this vehicle does not have."""


def test_each_aid_names_its_source_and_since_when_it_is_used(flown, vehicle):
    sources = {name: aid.source for name, aid in vehicle.aids.items()}
    assert sources == {
        "position": "GPS_RAW_INT",
        "height": "GPS_RAW_INT",
        "velocity": "GPS_RAW_INT",
        "heading": "HIGHRES_IMU, magnetometer",
        "baro": "HIGHRES_IMU, barometer",
        "rest": "the inertial samples",
        **dict.fromkeys(ABSENT, ""),
    }
    assert {name: aid.state for name, aid in vehicle.aids.items()} == {
        **dict.fromkeys(sources, "used"),
        **dict.fromkeys(ABSENT, "none"),
    }
    assert 5.0 < vehicle.aids["position"].since_s < 8.0


def test_a_range_finder_is_asked_for_and_used():
    watched = Watched().fly(8.0, range_finder=RangeFinderConfig(fitted=True))
    aid = watched.snapshot().vehicle.aids["range_finder"]
    assert (aid.source, aid.state) == ("DISTANCE_SENSOR, range finder", "used")


@pytest.mark.parametrize(
    ("name", "kind", "flight", "fitted", "source"),
    [
        ("airspeed", Kind.PX4, "loiter", AIRSPEED, "VFR_HUD, airspeed sensor"),
        ("airspeed", Kind.ARDUPILOT, "loiter", AIRSPEED, "AIRSPEED, airspeed sensor"),
        ("wheel", Kind.ARDUPILOT, "drive", WHEEL, "WHEEL_DISTANCE, wheel encoder"),
    ],
)
def test_airspeed_and_wheels_are_asked_for_and_used_by_the_vehicle_that_has_them(
    name, kind, flight, fitted, source
):
    watched = Watched().fly(22.0, flight, kind, **{name: fitted})
    aid = watched.snapshot().vehicle.aids[name]
    assert (aid.source, aid.state) == (source, "used")
    hovering = Watched().fly(12.0, kind=kind, **{name: fitted}).snapshot().vehicle.aids[name]
    assert hovering.state == "none"


def test_optical_flow_is_asked_for_and_used_once_the_ground_is_below():
    fitted = {"flow": FlowConfig(fitted=True), "range_finder": RangeFinderConfig(fitted=True)}
    watched = Watched().fly(20.0, **fitted)
    aid = watched.snapshot().vehicle.aids["optical_flow"]
    words = "OPTICAL_FLOW_RAD or OPTICAL_FLOW, optical flow sensor"
    assert (aid.source, aid.state) == (words, "used")
    assert 5.0 < aid.since_s < 19.0
    assert watched.companion.session.decoder.refused["optical flow: nothing seen"] > 0


def test_an_aid_that_comes_no_more_is_lost():
    watched = Watched().fly(8.0)
    for _ in range(40):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    aid = watched.snapshot().vehicle.aids["position"]
    assert aid.state == "lost"
    assert math.isnan(aid.since_s)
    assert aid.used_s == pytest.approx(4.0, abs=0.6)


def test_a_message_that_is_repeated_with_its_stamp_grows_old():
    """As by a router that sends the last one again and again."""
    watched = Watched().fly(3.0)
    for _ in range(4):
        watched.now_ns += 500 * MS
        watched.hear(AUTOPILOT.message("ATTITUDE", time_boot_ms=20_000, roll=0.5))
    assert watched.snapshot().vehicle.autopilot.attitude_age_s == pytest.approx(1.5)


def test_a_quaternion_is_an_attitude_too():
    watched = Watched().fly(2.0)
    half = math.radians(40.0) / 2.0
    fields = {"q1": math.cos(half), "q4": math.sin(half)}
    watched.now_ns += 500 * MS
    watched.hear(AUTOPILOT.message("ATTITUDE_QUATERNION", time_boot_ms=20_000, **fields))
    other = watched.snapshot().vehicle.autopilot
    assert other.attitude_message == "ATTITUDE_QUATERNION"
    assert other.heading_deg == pytest.approx(40.0, abs=1e-4)


def test_a_local_position_counts_from_the_origin_that_was_told():
    watched = Watched().fly(2.0)
    watched.now_ns += 1_500 * MS
    origin = {"latitude": 470_000_000, "longitude": 80_000_000, "altitude": 400_000}
    watched.hear(
        AUTOPILOT.message("GPS_GLOBAL_ORIGIN", **origin),
        AUTOPILOT.message("LOCAL_POSITION_NED", time_boot_ms=20_000, x=111.0, y=0.0, z=-30.0),
    )
    other = watched.snapshot().vehicle.autopilot
    assert other.position_message == "LOCAL_POSITION_NED"
    assert other.lat_deg == pytest.approx(47.000998, abs=2e-5)
    assert other.alt_m == pytest.approx(430.0)


def test_a_sigma_that_the_autopilot_states_is_taken():
    watched = Watched().fly(2.0)
    assert math.isnan(watched.snapshot().vehicle.autopilot.horizontal_std_m)
    accuracy = {"pos_horiz_accuracy": 2.5, "pos_vert_accuracy": 4.0}
    watched.hear(AUTOPILOT.message("ESTIMATOR_STATUS", time_usec=2_000_000, **accuracy))
    other = watched.snapshot().vehicle.autopilot
    assert (other.horizontal_std_m, other.vertical_std_m) == (2.5, 4.0)
