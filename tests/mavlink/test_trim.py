"""ArduPilot's board trim, from its parameters to the samples."""

import numpy as np
import pytest

from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.nav.measurements import ImuSample, MagSample
from ekf_companion.nav.mounting import trim_matrix
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, Voice, sent

ROLL, PITCH = 0.03, -0.05
G = 9.81


def of_board(vehicle_v):
    """Return a vector of the vehicle as the board measures it."""
    return np.asarray(vehicle_v) @ trim_matrix(ROLL, PITCH)


def sample(autopilot, t_us):
    accel, mag = of_board([0.0, 0.0, -G]), of_board([0.2, 0.0, 0.4])
    names = ("xacc", "yacc", "zacc", "xmag", "ymag", "zmag")
    return autopilot.say(
        "HIGHRES_IMU",
        time_usec=t_us,
        fields_updated=0x1FF,
        xgyro=1e-4 * (t_us % 7),
        **dict(zip(names, (*accel, *mag), strict=True)),
    )


def said(autopilot, name, value):
    return autopilot.say("PARAM_VALUE", param_id=name.encode(), param_type=9, param_value=value)


def flown(answers, family=ARDUPILOT, seconds=6):
    """Return the measurements of a second of samples at the end, and the session."""
    session, autopilot = Session(SessionOptions(rates={})), Voice(family=family)
    found = []
    for now_ns in range(0, seconds * SECOND, 10 * MS):
        data = autopilot.heartbeat() if now_ns % SECOND == 0 else b""
        session.tick(now_ns)
        for request in sent(session, "PARAM_REQUEST_READ"):
            name = request.param_id.decode()
            if name in answers and now_ns >= answers[name][0]:
                data += said(autopilot, name, answers[name][1])
        for name, (when, value) in answers.items():
            if now_ns == when and when > 2 * SECOND:
                data += said(autopilot, name, value)  # to somebody else's request
        measured = session.receive(data + sample(autopilot, 1_000_000 + now_ns // 1000), now_ns)
        if now_ns >= (seconds - 1) * SECOND:
            found += measured
    return found, session


ANSWERS = {"AHRS_TRIM_X": (0, ROLL), "AHRS_TRIM_Y": (0, PITCH)}


def test_samples_and_field_come_in_the_axes_of_the_vehicle():
    found, session = flown(ANSWERS)
    for one in found:
        if type(one) is ImuSample:
            force = (one.accel_x, one.accel_y, one.accel_z)
            assert force == pytest.approx((0.0, 0.0, -G), abs=1e-5)  # float32 on the wire
        if type(one) is MagSample:
            assert (one.mag_x, one.mag_y, one.mag_z) == pytest.approx((0.2, 0.0, 0.4), abs=1e-6)
    assert sum(type(one) is ImuSample for one in found) == 100
    notes = [event.text for event in session.events() if type(event).__name__ == "Noted"]
    assert notes == [
        "The board is mounted at roll 1.7 and pitch -2.9 deg (AHRS_TRIM): its samples are turned "
        "into the axes of the vehicle"
    ]


@pytest.mark.parametrize(
    ("answers", "family"),
    [
        ({}, ARDUPILOT),
        ({"AHRS_TRIM_X": (0, ROLL), "AHRS_TRIM_Y": (0, PITCH)}, PX4),
        ({"AHRS_TRIM_X": (0, float("nan")), "AHRS_TRIM_Y": (0, 40.0)}, ARDUPILOT),
        ({"AHRS_TRIM_X": (4 * SECOND, ROLL), "AHRS_TRIM_Y": (4 * SECOND, PITCH)}, ARDUPILOT),
    ],
    ids=["unanswered", "px4", "nonsense", "late"],
)
def test_without_an_answer_in_time_they_stay_as_they_are(answers, family):
    found, session = flown(answers, family)
    force = [(one.accel_x, one.accel_y, one.accel_z) for one in found if type(one) is ImuSample]
    assert np.allclose(force, of_board([0.0, 0.0, -G]), atol=1e-5)
    late = [
        e.text for e in session.events() if type(e).__name__ == "Noted" and "too late" in e.text
    ]
    assert bool(late) == (answers.get("AHRS_TRIM_X", (0, 0))[0] > 0)


def test_only_an_ardupilot_is_asked_and_three_times():
    for family, count in ((ARDUPILOT, 6), (PX4, 0)):
        session, autopilot = Session(SessionOptions(rates={})), Voice(family=family)
        asked = []
        for now_ns in range(0, 10 * SECOND, 100 * MS):
            if now_ns % SECOND == 0:
                session.receive(autopilot.heartbeat(), now_ns)
            session.tick(now_ns)
            asked += [r for r in sent(session, "PARAM_REQUEST_READ") if b"TRIM" in r.param_id]
        assert len(asked) == count
