"""Fields against pymavlink's decoder, for every message of the dialect."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.codec import Sender, pack, unpack
from ekf_companion.mavlink.frame import Frame, Splitter
from ekf_companion.mavlink.messages import LAYOUTS


def same(ours, theirs):
    if isinstance(ours, bytes):
        # pymavlink strips only the zeros at the end, and turns text into str
        return ours.decode("ascii", "replace") == str(theirs).split("\0")[0] or not ours.isascii()
    if isinstance(ours, tuple):
        return all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    return ours == theirs or (math.isnan(ours) and math.isnan(theirs))


@given(st.sampled_from(sorted(LAYOUTS)), st.data())
@settings(deadline=None, max_examples=300)
def test_fields_are_what_pymavlink_reads(message_id, data):
    layout = LAYOUTS[message_id]
    payload = data.draw(st.binary(min_size=layout.size, max_size=layout.size))
    raw = Sender(1, 1).frame(LAYOUTS[message_id].name, payload)
    (frame,) = Splitter().feed(raw)
    ours = unpack(frame)
    theirs = dialect.MAVLink(None).decode(bytearray(raw))
    for name in theirs.ordered_fieldnames:
        assert same(getattr(ours, name), getattr(theirs, name)), name

    if not layout.has_text:
        # Floats go through Python's double and back without loss, but a signalling NaN is quieted
        again = unpack(frame._replace(payload=pack(layout.name, **ours._asdict())))
        assert same(tuple(again), tuple(ours))


@given(st.lists(st.binary(max_size=70), max_size=5))
@settings(deadline=None, max_examples=50)
def test_columns_hold_what_single_messages_do(payloads):
    layout = LAYOUTS[105]
    whole = b"".join(payload.ljust(layout.size, b"\0")[: layout.size] for payload in payloads)
    for payload, record in zip(payloads, np.frombuffer(whole, layout.dtype), strict=True):
        single = unpack(Frame(105, 1, 1, 0, payload, b"", 2))
        assert same(tuple(single), tuple(record.item()))


def test_missing_extension_bytes_read_as_zero():
    assert unpack(Frame(24, 1, 1, 0, bytes(range(1, 31)), b"", 1)).yaw == 0


def test_a_field_that_does_not_exist_is_refused_by_name():
    with pytest.raises(TypeError, match="HEARTBEAT has no field colour"):
        pack("HEARTBEAT", colour=3)


def test_an_array_of_the_wrong_length_is_refused():
    with pytest.raises(TypeError, match="ODOMETRY"):
        pack("ODOMETRY", q=[1.0, 0.0, 0.0])


def test_the_sequence_counts_every_frame_and_wraps():
    sender, splitter = Sender(1, 194), Splitter()
    data = b"".join(sender.message("HEARTBEAT", type=18, autopilot=8) for _ in range(258))
    found = splitter.feed(data)
    assert [frame.sequence for frame in found] == [n & 0xFF for n in range(258)]
    assert {(frame.system_id, frame.component_id) for frame in found} == {(1, 194)}
