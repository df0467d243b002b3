"""Our heartbeat, and somebody else's under our ids."""

from itertools import pairwise

import pytest

from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import Clash
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.session import Session
from ekf_companion.nav.state import Status
from tests.mavlink.conversation import MS, OURS, SECOND, Voice, met, sent, station

STREAMING = GuardOptions(mode="always")


@pytest.mark.parametrize("stall", [2.1, 10.0])
def test_rule_2_a_stall_of_the_filter_is_silent_and_is_not_made_up_for(stall):
    """Rule 2."""
    session, beats, now_ns = Session(), [], 0
    for step in range(120):
        now_ns += round(stall * 1e9) if step == 50 else 100 * MS
        session.tick(now_ns)
        beats += [now_ns for _ in sent(session, "HEARTBEAT")]
    gaps = [after - before for before, after in pairwise(beats)]
    assert sum(gap > 1.1 * SECOND for gap in gaps) == 1
    assert all(gap >= 900 * MS for gap in gaps)


def test_rule_2_it_says_what_we_are_and_how_we_are():
    """Rule 2."""
    session = Session()
    session.set_state(SystemStatus.CRITICAL, Status.DEAD_RECKONING)
    session.tick(0)
    (beat,) = sent(session, "HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.base_mode) == (18, 8, 0)
    assert (beat.system_status, beat.custom_mode) == (5, 5)


def test_rule_4_the_echo_of_our_own_heartbeats_is_no_clash():
    """Rule 4."""
    session, _ = met(guard=STREAMING)
    for now_ns in range(0, 60 * SECOND, SECOND):
        session.tick(now_ns)
        frames = session.data_to_send()
        for frame in frames + frames:
            session.receive(frame, now_ns + 3 * MS)
    assert not [event for event in session.events() if type(event) is Clash]
    assert session.may_stream


def test_rule_4_a_foreign_heartbeat_under_our_ids_stops_odometry_and_is_named_twice_a_minute():
    """Rule 4."""
    session, autopilot = met(guard=STREAMING)
    other = Voice(*OURS)
    other.sender.sequence = 77
    told = []
    for now_ns in range(0, 60 * SECOND, SECOND):
        session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        said = other.heartbeat(type=18, autopilot=8) + other.say("ODOMETRY", time_usec=1)
        session.receive(said, now_ns)
        assert session.may_stream is (now_ns == 0)  # one alone may be an echo of an earlier run
        told += [event for event in session.events() if type(event) is Clash]
    assert told == [Clash(*OURS)] * 2
    session.tick(64 * SECOND)
    assert not session.may_stream
    session.tick(64 * SECOND + 100 * MS)
    assert session.may_stream


def test_rule_4_another_of_us_that_says_the_same_is_told_by_its_numbers():
    """Rule 4."""
    session, _ = met(guard=STREAMING)
    twin = Session()
    twin.outbox._sender.sequence = 100
    for now_ns in range(0, 5 * SECOND, SECOND):
        session.tick(now_ns)
        twin.tick(now_ns)
        for frame in twin.data_to_send():
            session.receive(frame, now_ns)
    assert not session.may_stream


def test_rule_4_our_heartbeats_in_a_recording_are_no_clash():
    """Rule 4."""
    session, _ = met(guard=STREAMING)
    session.receive(Voice(*OURS).heartbeat(type=18, autopilot=8), SECOND)
    assert session.may_stream
    assert session.events() == []


def test_rule_4_heartbeats_on_request_do_not_push_our_own_echo_out_of_memory():
    session, autopilot = met(guard=STREAMING)
    wish = station().to_us("COMMAND_LONG", command=512, param1=0.0)
    echoes = []
    for now_ns in range(0, 10 * SECOND, 50 * MS):
        session.receive(autopilot.heartbeat() + wish * 20, now_ns)
        session.tick(now_ns)
        echoes += [(now_ns + 3 * SECOND, frame) for frame in session.data_to_send()]
        while echoes and echoes[0][0] <= now_ns:
            session.receive(echoes.pop(0)[1], now_ns)
        assert session.stream_state.is_streaming
    assert session.outbox.sent["HEARTBEAT"] < 60
    assert not [event for event in session.events() if type(event) is Clash]


def test_rule_4_the_last_words_of_an_earlier_run_are_no_clash():
    earlier, session = Session(), met(guard=STREAMING)[0]
    for k in range(50):
        earlier.tick(k * SECOND)
    words = earlier.data_to_send()[-3:]
    session.tick(0)
    for k, frame in enumerate(words):
        session.receive(frame, k * 100 * MS)
    assert session.may_stream


def test_the_one_account_of_what_is_streamed_names_the_clash_first():
    session, _ = met(guard=STREAMING)
    session.tick(0)
    assert session.stream_state.is_streaming
    for k in range(2):
        session.receive(Voice(*OURS).heartbeat(type=18, autopilot=8, system_status=4), k * SECOND)
    state = session.stream_state
    assert not state.is_streaming
    assert state.reason == "somebody else speaks as system 1, component 194"
    assert "link.component_id" in state.remedy


FLYING = {"base_mode": 128}
"""Armed, and nothing is known of the ground."""


def beside_a_twin(seconds, *, twin_sends, guard=STREAMING, **heartbeat):
    """Return the session, and whether it streams after each second beside another of our ids."""
    session, autopilot = met(guard=guard)
    other = Voice(*OURS)
    other.sender.sequence = 77
    streaming = []
    for now_ns in range(0, seconds * SECOND, SECOND):
        session.receive(autopilot.heartbeat(**heartbeat), now_ns)
        if now_ns > 2 * SECOND:
            said = other.say("ODOMETRY", time_usec=1) if twin_sends else b""
            session.receive(other.heartbeat(type=18, autopilot=8) + said, now_ns)
        session.tick(now_ns)
        streaming.append(session.may_stream)
    return session, streaming


def test_rule_4_two_of_us_do_not_silence_each_other_for_good():
    _, streaming = beside_a_twin(40, twin_sends=False)
    assert streaming == [True] * 4 + [False] * 11 + [True] * 25  # 10 s of patience
    _, streaming = beside_a_twin(40, twin_sends=True)
    assert streaming == [True] * 4 + [False] * 36


def test_rule_4_who_streams_in_flight_is_not_silenced_by_a_heartbeat():
    """Anybody on the link can forge one."""
    session, streaming = beside_a_twin(40, twin_sends=True, **FLYING)
    assert all(streaming)
    assert [event.is_yielding for event in session.events() if type(event) is Clash] == [False] * 2
    assert session.clash.is_clash
    strict = GuardOptions(mode="always", withhold_in_flight=True)
    _, streaming = beside_a_twin(40, twin_sends=True, guard=strict, **FLYING)
    assert streaming == [True] * 4 + [False] * 36
