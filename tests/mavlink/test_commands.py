"""Commands to us."""

import math

import hypothesis.strategies as st
import pytest
from hypothesis import given

from ekf_companion.mavlink.commands import Stream
from ekf_companion.mavlink.event import IntervalSet
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.messages import IDS
from ekf_companion.version import __version__
from tests.mavlink.conversation import SECOND, Voice, met, sent, station

ARM, SET_INTERVAL, REQUEST = 400, 511, 512
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
ODOMETRY, STATUS = IDS["ODOMETRY"], IDS["ESTIMATOR_STATUS"]


def served(has_estimate=True):
    """Return a session that offers two messages, who commands it, and what was asked for."""
    session, _ = met()
    asked = []
    for name, rate, largest in (("ODOMETRY", 30.0, 50.0), ("ESTIMATOR_STATUS", 1.0, 1000.0)):
        stream = Stream(
            rate=rate,
            smallest=1.0 if name == "ODOMETRY" else 0.1,
            largest=largest,
            request=lambda name=name: asked.append(name) or has_estimate,
        )
        session.commands.offer(name, stream)
    return session, station(), asked


def command(session, who, number, component=194, name="COMMAND_LONG", system=1, **fields):
    target = {"target_system": system, "target_component": component}
    session.receive(who.say(name, command=number, **target, **fields), 0)
    return sent(session)


def result(messages):
    (ack,) = [m for m in messages if type(m).__name__ == "COMMAND_ACK"]
    return ack.result


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
def test_rule_31_a_command_to_us_is_always_answered_to_who_sent_it(name):
    """Rule 31."""
    session, who, _ = served()
    for number in (ARM, 0, 65535, 246):
        (ack,) = command(session, who, number, name=name)
        assert (ack.command, ack.result) == (number, UNSUPPORTED)
        assert (ack.target_system, ack.target_component) == (255, 190)


@pytest.mark.parametrize("component", [0, 1, 195])
def test_rule_31_a_command_to_all_or_to_others_is_not_ours_to_refuse(component):
    """Rule 31."""
    session, who, _ = served()
    assert command(session, who, ARM, component) == []
    assert command(session, who, SET_INTERVAL, component, param1=ODOMETRY, param2=1e5) == []
    assert command(session, who, REQUEST, component, param1=IDS["HOME_POSITION"]) == []
    assert command(session, who, ARM, 194, system=2) == []
    assert session.events() == []


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
@pytest.mark.parametrize("component", [194, 0])
@pytest.mark.parametrize(
    "message",
    [
        *("HEARTBEAT", "AUTOPILOT_VERSION", "MESSAGE_INTERVAL"),
        *("COMPONENT_INFORMATION_BASIC", "PROTOCOL_VERSION"),
    ],
)
def test_rule_31_a_message_that_needs_no_estimate_comes_at_once(name, component, message):
    """Rule 31."""
    session, who, _ = served()
    said = command(session, who, REQUEST, component, name, param1=IDS[message])
    assert [type(m).__name__ for m in said] == [message, "COMMAND_ACK"]
    assert said[1].result == ACCEPTED


def test_rule_31_a_message_of_the_estimate_is_asked_of_the_filter():
    """Rule 31."""
    session, who, asked = served()
    assert result(command(session, who, REQUEST, param1=ODOMETRY)) == ACCEPTED
    assert asked == ["ODOMETRY"]
    session, who, asked = served(has_estimate=False)
    assert result(command(session, who, REQUEST, param1=STATUS)) == TEMPORARILY_REJECTED


@pytest.mark.parametrize(
    "message",
    [
        *("ODOMETRY", "ESTIMATOR_STATUS", "AUTOPILOT_VERSION"),
        *("COMPONENT_INFORMATION_BASIC", "PROTOCOL_VERSION"),
    ],
)
@pytest.mark.parametrize("period_ms", [0, 1, 5, 25])
def test_a_message_that_is_requested_all_the_time_comes_four_times_a_second(message, period_ms):
    """Else ODOMETRY comes with each sample, 60 kB/s, and a radio is full."""
    session, who, asked = served()
    answers = []
    for n in range(1000):
        t_ns = n * period_ms * SECOND // 1000
        # By several in turn: the link is one
        target = {"target_system": 1, "target_component": 194 if n % 2 else 0}
        session.receive(
            who.say("COMMAND_LONG", command=REQUEST, param1=IDS[message], **target), t_ns
        )
        said = sent(session)
        answers.append(result(said))
        asked += [type(one).__name__ for one in said if type(one).__name__ == message]
    assert answers.count(ACCEPTED) == len(asked) == max(4 * period_ms, 1)
    assert set(answers) == {ACCEPTED, TEMPORARILY_REJECTED}


def test_a_request_that_found_nothing_to_send_may_be_repeated_at_once():
    session, who, _ = served(has_estimate=False)
    assert result(command(session, who, REQUEST, param1=ODOMETRY)) == TEMPORARILY_REJECTED
    session.commands.offer(
        "ODOMETRY",
        Stream(rate=30.0, smallest=1.0, largest=50.0, request=lambda: True),
    )
    assert result(command(session, who, REQUEST, param1=ODOMETRY)) == ACCEPTED
    # And each message has a time of its own
    assert result(command(session, who, REQUEST, param1=IDS["AUTOPILOT_VERSION"])) == ACCEPTED


@pytest.mark.parametrize("message_id", [0.5, -1.0, 1e9, math.nan, math.inf, 32.0, 105.0, 70000.0])
def test_rule_31_a_message_that_is_not_ours_is_unsupported(message_id):
    """Rule 31."""
    session, who, asked = served()
    said = command(session, who, SET_INTERVAL, param1=message_id, param2=1e5)
    assert result(said) == UNSUPPORTED
    if message_id != 0.5:
        assert result(command(session, who, REQUEST, param1=message_id)) == UNSUPPORTED
    assert asked == []


def test_rule_31_an_interval_is_set_reported_and_given_back():
    """Rule 31."""
    session, who, _ = served()

    def interval():
        said = command(session, who, REQUEST, param1=IDS["MESSAGE_INTERVAL"], param2=ODOMETRY)
        assert said[0].message_id == ODOMETRY
        return said[0].interval_us

    assert interval() == 33_333
    for interval_us, told, rate in ((50_000.0, 50_000, 20.0), (-1.0, -1, 0.0), (0.0, 33_333, 30.0)):
        for _ in range(2):  # a repeated command changes nothing more
            said = command(session, who, SET_INTERVAL, param1=ODOMETRY, param2=interval_us)
            assert result(said) == ACCEPTED
            assert session.events() == [IntervalSet("ODOMETRY", rate)]
        assert interval() == told
        assert session.commands.rate("ODOMETRY") == rate


def switched_off():
    session, who, _ = served()
    session.guard.retune(GuardOptions(mode="always"))
    session.receive(Voice().heartbeat(), 0)
    command(session, who, SET_INTERVAL, param1=ODOMETRY, param2=-1.0)
    assert session.commands.rate("ODOMETRY") == 0.0
    assert not session.stream_state.is_streaming
    assert "system 255, component 190 has switched it off" in session.stream_state.reason
    session.events()
    return session, who


def test_rule_31_an_interval_ends_when_the_autopilot_is_lost():
    session, _ = switched_off()
    session.tick(6 * SECOND)
    assert IntervalSet("ODOMETRY", 30.0) in session.events()
    session.receive(Voice().heartbeat(), 7 * SECOND)
    assert session.stream_state.is_streaming


@pytest.mark.parametrize(("is_beating", "rate"), [(True, 30.0), (False, 0.0)])
def test_rule_31_an_interval_ends_when_its_commander_is_lost(is_beating, rate):
    """One that sends no heartbeats is not missed."""
    session, who = switched_off()
    for now_ns in range(0, 100 * SECOND, SECOND):
        session.receive(Voice().heartbeat(), now_ns)
        if is_beating and now_ns < 60 * SECOND:
            session.receive(who.heartbeat(type=6, autopilot=8), now_ns)
        session.tick(now_ns)
        if now_ns < 80 * SECOND:
            assert session.commands.rate("ODOMETRY") == 0.0
    assert session.commands.rate("ODOMETRY") == rate
    assert session.stream_state.is_streaming is (rate > 0.0)


@pytest.mark.parametrize(
    "interval_us", [19_999.0, 1.0, -2.0, math.nan, math.inf, 1e30, 1.1e6, 2e9, 3e9]
)
def test_rule_22_a_rate_that_the_autopilot_cannot_use_is_denied(interval_us):
    """Rule 22."""
    session, who, _ = served()
    said = command(session, who, SET_INTERVAL, param1=ODOMETRY, param2=interval_us)
    assert result(said) == DENIED
    assert session.commands.rate("ODOMETRY") == 30.0
    assert session.events() == []


def test_rule_31_what_we_never_send_has_no_interval():
    """Rule 31."""
    session, who, _ = served()
    for message_id in (32, 105, 65535):
        said = command(session, who, REQUEST, param1=IDS["MESSAGE_INTERVAL"], param2=message_id)
        assert said[0].interval_us == 0


def test_rule_31_who_commands_less_than_comes_by_default_is_named():
    """Rule 31: One that sends no heartbeats is not missed, so the status says whom to ask."""
    session, who, _ = served()
    session.guard.retune(GuardOptions(mode="always"))
    session.receive(Voice().heartbeat(), 0)
    usual = session.stream_state
    command(session, who, SET_INTERVAL, param1=ODOMETRY, param2=5e5)
    state = session.stream_state
    assert state.is_streaming
    assert state.reason == "system 255, component 190 has commanded 2 Hz"
    assert "SET_MESSAGE_INTERVAL of ODOMETRY with 0" in state.remedy
    command(session, who, SET_INTERVAL, param1=ODOMETRY, param2=25_000.0)
    assert session.stream_state == usual


def test_rule_31_what_we_are_is_told_in_the_messages_that_the_dialect_lacks():
    """Rule 31, and section 4.5 of the notes on the protocol: 396 and 300."""
    session, who, _ = served()
    basic, _ = command(session, who, REQUEST, param1=396.0)
    assert (basic.software_version.decode(), basic.capabilities & 8192) == (__version__, 8192)
    protocol, _ = command(session, who, REQUEST, param1=300.0)
    assert (protocol.min_version, protocol.version, protocol.max_version) == (100, 200, 200)


@given(
    st.sampled_from([float(ODOMETRY), float(STATUS), 0.0, 244.0]),
    st.floats(width=32) | st.sampled_from([2e9, 3e9, 1e6, 1e7, -1.0, 0.0]),
    st.floats(width=32),
)
def test_rule_31_whatever_interval_was_commanded_can_be_told(message, interval_us, asked):
    """Rule 31."""
    session, who, _ = served()
    command(session, who, SET_INTERVAL, param1=message, param2=interval_us)
    for wanted in (float(ODOMETRY), float(STATUS), asked):
        told, ack = command(session, who, REQUEST, param1=244.0, param2=wanted)
        assert ack.result == ACCEPTED
        assert -1 <= told.interval_us <= 10_000_000


@given(
    st.sampled_from(["COMMAND_LONG", "COMMAND_INT"]),
    st.sampled_from([SET_INTERVAL, REQUEST, ARM]),
    st.lists(st.floats(width=32), min_size=7, max_size=7),
)
def test_rule_31_no_command_raises_and_each_is_answered_once(name, number, values):
    """Rule 31."""
    session, who, _ = served()
    count = 7 if name == "COMMAND_LONG" else 4
    fields = {f"param{k + 1}": value for k, value in enumerate(values[:count])}
    said = command(session, who, number, name=name, **fields)
    assert [type(m).__name__ for m in said].count("COMMAND_ACK") == 1
