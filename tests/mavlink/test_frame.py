"""The splitter against pymavlink, on whole, cut, damaged and mixed streams."""

from itertools import pairwise

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings
from pymavlink.dialects.v10 import ardupilotmega as dialect_1
from pymavlink.dialects.v20 import ardupilotmega as dialect_2

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import (
    LARGEST_FRAME,
    LARGEST_REST,
    UNKNOWN,
    Splitter,
)
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.sequence import Sequence

IDS_1 = sorted(dialect_1.mavlink_map)
IDS_2 = sorted(dialect_2.mavlink_map)


def pymavlink_frame(message_id, payload, sequence, *, version, key=None):
    """Return the frame that pymavlink would send for a payload."""
    dialect = dialect_2 if version == 2 else dialect_1
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.seq = sequence
    if key is not None:
        mav.signing.secret_key = key
        mav.signing.sign_outgoing = True
        mav.signing.link_id = 3
        mav.signing.timestamp = 1
    definition = dialect.mavlink_map[message_id]
    payload = payload.ljust(definition.unpacker.size, b"\0")[: definition.unpacker.size]
    message = dialect.MAVLink_message(message_id, definition.msgname)
    return bytes(message._pack(mav, definition.crc_extra, payload))


@st.composite
def frames(draw):
    version = draw(st.sampled_from([1, 2]))
    message_id = draw(st.sampled_from(IDS_2 if version == 2 else IDS_1))
    key = draw(st.sampled_from([None, bytes(32)])) if version == 2 else None
    payload = draw(st.binary(max_size=LAYOUTS[message_id].size))
    return pymavlink_frame(message_id, payload, draw(st.integers(0, 255)), version=version, key=key)


def cut(data, places):
    edges = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


def raws(found):
    return [frame.raw for frame in found if frame.message_id >= 0]


def feed_all(pieces):
    splitter = Splitter()
    return splitter, [frame for piece in pieces for frame in splitter.feed(piece)]


@given(st.lists(frames(), max_size=8), st.lists(st.integers(0, 4000), max_size=10))
@settings(deadline=None, max_examples=150)
def test_any_cut_of_a_clean_stream_gives_every_frame_as_pymavlink_does(stream, places):
    splitter, found = feed_all(cut(b"".join(stream), places))
    assert [frame.raw for frame in found] == stream
    assert splitter.frames == len(stream)
    assert splitter.bad_crc == splitter.junk_bytes == splitter.unknown_id == 0

    for frame in found:
        mav = (dialect_2 if frame.version == 2 else dialect_1).MAVLink(None)
        theirs = mav.decode(bytearray(frame.raw))
        assert frame.message_id == theirs.get_msgId()
        assert frame.sequence == theirs.get_seq()
        assert (frame.system_id, frame.component_id) == (1, 1)


@given(
    st.lists(st.one_of(frames(), st.binary(min_size=1, max_size=40)), max_size=8),
    st.lists(st.integers(0, 4000), max_size=10),
)
@settings(deadline=None, max_examples=150)
def test_every_byte_comes_out_once_and_in_order_however_the_stream_is_cut(parts, places):
    data = b"".join(parts) + bytes(LARGEST_REST)  # zeros start nothing: all is decided
    whole, found = feed_all([data])
    pieces, again = feed_all(cut(data, places))
    assert b"".join(frame.raw for frame in found) == data
    assert b"".join(frame.raw for frame in again) == data
    assert raws(found) == raws(again)
    for counter in ("frames", "bad_crc", "incompatible", "unknown_id", "junk_bytes"):
        assert getattr(whole, counter) == getattr(pieces, counter)


@given(st.lists(frames(), min_size=1, max_size=6), st.data())
@settings(deadline=None, max_examples=150)
def test_garbage_between_frames_costs_no_frame(stream, data):
    # Garbage may itself be a frame only by a right checksum, which these bytes are too short for
    garbage = st.binary(max_size=7)
    parts = [part for frame in stream for part in (data.draw(garbage), frame)]
    _, found = feed_all([*parts, bytes(LARGEST_FRAME)])
    kept = raws(found)
    assert [raw for raw in kept if raw in stream] == stream


@given(st.binary(max_size=3000), st.lists(st.integers(0, 3000), max_size=5))
@settings(deadline=None, max_examples=100)
def test_noise_never_raises_and_never_piles_up(noise, places):
    _, found = feed_all(cut(noise, places))
    assert len(noise) - sum(len(frame.raw) for frame in found) <= LARGEST_REST


@pytest.mark.parametrize("flipped", [0x10, 0x40])
def test_a_damaged_frame_costs_only_itself(flipped):
    good = [pymavlink_frame(30, bytes([n] * 28), n, version=2) for n in range(1, 6)]
    for place in range(len(good[2])):
        damaged = bytearray(good[2])
        damaged[place] ^= flipped  # the length too, shorter and longer
        data = b"".join([*good[:2], bytes(damaged), *good[3:], bytes(LARGEST_FRAME)])
        _, found = feed_all([data])
        assert raws(found) == [*good[:2], *good[3:]]


def unknown_frame(size, sequence=7, payload=b""):
    """Return a frame of no known message, filled up with what looks like starts."""
    header = b"\xfd" + bytes([size, 0, 0, sequence, 1, 1, 0xEE, 0xEE, 0x33])
    return header + payload.ljust(size + 2, b"\xfe")


def test_a_frame_of_unknown_id_is_whole_and_not_searched_while_the_framing_holds():
    """Its payload is full of what looks like starts; newer firmware sends many such messages."""
    good = [pymavlink_frame(30, bytes(range(28)), n, version=2) for n in (6, 8, 10)]
    hidden = unknown_frame(60, 9, payload=good[0])
    stream = [good[0], unknown_frame(20), good[1], hidden, unknown_frame(0, 9), good[2]]
    for data in ([b"".join(stream)], [bytes([byte]) for byte in b"".join(stream)]):
        splitter, found = feed_all(data)
        assert [frame.raw for frame in found] == stream
        assert [f.message_id for f in found] == [30, UNKNOWN, 30, UNKNOWN, UNKNOWN, 30]
        assert [f.sequence for f in found] == [6, 7, 8, 9, 9, 10]
        assert {frame[1:3] for frame in found} == {(1, 1)}
        assert (splitter.unknown_id, splitter.frames) == (3, 3)
        assert splitter.bad_crc == splitter.junk_bytes == 0


@pytest.mark.parametrize(
    "behind",
    [
        bytes(20),  # no start byte
        b"\xfd" + bytes([9, 0x40, 0, 0, 1, 1, 30, 0, 0]) + bytes(30),  # an unknown flag
        b"\xfd" + bytes([9, 0, 0, 0, 7, 7, 0xEE, 0xEE, 0x33]) + bytes(30),  # unknown, another's
        b"\xfd" + bytes([200, 0, 0, 0, 7, 7, 30, 0, 0]) + bytes(30),  # longer than that message is
    ],
)
def test_without_a_header_behind_it_a_frame_of_unknown_id_is_junk(behind):
    good = pymavlink_frame(30, bytes(range(28)), 0, version=2)
    data = good + unknown_frame(20) + behind + bytes(LARGEST_REST)
    splitter, found = feed_all([data])
    assert raws(found) == [good]
    assert splitter.unknown_id == 0
    assert splitter.junk_bytes == len(data) - len(good)


def test_behind_damage_a_frame_of_unknown_id_is_searched_and_hides_nothing():
    good = pymavlink_frame(30, bytes(range(28)), 0, version=2)
    data = good + b"static" + unknown_frame(60, payload=good) + good * 2
    splitter, found = feed_all([data, bytes(LARGEST_REST)])
    assert raws(found) == [good] * 4
    assert splitter.unknown_id == 0


def test_a_false_start_with_an_unknown_id_hides_no_frame_behind_it():
    good = pymavlink_frame(30, bytes(range(28)), 0, version=2)
    splitter, found = feed_all([unknown_frame(60)[:12] + good * 3, bytes(LARGEST_REST)])
    assert raws(found) == [good] * 3
    assert splitter.unknown_id == 0


def test_sequence_numbers_count_for_frames_whose_checksum_nobody_can_test():
    sequence = Sequence()
    for number in (5, 7, 9):
        sequence.count(number, 0)
        sequence.count_unverified(number + 1, 0)
    assert sequence.lost == 0
    sequence.count_unverified(12, 0)
    assert sequence.lost == 1
    # One that is far off is more likely damage than a loss of so many
    sequence.count_unverified(100, 0)
    sequence.count(13, 0)
    assert (sequence.lost, sequence.late) == (1, 0)


def test_an_unknown_incompatibility_flag_drops_the_frame():
    mav = dialect_2.MAVLink(None, srcSystem=1, srcComponent=1)
    good = pymavlink_frame(30, bytes(range(28)), 0, version=2)
    foreign = bytearray(good)
    foreign[2] = 0x02
    crc = mav_crc(foreign[1:-2], 30)
    foreign[-2:] = crc.to_bytes(2, "little")
    splitter, found = feed_all([bytes(foreign), good])
    assert raws(found) == [good]
    assert splitter.incompatible == 1
    assert mav.total_receive_errors == 0


def mav_crc(body, message_id):
    crc = dialect_2.x25crc(bytes(body))
    crc.accumulate(bytes([LAYOUTS[message_id].crc_extra]))
    return crc.crc


@given(st.sampled_from(IDS_2), st.binary(max_size=255), st.integers(0, 255), st.integers(0, 255))
@settings(deadline=None, max_examples=100)
def test_an_encoded_frame_is_what_pymavlink_sends(message_id, payload, sequence, component):
    payload = payload.ljust(LAYOUTS[message_id].size, b"\0")[: LAYOUTS[message_id].size]
    sender = Sender(1, component)
    sender.sequence = sequence
    ours = sender.frame(LAYOUTS[message_id].name, payload)
    mav = dialect_2.MAVLink(None, srcSystem=1, srcComponent=component)
    mav.seq = sequence
    definition = dialect_2.mavlink_map[message_id]
    message = dialect_2.MAVLink_message(message_id, definition.msgname)
    assert ours == bytes(message._pack(mav, definition.crc_extra, payload))
