from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.lidar import livox
from sim_autopilot.lidar.livox import datagrams
from tests.lidar.recordings import small


def test_the_layout_is_that_of_the_header():
    """Offsets of LivoxLidarEthernetPacket, packed: 24 bytes, CRC, time."""
    data = struct.pack("<iiiBB", 1000, -2000, 3000, 9, 0) + struct.pack("<iiiBB", 4, 5, 6, 9, 0)
    head = bytes(range(1)) + struct.pack("<HHHH", 36 + len(data), 200, 2, 7) + bytes((1, 1, 0))
    packet = head + bytes(12) + struct.pack("<I", 99) + struct.pack("<Q", 5_000) + data
    assert livox.HEAD.size == 36
    found = livox.decode(packet)
    assert isinstance(found, livox.Points)
    assert list(found.t_ns) == [5_000, 5_000 + 10_000]  # 20 us over two points
    assert found.points.tolist() == [[1.0, -2.0, 3.0], [0.004, 0.005, 0.006]]


@pytest.mark.parametrize(
    ("kind", "point", "expected"),
    [
        (2, struct.pack("<hhhBB", 100, -200, 50, 9, 0), (1.0, -2.0, 0.5)),
        (3, struct.pack("<IHHBB", 2000, 9000, 9000, 9, 0), (0.0, 2.0, 0.0)),
    ],
)
def test_other_kinds_of_points_are_metres_too(kind, point, expected):
    packet = livox.HEAD.pack(0, 36 + len(point), 0, 1, 0, 0, kind, 0, 0, 1) + point
    found = livox.decode(packet)
    assert isinstance(found, livox.Points)
    assert found.points[0] == pytest.approx(expected, abs=1e-12)


def test_a_simulated_mid_360_is_decoded_to_its_scans_and_samples():
    flown = small()
    assembler, scans, samples = livox.Assembler(), [], []
    for _, port, datagram in datagrams(flown, begin_ns=7_000_000_000):
        found = livox.decode(datagram)
        if port == livox.POINT_PORT:
            assert isinstance(found, livox.Points)
            scans.extend(assembler.add(found))
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
    assert assembler.late == 0


def test_a_late_datagram_is_counted_and_left_out():
    def at(t_ns):
        return livox.Points(np.array([t_ns]), np.ones((1, 3)))

    assembler = livox.Assembler()
    assert list(assembler.add(at(1_000_000_000))) == []
    (scan,) = assembler.add(at(1_100_000_000))
    assert scan.stamp == 1.0
    assert list(assembler.add(at(1_050_000_000))) == []
    assert assembler.late == 1
    # A lidar that was switched off and on begins its clock anew
    assert list(assembler.add(at(1_000))) == []
    (scan,) = assembler.add(at(100_000_001))
    assert scan.stamp == pytest.approx(1e-6)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_decoded_or_none(data, is_headed):
    head = livox.HEAD.pack(0, 36 + len(data), 100, 3, 0, 0, 1, 0, 0, 1)
    found = livox.decode(head + data if is_headed else data)
    assert found is None or isinstance(found, livox.Points | livox.Inertial)
