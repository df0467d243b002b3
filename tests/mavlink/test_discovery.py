"""Whom the session listens to."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import PeerChanged, PeerFound, PeerLost, SeveralAutopilots
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.sequence import Sequence
from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.nav.measurements import ImuSample
from tests.mavlink.conversation import ARDUPILOT, PX4, SECOND, Voice, met, sent

IMU = {"zacc": -9.81, "fields_updated": 63}


def test_rule_1_the_first_of_several_autopilots_is_kept_and_the_choice_is_named_once():
    """Rule 1."""
    session, first = met()
    second = Voice(system_id=2)
    for now_ns in range(0, 10 * SECOND, SECOND):
        session.receive(first.heartbeat() + second.heartbeat(), now_ns)
    assert session.events() == [SeveralAutopilots(1, 2)]
    assert session.peer == (1, 1)
    # No sample of the first is waited for, none of the second is taken
    assert len(session.receive(first.say("HIGHRES_IMU", time_usec=1000, **IMU), SECOND)) == 1
    assert session.receive(second.say("HIGHRES_IMU", time_usec=1000, **IMU), SECOND) == []


@pytest.mark.parametrize(
    ("wanted", "other"),
    [(1, {"system_id": 2}), (None, {"system_id": 1, "component_id": 2})],
)
def test_rule_1_a_choice_that_was_made_or_that_is_none_is_not_named(wanted, other):
    """Rule 1."""
    session, _ = met(autopilot_system_id=wanted)
    session.receive(Voice(**other).heartbeat(), 0)
    assert session.events() == []


def test_rule_1_a_ground_station_is_no_second_autopilot():
    """Rule 1."""
    session, _ = met()
    session.receive(Voice(255, 190).heartbeat(type=6, autopilot=8), 0)
    session.receive(Voice(254, 190).heartbeat(type=6, autopilot=3), 0)
    assert session.events() == []


def test_rule_3_what_was_sent_in_a_silence_is_not_counted_as_lost():
    """Rule 3."""
    sequence = Sequence()
    for number, now_ns, lost in (
        (0, 0, 0),
        (90, 5 * SECOND, 89),
        (200, 10 * SECOND + 1, 89),
        (203, 11 * SECOND, 91),
    ):
        sequence.count(number, now_ns)
        assert sequence.lost == lost


def test_rule_3_an_autopilot_that_returns_is_counted_anew():
    """Rule 3."""
    session, autopilot = met()
    session.tick(6 * SECOND)
    autopilot.sender.sequence = 90
    session.receive(autopilot.heartbeat(), 6 * SECOND)
    assert session.sequence.lost == 0


def test_rule_33_a_peer_that_speaks_mavlink_1_is_understood_and_answered_in_2():
    """Rule 33."""
    mav = dialect.MAVLink(None, 7, 1)
    heartbeat = mav.heartbeat_encode(2, 3, 0, 0, 4).pack(mav, force_mavlink1=True)
    imu = dialect.MAVLink_raw_imu_message(1_000_000, 0, 0, -1000, 1, 0, 0, 0, 0, 0)
    session = Session(SessionOptions())
    session.receive(bytes(heartbeat), 0)
    assert [type(event) for event in session.events()] == [PeerFound]
    data = bytes(imu.pack(mav, force_mavlink1=True))
    assert data[0] == 0xFE
    session.decoder.prefer(1, 1, 1, 1)  # no better source ever comes
    assert ImuSample in [type(one) for one in session.receive(data, 0)]
    session.tick(0)
    assert {frame[0] for frame in session.data_to_send()} == {0xFD}


def test_a_session_alone_speaks_of_nothing_but_itself():
    session = Session()
    for now_ns in range(0, 30 * SECOND, SECOND // 10):
        session.tick(now_ns)
    assert {type(message).__name__ for message in sent(session)} == {"HEARTBEAT"}


GENERIC = 0


def found(session):
    return [event for event in session.events() if type(event) is PeerFound]


def test_rule_1_the_autopilot_goes_before_another_component_that_calls_itself_one():
    gimbal, autopilot = Voice(1, 154, GENERIC), Voice()
    session = Session(SessionOptions(rates={}))
    session.receive(gimbal.heartbeat(), 0)
    session.events()
    session.receive(autopilot.heartbeat() + gimbal.heartbeat(), SECOND)
    assert session.events() == [
        PeerChanged((1, 154), (1, 1), is_lost=False),
        PeerFound(1, 1, Family.PX4),
    ]
    assert session.peer == (1, 1)
    # And it is waited for when it is silent: the gimbal does not stand in for it
    session.tick(7 * SECOND)
    session.receive(gimbal.heartbeat(), 8 * SECOND)
    assert session.peer is None
    session.receive(autopilot.heartbeat(), 9 * SECOND)
    assert session.peer == (1, 1)


def test_rule_1_one_stray_heartbeat_does_not_blind_it_for_ever():
    stray, autopilot = Voice(7, 1, ARDUPILOT), Voice()
    session = Session(SessionOptions(rates={}))
    session.receive(stray.heartbeat(), 0)
    for k in range(1, 8):
        session.receive(autopilot.heartbeat(), k * SECOND)
    assert [type(e) for e in session.events()] == [
        *(PeerFound, SeveralAutopilots, PeerLost, PeerChanged, PeerFound)
    ]
    assert session.peer == (1, 1)
    # What it measures begins a new course of time
    imu = autopilot.say("HIGHRES_IMU", time_usec=1000, **IMU)
    assert [type(m) for m in session.receive(imu, 8 * SECOND)] == [ImuSample]


def talk(session, voices, seconds):
    """Let the voices beat once a second in these seconds, while time goes on."""
    for now_ns in range(seconds.start * SECOND, seconds.stop * SECOND, SECOND // 10):
        if now_ns % SECOND == 0:
            for voice in voices:
                session.receive(voice.heartbeat(), now_ns)
        session.tick(now_ns)


def chosen(session):
    return [(e.system_id, e.component_id) for e in found(session)]


@pytest.mark.parametrize("kind", [6, 18, 26, 27, 30, 31, 34, 36, 42, 49])
def test_rule_1_what_is_no_vehicle_is_no_autopilot(kind):
    session = Session(SessionOptions(rates={}))
    for family in (GENERIC, PX4):
        session.receive(Voice(42, 100).heartbeat(type=kind, autopilot=family), 0)
    assert session.events() == []


@pytest.mark.parametrize("first", [(42, 100), (42, 1), (1, 100)])
def test_rule_1_a_known_stack_takes_the_place_of_an_unknown_one_that_was_heard_first(first):
    session = Session(SessionOptions(rates={}, guard=GuardOptions()))
    talk(session, [Voice(*first, GENERIC), Voice()], range(60))
    assert chosen(session) == [first, (1, 1)]
    assert not session.may_stream  # before it has answered
    # One heartbeat is none, and no third takes its place in turn
    talk(session, [Voice(3, 1, ARDUPILOT)], range(60, 61))
    talk(session, [Voice(*first, GENERIC), Voice(), Voice(3, 1, ARDUPILOT)], range(61, 90))
    assert chosen(session) == []


def test_rule_1_a_stray_heartbeat_of_a_known_stack_does_not_take_the_place_of_an_unknown_one():
    session, autopilot = met(GENERIC)
    talk(session, [autopilot, Voice(7)], range(1, 2))
    talk(session, [autopilot], range(2, 20))
    assert session.peer == (1, 1)


def test_rule_1_where_the_one_is_named_no_known_stack_takes_its_place():
    session, autopilot = met(GENERIC, autopilot_system_id=1)
    talk(session, [autopilot, Voice(7)], range(1, 20))
    assert session.peer == (1, 1)


@pytest.mark.parametrize("away", [7, 15, 29])
def test_rule_1_a_vehicle_is_waited_for_while_it_reboots(away):
    session, first = met()
    second = Voice(2)
    talk(session, [first, second], range(1, 11))
    talk(session, [second], range(11, 10 + away))
    assert session.peer is None
    talk(session, [first, second], range(10 + away, 60 + away))
    assert session.peer == (1, 1)
    assert chosen(session) == [(1, 1)]


def test_rule_1_a_vehicle_that_was_given_up_is_returned_to_when_it_is_back_soon():
    session, first = met()
    second = Voice(2)
    talk(session, [first], range(1, 10))
    talk(session, [second], range(10, 60))
    assert session.peer == (2, 1)
    talk(session, [first, second], range(60, 62))
    assert session.peer == (1, 1)
    assert chosen(session) == [(2, 1), (1, 1)]
    # And then kept
    talk(session, [first, second], range(62, 90))
    assert chosen(session) == []


def test_rule_1_where_another_was_put_in_its_place_the_first_is_not_returned_to():
    session, first = met()
    second = Voice(2)
    talk(session, [first], range(1, 10))
    talk(session, [second], range(10, 400))
    talk(session, [first, second], range(400, 420))
    assert session.peer == (2, 1)


@pytest.mark.parametrize("ours", [PX4, GENERIC])
def test_rule_25_the_vehicle_that_is_turned_to_is_not_taken_for_another_beside_it(ours):
    """It is streamed to as soon as it has answered; while the other beats too, it is not."""
    session, _ = met(ours, guard=GuardOptions())
    talk(session, [Voice(family=ours)], range(1, 10))
    second = Voice(2)
    talk(session, [second], range(10, 50))
    assert session.peer == (2, 1)
    answer = second.say("PARAM_VALUE", param_id=b"EKF2_EV_CTRL", param_type=6)
    session.receive(answer, 50 * SECOND)
    assert session.may_stream
    talk(session, [second, Voice(3)], range(51, 54))
    assert not session.may_stream


def test_rule_1_the_one_that_is_named_is_waited_for():
    session, _ = met(autopilot_system_id=1)
    for k in range(1, 20):
        session.receive(Voice(2).heartbeat(), k * SECOND)
    assert session.peer is None
    assert not found(session)


@pytest.mark.parametrize("others", [(GENERIC, PX4), (GENERIC, ARDUPILOT), (ARDUPILOT, PX4, PX4)])
def test_another_family_begins_everything_anew(others):
    """A bootloader's heartbeat before the firmware's, or another autopilot on the wire."""
    first, *later = others
    session, autopilot = met(first, guard=GuardOptions())
    session.receive(autopilot.say("HIGHRES_IMU", time_usec=10**9, **IMU), 0)
    for k, family in enumerate(later, 1):
        session.receive(autopilot.heartbeat(autopilot=family), k * SECOND)
    family = {PX4: Family.PX4, ARDUPILOT: Family.ARDUPILOT}[later[-1]]
    assert found(session) == [PeerFound(1, 1, family)]
    assert session.decoder.family is family
    # Of the old one's clock nothing is known
    assert session.decoder.clock.latest_us is None
    session.tick(k * SECOND)
    asked = {m.param_id.decode() for m in sent(session, "PARAM_REQUEST_READ")}
    assert {"EKF2_EV_CTRL"} <= asked or {"VISO_TYPE"} <= asked
    assert not session.may_stream


def test_a_known_family_stays_for_a_heartbeat_that_names_none_and_for_a_single_other():
    session, autopilot = met(PX4)
    for k, family in enumerate((GENERIC, GENERIC, PX4, ARDUPILOT, PX4, ARDUPILOT, PX4), 1):
        session.receive(autopilot.heartbeat(autopilot=family), k * SECOND)
    assert session.decoder.family is Family.PX4
    session.tick(20 * SECOND)
    session.receive(autopilot.heartbeat(autopilot=GENERIC), 21 * SECOND)
    assert session.decoder.family is Family.PX4
    session.tick(30 * SECOND)
    session.receive(autopilot.heartbeat(autopilot=ARDUPILOT), 31 * SECOND)
    assert session.decoder.family is Family.ARDUPILOT


def meet_two(first, second, first_beats, *, end, first_samples=(), step=SECOND // 10):
    """Return a session that heard two autopilots; the second sends samples all the time."""
    session = Session(SessionOptions(rates={}))
    for now_ns in range(0, end * SECOND, step):
        now = now_ns / SECOND
        if now_ns % SECOND == 0 and now in first_beats:
            session.receive(first.heartbeat(), now_ns)
        for voice in [second] if now >= 1.0 else []:
            if now_ns % SECOND == 0:
                session.receive(voice.heartbeat(), now_ns)
            said = voice.say("HIGHRES_IMU", time_usec=now_ns // 1000, **IMU)
            session.receive(said, now_ns)
        if now in first_samples:
            session.receive(first.say("HIGHRES_IMU", time_usec=now_ns // 1000, **IMU), now_ns)
        session.tick(now_ns)
    return session


@pytest.mark.parametrize("first", [Voice(7), Voice(7, 1, ARDUPILOT), Voice(7, 42, GENERIC)])
@pytest.mark.parametrize("last", [0, 1, 5, 20])
def test_rule_1_one_that_sent_no_sample_is_not_waited_for_beside_one_that_does(first, last):
    """A bench's or a neighbour's autopilot, whose heartbeats a radio passed on for a while."""
    session = meet_two(first, Voice(), range(last + 1), end=last + 12)
    assert session.peer == (1, 1)
    changed = [e for e in session.events() if isinstance(e, PeerChanged)]
    assert [(e.was[0], e.now[0]) for e in changed] == [(7, 1)]


def test_rule_1_nor_is_it_returned_to():
    session = meet_two(Voice(7), Voice(), {*range(6), *range(40, 45)}, end=60)
    assert session.peer == (1, 1)
    assert chosen(session) == [(7, 1), (1, 1)]


def test_rule_1_one_that_has_sent_samples_is_waited_for_beside_another_that_does():
    session = meet_two(Voice(7), Voice(), {*range(6), *range(25, 60)}, end=60, first_samples={2.0})
    assert session.peer == (7, 1)
    assert chosen(session) == [(7, 1)] * 2


def test_rule_1_of_two_others_the_one_that_sends_samples_is_taken():
    session, first = met()
    talk(session, [first, Voice(3)], range(1, 5))
    for now_ns in range(5 * SECOND, 50 * SECOND, SECOND):
        for voice in (Voice(3), Voice(2)):
            session.receive(voice.heartbeat(), now_ns)
        said = Voice(2).say("HIGHRES_IMU", time_usec=now_ns // 1000, **IMU)
        session.receive(said, now_ns)
        session.tick(now_ns)
    assert session.peer == (2, 1)
