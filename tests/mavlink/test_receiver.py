"""The receiver's delay, from the autopilot's parameters to what the filter begins with."""

import struct

import pytest

from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.nav.measurements import VehicleState
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, Voice, sent

INT32, REAL32 = 6, 9


def bytewise(number: int) -> float:
    """Return an integer as PX4 sends it: its bytes where a float's would be."""
    return struct.unpack("<f", struct.pack("<i", number))[0]


def flown(family, answers, seconds=8):
    """Return the delay told at each state of the vehicle, what was asked for, and the session."""
    session, autopilot = Session(SessionOptions(rates={})), Voice(family=family)
    told, asked = [], []
    for now_ns in range(0, seconds * SECOND, 50 * MS):
        data = autopilot.heartbeat() if now_ns % SECOND == 0 else b""
        data += autopilot.say("HIGHRES_IMU", time_usec=10**6 + now_ns // 1000, xgyro=1e-9 * now_ns)
        session.tick(now_ns)
        for request in sent(session, "PARAM_REQUEST_READ"):
            name = request.param_id.decode()
            asked.append(name)
            if name in answers:
                kind, value = answers[name]
                data += autopilot.say(
                    "PARAM_VALUE", param_id=name.encode(), param_type=kind, param_value=value
                )
        states = [m for m in session.receive(data, now_ns) if type(m) is VehicleState]
        told += [state.gnss_delay for state in states]
    return told, asked, session


@pytest.mark.parametrize(
    ("family", "answers", "delay"),
    [
        (PX4, {"EKF2_GPS_DELAY": (REAL32, 0.0)}, 0.0),
        (PX4, {"EKF2_GPS_DELAY": (REAL32, 110.0)}, 0.11),
        (PX4, {"SENS_GPS0_DELAY": (INT32, bytewise(80))}, 0.08),
        (ARDUPILOT, {"GPS1_DELAY_MS": (4, 200.0)}, 0.2),
        (ARDUPILOT, {"GPS_DELAY_MS": (4, 200.0)}, 0.2),
        (ARDUPILOT, {"GPS1_DELAY_MS": (4, 0.0)}, None),
        (PX4, {"GPS1_DELAY_MS": (4, 200.0)}, None),
        (PX4, {"EKF2_GPS_DELAY": (REAL32, float("nan"))}, None),
        (PX4, {"EKF2_GPS_DELAY": (REAL32, -5.0)}, None),
        (PX4, {"EKF2_GPS_DELAY": (REAL32, 5000.0)}, None),
        (PX4, {}, None),
    ],
)
def test_what_the_autopilot_says_of_the_receiver_comes_with_the_state_of_the_vehicle(
    family, answers, delay
):
    told, _, _ = flown(family, answers)
    assert told[-1] == (delay if delay is None else pytest.approx(delay, abs=1e-9))


def test_it_is_asked_until_it_answers_and_three_times_at_most():
    names = {"SENS_GPS0_DELAY", "EKF2_GPS_DELAY"}
    _, asked, _ = flown(PX4, {"EKF2_GPS_DELAY": (REAL32, 60.0)})
    assert [name for name in asked if name in names] == ["SENS_GPS0_DELAY", "EKF2_GPS_DELAY"]
    _, asked, _ = flown(PX4, {})
    assert len([name for name in asked if name in names]) == 6


def test_a_change_counts_and_another_autopilot_has_said_nothing():
    _, _, session = flown(PX4, {"EKF2_GPS_DELAY": (REAL32, 60.0)})
    autopilot = Voice(family=PX4)
    changed = autopilot.say(
        "PARAM_VALUE", param_id=b"EKF2_GPS_DELAY", param_type=REAL32, param_value=90.0
    )
    (state,) = session.receive(changed, 8 * SECOND)
    assert state.gnss_delay == pytest.approx(0.09)
    other = Voice(family=ARDUPILOT)
    for k in range(9, 20):
        session.receive(other.heartbeat(), k * SECOND)
        session.tick(k * SECOND)
    assert session.decoder.vehicle.gnss_delay is None
