"""The origin that a PX4 flying on our estimate alone is given."""

import pytest

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.outbox import Message
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, met, sent

OURS = Message("GPS_GLOBAL_ORIGIN", encode.gps_global_origin(0.8, 0.15, 489.4, t_ns=SECOND))
ON_OURS = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0}


def given(parameters, family=PX4, shown=None, shown_at=0, seconds=16, is_known=True):
    """Return the origins that an autopilot is given, each with its time in seconds.

    ``shown`` is the message by which it shows, once, that it has one.
    """
    session, autopilot = met(family, guard=GuardOptions())
    origins = []
    for now_ns in range(0, seconds * SECOND, 50 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
            if is_known:
                session.publish(OURS, now_ns)
            if shown is not None and now_ns == shown_at * SECOND:
                session.receive(autopilot.say(shown), now_ns)
        session.tick(now_ns)
        for message in sent(session):
            name = type(message).__name__
            if name == "SET_GPS_GLOBAL_ORIGIN":
                origins.append((now_ns / SECOND, message))
            if name == "PARAM_REQUEST_READ":
                asked = message.param_id.decode()
                value = parameters.get(asked, 0)
                said = autopilot.say(
                    "PARAM_VALUE", param_id=asked.encode(), param_value=value * 1.0, param_type=9
                )
                session.receive(said, now_ns)
    return origins


def test_a_px4_on_our_estimate_that_has_no_origin_is_given_ours_every_five_seconds():
    origins = given(ON_OURS)
    assert [t for t, _ in origins] == pytest.approx([5.0, 10.0, 15.0], abs=0.2)
    m = origins[0][1]
    assert m.target_system == 1
    assert m.latitude == pytest.approx(458_366_236, abs=2)


def test_the_origin_has_no_altitude_for_px4_would_take_it_off_its_height_at_a_moved_counter():
    assert given(ON_OURS)[0][1].altitude == 0


@pytest.mark.parametrize("shown", ["GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT"])
def test_one_that_has_shown_an_origin_once_is_given_none_again_for_each_is_a_reset(shown):
    assert given(ON_OURS, shown=shown) == []
    assert [t for t, _ in given(ON_OURS, shown=shown, shown_at=6)] == pytest.approx([5.0], abs=0.2)


@pytest.mark.parametrize(
    ("parameters", "family", "is_known"),
    [
        ({"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7}, PX4, True),
        ({"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7}, PX4, True),
        (ON_OURS, PX4, False),
        ({"VISO_TYPE": 1, **{f"EK3_SRC1_{p}": 6 for p in ("POSXY", "YAW")}}, ARDUPILOT, True),
    ],
)
def test_no_other_is_given_one(parameters, family, is_known):
    assert given(parameters, family, is_known=is_known) == []
