"""Signatures against pymavlink's own, both ways; their times, and what a restart keeps of them."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.admission import (
    COMPONENT,
    SECRET,
    SYSTEM,
    UNSIGNED,
    Admission,
)
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.mavlink.signing import (
    CROWDED,
    EPOCH_NS,
    FIRST_CONTACT,
    LARGEST,
    OLD,
    REPLAYED,
    SECOND,
    STREAMS,
    UNIT_NS,
    WRONG,
    Signing,
    time_of,
)

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
NOW_NS = EPOCH_NS + 10**18  # in 2046
NOW = time_of(NOW_NS)
SECOND_NS = 10**9


def pymavlink(key=KEY, *, time=NOW, link=0, system=1, component=1):
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    mav.signing.secret_key = key
    mav.signing.sign_outgoing = key is not None
    mav.signing.link_id = link
    mav.signing.timestamp = time
    return mav


def heartbeat(mav):
    message = mav.heartbeat_encode(type=2, autopilot=3, base_mode=0, custom_mode=0, system_status=4)
    data = message.pack(mav)
    mav.seq = (mav.seq + 1) % 256
    return data


def framed(data):
    (frame,) = Splitter().feed(bytes(data))
    return frame


def verify(signing, data, now_ns=NOW_NS):
    return signing.verify(framed(data), now_ns)


def test_what_pymavlink_signs_is_believed_rule_34():
    ours, theirs = Signing(KEY), pymavlink(link=7)
    for _ in range(300):
        assert verify(ours, heartbeat(theirs)) == ""
    assert ours.verified == 300


def test_pymavlink_believes_what_we_sign_rule_34():
    ours, theirs = Sender(1, 194, Signing(KEY, link_id=5)), pymavlink()
    for k in range(300):
        data = ours.frame("HEARTBEAT", bytes(9), NOW_NS + k)
        message = theirs.decode(bytearray(data))
        assert message.get_signed()
        assert message.get_link_id() == 5
    assert theirs.signing.goodsig_count == 300
    assert list(theirs.signing.stream_timestamps) == [(5, 1, 194)]


def test_pymavlink_refuses_what_we_sign_with_another_secret():
    data = Sender(1, 194, Signing(OTHER)).frame("HEARTBEAT", bytes(9), NOW_NS)
    with pytest.raises(dialect.MAVError, match="Invalid signature"):
        pymavlink().decode(bytearray(data))


@pytest.mark.parametrize("place", [-1, -6, -7, -12, -13])
def test_a_changed_signature_is_refused(place):
    data = bytearray(heartbeat(pymavlink()))
    data[place] ^= 1
    ours = Signing(KEY)
    assert verify(ours, data) == WRONG
    assert verify(ours, heartbeat(pymavlink(OTHER))) == WRONG
    assert ours.verified == 0


def test_a_frame_is_believed_once_and_no_older_one_after_it():
    ours, theirs = Signing(KEY), pymavlink()
    first, second = heartbeat(theirs), heartbeat(theirs)
    assert verify(ours, second) == ""
    assert verify(ours, second) == REPLAYED
    assert verify(ours, first) == REPLAYED
    # Another link of the same component counts for itself
    assert verify(ours, heartbeat(pymavlink(link=1))) == ""


def test_a_stream_heard_first_may_be_a_minute_behind_and_no_more():
    behind = NOW - FIRST_CONTACT
    assert verify(Signing(KEY), heartbeat(pymavlink(time=behind))) == ""
    assert verify(Signing(KEY), heartbeat(pymavlink(time=behind - 1))) == OLD
    # One that has been heard may be as slow as it likes
    ours = Signing(KEY)
    assert verify(ours, heartbeat(pymavlink(time=behind))) == ""
    assert verify(ours, heartbeat(pymavlink(time=behind + 1)), NOW_NS + 3600 * SECOND_NS) == ""


def time_in(data):
    return int.from_bytes(data[-12:-6], "little")


def test_our_time_is_the_clocks_and_always_grows():
    sender = Sender(1, 194, Signing(KEY))
    times = [time_in(sender.frame("HEARTBEAT", bytes(9), NOW_NS)) for _ in range(3)]
    assert times == [NOW, NOW + 1, NOW + 2]
    assert time_in(sender.frame("HEARTBEAT", bytes(9), NOW_NS - SECOND_NS)) == NOW + 3
    assert time_in(sender.frame("HEARTBEAT", bytes(9), NOW_NS + SECOND_NS)) == NOW + SECOND


def test_a_board_without_a_clock_takes_the_time_that_it_hears():
    signing = Signing(KEY)
    sender = Sender(1, 194, signing)
    assert time_in(sender.frame("HEARTBEAT", bytes(9), 0)) == 1  # 1970
    assert verify(signing, heartbeat(pymavlink(time=NOW)), SECOND_NS) == ""
    data = sender.frame("HEARTBEAT", bytes(9), SECOND_NS)
    assert time_in(data) == NOW + 1
    assert pymavlink(time=NOW).decode(bytearray(data)).get_signed()


def test_a_time_at_its_end_still_signs():
    signing = Signing(KEY)
    assert verify(signing, heartbeat(pymavlink(time=LARGEST))) == ""
    assert time_in(Sender(1, 194, signing).frame("HEARTBEAT", bytes(9), NOW_NS)) == LARGEST


def test_after_a_restart_nothing_can_be_replayed_and_nothing_of_ours_is_refused_rule_34():
    before, receiver, theirs = Signing(KEY), pymavlink(), pymavlink()
    heard = [heartbeat(theirs) for _ in range(100)]
    assert all(verify(before, data) == "" for data in heard)
    state = before.state()
    for k in range(100):  # what was sent after the last time that the state was kept
        last = Sender(1, 194, before).frame("HEARTBEAT", bytes(9), NOW_NS + k * SECOND_NS // 100)
        receiver.decode(bytearray(last))

    after = Signing(KEY)
    assert after.restore(state)
    assert [verify(after, data, 0) for data in heard] == [REPLAYED] * 100
    assert verify(after, heartbeat(theirs), 0) == ""
    # The board has no real-time clock: it is 1970 again
    again = Sender(1, 194, after).frame("HEARTBEAT", bytes(9), 0)
    assert receiver.decode(bytearray(again)).get_signed()


def test_a_quick_succession_of_restarts_does_not_run_ahead_of_the_clock():
    signing, now_ns = Signing(KEY), NOW_NS
    for _ in range(100):
        state = signing.state()
        signing = Signing(KEY)
        assert signing.restore(state)
        now_ns += 3 * SECOND_NS
        signing.sign(b"", now_ns)
    assert time_in(signing.sign(b"", now_ns)) == time_of(now_ns) + 1


@pytest.mark.parametrize("size", [0, 1, 15, 16, 17, 33, 34, 40, 44])
def test_a_damaged_state_is_no_state(size):
    signing = Signing(KEY)
    verify(signing, heartbeat(pymavlink()))
    state = signing.state()
    assert len(state) == 45
    assert not Signing(KEY).restore(state[:size])
    assert not Signing(KEY).restore(state[:size] + b"x" + state[size + 1 :])
    assert not Signing(OTHER).restore(state)
    assert Signing(KEY).restore(state)


def test_the_table_of_streams_is_bounded_and_what_is_forgotten_cannot_be_replayed():
    signing = Signing(KEY)
    first = heartbeat(pymavlink(system=1))
    for system in range(1, STREAMS + 1):
        assert verify(signing, heartbeat(pymavlink(system=system))) == ""
    assert verify(signing, heartbeat(pymavlink(system=200))) == CROWDED
    # A minute later the oldest makes room
    late = NOW + FIRST_CONTACT + 10
    late_ns = NOW_NS + (FIRST_CONTACT + 10) * UNIT_NS
    assert verify(signing, heartbeat(pymavlink(system=200, time=late)), late_ns) == ""
    assert verify(signing, first, late_ns) in (OLD, REPLAYED)
    assert len(signing.state()) == len(Signing(KEY).state()) + 11 * STREAMS


def test_the_secret_stands_in_no_representation():
    secret = b"a secret that nobody may print!!"
    signing = Signing(secret)
    session = Session(SessionOptions(), signing)
    session.outbox.send("HEARTBEAT", bytes(9), NOW_NS)
    words = repr(signing) + repr(vars(signing)) + repr(vars(session)) + repr(session.options)
    words += repr(signing.state())
    assert "secret that" not in words
    with pytest.raises(ValueError, match="32 bytes") as caught:
        Signing(secret[:31])
    assert "secret that" not in str(caught.value)


# Who may speak


def refuse(admission, data):
    return admission.refuse(framed(data), NOW_NS)


def test_unsigned_frames_are_refused_where_there_is_a_key_rule_34():
    plain = heartbeat(pymavlink(None))
    strict, lenient = (Admission((), (), Signing(KEY), is_lenient) for is_lenient in (False, True))
    assert refuse(strict, plain) == UNSIGNED
    assert refuse(lenient, plain) == ""
    assert refuse(Admission(), plain) == ""
    for admission in (strict, lenient):
        assert refuse(admission, heartbeat(pymavlink())) == ""
        assert refuse(admission, heartbeat(pymavlink(OTHER))) == WRONG
        assert admission.signed == 1
    assert strict.refused == {UNSIGNED: 1, WRONG: 1}


def test_a_signed_frame_is_accepted_where_there_is_no_key():
    assert refuse(Admission(), heartbeat(pymavlink())) == ""


def test_a_telemetry_radio_needs_no_signature_but_the_autopilot_does():
    admission = Admission(signing=Signing(KEY))
    for component, is_beside, reason in (
        (68, False, UNSIGNED),
        (68, True, ""),
        (1, True, UNSIGNED),
    ):
        frame = framed(Sender(51, component).message("RADIO_STATUS", rssi=9))
        assert admission.refuse(frame, NOW_NS, is_beside_autopilot=is_beside) == reason


def test_only_those_on_the_lists_may_speak():
    admission = Admission((1, 255), (1, 190))
    speakers = [(1, 1), (255, 190), (2, 1), (1, 191)]
    reasons = [refuse(admission, heartbeat(pymavlink(None, system=s, component=c)))
               for s, c in speakers]  # fmt: skip
    assert reasons == ["", "", SYSTEM, COMPONENT]
    assert admission.refused == {SYSTEM: 1, COMPONENT: 1}
    assert admission.is_selective


def test_without_lists_and_a_key_nobody_is_asked_who_they_are():
    assert not Admission().is_selective
    assert Admission(signing=Signing(KEY)).is_selective


def test_a_secret_that_is_sent_over_the_link_is_not_recorded():
    session = Session(SessionOptions(is_recording=True))
    secret = b"a secret that nobody may print!!"
    data = Sender(255, 190).message("SETUP_SIGNING", target_system=1, secret_key=tuple(secret))
    assert secret in data
    session.receive(data, NOW_NS)
    assert session.outbox.take_record() == []
    assert session.admission.refused == {SECRET: 1}


def test_a_session_with_a_key_hears_its_autopilot_alone_and_signs_its_answers_rule_34():
    session = Session(SessionOptions(is_recording=True), Signing(KEY))
    stranger, theirs = pymavlink(None, system=9), pymavlink(system=3)
    session.receive(heartbeat(stranger), NOW_NS)
    assert session.peer is None
    assert session.heard == 0
    genuine = heartbeat(theirs)
    session.receive(genuine, NOW_NS)
    assert session.peer == (3, 1)
    assert session.heard == 1
    session.tick(NOW_NS)
    sent = session.data_to_send()
    assert len(sent) > 2
    assert all(theirs.decode(bytearray(data)).get_signed() for data in sent)
    # A stranger does not speak in a replay either, which knows no key
    assert [data for _, data in session.outbox.take_record()] == [genuine, *sent]


def test_the_unfinished_frame_of_one_sender_is_not_cut_by_another():
    session = Session()
    data = Sender(3, 1).message("HEARTBEAT", type=2, autopilot=3)
    session.receive(data[:9], NOW_NS, ("10.0.0.2", 14550))
    for k in range(40):
        session.receive(b"\xfd\x40\x00" * 3, NOW_NS, ("10.0.0.9", k))
        if k % 10 == 0:
            session.receive(b"", NOW_NS, ("10.0.0.2", 14550))
    session.receive(data[9:], NOW_NS, ("10.0.0.2", 14550))
    assert session.peer == (3, 1)
