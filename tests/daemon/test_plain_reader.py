"""The recording as pymavlink's own reader sees it: a stamp and a whole frame, again and again."""

from __future__ import annotations

from collections import Counter

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.session import Session, SessionOptions
from tests.engine.recorded import frames

PX4 = "sitl-px4-flown-on-odometry"
CUT = (290, 291, 441, 245)
"""Messages whose frames PX4 1.18 cut over two datagrams in that flight, by its README."""


def datagrams(stream: list[tuple[int, bytes]], size: int = 1400) -> list[tuple[int, bytes]]:
    """Return frames as PX4 sends them: buffers of a size, that end inside a frame."""
    found, waiting = [], b""
    for now_ns, frame in stream:
        waiting += frame
        while len(waiting) >= size:
            found.append((now_ns, waiting[:size]))
            waiting = waiting[size:]
    return found


def message_id(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Half a minute of that flight, recorded from datagrams that cut frames, with some noise."""
    stream = [one for one in frames(PX4)[:16_000] if one[1][0] == 0xFD]
    session = Session(SessionOptions(is_recording=True))
    record = []
    for count, (now_ns, data) in enumerate(datagrams(stream)):
        session.receive(data, now_ns, ("127.0.0.1", 14580))
        if count % 50 == 0:
            session.receive(b"\xfd\x30static", now_ns, ("127.0.0.1", 9))
        record += session.outbox.take_record()
    path = tmp_path_factory.mktemp("recording") / "flight.tlog"
    path.write_bytes(b"".join(us.to_bytes(8, "big") + frame for us, frame in record))
    return stream, session, path


def test_a_link_without_loss_counts_none_whatever_firmware_sends(recording):
    """5 % of the frames seemed to be lost where nine messages had no definition here."""
    stream, session, _ = recording
    counts = session.counters()
    assert counts["unknown_id"] > 0.03 * len(stream)
    assert {message_id(frame) for _, frame in stream} & set(CUT) - set(IDS.values())
    assert counts["lost"] == counts["late"] == counts["bad_crc"] == 0
    assert counts["junk_bytes"] < 1000


def test_each_record_is_a_whole_frame_to_pymavlinks_plain_reader(recording):
    """Of a recording with halves of frames it lost 14 % of HIGHRES_IMU."""
    stream, _, path = recording
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    read: Counter[int] = Counter()
    while (message := log.recv_msg()) is not None:
        assert message.get_type() != "BAD_DATA"
        read[message.get_msgId()] += 1
    log.close()
    sent = Counter(message_id(frame) for _, frame in stream)
    known = set(ardupilotmega.mavlink_map)
    unknown = sum(count for number, count in sent.items() if number not in known)
    expected = {number: count for number, count in sent.items() if number in known} | {-2: unknown}
    assert expected[IDS["HIGHRES_IMU"]] > 5000
    assert unknown > 500
    for number, count in expected.items():
        # the last datagram was not full
        assert count - 10 <= read[number] <= count
