"""Whether what was asked for comes."""

from itertools import pairwise

import pytest

from ekf_companion.mavlink.audit import probable_cause
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import RateTooLow
from ekf_companion.mavlink.statustext import LARGEST
from tests.mavlink.conversation import ARDUPILOT, MS, PX4, SECOND, asked, met, sent

RATES = {
    "HIGHRES_IMU": 250.0,
    "GPS_RAW_INT": 10.0,
    "ATTITUDE": 10.0,
    "GLOBAL_POSITION_INT": 5.0,
    "SCALED_PRESSURE": 10.0,
}


def listen(duration, rates, family=PX4, change=None, then=None, cap=1e3, unknown=()):
    """Hear messages at rates (Hz); give when which was asked again, and events.

    All is granted, but what is unknown, and rates above a cap (Hz).
    """
    session, autopilot = met(family, rates=RATES)
    again, events, counts, now = [], [], dict.fromkeys({*RATES, *rates}, 0.0), 0
    for now in range(0, int(duration * SECOND), 50 * MS):
        for at, changed in filter(None, (change, then)):
            rates = changed if now >= at * SECOND else rates
        if now % SECOND == 0:
            session.receive(autopilot.heartbeat(), now)
        for name, rate in rates.items():
            counts[name] += rate * 0.05
            while counts[name] >= 1.0:
                counts[name] -= 1.0
                session.receive(autopilot.say(name), now)
        session.tick(now)
        while commands := sent(session, "COMMAND_LONG"):
            for command in commands:
                if command.command == 511:
                    again.append((now // SECOND, asked(command)))
                is_denied = command.command == 511 and cap * command.param2 < 1e6
                result = 3 if asked(command) in unknown else 2 if is_denied else 0
                data = autopilot.say("COMMAND_ACK", command=command.command, result=result)
                session.receive(data, now)
        events += [event for event in session.events() if type(event) is RateTooLow]
    return again[len(RATES) :], events, session


def test_rule_6_what_comes_as_asked_is_left_in_peace():
    """Rule 6."""
    usual = RATES | {"HIGHRES_IMU": 130.0, "GPS_RAW_INT": 5.0, "ATTITUDE": 1.0}
    again, events, session = listen(40.0, usual)
    assert (again, events) == ([], [])
    assert session.audit.rates["HIGHRES_IMU"] == pytest.approx(130.0, rel=0.05)
    assert session.audit.rates["GPS_RAW_INT"] == pytest.approx(5.0, rel=0.1)


def test_rule_6_what_comes_at_less_than_half_is_asked_again_every_ten_seconds_then_named_once():
    """Rule 6."""
    slow = RATES | {"HIGHRES_IMU": 100.0}
    again, events, _ = listen(170.0, slow)
    assert {name for _, name in again} == {"HIGHRES_IMU"}
    times = [now for now, _ in again]
    assert 5 <= times[0] <= 7
    gaps = [after - before for before, after in pairwise(times)]
    assert all(10 <= gap <= 12 for gap in gaps[:3])
    assert all(gap >= 60 for gap in gaps[3:])
    assert len(gaps) == 5
    (event,) = events
    assert (event.message, event.asked) == ("HIGHRES_IMU", 250.0)
    assert event.measured == pytest.approx(100.0, rel=0.05)


def test_rule_6_inertial_samples_that_fill_the_line_are_requested_at_less_than_comes():
    """At 57600 baud 250 Hz leave no room for a fix."""
    full = {"HIGHRES_IMU": 66.0, "ATTITUDE": 3.0}
    relieved = RATES | {"HIGHRES_IMU": 25.0}
    again, events, session = listen(60.0, full, ARDUPILOT, change=(25.0, relieved))
    assert session.requests.expected_rate("HIGHRES_IMU") == 25.0
    assert events == []
    times = [at for at, name in again if name == "HIGHRES_IMU"]
    assert len(times) == 2  # once more at the same rate, then lower
    assert times[1] < 20


def test_rule_6_a_full_line_is_relieved_while_other_requests_wait_for_their_answers():
    """An answer takes seconds there, all of them a minute, and no fix comes meanwhile."""
    others = {f"SCALED_IMU{k}": 10.0 for k in (2, 3)} | {"DISTANCE_SENSOR": 10.0, "AIRSPEED": 10.0}
    session, autopilot = met(ARDUPILOT, rates=RATES | others)
    now, due, counted = 0, [], 0.0
    while session.requests.expected_rate("HIGHRES_IMU") > 25.0 and now < 60 * SECOND:
        now += 50 * MS
        if now % SECOND == 0:
            session.receive(autopilot.heartbeat(), now)
        counted += 66.0 * 0.05
        while counted >= 1.0:
            counted -= 1.0
            session.receive(autopilot.say("HIGHRES_IMU"), now)
        session.tick(now)
        due += [(now + 2500 * MS, one) for one in sent(session, "COMMAND_LONG")]
        for _, command in [one for one in due if one[0] <= now]:
            session.receive(autopilot.say("COMMAND_ACK", command=command.command, result=0), now)
        due = [one for one in due if one[0] > now]
    assert now < 30 * SECOND


def test_rule_6_what_recovers_is_forgiven():
    """Rule 6."""
    slow = RATES | {"HIGHRES_IMU": 100.0}
    again, events, _ = listen(60.0, slow, change=(12.0, RATES))
    assert len(again) == 1
    assert events == []


def test_rule_6_two_short_troubles_are_not_one_long_one():
    """Rule 6."""
    slow = RATES | {"HIGHRES_IMU": 100.0}
    again, events, _ = listen(80.0, slow, change=(28.0, RATES), then=(50.0, slow))
    assert len(again) > 4
    assert events == []


def test_rule_6_fixes_that_cease_are_asked_for_again():
    """Rule 6."""
    silent = {name: rate for name, rate in RATES.items() if name != "GPS_RAW_INT"}
    again, _, _ = listen(30.0, RATES, change=(10.0, silent))
    assert again
    assert {name for _, name in again} == {"GPS_RAW_INT"}


@pytest.mark.parametrize(
    ("family", "setting"), [(PX4, "GPS_1_CONFIG, SER_GPS1_BAUD"), (ARDUPILOT, "GPS1_TYPE")]
)
def test_rule_6_that_no_fix_comes_is_laid_to_the_receiver_and_its_stream(family, setting):
    """Rule 6: the inertial samples come as asked, so neither loop nor link is slow."""
    silent = {name: rate for name, rate in RATES.items() if name != "GPS_RAW_INT"}
    _, events, _ = listen(60.0, silent, family)
    (event,) = events
    assert (event.message, event.measured) == ("GPS_RAW_INT", 0.0)
    assert event.cause.startswith("no receiver, or its stream is off; see ")
    assert setting in event.cause
    words = f"Companion: GPS_RAW_INT 0 of 10 Hz: {event.cause}"
    assert len(words) <= LARGEST
    _, events, _ = listen(60.0, silent, family, unknown=("GPS_RAW_INT",))
    assert "(request: unsupported)" in events[0].cause


@pytest.mark.parametrize(("loop", "granted"), [(50.0, 40.0), (200.0, 100.0), (300.0, 100.0)])
def test_rule_6_what_was_granted_is_judged_and_no_other_message(loop, granted):
    """Rule 6: HIGHRES_IMU comes as granted, and RAW_IMU, which was denied, need not come."""
    session_rates = RATES | {"HIGHRES_IMU": granted}
    again, events, session = listen(130.0, session_rates, ARDUPILOT, cap=0.8 * loop)
    assert session.requests.results["RAW_IMU"] == "denied"
    assert session.requests.inertial == "HIGHRES_IMU"
    assert session.requests.expected_rate("HIGHRES_IMU") == granted
    assert events == []
    assert all(now < 10 for now, _ in again)


def test_rule_6_what_was_granted_stays_so_whatever_else_is_turned():
    """Rule 6."""
    session_rates = RATES | {"HIGHRES_IMU": 100.0}
    _, _, session = listen(10.0, session_rates, ARDUPILOT, cap=160.0)
    session.requests.retune(RATES | {"ATTITUDE": 20.0})
    assert session.requests.expected_rate("HIGHRES_IMU") == 100.0
    session.requests.retune(RATES | {"HIGHRES_IMU": 50.0})
    assert session.requests.expected_rate("HIGHRES_IMU") == 50.0


def test_rule_6_the_message_that_is_in_use_is_named():
    """Rule 6: neither was granted, and the stream of old brings RAW_IMU."""
    slow = {"RAW_IMU": 10.0, "GPS_RAW_INT": 5.0}
    unknown = ("HIGHRES_IMU", "RAW_IMU")
    again, events, _ = listen(80.0, slow, ARDUPILOT, unknown=unknown)
    (event,) = events
    assert (event.message, event.asked) == ("RAW_IMU", 250.0)
    assert event.measured == pytest.approx(10.0, rel=0.1)
    assert again


def test_rule_6_nothing_is_asked_of_an_autopilot_that_is_lost():
    """Rule 6."""
    session, autopilot = met(rates=RATES)
    asked_at = []
    for now in range(0, 60 * SECOND, 100 * MS):
        session.tick(now)
        for command in sent(session, "COMMAND_LONG"):
            asked_at.append(now)
            session.receive(autopilot.say("COMMAND_ACK", command=command.command), now)
    assert max(asked_at) < 6 * SECOND


AT_4 = dict.fromkeys(("RAW_IMU", "ATTITUDE", "GLOBAL_POSITION_INT", "SCALED_PRESSURE"), 4.0)


@pytest.mark.parametrize(
    ("measured", "family", "words"),
    [
        (AT_4, Family.ARDUPILOT, "a ground station sets 4 Hz for all (SRn_*"),
        (
            RATES | {"HIGHRES_IMU": 40.0},
            Family.ARDUPILOT,
            "a loop of 50 Hz sends at most 40; raise SCHED_LOOP_RATE",
        ),
        (
            {name: 0.4 * rate for name, rate in RATES.items()},
            Family.PX4,
            "all are thinned alike, so the link is full; raise MAV_n_RATE",
        ),
        ({name: 0.4 * rate for name, rate in RATES.items()}, Family.ARDUPILOT, "SERIALn_BAUD"),
        (RATES | {"HIGHRES_IMU": 90.0}, Family.PX4, "see IMU_INTEG_RATE or MAV_n_RATE"),
        (RATES | {"HIGHRES_IMU": 0.0}, Family.PX4, "none comes"),
        ({}, Family.UNKNOWN, "none comes"),
    ],
)
def test_rule_6_the_probable_cause_is_named(measured, family, words):
    """Rule 6."""
    assert words in probable_cause(measured, RATES, family)
