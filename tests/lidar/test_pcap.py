from __future__ import annotations

import struct

import numpy as np
import pytest

from ekf_companion.errors import LogError, MissingPackageError
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.readers.pcap import open_pcap
from tests.paths import DATA

FIRING = 55.296e-6
"""s, of the sixteen lasers of a VLP-16."""


def write_velodyne(path, turns: int, reach: float) -> None:
    """Write packets of a VLP-16 in a round room: every laser measures the same distance."""
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        step = 36000 * FIRING / 0.1
        for packet in range(int(turns * 0.1 / FIRING / 24)):
            begin = packet * 24 * FIRING
            blocks = b"".join(
                struct.pack("<HH", 0xEEFF, int((packet * 24 + 2 * block) * step) % 36000)
                + struct.pack("<HB", round(reach / 0.002), 50) * 32
                for block in range(12)
            )
            body = blocks + struct.pack("<IBB", int(begin * 1e6), 0x37, 0x22)
            udp = struct.pack(">HHHH", 2368, 2368, 8 + len(body), 0)
            ip = struct.pack(
                ">BBHHHBBHII", 0x45, 0, 28 + len(body), 0, 0, 64, 17, 0, 0x7F000001, 0x7F000001
            )
            frame = b"\0" * 12 + b"\x08\0" + ip + udp + body
            stamp = 1000.0 + begin
            head = struct.pack("<IIII", int(stamp), int(stamp % 1 * 1e6), len(frame), len(frame))
            file.write(head + frame)


def write_inertial(path) -> None:
    lines = [f"{1000 + k * 0.005},0,0,0,0,0,9.8{k % 2}" for k in range(200)]
    path.write_text("\n".join(["stamp,wx,wy,wz,ax,ay,az", *lines]))


def test_packets_of_a_velodyne_are_read_with_their_times(tmp_path):
    pytest.importorskip("velodyne_decoder", reason="the extra `velodyne` is not installed")
    path = tmp_path / "room.pcap"
    write_velodyne(path, 6, 8.0)
    write_inertial(tmp_path / "imu.csv")
    recording = read(path)
    scans = list(recording.scans)
    assert len(scans) >= 5
    for scan in scans[1:-1]:
        # 2 mm is a step of the distance; the lasers stand up to 4 cm off the centre
        assert np.linalg.norm(scan.points, axis=1) == pytest.approx(8.0, abs=0.05)
        assert np.ptp(scan.times) == pytest.approx(0.1, abs=0.003)
    assert np.diff([scan.stamp for scan in scans[1:-1]]) == pytest.approx(0.1, abs=0.003)
    assert any("a Velodyne VLP16" in words for words in recording.decisions)


def test_another_pcap_is_refused_by_name(tmp_path):
    pytest.importorskip("velodyne_decoder", reason="the extra `velodyne` is not installed")
    path = tmp_path / "other.pcap"
    path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
    with pytest.raises(LogError, match=r"no packets of a Velodyne.*other\.json"):
        read(path)
    path.write_bytes(b"no pcap at all")
    with pytest.raises(LogError, match=r"other\.pcap"):
        read(path)


def test_without_the_decoder_the_extra_is_named(tmp_path):
    try:
        import ouster.sdk  # noqa: F401
    except ImportError:
        path = tmp_path / "o.pcap"
        path.write_bytes(b"")
        path.with_suffix(".json").write_text("{}")
        with pytest.raises(MissingPackageError, match=r"ekf-companion\[ouster\]"):
            read(path)


@pytest.mark.parametrize("path", sorted(DATA.glob("ouster*/*.pcap")) or [None])
def test_recordings_of_ouster_decode_as_its_sdk_says(path):
    if path is None:
        pytest.skip(f"no recordings of Ouster's tests in {DATA}/ouster*")
    core = pytest.importorskip("ouster.sdk.core", reason="the extra `ouster` is not installed")
    from ouster.sdk import open_source

    source = open_source(str(path), meta=[str(path.with_suffix(".json"))])
    to_points = core.XYZLut(source.sensor_info[0])
    for frames, scan in zip(source, open_pcap(path, None).scans(), strict=True):
        valid = (frames[0].status & 1).astype(bool)
        assert np.array_equal(scan.points, to_points(frames[0])[:, valid].reshape(-1, 3))
