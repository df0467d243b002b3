"""Whom the session listens to."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.event import PeerFound, SeveralAutopilots
from ekf_companion.mavlink.sequence import Sequence
from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.nav.measurements import ImuSample
from tests.mavlink.conversation import SECOND, Voice, met, sent

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
