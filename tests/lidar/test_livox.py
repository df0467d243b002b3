"""Datagrams and commands of a Livox."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.lidar import livox, livox_command
from ekf_companion.lidar.livox import Refusal
from sim_autopilot.lidar.device import Device
from sim_autopilot.lidar.livox import datagrams
from tests.lidar.recordings import small


def packet(kind, data, *, count=1, interval=0, number=0, t_ns=1, length=None):
    """Write a datagram by the table of the protocol: 24 bytes, CRC-32, time, data."""
    checked = struct.pack("<Q", t_ns) + data
    length = 36 + len(data) if length is None else length
    head = struct.pack("<BHHHHBBB", 0, length, interval, count, number, 0, kind, 0) + bytes(12)
    return head + struct.pack("<I", crc32(checked)) + checked


def test_the_layout_is_that_of_the_protocol():
    data = struct.pack("<iiiBB", 1000, -2000, 3000, 9, 0) + struct.pack("<iiiBB", 4, 5, 6, 9, 0)
    found = livox.decode(packet(1, data, count=2, interval=200, number=7, t_ns=5_000))
    assert isinstance(found, livox.Points)
    assert (found.number, found.end_ns) == (7, 5_000 + 20_000)
    scan = livox.scan_of([found], 1_000)
    assert scan.stamp == 4e-6
    assert list(scan.times) == [0.0, 1e-5]  # 20 us over two points
    assert scan.points.tolist() == [[1.0, -2.0, 3.0], [0.004, 0.005, 0.006]]


@pytest.mark.parametrize(
    ("kind", "point", "expected"),
    [
        (2, struct.pack("<hhhBB", 100, -200, 50, 9, 0), (1.0, -2.0, 0.5)),
        (3, struct.pack("<IHHBB", 2000, 9000, 9000, 9, 0), (0.0, 2.0, 0.0)),
    ],
)
def test_other_kinds_of_points_are_metres_too(kind, point, expected):
    found = livox.decode(packet(kind, point))
    millimetres = livox.decode(packet(1, struct.pack("<iiiBB", 7, 8, 9, 0, 0), t_ns=2))
    points = livox.scan_of([found, millimetres], 0).points
    assert points[0] == pytest.approx(expected, abs=1e-12)
    assert points[1].tolist() == [0.007, 0.008, 0.009]


def test_what_no_lidar_has_sent_so_is_refused_with_the_reason():
    data = struct.pack("<iiiBB", 1, 2, 3, 0, 0)
    good = packet(1, data)
    assert isinstance(livox.decode(good), livox.Points)
    for place in range(24, len(good)):  # of what the CRC covers every bit counts, and of its own
        wrong = good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :]
        assert livox.decode(wrong) is Refusal.CRC, place
    assert livox.decode(good[:-1]) is Refusal.CUT
    assert livox.decode(good + b"\0") is Refusal.CUT
    assert livox.decode(good[:30]) is Refusal.CUT
    assert livox.decode(packet(1, data, count=2)) is Refusal.CUT
    assert livox.decode(packet(1, data, count=0)) is Refusal.CUT
    assert livox.decode(packet(4, data)) is Refusal.KIND
    assert livox.decode(packet(0, struct.pack("<6f", np.nan, 0, 0, 0, 0, 1))) is Refusal.NUMBERS


def test_a_simulated_mid_360_is_decoded_to_its_scans_and_samples():
    flown = small()
    assembler, scans, samples = livox.Assembler(), [], []
    for _, port, datagram in datagrams(flown, begin_ns=7_000_000_000):
        found = livox.decode(datagram)
        if port == livox.POINT_PORT:
            assert isinstance(found, livox.Points)
            if ended := assembler.add(found):
                scans.append(livox.scan_of(ended, 0))
        else:
            assert isinstance(found, livox.Inertial)
            samples.append(found)
    assert len(samples) == len(flown.imu_stamp)
    assert samples[9].t_ns == 7_000_000_000 + round(flown.imu_stamp[9] * 1e9)
    assert np.allclose([one.accel for one in samples], flown.accel, rtol=1e-6)
    assert np.array_equal([one.gyro for one in samples], flown.gyro)
    points = np.concatenate([scan.points for scan in scans])
    assert np.allclose(points, flown.xyz[: len(points)] * 0.003, rtol=0, atol=1e-12)
    assert len(flown.xyz) - len(points) <= 2 * 1200  # the last scan waits for its end
    assert np.diff([scan.stamp for scan in scans]) == pytest.approx(0.1, abs=0.02)
    assert all((scan.times >= 0).all() and scan.times.max() < 0.12 for scan in scans)
    assert (assembler.late, assembler.lost, assembler.repeated) == (0, 0, 0)


def points_at(t_ns, number=0):
    return livox.Points(t_ns, 0, 1, number, 1, struct.pack("<iiiBB", 1, 2, 3, 0, 0))


def test_a_late_datagram_is_counted_and_left_out():
    assembler = livox.Assembler()
    assert assembler.add(points_at(1_000_000_000)) == []
    (one,) = assembler.add(points_at(1_100_000_000))
    assert one.t_ns == 1_000_000_000
    assert assembler.add(points_at(1_050_000_000)) == []
    assert assembler.late == 1
    # A lidar that was switched off and on begins its clock anew
    assert assembler.add(points_at(1_000)) == []
    (one,) = assembler.add(points_at(100_000_001))
    assert one.t_ns == 1_000


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [
        ([5, 6, 7], 0),
        ([5, 7, 8], 1),
        ([65534, 65535, 0, 1], 0),
        ([65534, 2], 3),
        ([100, 101, 0, 1], 0),  # a frame begins, as the protocol has it
        ([100, 101, 2, 3], 2),
    ],
)
def test_lost_datagrams_are_counted_by_their_numbers(numbers, lost):
    assembler = livox.Assembler()
    for k, number in enumerate(numbers):
        assembler.add(points_at(10_000_000_000 + k, number))
    assert assembler.lost == lost


def test_what_was_overtaken_is_not_lost_and_what_comes_twice_counts_once():
    assembler = livox.Assembler()
    for t_ns, number in ((10, 5), (12, 7), (11, 6), (13, 8), (13, 8)):
        assembler.add(points_at(10_000_000_000 + t_ns, number))
    assert (assembler.lost, assembler.repeated) == (0, 1)
    ended = assembler.add(points_at(10_100_000_000, 9))
    assert [one.number for one in ended] == [5, 6, 7, 8]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.booleans(), st.integers(0, 6))
def test_any_bytes_are_decoded_or_refused(data, is_headed, kind):
    found = livox.decode(packet(kind, data, count=3, interval=100) if is_headed else data)
    assert isinstance(found, livox.Points | livox.Inertial | Refusal)


# Commands


def test_the_command_is_that_of_the_protocol():
    said = livox_command.configure(7, "192.168.1.5", 56301, 56401)
    assert said[:4] == struct.pack("<BBH", 0xAA, 0, len(said))
    assert said[4:12] == struct.pack("<IHBB", 7, 0x0100, 0, 0)
    assert struct.unpack("<H", said[18:20])[0] == crc_hqx(said[:18], 0xFFFF)
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1  # CRC-16/CCITT-FALSE
    assert struct.unpack("<I", said[20:24])[0] == crc32(said[24:])
    assert said[24:28] == struct.pack("<HH", 5, 0)
    host = struct.pack("<HHBBBBHH", 6, 8, 192, 168, 1, 5, 56301, 56300)
    assert said[28:40] == host
    assert said.endswith(struct.pack("<HHB", 0x001A, 1, 1))


def test_the_simulated_lidar_takes_it_and_answers():
    lidar = Device(small(), "127.0.0.1")
    said = livox_command.configure(9, "127.0.0.1", 5001, 5002)
    answer = lidar.command(said)
    assert livox_command.read_answer(answer, 9) == ""
    assert livox_command.read_answer(answer, 8) is None
    assert lidar.refused == []
    unknown = livox_command.frame(9, 0x0100, struct.pack("<HHHHB", 1, 0, 0x0099, 1, 0))
    words = livox_command.read_answer(lidar.command(unknown), 9)
    assert words == "a parameter that it does not know (parameter 0x0099)"
    for place in range(len(answer)):
        wrong = answer[:place] + bytes([answer[place] ^ 4]) + answer[place + 1 :]
        assert livox_command.read_answer(wrong, 9) is None
    for place in range(len(said)):
        assert lidar.command(said[:place] + bytes([said[place] ^ 4]) + said[place + 1 :]) is None
    lidar._socket.close()


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes_are_an_answer_or_none(data):
    assert livox_command.read_answer(data, 1) is None
