"""Datagrams of one frame are read by a way of their own, which must make the same of them."""

import math
import random

import pytest

from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.nav.measurements import HeadingSample, HeadingSource
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from tests.engine.conversation import STREAMING

NUMBER = IDS["HIGHRES_IMU"].to_bytes(3, "little")
READ = ("HIGHRES_IMU", "ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT")
GUARDED_NS = 5_000_000_000


def flown(kind=Kind.PX4, duration=12.0):
    """Yield stamp and frames of each cycle of a flight."""
    config = SimConfig()
    autopilot = Autopilot(config, kind)
    autopilot.heartbeat()
    for cycle in Flight.plan("figure-eight", config, duration=duration).cycles():
        autopilot.cycle(cycle)
        yield cycle.t_ns, autopilot.data_to_send()


def oddities(name, m, rng):
    """Return what else a message may say."""
    if "time_boot_ms" in m._fields:
        stamp, value = "time_boot_ms", m.time_boot_ms
        stamps = [max(value - 300, 0), max(value - 4, 0), max(value - 20, 0), value + 400, 0]
        stamps += [value + 2000, (1 << 31) + 1, (1 << 32) - 1]
    else:
        stamp, value = "time_usec", m.time_usec
        stamps = [value + step for step in (-300_000, -4000, 400_000, 2_000_000)]
        stamps += [0, 1, 1 << 51, (1 << 52) + 1, (1 << 64) - 1]
    said = {
        "HIGHRES_IMU": [
            {rng.choice(["xacc", "zgyro"]): rng.choice([math.nan, math.inf, 1e30])},
            {"fields_updated": rng.choice([0, 0x3F, 0x1FF, 0x23F, 0x1F])},
            {"id": rng.choice([0, 1, 2, 255])},
            {"xmag": 0.0, "ymag": 0.0, "zmag": 0.0},
            {"xmag": rng.choice([1e-4, 40.0, math.nan])},
            {"abs_pressure": rng.choice([0.0, 1.0, 1013.0, 101300.0, math.nan])},
        ],
        "ATTITUDE": [{"yaw": rng.choice([math.nan, math.inf, 4.0])}],
        "GLOBAL_POSITION_INT": [{"lat": 0, "lon": 0}, {"hdg": 65_535}, {"lat": 910_000_000}],
        "GPS_RAW_INT": [
            *({"fix_type": 1}, {"yaw": 9000}, {"vel": 65_535}, {"lat": 910_000_000}),
            *({"h_acc": 0, "eph": rng.choice([0, 20, 121])}, {"alt_ellipsoid": -(1 << 31)}),
        ],
    }
    return [{stamp: rng.choice(stamps)}, *said[name], {}]


def disturbed(seed):
    """Yield the same with messages that are odd: in stamp, content, sender, number and bytes."""
    rng = random.Random(seed)
    stranger, frozen = Sender(7, 1), None
    for t_ns, frames in flown():
        for data in frames:
            (frame,) = Splitter().feed(data)
            odd, layout = rng.random(), LAYOUTS[frame.message_id]
            if layout.name not in READ or odd > 0.1:
                yield t_ns, data
                continue
            m = unpack(frame)
            said = m._replace(**rng.choice(oddities(layout.name, m, rng)))
            if layout.name == "HIGHRES_IMU":
                if odd < 0.01:
                    frozen = said if frozen is None else None
                if frozen is not None:
                    said = frozen._replace(time_usec=m.time_usec)
            sender = stranger if odd > 0.09 else Sender(frame.system_id, frame.component_id)
            sender.sequence = frame.sequence
            data = sender.frame(layout.name, layout.struct.pack(*said), t_ns)
            if 0.08 < odd < 0.09:
                place = rng.randrange(len(data))
                data = (
                    data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
                )
            yield t_ns, data
            if 0.07 < odd < 0.08:
                yield t_ns, data


def told(companion, flight, *, is_torn):
    """Return all that a companion says of a flight, given datagrams or, torn, a stream."""
    said = []
    for i, (t_ns, data) in enumerate(flight):
        pieces = (data[:3], data[3:]) if is_torn else (data,)
        for piece in pieces:
            companion.receive(piece, t_ns)
        if i % 12 == 0:  # as often as the daemon: between two, nothing is looked up anew
            companion.tick(t_ns)
        said += companion.data_to_send()
    return said


def ended(companion):
    """Return what a companion has counted, noted and estimated."""
    session, pipeline = companion.session, companion.pipeline
    assert pipeline is not None
    counted = session.counters(), session.received, session.heard, session.believed
    learnt = session.decoder.refused, session.ignored, pipeline.health(), pipeline.state().block
    return repr((*counted, session.received_bytes, session.splitter.frames, *learnt))


@pytest.mark.parametrize("seed", range(6))
def test_odd_messages_are_read_as_by_the_session(seed):
    flight = list(disturbed(seed))
    whole, torn = Companion(STREAMING, is_recording=True), Companion(STREAMING, is_recording=True)
    assert told(whole, flight, is_torn=False) == told(torn, flight, is_torn=True)
    assert ended(whole) == ended(torn)
    assert whole.session.outbox.take_record() == torn.session.outbox.take_record()


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize(("name", "least"), [("HIGHRES_IMU", 500), ("GPS_RAW_INT", 10)])
def test_plain_samples_and_fixes_are_not_left_to_the_session(kind, name, least):
    companion, left, begin_ns = Companion(STREAMING), [], None
    number = IDS[name].to_bytes(3, "little")
    for t_ns, frames in flown(kind, duration=8.0):
        begin_ns = begin_ns or t_ns
        for data in frames:
            # Until the autopilot's answers are there, the session needs each frame
            if t_ns - begin_ns > GUARDED_NS and data[7:10] == number:
                left.append(companion.reader.read_datagram(data, t_ns, None) is None)
            else:
                companion.receive(data, t_ns)
        companion.tick(t_ns)
    assert len(left) > least
    assert not any(left)


def overtaken(count):
    """Yield stamp and frame of a flight; each second a sample comes before as many others."""
    waiting, number, others = [], 0, Sender(1, 1)
    for t_ns, frames in flown():
        for data in frames:
            (frame,) = Splitter().feed(data)
            if data[7:10] == NUMBER:
                number += 1
                m, layout = unpack(frame), LAYOUTS[frame.message_id]
                new = {"fields_updated": 0x3FF, "xmag": 0.2 + 1e-6 * number}
                said = m._replace(**new, abs_pressure=950.0 + 1e-3 * number)
                others.sequence = frame.sequence
                data = others.frame(layout.name, layout.struct.pack(*said))
                if 0 <= number % 250 - 200 <= count:
                    waiting.append(data)
                    if number % 250 - 200 < count:
                        continue
                    waiting, data = waiting[:-1], waiting[-1]
            yield t_ns, data
            if number % 250 - 200 == count:
                yield from ((t_ns, one) for one in waiting)
                waiting = []


def test_of_samples_that_wait_for_one_that_overtook_them_none_is_lost():
    """They are more rows than the reader has room for at first."""
    flight = list(overtaken(24))
    whole, torn = Companion(STREAMING), Companion(STREAMING)
    assert told(whole, flight, is_torn=False) == told(torn, flight, is_torn=True)
    assert ended(whole) == ended(torn)


class Patient:
    """Receives as the daemon does: what may wait is received with what comes next."""

    def __init__(self, companion):
        self.companion, self.waiting, self.waited = companion, [], 0

    def receive(self, data, t_ns):
        self.waiting.append((data, t_ns))
        if self.companion.may_wait(data):
            self.waited += 1
        else:
            self.catch_up()

    def catch_up(self):
        for data, t_ns in self.waiting:
            self.companion.receive(data, t_ns)
        self.waiting = []


@pytest.mark.parametrize("kind", list(Kind))
def test_what_may_wait_delays_no_message(kind):
    prompt, patient = Companion(STREAMING), Patient(Companion(STREAMING))
    said, count = [], 0
    for t_ns, frames in flown(kind):
        for data in frames:
            count += 1
            prompt.receive(data, t_ns)
            patient.receive(data, t_ns)
            said.append(prompt.data_to_send())
            assert patient.companion.data_to_send() == said[-1]
        if count % 12 == 0:
            patient.catch_up()
            for companion in (prompt, patient.companion):
                companion.tick(t_ns)
    patient.catch_up()
    assert ended(patient.companion) == ended(prompt)
    assert sum(map(len, said)) > 100
    assert patient.waited > 0.5 * count


@pytest.mark.parametrize("name", ["TIMESYNC", "COMMAND_LONG", "HEARTBEAT", "PARAM_VALUE"])
def test_what_may_be_answered_does_not_wait(name):
    companion = Companion(STREAMING)
    for t_ns, frames in flown(duration=8.0):
        for data in frames:
            companion.receive(data, t_ns)
        companion.tick(t_ns)
    assert companion.may_wait(Sender(1, 1).message("ATTITUDE", time_boot_ms=t_ns // 1_000_000))
    assert not companion.may_wait(Sender(1, 1).message(name))


def test_nothing_waits_before_there_is_an_autopilot():
    assert not Companion(STREAMING).may_wait(Sender(1, 1).message("HIGHRES_IMU", time_usec=1))


def test_a_sample_waits_no_longer_than_others_allow():
    companion = Companion(STREAMING)
    for t_ns, frames in flown(duration=8.0):
        for data in frames:
            if data[7:10] == NUMBER and companion.may_wait(data):
                (frame,) = Splitter().feed(data)
                stamp_ns = unpack(frame).time_usec * 1000
                assert companion.may_wait(data, stamp_ns + 1)
                assert not companion.may_wait(data, stamp_ns)
                return
            companion.receive(data, t_ns)
        companion.tick(t_ns)
    pytest.fail("no sample may wait")


def test_frames_that_waited_have_room_whatever_their_number():
    """A sample that freed just as many rows as the buffer had wrote its own ones behind it."""
    companion = Companion(STREAMING)
    reader, decoder = companion.reader, companion.session.decoder
    numbers = [*range(55, 72), *range(120, 140)]
    one = HeadingSample(t_ns=0, heading=0.1, std=0.1, source=HeadingSource.AUTOPILOT)
    for t_ns, frames in flown(duration=16.0):
        for data in frames:
            is_sample = data[7:10] == NUMBER
            if t_ns < 8_000_000_000 or not is_sample or not numbers:
                companion.receive(data, t_ns)
                continue
            decoder.held = [(Splitter().feed(data)[0], [one])] * numbers[0]
            rows = reader.read_datagram(data, t_ns, None)
            if rows is None:  # not plainly the next sample: the session reads it
                decoder.held = []
                companion.receive(data, t_ns)
                continue
            assert len(rows) > numbers.pop(0)
            assert reader.n <= len(reader.buffer.t_ns)
    assert not numbers
