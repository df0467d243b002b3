"""A simulated recording as the datagrams of a Livox Mid-360: points in mm, samples in g.

Layout: "Livox LiDAR Communication Protocol, Mid-360", 1.4.11, point cloud and IMU data.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from sim_autopilot.lidar.motion import GRAVITY
from sim_autopilot.lidar.record import TICK, UNIT, Simulated

POINT_PORT = 56301
IMU_PORT = 56401
_HEAD = struct.Struct("<BHHHHBBB12x")
_POINTS = 96
"""Of a datagram."""
_IMU, _MILLIMETRES = 0, 1
_SOURCES = {POINT_PORT: 56300, IMU_PORT: 56400}


@dataclass(frozen=True, slots=True, kw_only=True)
class LivoxFaults:
    """What is wrong with it or its network; each as by default is nothing."""

    lost: float = 0.0
    """Share of its datagrams that do not arrive."""
    times: int = 1
    """So often each arrives."""
    exchanged: float = 0.0
    """Share that is overtaken by the next one of its port."""
    damaged: float = 0.0
    """Share of which one bit is wrong."""
    silent: tuple[float, float] = (np.inf, np.inf)
    """From when until when the cable is out, s after its begin."""
    without_imu: tuple[float, float] = (np.inf, np.inf)
    """From when until when it sends points only, s."""
    leap: tuple[float, float] = (np.inf, 0.0)
    """When its clock is set, s after its begin, and by how much, s."""
    seed: int = 1


def datagrams(
    flown: Simulated, begin_ns: int = 0, faults: LivoxFaults | None = None
) -> Iterator[tuple[int, int, bytes]]:
    """Yield when each datagram leaves the lidar, the port of the host, and its bytes.

    Args:
        flown: The recording; its lidar fires evenly within a datagram, as a Livox does.
        begin_ns: The lidar's clock at t = 0, ns: free-running since it was switched on. The times
            of leaving are by it, and know no fault.
        faults: What becomes of them on their way.
    """
    faults = faults or LivoxFaults()
    at_s, by_s = faults.leap
    rows = [*_points(flown), *_samples(flown)]
    rows.sort(key=lambda row: row[0])
    way = _Way(faults)
    for leaves_ns, port, head, stamp_ns, data in rows:
        leap_ns = round(by_s * 1e9) if stamp_ns * 1e-9 >= at_s else 0
        checked = struct.pack("<Q", begin_ns + stamp_ns + leap_ns) + data
        whole = head + struct.pack("<I", crc32(checked)) + checked
        for one in way.pass_on(leaves_ns * 1e-9, port, whole):
            yield begin_ns + leaves_ns, port, one


class _Way:
    """What becomes of datagrams on their way."""

    def __init__(self, faults: LivoxFaults) -> None:
        self._faults, self._rng = faults, np.random.default_rng(faults.seed)
        self._held: dict[int, bytes] = {}

    def pass_on(self, t: float, port: int, whole: bytes) -> list[bytes]:
        faults = self._faults
        lost, exchanged, damaged = self._rng.random(3)
        if faults.silent[0] <= t < faults.silent[1] or lost < faults.lost:
            return []
        if port == IMU_PORT and faults.without_imu[0] <= t < faults.without_imu[1]:
            return []
        if damaged < faults.damaged:
            place = int(self._rng.integers(0, len(whole)))
            whole = whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :]
        if (held := self._held.pop(port, None)) is not None:
            return [whole, held] * faults.times
        if exchanged < faults.exchanged:
            self._held[port] = whole
            return []
        return [whole] * faults.times


_Row = tuple[int, int, bytes, int, bytes]
"""When it leaves (ns), port, head, stamp (ns) and data."""


def _points(flown: Simulated) -> Iterator[_Row]:
    layout = np.dtype([("xyz", "<i4", 3), ("reflectivity", "u1"), ("tag", "u1")])
    count = 0
    for k, stamp in enumerate(flown.stamp):
        for first in range(flown.first[k], flown.first[k + 1], _POINTS):
            part = slice(first, min(first + _POINTS, flown.first[k + 1]))
            times = np.round((stamp + flown.dt[part] * TICK) * 1e9).astype(np.int64)
            data = np.zeros(len(times), layout)
            data["xyz"] = np.round(flown.xyz[part] * (UNIT * 1e3))
            data["reflectivity"] = 50
            # From the first point to where the next one would be
            span = int(times[-1] - times[0]) * len(times) // max(len(times) - 1, 1) // 100
            head = _head(_MILLIMETRES, count, len(times), span, len(data.tobytes()))
            yield int(times[-1]), POINT_PORT, head, int(times[0]), data.tobytes()
            count += 1


def _samples(flown: Simulated) -> Iterator[_Row]:
    for count, stamp in enumerate(flown.imu_stamp):
        t_ns = round(stamp * 1e9)
        force = flown.accel[count].astype(np.float64) / GRAVITY
        data = np.concatenate((flown.gyro[count], force)).astype("<f4").tobytes()
        yield t_ns, IMU_PORT, _head(_IMU, count, 1, 0, len(data)), t_ns, data


def _head(kind: int, count: int, points: int, span: int, size: int) -> bytes:
    length = _HEAD.size + 12 + size
    return _HEAD.pack(0, length, min(span, 65535), points, count & 0xFFFF, 0, kind, 0)


def write_pcap(
    path: Path, rows: Iterator[tuple[int, int, bytes]], sender: str = "192.168.1.150"
) -> None:
    """Write datagrams as a capture on Ethernet, as tcpdump does.

    Args:
        path: .pcap.
        rows: When each arrived (ns), at which port, and its bytes.
        sender: The lidar's address.

    Raises:
        OSError: It cannot be written.
    """
    source = bytes(map(int, sender.split(".")))
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1))
        for t_ns, port, data in rows:
            udp = struct.pack(">HHHH", _SOURCES[port], port, 8 + len(data), 0) + data
            head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0)
            frame = bytes(12) + b"\x08\0" + head + source + bytes((192, 168, 1, 5)) + udp
            stamp = divmod(t_ns, 10**9)
            file.write(struct.pack("<IIII", *stamp, len(frame), len(frame)) + frame)
