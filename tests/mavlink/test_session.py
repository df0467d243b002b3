"""The conversation, with an autopilot that pymavlink packs, and over recorded flights."""

import random
from itertools import pairwise

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender, pack, unpack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import PeerFound, PeerLost, Rebooted, RequestAnswered
from ekf_companion.mavlink.frame import JUNK, Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.session import RATES, Session, SessionOptions
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import quantise
from ekf_companion.nav.measurements import ImuSample, Kind, Restart
from tests.paths import DATA

MS = 1_000_000
SECOND = 1000 * MS
ARDUPILOT, PX4 = 3, 12


class Autopilot:
    """The other end, as pymavlink packs it."""

    def __init__(self, system_id=1, component_id=1, family=PX4):
        self.mav = dialect.MAVLink(None, system_id, component_id)
        self.family = family

    def say(self, name, **fields):
        definition = getattr(dialect, f"MAVLink_{name}_message")
        message = definition(**(dict.fromkeys(definition.fieldnames, 0) | fields))
        data = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        return data

    def heartbeat(self, **fields):
        return self.say("heartbeat", **({"type": 2, "autopilot": self.family} | fields))

    def imu(self, t_us):
        return self.say("highres_imu", time_usec=t_us, zacc=-9.81, fields_updated=63)

    def ack(self, result=0, command=511, **target):
        return self.say("command_ack", command=command, result=result, **target)


def sent(session, name=None):
    """Return what the session sends, as fields, or of one message only."""
    frames = Splitter().feed(b"".join(session.data_to_send()))
    messages = [unpack(frame) for frame in frames]
    return messages if name is None else [m for m in messages if type(m).__name__ == name]


def met(family=PX4, **options):
    """Return a session that has just found its autopilot, and the autopilot."""
    session, autopilot = Session(SessionOptions(**options)), Autopilot(family=family)
    session.receive(autopilot.heartbeat(), 0)
    session.events()
    return session, autopilot


# Who speaks


def test_the_first_autopilot_is_found_by_its_heartbeat_and_gives_us_its_system():
    session, autopilot = Session(), Autopilot(system_id=7, family=ARDUPILOT)
    assert session.receive(autopilot.imu(1000), 0) == []
    session.receive(autopilot.heartbeat(), 0)
    assert session.events() == [PeerFound(7, 1, Family.ARDUPILOT)]
    assert session.events() == []
    session.tick(0)
    (frame, *_) = Splitter().feed(session.data_to_send()[0])
    assert (frame.system_id, frame.component_id) == (7, 194)
    assert len(session.receive(autopilot.imu(2000), 0)) == 1


@pytest.mark.parametrize(
    "fields", [{"autopilot": 8}, {"type": 6, "autopilot": 3}, {"type": 18, "autopilot": 8}]
)
def test_a_ground_station_or_a_companion_is_no_autopilot(fields):
    session = Session()
    session.receive(Autopilot().heartbeat(**fields), 0)
    assert session.peer is None


def test_a_second_autopilot_is_counted_and_ignored():
    session, autopilot = met()
    other = Autopilot(system_id=2)
    session.receive(other.heartbeat(), 0)
    assert session.receive(other.imu(1000), 0) == []
    assert session.receive(Autopilot(component_id=100).imu(1000), 0) == []
    assert session.counters()["ignored: of another system or component"] == 3
    assert len(session.receive(autopilot.imu(1000), 0)) == 1


def test_a_configured_autopilot_is_waited_for():
    session = Session(SessionOptions(autopilot_system_id=2, system_id=5))
    session.receive(Autopilot(system_id=1).heartbeat(), 0)
    assert session.peer is None
    session.receive(Autopilot(system_id=2).heartbeat(), 0)
    assert session.peer == (2, 1)
    session.tick(0)
    assert Splitter().feed(session.data_to_send()[0])[0].system_id == 5


def test_our_own_frames_in_a_recording_are_ignored():
    session, _ = met()
    session.receive(Sender(1, 194).message("HEARTBEAT", autopilot=3, type=2), 0)
    assert session.counters()["ignored: our own"] == 1


# What time brings


def test_our_heartbeat_beats_once_a_second_however_the_ticks_fall():
    session = Session()
    session.set_state(SystemStatus.CALIBRATING)
    beats, now_ns = [], 0
    rng = np.random.default_rng(1)
    while now_ns < 20 * SECOND:
        session.tick(now_ns)
        for beat in sent(session, "HEARTBEAT"):
            assert (beat.type, beat.autopilot, beat.system_status) == (18, 8, 2)
            beats.append(now_ns)
        now_ns += int(rng.integers(1 * MS, 100 * MS))
    assert len(beats) == 20
    assert all(abs(b - a - SECOND) < 100 * MS for a, b in pairwise(beats))


def test_a_tick_after_a_long_sleep_beats_once_and_not_for_all_that_was_missed():
    session = Session()
    for now_ns in (0, 60 * SECOND, 60 * SECOND + 100 * MS):
        session.tick(now_ns)
    assert len(sent(session, "HEARTBEAT")) == 2


def test_a_silent_autopilot_is_reported_once_and_asked_again_when_it_returns():
    session, autopilot = met(rates={"HIGHRES_IMU": 250.0})
    session.tick(4 * SECOND)
    session.receive(autopilot.ack(), 4 * SECOND)
    assert session.events() == [RequestAnswered("HIGHRES_IMU", "accepted")]
    session.tick(5 * SECOND)
    assert session.peer == (1, 1)
    session.tick(5 * SECOND + 4000)
    assert session.events() == [PeerLost(last_ns=0)]
    assert session.peer is None
    sent(session)
    session.tick(30 * SECOND)
    assert session.events() == []
    assert sent(session, "COMMAND_LONG") == []

    session.receive(autopilot.heartbeat(), 40 * SECOND)
    assert session.events() == [PeerFound(1, 1, Family.PX4)]
    session.tick(40 * SECOND)
    assert len(sent(session, "COMMAND_LONG")) == 1


def test_without_ticks_as_in_a_replay_the_silence_is_still_seen():
    session, autopilot = met()
    session.receive(autopilot.heartbeat(), 9 * SECOND)
    assert session.events() == [PeerLost(last_ns=0), PeerFound(1, 1, Family.PX4)]


def test_lost_and_late_frames_are_counted_by_their_numbers():
    session, autopilot = met()
    for sequence in (1, 2, 5, 4, 5, 6, 206, 207):
        autopilot.mav.seq = sequence
        session.receive(autopilot.say("attitude"), 0)
    counters = session.counters()
    # 3 and 4 at first, of which 4 then came late as 5 came twice, and 7 to 205
    assert (counters["lost"], counters["late"], counters["duplicate"]) == (2 + 199, 1, 1)


def test_a_wrap_of_the_sequence_loses_nothing():
    session, autopilot = met()
    for _ in range(600):
        session.receive(autopilot.say("attitude"), 0)
    assert session.counters()["lost"] == session.counters()["late"] == 0


# What we ask


LOOP = {"param_id": b"SCHED_LOOP_RATE", "param_value": 400.0, "param_type": 4}


def answer_all(session, autopilot, now_ns, results=None):
    """Tick and answer until nothing is asked; give (message id, rate) in order."""
    asked = []
    session.tick(now_ns)
    while requests := sent(session, "COMMAND_LONG"):
        (request,) = requests
        if request.command == 512:
            session.receive(autopilot.ack(3, command=512), now_ns)
            continue
        asked.append((LAYOUTS[int(request.param1)].name, round(1e6 / request.param2)))
        session.receive(autopilot.ack((results or {}).get(asked[-1][0], 0)), now_ns)
    return asked


def test_every_message_is_asked_for_one_after_the_other():
    session, autopilot = met()
    asked = [(name, round(hz)) for name, hz in RATES.items() if not name.startswith("SCALED_IMU")]
    assert answer_all(session, autopilot, 0) == asked
    assert session.requests.results == dict.fromkeys((name for name, _ in asked), "accepted")


def test_a_request_is_repeated_twice_then_given_up_for_the_next():
    session, _ = met(rates={"HIGHRES_IMU": 200.0, "ATTITUDE": 10.0})
    asked = []
    for now_ns in range(0, 7 * SECOND // 2, 100 * MS):
        session.tick(now_ns)
        asked += [(now_ns, m.param1, m.confirmation) for m in sent(session, "COMMAND_LONG")]
    assert asked == [(0, 105, 0), (SECOND, 105, 1), (2 * SECOND, 105, 2), (3 * SECOND, 30, 0)]
    assert session.events() == [RequestAnswered("HIGHRES_IMU", "no answer")]


def test_an_answer_to_another_command_or_component_is_not_ours():
    session, autopilot = met(rates={"ATTITUDE": 10.0})
    session.tick(0)
    for data in (
        autopilot.ack(command=512),
        autopilot.ack(target_system=255, target_component=190),
        autopilot.ack(target_system=1, target_component=191),
    ):
        session.receive(data, 0)
    assert session.events() == []
    session.receive(autopilot.ack(target_system=1, target_component=194), 0)
    assert session.events() == [RequestAnswered("ATTITUDE", "accepted")]


def test_in_progress_is_waited_for():
    session, autopilot = met(rates={"ATTITUDE": 10.0})
    session.tick(0)
    session.receive(autopilot.ack(result=5), 900 * MS)
    sent(session)
    session.tick(1800 * MS)
    assert sent(session, "COMMAND_LONG") == []
    session.tick(1900 * MS)
    assert sent(session, "COMMAND_LONG")[0].confirmation == 1


@pytest.mark.parametrize("result", [2, 3, 4])
def test_an_ardupilot_without_highres_imu_is_asked_for_raw_imu(result):
    session, autopilot = met(ARDUPILOT, rates={"HIGHRES_IMU": 250.0, "ATTITUDE": 10.0})
    session.receive(autopilot.say("param_value", **LOOP), 0)
    asked = answer_all(session, autopilot, 0, {"HIGHRES_IMU": result})
    assert asked == [("HIGHRES_IMU", 250), ("RAW_IMU", 250), ("ATTITUDE", 10)]
    session, autopilot = met(PX4, rates={"HIGHRES_IMU": 250.0})
    assert answer_all(session, autopilot, 0, {"HIGHRES_IMU": result}) == [("HIGHRES_IMU", 250)]
    assert session.requests.results == {
        "HIGHRES_IMU": ("denied", "unsupported", "failed")[result - 2]
    }


def test_after_a_reboot_everything_is_asked_again():
    """Rule 12."""
    session, autopilot = met(rates={"ATTITUDE": 10.0})
    session.receive(autopilot.imu(60_000_000), 0)
    assert len(answer_all(session, autopilot, 0)) == 1
    session.events()
    assert session.receive(autopilot.imu(2_000_000), SECOND) == []  # one stamp may be wild
    measured = session.receive(autopilot.imu(2_250_000), SECOND + SECOND // 4)
    assert [type(one) for one in measured] == [Restart, ImuSample]
    assert session.events() == [Rebooted()]
    assert len(answer_all(session, autopilot, SECOND)) == 1


# Time


def synchronised(offset_ns):
    """Return a session that has learned the autopilot's clock, which is ahead by the offset."""
    session, autopilot = met(rates={})
    for now_ns in range(0, 4 * SECOND, 20 * MS):
        session.tick(now_ns)
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
        for request in sent(session, "TIMESYNC"):
            assert request.tc1 == 0
            assert (request.target_system, request.target_component) == (1, 1)
            data = autopilot.say("timesync", tc1=now_ns + MS + offset_ns, ts1=request.ts1)
            session.receive(data, now_ns + 2 * MS)
    return session, autopilot


def test_a_request_is_answered_at_once_in_the_autopilots_own_time():
    """Rule 27."""
    session, autopilot = synchronised(-3_000_000_123)
    session.receive(autopilot.say("timesync", ts1=987_654_321_001), 5 * SECOND)
    (data,) = session.data_to_send()
    (frame,) = Splitter().feed(data)
    assert len(frame.payload) == 18
    answer = unpack(frame)
    assert answer.ts1 == 987_654_321_001
    assert answer.tc1 == 5 * SECOND - 3_000_000_123
    assert (answer.target_system, answer.target_component) == (1, 1)


@pytest.mark.parametrize("target", [(248, 30), (175, 131), (16, 0), (255, 255)])
@pytest.mark.parametrize("size", [16, 17, 18])
def test_an_answer_to_our_request_is_ours_whatever_target_it_names(target, size):
    """PX4 1.17 leaves the target ids of its answers uninitialised; 16 bytes hold none."""
    session, px4 = met(rates={})[0], Sender(1, 1)
    for now_ns in range(0, 4 * SECOND, 20 * MS):
        session.tick(now_ns)
        for request in sent(session, "TIMESYNC"):
            ids = dict(zip(("target_system", "target_component"), target, strict=True))
            payload = pack("TIMESYNC", tc1=6 * SECOND + now_ns, ts1=request.ts1, **ids)
            session.receive(px4.frame("TIMESYNC", payload[:size]), now_ns + 2 * MS)
    assert session.timesync.is_locked
    assert session.timesync.peer_ns(now_ns) == now_ns + 6 * SECOND - MS
    assert not session.timesync.refused
    assert session.misaddressed[IDS["TIMESYNC"]] == 0


def test_an_answer_to_our_request_counts_from_the_autopilot_only_and_once():
    session, px4 = met(rates={})[0], Sender(1, 1)
    session.tick(5 * SECOND)
    (request,) = sent(session, "TIMESYNC")
    said = {"tc1": 9 * SECOND, "ts1": request.ts1, "target_system": 248}
    session.receive(Sender(1, 100).message("TIMESYNC", **said), 5 * SECOND + MS)
    session.receive(Sender(2, 1).message("TIMESYNC", **said), 5 * SECOND + MS)
    assert session.timesync.answers == 0
    for _ in range(2):
        session.receive(px4.message("TIMESYNC", **said), 5 * SECOND + MS)
    session.receive(px4.message("TIMESYNC", **said | {"ts1": 7}), 5 * SECOND + MS)
    assert session.timesync.answers == 1
    assert session.timesync.refused == {"foreign": 2}
    session.receive(px4.message("TIMESYNC", ts1=8, target_system=248), 5 * SECOND + MS)
    assert session.misaddressed[IDS["TIMESYNC"]] == 1


def test_no_request_is_answered_before_the_clock_is_known():
    """Rule 27."""
    session, autopilot = met()
    session.receive(autopilot.say("timesync", ts1=987), SECOND)
    assert sent(session, "TIMESYNC") == []


def test_a_reboot_forgets_the_autopilots_clock():
    """Rule 12."""
    session, autopilot = synchronised(5 * SECOND)
    for t_us, now_ns in ((60_000_000, 0), (1_000_000, 0), (1_250_000, SECOND // 4)):
        session.receive(autopilot.imu(t_us), 5 * SECOND + now_ns)
    session.receive(autopilot.say("timesync", ts1=987), 5 * SECOND)
    assert sent(session, "TIMESYNC") == []


@given(st.integers(0, 2**62))
@settings(deadline=None)
def test_a_quantised_time_survives_a_tlog(now_ns):
    held = quantise(now_ns)
    assert 0 <= now_ns - held < 4000
    stamp_us = held // 1000
    assert stamp_us & 3 == 0
    assert quantise(stamp_us * 1000) == held


# Live is replay


def flight(seed):
    """Return a stream of an autopilot with another system, noise and a reboot in it."""
    rng = random.Random(seed)
    autopilot, station = Autopilot(), Autopilot(255, 190)
    parts, t_us = [], 5_000_000
    for step in range(250):
        t_us = 1_000_000 if step == 150 else t_us + 4000
        parts.append(autopilot.imu(t_us))
        if step % 25 == 0:
            parts.append(autopilot.heartbeat())
            parts.append(station.heartbeat(type=6, autopilot=8))
        if step % 10 == 0:
            parts.append(
                autopilot.say(
                    "gps_raw_int",
                    time_usec=0 if step % 20 else t_us,
                    fix_type=3,
                    lat=473977635 + step,
                    lon=85455780,
                    vel=100,
                    cog=step,
                )
            )
            parts.append(autopilot.say("vfr_hud", heading=step % 360))
            parts.append(autopilot.say("attitude", time_boot_ms=t_us // 1000, yaw=0.1))
        if rng.random() < 0.05:
            parts.append(rng.randbytes(rng.randrange(1, 30)))
    return b"".join(parts)


@given(st.integers(0, 3), st.lists(st.integers(0, 60_000), max_size=40), st.randoms())
@settings(deadline=None, max_examples=25)
def test_a_recording_fed_frame_by_frame_gives_what_was_measured_live(seed, places, rng):
    stream = flight(seed)
    live = Session(SessionOptions(is_recording=True))
    edges = [0, *sorted(place % len(stream) for place in places), len(stream)]
    measured, record, now_ns = [], [], 1_700_000_000 * SECOND
    for start, end in pairwise(edges):
        now_ns += rng.randrange(1, 300 * MS)
        measured += live.receive(stream[start:end], now_ns)
        live.tick(now_ns)
        record += live.outbox.take_record()
    ours = set(live.data_to_send())
    heard = [raw for _, raw in record if raw not in ours]
    assert heard == [frame.raw for frame in Splitter().feed(stream) if frame.message_id != JUNK]

    replay, again = Session(), []
    for stamp_us, raw in record:
        again += replay.receive(raw, stamp_us * 1000)
    assert again == measured
    # None where all that came after the reboot came at once
    assert sum(type(one) is Restart for one in measured) <= 1


def test_nothing_is_kept_unless_it_is_to_be_recorded():
    session, autopilot = met()
    session.receive(autopilot.imu(1000), 0)
    session.tick(0)
    assert session.outbox.take_record() == []


def test_a_recording_holds_every_frame_in_and_out_in_order():
    session, autopilot = Session(SessionOptions(is_recording=True)), Autopilot()
    first, second = autopilot.heartbeat(), autopilot.imu(1000)
    session.receive(b"noise" + first, 1_234_567_891)
    session.outbox.send("HEARTBEAT", encode.heartbeat(SystemStatus.ACTIVE), 1_300_000_000)
    session.receive(second, 1_400_000_000)
    record = session.outbox.take_record()
    assert [raw for _, raw in record] == [first, *session.data_to_send(), second]
    assert [stamp for stamp, _ in record] == [1_234_564, 1_300_000, 1_400_000]
    assert session.outbox.take_record() == []


def test_what_is_no_frame_is_not_recorded():
    """Rule 39: other readers expect a frame behind each stamp, and noise would fill the disk."""
    session, autopilot = Session(SessionOptions(is_recording=True)), Autopilot()
    session.receive(b"noise", 0)
    heartbeat, sample = autopilot.heartbeat(), autopilot.imu(1000)
    session.receive(heartbeat + b"static" + sample[:20], 0)
    session.receive(sample[20:] + b"static", 0)
    assert [raw for _, raw in session.outbox.take_record()] == [heartbeat, sample]


def test_where_all_is_signed_only_the_autopilots_own_radio_is_recorded_and_no_flood_of_it():
    """Rule 34, rule 39: a stranger who needs no signature does not fill the disk."""
    key, now_ns = bytes(range(32)), 1_800_000_000 * SECOND
    session = Session(SessionOptions(is_recording=True), Signing(key))
    theirs, radio = Sender(1, 1, Signing(key)), Sender(51, 68)

    def flood(sender):
        for k in range(1000):
            session.receive(radio.message("RADIO_STATUS", rssi=1), now_ns + k * MS, sender)
        return len(session.outbox.take_record())

    assert [flood(None), flood("stranger")] == [0, 0]  # no autopilot is heard
    heartbeat = theirs.frame("HEARTBEAT", pack("HEARTBEAT", autopilot=12), now_ns)
    session.receive(heartbeat, now_ns, "autopilot")
    session.outbox.take_record()
    assert [flood("stranger"), flood("autopilot")] == [0, 10]
    assert session.admission.refused == {"not signed": 4000 - 10}


def test_where_all_is_signed_a_radio_proves_nobody_and_neither_does_our_echo():
    """Rule 34: only who knows the secret says where our answers go."""
    key, now_ns = bytes(range(32)), 1_800_000_000 * SECOND
    radio = Sender(51, 68).message("RADIO_STATUS", rssi=1)
    session = Session(SessionOptions(), Signing(key))
    session.tick(now_ns)
    (echo,) = session.data_to_send()
    assert list(session.steps(echo, now_ns)) == [[]], "our own signature is refused"
    assert session.believed == 0
    theirs = Sender(1, 1, Signing(key))
    session.receive(theirs.frame("HEARTBEAT", pack("HEARTBEAT", autopilot=12), now_ns), now_ns)
    assert session.believed == 1
    assert list(session.steps(radio, now_ns)) == [[]], "a radio is refused"
    assert session.believed == 1
    for options, signing in ((SessionOptions(), None), (SessionOptions(accept_unsigned=True), 1)):
        open_one = Session(options, signing and Signing(key))
        open_one.receive(radio, now_ns)
        assert open_one.believed == 1


# Whatever comes

VISIONS = (
    *("VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE", "VISION_POSITION_DELTA"),
    *("VICON_POSITION_ESTIMATE", "ATT_POS_MOCAP", "GLOBAL_VISION_POSITION_ESTIMATE"),
)


@given(st.sampled_from(sorted(LAYOUTS)), st.data())
@settings(deadline=None, max_examples=400)
def test_no_well_formed_message_with_any_values_raises(message_id, data):
    session, _ = met(ARDUPILOT)
    sender = Sender(1, 1)
    size = LAYOUTS[message_id].size
    for now_ns in range(3):
        payload = data.draw(st.binary(min_size=size, max_size=size))
        for one in session.receive(sender.frame(LAYOUTS[message_id].name, payload), now_ns):
            t_ns, kind, values = one.row()
            assert abs(t_ns) < 2**63
            assert kind in list(Kind)
            assert not np.isinf(values).any()
        session.tick(now_ns)


INPUTS = sorted(Session().decoder.readers)


@given(st.lists(st.tuples(st.sampled_from(INPUTS), st.binary(max_size=70)), max_size=20))
@settings(deadline=None, max_examples=200)
def test_no_sequence_of_inputs_with_any_values_raises(messages):
    session, _ = met(ARDUPILOT)
    sender = Sender(1, 1)
    for message_id, payload in messages:
        for one in session.receive(sender.frame(LAYOUTS[message_id].name, payload), 0):
            assert abs(one.row()[0]) < 2**63


# Recorded flights

FLIGHTS = {
    "sitl-arducopter-square/flight.tlog": (Family.ARDUPILOT, "HIGHRES_IMU", 11601, 581, 0),
    "sitl-px4-square/flight.tlog": (Family.PX4, "HIGHRES_IMU", 19824, 639, 0),
    "tlog-transcoded-x500-mission/x500_mission_highres.tlog": (
        *(Family.PX4, "HIGHRES_IMU", 13911, 125, 0),
    ),
    "tlog-apm-2013-nebraska/2013-10-13_18-50-10.tlog": (Family.ARDUPILOT, "RAW_IMU", 791, 781, 0),
    "tlog-copter-canberra/flight.tlog": (Family.ARDUPILOT, "RAW_IMU", 2856, 2710, 1),
    "tlog-copter-vancouver/mission2_2018-09-25.tlog": (
        *(Family.ARDUPILOT, "RAW_IMU", 1627, 1628, 0),
    ),
}
"""The autopilot, its inertial message, how many of it, how many new 3-D fixes, and reboots."""


@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_recorded_flight_gives_its_measurements(flight):
    path = DATA / flight
    if not path.exists():
        pytest.skip(f"the recorded flight {flight} is not beside this checkout")
    family, source, imu, fixes, restarts = FLIGHTS[flight]
    session = Session()
    # The stamps between the records are so many bytes of junk to the splitter
    counts, derived = dict.fromkeys(Kind, 0), 0
    for one in session.receive(path.read_bytes(), 0):
        _, kind, values = one.row()
        counts[Kind(kind)] += 1
        derived += kind == Kind.GNSS and values[10] == 1
    assert session.decoder.family is family
    assert session.decoder.imu_source == source
    # What came before the first heartbeat, and while a better source was waited for, is lacking
    assert 0.98 * imu <= counts[Kind.IMU] <= imu
    assert 0.98 * fixes <= counts[Kind.GNSS] - derived < fixes
    assert counts[Kind.RESTART] == restarts
    assert counts[Kind.HEADING] > 100
    assert counts[Kind.BARO] > 100 or "transcoded" in flight


# After a restart


def expecting(autopilot, **options):
    family = Family.PX4 if autopilot.family == PX4 else Family.ARDUPILOT
    return Session(SessionOptions(expected=PeerFound(7, 1, family), **options))


def test_an_expected_autopilot_is_found_by_its_first_sample():
    autopilot = Autopilot(system_id=7)
    session = expecting(autopilot)
    assert [type(m) for m in session.receive(autopilot.imu(5_000_000), 0)] == [ImuSample]
    assert session.events() == [PeerFound(7, 1, Family.PX4)]
    session.tick(0)
    assert session.peer == (7, 1)
    assert {m.target_system for m in sent(session, "COMMAND_LONG")} == {7}
    # Its heartbeat says nothing new, and its absence is missed as ever
    session.receive(autopilot.heartbeat(), SECOND)
    assert session.events() == []
    session.tick(7 * SECOND)
    assert session.events()[-1] == PeerLost(SECOND)


@pytest.mark.parametrize("other", [(8, 1), (7, 2)])
def test_another_than_the_expected_one_is_found_by_its_heartbeat(other):
    autopilot = Autopilot(*other)
    session = expecting(autopilot)
    assert session.receive(autopilot.imu(5_000_000), 0) == []
    session.receive(autopilot.heartbeat(), 0)
    assert session.events() == [PeerFound(*other, Family.PX4)]


def test_an_expected_autopilot_of_another_family_is_found_again_by_its_heartbeat():
    autopilot = Autopilot(system_id=7, family=ARDUPILOT)
    session = Session(SessionOptions(expected=PeerFound(7, 1, Family.PX4)))
    session.receive(autopilot.imu(5_000_000), 0)
    session.receive(autopilot.heartbeat(), 0)
    session.receive(autopilot.heartbeat(), SECOND)
    assert [event.family for event in session.events()] == [Family.PX4, Family.ARDUPILOT]
    assert session.decoder.family is Family.ARDUPILOT


def test_one_that_is_not_to_be_listened_to_is_not_expected_either():
    autopilot = Autopilot(system_id=7)
    session = expecting(autopilot, autopilot_system_id=8)
    assert session.receive(autopilot.imu(5_000_000), 0) == []
    assert session.peer is None


def test_a_flow_by_more_milliseconds_than_there_are_has_no_time():
    session, _ = met(ARDUPILOT)
    sample = {"time_usec": 5_000_000, "zacc": -9.81, "fields_updated": 0x3F}
    session.receive(Sender(1, 1).message("HIGHRES_IMU", **sample), 0)
    assert not session.receive(
        Sender(1, 1).message("OPTICAL_FLOW", time_usec=1 << 56, quality=9), 1
    )
    assert session.refused["optical flow: no time"] == 1


@given(st.sampled_from(["ODOMETRY", *VISIONS]), st.data())
@settings(deadline=None, max_examples=200)
def test_no_message_of_others_with_any_values_raises(name, data):
    session, _ = met(ARDUPILOT, reads_others=True)
    sample = {"time_usec": 5_000_000, "zacc": -9.81, "fields_updated": 0x3F}
    session.receive(Sender(1, 1).message("HIGHRES_IMU", **sample), 0)
    other, size = Sender(1, 197), LAYOUTS[IDS[name]].size
    for now_ns in range(3):
        frame = other.frame(name, data.draw(st.binary(min_size=size, max_size=size)))
        board = [one for found in session.steps_of_board(frame, now_ns) for one in found]
        for one in [*session.receive(frame, now_ns), *board]:
            t_ns, _, values = one.row()
            assert abs(t_ns) < 2**63
            assert not np.isinf(values).any()
