"""The origin that a PX4 flying on our estimate alone is given."""

import itertools

import pytest

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.event import HoldChanged
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.outbox import Message
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, met, sent

OURS = Message("GPS_GLOBAL_ORIGIN", encode.gps_global_origin(0.8, 0.15, 489.4, t_ns=SECOND))
ON_OURS = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0}


PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
FROM_START = {"VISO_TYPE": 1, **{f"EK3_SRC1_{part}": 6 for part in PARTS}}
BY_CHOICE = {
    "VISO_TYPE": 1,
    "EK3_SRC1_POSXY": 3,
    "EK3_SRC1_VELXY": 3,
    "EK3_SRC1_POSZ": 1,
    "EK3_SRC1_VELZ": 3,
    "EK3_SRC1_YAW": 1,
    **{f"EK3_SRC2_{part}": 6 for part in PARTS},
}


ODOMETRY = Message("ODOMETRY", bytes(LAYOUTS[IDS["ODOMETRY"]].size), is_replaceable=True)


PLACES = {
    "GPS_GLOBAL_ORIGIN": {"latitude": 458366240, "longitude": 85943670, "altitude": 489_000},
    "GLOBAL_POSITION_INT": {"time_boot_ms": 1, "lat": 458366240, "lon": 85943670, "alt": 489_000},
}


def flown(parameters, family=PX4, shown=None, shown_at=0.0, seconds=20, is_known=True, **flying):
    """Return times, s, at which an autopilot gets an origin, the origins, and those of ODOMETRY.

    X
    """
    session, autopilot = met(family, guard=GuardOptions())
    origins, odometry = [], []
    for now_ns in range(0, seconds * SECOND, 50 * MS):
        values = parameters(now_ns / SECOND) if callable(parameters) else parameters
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(**flying), now_ns)
        if shown is not None and now_ns == round(shown_at * SECOND):
            session.receive(autopilot.say(shown, **PLACES[shown]), now_ns)
        session.tick(now_ns)
        if is_known:
            session.publish(OURS, now_ns)
        session.publish(ODOMETRY, now_ns)
        for message in sent(session):
            name = type(message).__name__
            if name == "SET_GPS_GLOBAL_ORIGIN":
                origins.append((now_ns / SECOND, message))
            if name == "ODOMETRY":
                odometry.append(now_ns / SECOND)
            if name == "PARAM_REQUEST_READ":
                asked = message.param_id.decode()
                value = values.get(asked, 0)
                said = autopilot.say(
                    "PARAM_VALUE", param_id=asked.encode(), param_value=value * 1.0, param_type=9
                )
                session.receive(said, now_ns)
    return [t for t, _ in origins], [m for _, m in origins], odometry


def silences(times):
    """Return the pauses between messages that are longer than the usual interval, s."""
    return [(a, b) for a, b in itertools.pairwise(times) if b - a > 0.11]


def test_a_px4_on_our_estimate_that_has_no_origin_is_given_ours_before_any_odometry():
    """PX4 1.18 that got it while it fused was 5300 km off."""
    times, origins, odometry = flown(ON_OURS, seconds=4)
    assert times == pytest.approx([2.0], abs=0.1)
    assert odometry[0] == pytest.approx(2.5, abs=0.1)
    assert silences(odometry) == []
    m = origins[0]
    assert m.target_system == 1
    assert m.latitude == pytest.approx(458_366_236, abs=2)


def test_an_origin_that_it_does_not_show_is_given_three_times_each_when_nothing_is_fused():
    times, _, odometry = flown(ON_OURS, seconds=40)
    assert times == pytest.approx([2.0, 8.0, 14.0], abs=0.2)
    for given, (last, after) in zip(times[1:], silences(odometry), strict=True):
        assert last < given - 0.9
        assert given + 0.4 < after < given + 0.7


def test_one_that_begins_to_fuse_ours_later_gets_it_after_a_second_of_silence():
    def parameters(t):
        return ON_OURS if t > 8.0 else {"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 0}

    times, _, odometry = flown(parameters, seconds=14)
    ((last, after),) = silences(odometry)
    assert 8.0 < last < 10.0
    assert last + 0.9 < times[0] < after - 0.4


def test_the_origin_has_no_altitude_for_px4_would_take_it_off_its_height_at_a_moved_counter():
    assert flown(ON_OURS)[1][0].altitude == 0


@pytest.mark.parametrize("shown", ["GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT"])
def test_one_that_has_shown_an_origin_once_is_given_none_again_for_each_is_a_reset(shown):
    times, _, odometry = flown(ON_OURS, shown=shown)
    assert times == []
    # Where only its position shows that it has one, it is waited for
    assert odometry[0] < 0.3 if shown == "GPS_GLOBAL_ORIGIN" else odometry[0] == 2.0
    times, _, odometry = flown(ON_OURS, shown=shown, shown_at=2.1)
    assert len(times) == 1
    assert odometry[0] == pytest.approx(2.1, abs=0.11)


@pytest.mark.parametrize(("shown", "begin"), [("GPS_GLOBAL_ORIGIN", 0.0), (None, 2.0)])
def test_in_flight_none_is_given_and_its_own_is_waited_for_a_moment(shown, begin):
    times, _, odometry = flown(ON_OURS, base_mode=128, shown=shown)
    assert times == []
    assert odometry[0] == pytest.approx(begin, abs=0.3)
    assert silences(odometry) == []


@pytest.mark.parametrize(
    ("parameters", "family", "is_known"),
    [
        ({"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7}, PX4, True),
        ({"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7}, PX4, True),
        (ON_OURS, PX4, False),
        ({"VISO_TYPE": 0}, ARDUPILOT, True),
        ({**FROM_START, "EK3_SRC1_POSXY": 3, "EK3_SRC1_VELXY": 3}, ARDUPILOT, True),
    ],
)
def test_no_other_is_given_one(parameters, family, is_known):
    times, _, odometry = flown(parameters, family, is_known=is_known)
    assert times == []
    assert silences(odometry) == []


def test_a_px4_that_shows_a_position_is_asked_for_its_origin_until_it_tells_it():
    def asked(shown, told_at, **rates):
        session, autopilot = met(PX4, guard=GuardOptions(), rates=rates)
        times, tries = [], itertools.count()
        for now_ns in range(0, 20 * SECOND, 50 * MS):
            if now_ns % SECOND == 0:
                session.receive(autopilot.heartbeat(), now_ns)
            if shown and now_ns == 10 * SECOND:
                session.receive(autopilot.say(shown, **PLACES[shown]), now_ns)
            session.tick(now_ns)
            for m in sent(session, "COMMAND_LONG"):
                answer = autopilot.say("COMMAND_ACK", command=m.command, result=0)
                session.receive(answer, now_ns)
                if m.command == 512 and m.param1 == IDS["GPS_GLOBAL_ORIGIN"]:
                    times.append(now_ns / SECOND)
                    if next(tries) == told_at:
                        name = "GPS_GLOBAL_ORIGIN"
                        session.receive(autopilot.say(name, **PLACES[name]), now_ns)
        return times

    assert len(asked(None, None, ATTITUDE=10.0)) == 1
    assert len(asked("GLOBAL_POSITION_INT", 0, ATTITUDE=10.0)) == 1
    assert asked("GLOBAL_POSITION_INT", 0) == []
    # The answer to the first three is lost
    times = asked("GLOBAL_POSITION_INT", 3, ATTITUDE=10.0)
    assert times[0] < 1.0
    assert times[1:] == pytest.approx([10.0, 10.5, 11.0], abs=0.2)


# ArduPilot: what is sent counts from its own


def test_an_ardupilot_that_flies_on_ours_from_its_start_is_given_our_origin_with_its_altitude():
    times, origins, odometry = flown(FROM_START, ARDUPILOT, seconds=9)
    assert times == pytest.approx([2.0, 7.0], abs=0.1)
    assert odometry == []
    assert origins[0].altitude == 489_400


def test_an_ardupilot_is_sent_nothing_before_it_has_told_its_origin_and_its_height():
    times, _, odometry = flown(BY_CHOICE, ARDUPILOT, shown="GPS_GLOBAL_ORIGIN", shown_at=6.0)
    assert times == []
    assert odometry == []  # its height did not come
    session, autopilot = spoken(BY_CHOICE)
    assert session.hold is not None
    for name in ("GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT"):
        session.receive(autopilot.say(name, **PLACES[name]), 7 * SECOND)
    session.tick(7 * SECOND)
    assert session.hold is None


def test_an_origin_that_is_never_told_is_announced_after_half_a_minute_and_in_flight_soon():
    said = (20, False, False), (40, False, True), (1, True, False), (8, True, True)
    for seconds, is_flying, is_said in said:
        session, _ = spoken(BY_CHOICE, seconds, base_mode=128 * is_flying)
        (held,) = [event for event in session.events() if type(event) is HoldChanged] or [None]
        assert (held is not None) is is_said
        assert not session.may_stream


def test_in_flight_an_ardupilot_is_given_no_origin():
    assert flown(FROM_START, ARDUPILOT, base_mode=128)[0] == []


def test_an_origin_on_the_other_side_of_the_earth_is_not_counted_from():
    session, autopilot = spoken(BY_CHOICE)
    session.publish(OURS, 7 * SECOND)
    far = {"latitude": 10_000_000, "longitude": 20_000_000, "altitude": 0}
    session.receive(autopilot.say("GPS_GLOBAL_ORIGIN", **far), 7 * SECOND)
    name = "GLOBAL_POSITION_INT"
    session.receive(autopilot.say(name, **PLACES[name]), 7 * SECOND)
    session.tick(7 * SECOND)
    assert session.hold is not None
    assert "km" in session.hold.text


def spoken(parameters, seconds=6, **flying):
    """Return a session that an ArduPilot with these parameters has spoken to, and the latter."""
    session, autopilot = met(ARDUPILOT, guard=GuardOptions())
    for now_ns in range(0, seconds * SECOND, 50 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(**flying), now_ns)
        session.tick(now_ns)
        session.publish(OURS, now_ns)
        for message in sent(session):
            if type(message).__name__ == "PARAM_REQUEST_READ":
                asked = message.param_id.decode()
                value = parameters.get(asked, 0) * 1.0
                said = autopilot.say(
                    "PARAM_VALUE", param_id=asked.encode(), param_value=value, param_type=9
                )
                session.receive(said, now_ns)
    return session, autopilot
