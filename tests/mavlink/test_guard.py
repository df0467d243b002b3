"""Rule 25: the guard in time, and beside others on the link."""

from collections import Counter

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import GuardChanged, PeerFound
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.fusion import NAMES
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.messages import IDS
from tests.mavlink.conversation import MS, PX4, SECOND, Voice, met, sent, station

GENERIC = 0


def test_each_time_that_the_guard_is_lifted_the_pilot_is_warned():
    companion, autopilot = Companion(Config()), Voice()
    texts = []
    for now_ns in range(0, 20 * SECOND, 100 * MS):
        if now_ns % SECOND == 0:
            mode = now_ns // (2 * SECOND) % 2
            said = station().to_us(
                "PARAM_SET", param_id=b"EC_ODOM_MODE", param_value=float(mode), param_type=9
            )
            companion.receive(autopilot.heartbeat() + said, now_ns)
        companion.tick(now_ns)
        frames = Splitter().feed(b"".join(companion.data_to_send()))
        texts += [unpack(f) for f in frames if f.message_id == IDS["STATUSTEXT"]]
    warned = [one for one in texts if one.text == b"Companion: ODOMETRY is streamed unguarded"]
    assert [one.severity for one in warned] == [4] * 5  # though no answer came in between


def answer(autopilot):
    """Return that nothing of ours is fused."""
    return autopilot.say("PARAM_VALUE", param_id=b"EKF2_EV_CTRL", param_type=6)


def watched(minutes, is_answered):
    """Return the session, and what was decided after each tenth of a second."""
    session, autopilot = met(PX4, guard=GuardOptions())
    session.receive(answer(autopilot), 0)
    streaming = []
    for now_ns in range(0, minutes * 60 * SECOND, 100 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        for _ in sent(session, "PARAM_REQUEST_READ"):
            if is_answered(now_ns):
                session.receive(answer(autopilot), now_ns + 20 * MS)
        streaming.append(session.may_stream)
    return session, streaming


def test_without_any_answer_for_five_seconds_it_is_withheld_until_the_next():
    session, streaming = watched(1, lambda now_ns: not 20 * SECOND <= now_ns < 40 * SECOND)
    first, last = streaming.index(False), len(streaming) - streaming[::-1].index(False) - 1
    assert 245 <= first <= 260
    assert 395 <= last <= 405
    assert not any(streaming[first:last])
    changes = [event.decision for event in session.events() if type(event) is GuardChanged]
    assert [decision.is_streaming for decision in changes] == [True, False, True]
    assert "answers no request for a parameter any more" in changes[1].reason


def test_a_link_that_loses_a_tenth_of_all_frames_withholds_nothing():
    rng = np.random.default_rng(1)
    _, streaming = watched(60, lambda now_ns: rng.random() < 0.9 * 0.9)
    assert all(streaming)


def fused_by_none(guard, other, until=20 * SECOND):
    """Return whether it streams after each second, beside somebody else's heartbeats."""
    session, autopilot = met(PX4, guard=guard)
    streaming = []
    for now_ns in range(SECOND, 40 * SECOND, SECOND):
        session.receive(autopilot.heartbeat() + answer(autopilot), now_ns)
        if now_ns <= until:
            session.receive(other.heartbeat(), now_ns + 10 * MS)
        session.tick(now_ns + 20 * MS)
        streaming.append(session.may_stream)
    return session, streaming


def test_rule_25_another_autopilot_on_the_link_is_guarded_too():
    session, streaming = fused_by_none(GuardOptions(), Voice(2))
    # From its second heartbeat on, until it has been silent for ten seconds
    assert streaming == [True, *[False] * 28, *[True] * 10]
    session, streaming = fused_by_none(GuardOptions(), Voice(2), until=40 * SECOND)
    assert "system 2 is on this link too" in session.guard.decision.reason
    assert "a link of its own" in session.guard.decision.remedy


@pytest.mark.parametrize(
    ("guard", "other"),
    [
        (GuardOptions(mode="always"), Voice(2)),
        (GuardOptions(independent=True), Voice(2)),
        (GuardOptions(), Voice(2, family=GENERIC)),
        (GuardOptions(), Voice(255, family=8)),
    ],
)
def test_rule_25_a_choice_that_was_made_or_who_is_no_such_autopilot_withholds_nothing(guard, other):
    assert all(fused_by_none(guard, other)[1])


def test_rule_25_one_stray_heartbeat_of_another_withholds_nothing():
    assert all(fused_by_none(GuardOptions(), Voice(2), until=SECOND)[1])


def requested(answers, seconds=6):
    """Return how often each parameter is requested of a PX4 that has these and no others."""
    session, autopilot = met(PX4, guard=GuardOptions())
    names = Counter()
    for now_ns in range(0, seconds * SECOND, 50 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
        session.tick(now_ns)
        for request in sent(session, "PARAM_REQUEST_READ"):
            name = request.param_id.rstrip(b"\0")
            names[name.decode()] += 1
            if name.decode() in answers:
                said = autopilot.say("PARAM_VALUE", param_id=name, param_value=0.0, param_type=6)
                session.receive(said, now_ns + 20 * MS)
    return session, names


def test_parameters_that_newer_firmware_lacks_are_not_requested_of_it():
    session, names = requested({"EKF2_EV_CTRL", "EKF2_GPS_CTRL"})
    assert session.may_stream
    assert set(names) & set(NAMES[Family.PX4]) == {"EKF2_EV_CTRL", "EKF2_GPS_CTRL"}


def test_older_firmware_that_says_nothing_of_the_newer_ones_is_asked_for_its_own():
    session, names = requested({"EKF2_AID_MASK", "EKF2_HGT_MODE"})
    assert session.may_stream
    assert names["EKF2_AID_MASK"] >= 1


def test_rule_25_what_begins_in_flight_needs_proof_or_a_switch():
    """Anybody on the link can forge the heartbeat of another autopilot."""

    def flown(other, options=None, *, answers=True, values=()):
        session, autopilot = met(PX4, guard=options or GuardOptions())
        session.receive(answer(autopilot), 0)
        streaming = []
        for now_ns in range(0, 40 * SECOND, 100 * MS):
            on_ground = now_ns < 3 * SECOND or now_ns >= 30 * SECOND
            if now_ns % SECOND == 0:
                session.receive(autopilot.heartbeat(base_mode=0 if on_ground else 128), now_ns)
                if other is not None and now_ns >= 10 * SECOND:
                    session.receive(other.heartbeat(), now_ns)
            session.tick(now_ns)
            if sent(session, "PARAM_REQUEST_READ") and (answers or now_ns < 10 * SECOND):
                value = dict(values).get(now_ns // SECOND, 0)
                said = autopilot.say(
                    "PARAM_VALUE", param_id=b"EKF2_EV_CTRL", param_type=9, param_value=value
                )
                session.receive(said, now_ns)
            streaming.append(session.may_stream)
        return session, [all(streaming[10 * k : 10 * k + 10]) for k in range(40)]

    session, streaming = flown(Voice(2))
    assert streaming[:30] == [True] * 30
    assert not any(streaming[32:])  # landed: it is withheld as on any ground
    told = [event.decision for event in session.events() if type(event) is GuardChanged]
    doubt = told[1]
    assert (doubt.is_streaming, doubt.is_warning) == (True, True)
    assert "system 2 is on this link too" in doubt.reason
    assert "began in flight and is no proof" in doubt.reason
    assert "output.odometry.withhold_in_flight" in doubt.remedy
    assert len(f"Companion: {doubt.text}") <= 50

    assert all(flown(None, answers=False)[1][:30])  # who falls silent proves nothing either
    assert not any(flown(Voice(2), GuardOptions(withhold_in_flight=True))[1][12:])


def test_rule_1_forged_heartbeats_of_our_own_autopilot_begin_nothing_anew():
    session, autopilot = met(PX4, guard=GuardOptions())
    for now_ns in range(0, 30 * SECOND, 250 * MS):
        family = PX4 if now_ns % SECOND == 0 else 3
        session.receive(autopilot.heartbeat(autopilot=family), now_ns)
    assert not [event for event in session.events() if type(event) is PeerFound]
