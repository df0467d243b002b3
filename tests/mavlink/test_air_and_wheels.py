"""Airspeed, wheels, and how the vehicle moves: which messages count, and which do not."""

import math

import pytest

from ekf_companion.mavlink.decode import Family
from ekf_companion.nav.measurements import (
    AirspeedSample,
    VehicleState,
    VehicleType,
    WheelSample,
)
from tests.mavlink.test_decode import Peer, only

SENSOR = 16
"""MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE."""
UNHEALTHY, USING = 1, 2


def begun(family=Family.ARDUPILOT):
    peer = Peer(family)
    peer.highres(1_000_000)
    return peer


def speeds(said):
    return [one.airspeed for one in only(AirspeedSample, said)]


def test_an_airspeed_counts_at_the_newest_inertial_stamp_and_is_indicated():
    (one,) = begun().say("airspeed", airspeed=21.5, flags=USING)
    assert one == AirspeedSample(t_ns=1_000_000_000, airspeed=21.5, is_indicated=True)
    assert Peer().say("airspeed", airspeed=21.5, flags=USING) == []


def test_an_unhealthy_sensor_is_refused_and_counted():
    peer = begun()
    assert peer.say("airspeed", airspeed=21.5, flags=USING | UNHEALTHY) == []
    assert peer.refused == {"airspeed: its sensor is unhealthy": 1}


def test_of_several_sensors_the_one_that_the_autopilot_uses_counts():
    peer = begun()
    found = []
    for t_ms in range(1000, 5000, 100):
        peer.highres(t_ms * 1000)
        found += speeds(peer.say("airspeed", id=0, airspeed=10.0))
        found += speeds(peer.say("airspeed", id=1, airspeed=20.0, flags=USING))
    assert set(found) == {20.0}


@pytest.mark.parametrize("lacking", ["present", "enabled", "health", None])
def test_vfr_hud_counts_only_where_there_is_a_sensor_that_is_used_and_healthy(lacking):
    """Without one it is the autopilot's own estimate, made of the fixes."""
    peer = begun()
    bits = {
        f"onboard_control_sensors_{name}": 0 if name == lacking else SENSOR
        for name in ("present", "enabled", "health")
    }
    found = []
    for t_ms in range(1000, 6000, 100):
        peer.highres(t_ms * 1000)
        peer.say("sys_status", **bits)
        found += speeds(peer.say("vfr_hud", airspeed=21.5, heading=-1))
    assert set(found) == (set() if lacking else {21.5})


def test_beside_airspeed_vfr_hud_says_nothing_new():
    peer = begun()
    bits = dict.fromkeys((f"onboard_control_sensors_{x}" for x in ("present", "enabled")), SENSOR)
    found = []
    for t_ms in range(1000, 6000, 100):
        peer.highres(t_ms * 1000)
        peer.say("sys_status", onboard_control_sensors_health=SENSOR, **bits)
        found += speeds(peer.say("airspeed", airspeed=20.0, flags=USING))
        found += speeds(peer.say("vfr_hud", airspeed=21.5, heading=-1))
    assert set(found) == {20.0}


def wheels(peer, t_us, *distances, count=None):
    whole = [*distances, *[0.0] * (16 - len(distances))]
    count = len(distances) if count is None else count
    return only(
        WheelSample, peer.say("wheel_distance", time_usec=t_us, count=count, distance=whole)
    )


def test_what_the_wheels_gain_is_a_speed_halfway():
    peer = begun()
    assert wheels(peer, 1_000_000, 5.0, 6.0) == []
    (one,) = wheels(peer, 1_100_000, 5.2, 6.4)
    assert one.t_ns == 1_050_000_000
    assert one.speed == pytest.approx(3.0)
    (back,) = wheels(peer, 1_200_000, 5.0, 6.2)
    assert back.speed == pytest.approx(-2.0)


def test_over_a_pause_or_another_number_of_wheels_there_is_no_speed():
    peer = begun()
    wheels(peer, 1_000_000, 5.0, 6.0)
    for t_ms in range(1000, 2500, 100):
        peer.highres(t_ms * 1000)
    assert wheels(peer, 2_500_000, 50.0, 60.0) == []
    assert wheels(peer, 2_600_000, 50.0) == []
    assert wheels(peer, 2_650_000, count=0) == []
    assert wheels(peer, 2_660_000, count=17) == []


TYPES = [
    (1, 0, VehicleType.FIXED_WING),
    (2, 0, VehicleType.ROTARY),
    (4, 0, VehicleType.ROTARY),
    (10, 0, VehicleType.GROUND),
    (11, 0, VehicleType.OTHER),
    (0, 0, VehicleType.UNKNOWN),
    (22, 0, VehicleType.OTHER),
    (22, 1, VehicleType.OTHER),
    (22, 3, VehicleType.ROTARY),
    (22, 4, VehicleType.FIXED_WING),
]


@pytest.mark.parametrize(("mav_type", "vtol_state", "expected"), TYPES)
def test_how_a_vehicle_moves_is_by_its_type_and_of_one_that_hovers_by_its_state(
    mav_type, vtol_state, expected
):
    peer = begun()
    peer.say("extended_sys_state", vtol_state=vtol_state, landed_state=2)
    (state,) = peer.say("heartbeat", type=mav_type, autopilot=3)
    assert state.type == expected
    assert state.row()[2][4] == float(expected)


def test_a_transition_is_told_at_once():
    peer = begun()
    peer.say("heartbeat", type=22, autopilot=3)
    peer.say("extended_sys_state", vtol_state=3, landed_state=2)
    assert peer.say("extended_sys_state", vtol_state=3, landed_state=2) == []
    (state,) = only(VehicleState, peer.say("extended_sys_state", vtol_state=4, landed_state=2))
    assert state.type is VehicleType.FIXED_WING
    assert not math.isnan(state.row()[2][0])
