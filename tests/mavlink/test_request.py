"""What is asked of an autopilot, and what becomes of it."""

import pytest

from ekf_companion.mavlink.event import FirmwareReported, RequestAnswered
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.request import ACCEPTED
from ekf_companion.mavlink.session import RATES, Session, SessionOptions
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, asked, met, sent


def converse(kind, duration=2.0):
    """Return a session that has flown with a simulated autopilot, and its events."""
    config = SimConfig()
    session, autopilot, events = Session(), Autopilot(config, kind), []
    for cycle in Flight.plan("hover", config, duration=duration).cycles():
        autopilot.cycle(cycle)
        session.receive(b"".join(autopilot.data_to_send()), cycle.t_ns)
        session.tick(cycle.t_ns)
        for data in session.data_to_send():
            autopilot.receive(data, cycle.t_ns)
        events += session.events()
    return session, autopilot, events


@pytest.mark.parametrize(("kind", "version"), [(Kind.PX4, "1.16.0"), (Kind.ARDUPILOT, "4.6.0")])
def test_rule_5_an_autopilot_is_asked_for_its_messages_and_its_version(kind, version):
    """Rule 5."""
    session, autopilot, events = converse(kind)
    commands = [m.fields for m in autopilot.received() if m.name == "COMMAND_LONG"]
    assert [asked(m) for m in commands if m.command == 511][: len(RATES)][0] == "HIGHRES_IMU"
    others = {"SCALED_IMU2", "SCALED_IMU3"}  # of other compasses: ArduPilot's alone
    wanted = set(RATES) if kind is Kind.ARDUPILOT else set(RATES) - others
    assert {asked(m) for m in commands if m.command == 511} == wanted
    assert session.requests.results["HIGHRES_IMU"] == ACCEPTED
    assert FirmwareReported(version) in events
    assert session.requests.version == version


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (6, "cancelled"),
        (7, "only as COMMAND_LONG"),
        (8, "only as COMMAND_INT"),
        (9, "unsupported frame"),
        (10, "not in control"),
        (11, "result 11"),
    ],
)
def test_rule_5_every_answer_has_its_words(result, words):
    """Rule 5."""
    session, autopilot = met(rates={"ATTITUDE": 10.0})
    session.tick(0)
    session.receive(autopilot.say("COMMAND_ACK", command=511, result=result), 0)
    assert session.events() == [RequestAnswered("ATTITUDE", words)]


@pytest.mark.parametrize("answer", [None, 3])
def test_rule_5_an_autopilot_that_cannot_tell_its_version_is_not_complained_of(answer):
    """Rule 5."""
    session, autopilot = met(ARDUPILOT, rates={"ATTITUDE": 10.0})
    session.tick(0)
    session.receive(autopilot.say("COMMAND_ACK", command=511), 0)
    session.events()
    requests = []
    for now_ns in range(0, 6 * SECOND, 100 * MS):
        session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        requests += [m for m in sent(session, "COMMAND_LONG") if m.command == 512]
        if answer is not None:
            session.receive(autopilot.say("COMMAND_ACK", command=512, result=answer), now_ns)
    assert [m.confirmation for m in requests] == ([0, 1, 2] if answer is None else [0])
    assert session.events() == []
    assert session.requests.version == ""


def answered(family, results, rates):
    """Return what is asked in the old way of an autopilot that answers so."""
    session, autopilot = met(family, rates=rates)
    streams = []
    for now_ns in range(0, 30 * SECOND, 100 * MS):
        session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        for message in sent(session, "COMMAND_LONG", "REQUEST_DATA_STREAM"):
            if type(message).__name__ == "REQUEST_DATA_STREAM":
                streams.append((now_ns, message.req_stream_id, message.req_message_rate))
            elif (result := results.get(asked(message))) is not None:
                data = autopilot.say("COMMAND_ACK", command=message.command, result=result)
                session.receive(data, now_ns)
    return streams


OLD = {"HIGHRES_IMU": 50.0, "GPS_RAW_INT": 10.0, "ATTITUDE": 10.0}


def test_rule_7_an_ardupilot_that_grants_nothing_is_asked_by_groups():
    """Rule 7."""
    streams = answered(ARDUPILOT, {}, OLD)
    # It sends none of them either, so that the inertial group is asked for again, ever less often
    assert {stream[1:] for stream in streams} == {(1, 50), (2, 10), (10, 10)}


def test_rule_7_only_the_groups_are_asked_of_which_nothing_is_granted():
    """Rule 7."""
    denied = dict.fromkeys(("HIGHRES_IMU", "RAW_IMU"), 2)
    granted = dict.fromkeys(("GPS_RAW_INT", "ATTITUDE", "AUTOPILOT_VERSION"), 0)
    assert {stream[1] for stream in answered(ARDUPILOT, denied | granted, OLD)} == {1}
    assert answered(PX4, denied | granted, OLD) == []
    assert answered(ARDUPILOT, {**granted, "HIGHRES_IMU": 2, "RAW_IMU": 0}, OLD) == []
    # A group would change the rate of what was granted out of it
    with_baro = OLD | {"SCALED_PRESSURE": 10.0}
    assert answered(ARDUPILOT, denied | granted | {"SCALED_PRESSURE": 0}, with_baro) == []


def test_rule_12_after_a_reboot_the_version_is_asked_again():
    """Rule 12."""
    session, autopilot = met(rates={"ATTITUDE": 10.0})
    for now_ns in (0, SECOND):
        session.tick(now_ns)
        while commands := sent(session, "COMMAND_LONG"):
            last = commands[-1]
            session.receive(autopilot.say("COMMAND_ACK", command=last.command), now_ns)
        assert last.command == 512
        stamp = 60_000_000 if now_ns == 0 else 1_000_000
        for step in range(2):
            data = autopilot.say("HIGHRES_IMU", time_usec=stamp + step, zacc=-9.8)
            session.receive(data, now_ns)


def test_options_without_rates_ask_nothing():
    session, _ = met(rates={})
    session.tick(0)
    assert sent(session, "COMMAND_LONG", "REQUEST_DATA_STREAM") == []
    assert SessionOptions(rates={}).rates == {}


@pytest.mark.parametrize("delay_ms", [40, 700, 1300, 1900])
@pytest.mark.parametrize("lost", [set(), {0}, {1, 4}])
def test_rule_5_a_late_answer_is_not_taken_for_that_to_the_next_request(delay_ms, lost):
    """COMMAND_ACK names the command, not the message."""
    session, autopilot = met(ARDUPILOT, rates=RATES)
    waiting, answers = [], 0
    for now_ns in range(0, 60 * SECOND, 50 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        for message in sent(session, "COMMAND_LONG"):
            if message.command == 511:
                result = 2 if asked(message) in ("HIGHRES_IMU", "ATTITUDE") else 0
                ack = autopilot.to_us("COMMAND_ACK", command=511, result=result)
                if answers not in lost:
                    waiting.append((now_ns + delay_ms * MS, ack))
                answers += 1
        while waiting and waiting[0][0] <= now_ns:
            session.receive(waiting.pop(0)[1], now_ns)
        if session.requests.results.keys() >= RATES.keys() | {"RAW_IMU"}:
            break
    denied = {name for name, result in session.requests.results.items() if result == "denied"}
    accepted = {name for name, result in session.requests.results.items() if result == "accepted"}
    assert denied == {"HIGHRES_IMU", "ATTITUDE"}
    assert accepted == {"RAW_IMU", *RATES} - denied


@pytest.mark.parametrize(
    ("personality", "granted"),
    [
        ("ardupilot", {"HIGHRES_IMU": 250.0}),
        ("ardupilot:loop_rate=300", {"HIGHRES_IMU": 250.0}),
        ("ardupilot:loop_rate=100", {"HIGHRES_IMU": 1e3 / 12}),
        ("ardupilot:loop_rate=50", {"HIGHRES_IMU": 40.0}),
        ("ardupilot-old:loop_rate=50", {"RAW_IMU": 40.0}),
        ("ardupilot-old", {"RAW_IMU": 250.0}),
    ],
)
def test_an_ardupilot_is_asked_for_no_more_than_its_loop_gives(personality, granted):
    """It tells the pilot of each rate that is too fast: six times on a loop of 50 Hz."""
    session, _, _ = converse(parse(personality))
    assert session.requests.inertial == next(iter(granted))
    rate = session.requests.expected_rate(session.requests.inertial)
    assert rate == pytest.approx(granted[session.requests.inertial])
    assert IDS["STATUSTEXT"] not in session.received


def test_an_ardupilot_that_does_not_tell_its_loops_rate_is_asked_as_before():
    session, autopilot = met(ARDUPILOT, rates={"HIGHRES_IMU": 250.0})
    rates = []
    for now_ns in range(0, 20 * SECOND, 100 * MS):
        session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        for message in sent(session, "COMMAND_LONG"):
            if message.command == 511:
                rates.append((asked(message), 1e6 / message.param2))
                is_granted = rates[-1] == ("RAW_IMU", 40.0)
                answer = 0 if is_granted else 2
                data = autopilot.say("COMMAND_ACK", command=511, result=answer)
                session.receive(data, now_ns)
    assert rates[0] == ("HIGHRES_IMU", 250.0)
    assert rates[:8] == [
        (name, rate) for rate in (250.0, 100.0, 50.0, 40.0) for name in ("HIGHRES_IMU", "RAW_IMU")
    ]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -50.0, 1e30])
def test_a_loops_rate_that_none_can_have_changes_nothing(value):
    session, autopilot = met(ARDUPILOT, rates={"HIGHRES_IMU": 250.0})
    session.tick(0)
    data = autopilot.say(
        "PARAM_VALUE", param_id=b"SCHED_LOOP_RATE", param_value=value, param_type=9, param_count=1
    )
    session.receive(data, MS)
    for now_ns in range(0, 2 * SECOND, 100 * MS):
        session.tick(now_ns)
    (message,) = [m for m in sent(session, "COMMAND_LONG") if m.command == 511][:1]
    assert 1e6 / message.param2 == 250.0
