"""Datagrams of a Livox Mid-360 (HAP, Avia 2): bytes in, points and inertial samples out.

Layout: "Livox LiDAR Communication Protocol, Mid-360", 1.4.11, point cloud and IMU data:
little-endian, CRC-32 (IEEE 802.3) of everything from the time stamp on. The times of points are
spread over the datagram's interval, as livox_ros_driver2 does it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import groupby
from zlib import crc32

import numpy as np

from ekf_companion.lidar.recording import Mounting, Scan
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import STANDARD_GRAVITY

POINT_PORT = 56301
IMU_PORT = 56401
"""Of the host, as the lidar has them from the factory."""
HEAD = struct.Struct("<BHHHHBBB12xIQ")
"""Version, length, interval (0.1 us), points, count, frame, data, time, CRC, time (ns)."""
CHECKED = HEAD.size - 8
"""From where on the CRC counts: the time stamp."""
IMU_DATA, MILLIMETRES, CENTIMETRES, SPHERICAL = range(4)
"""Kinds of data."""
LAYOUTS = {
    IMU_DATA: np.dtype([("gyro", "<f4", 3), ("accel", "<f4", 3)]),
    MILLIMETRES: np.dtype([("xyz", "<i4", 3), ("reflectivity", "u1"), ("tag", "u1")]),
    CENTIMETRES: np.dtype([("xyz", "<i2", 3), ("reflectivity", "u1"), ("tag", "u1")]),
    SPHERICAL: np.dtype(
        [("depth", "<u4"), ("angles", "<u2", 2), ("reflectivity", "u1"), ("tag", "u1")]
    ),
}
MID_360 = Mounting(np.eye(3), np.array((-0.011, -0.02329, 0.04412)), np.radians(0.2), 0.002)
"""Of a Mid-360 on its own inertial sensor: that is at (11.0, 23.29, -44.12) mm in the lidar."""
PERIOD_NS = 100_000_000
"""Of a scan, as the lidar's own driver has it."""
TANGLED = 10
"""Scans by which a datagram may come too late; older ones are of a clock that was set back."""


class Refusal(str, Enum):
    """Why a datagram is not used."""

    CUT = "cut off, or of another program"
    CRC = "wrong CRC"
    KIND = "of an unknown kind"
    NUMBERS = "with a time or a number that cannot be"


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a datagram, as they came."""

    t_ns: int
    """Of the first one, the lidar's clock."""
    span_ns: int
    count: int
    number: int
    """Counted from datagram to datagram, modulo 2**16; some models begin each frame at 0."""
    kind: int
    data: bytes

    @property
    def end_ns(self) -> int:
        """Return when the last point was measured, at the latest."""
        return self.t_ns + self.span_ns


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """One inertial sample."""

    t_ns: int
    """The lidar's clock."""
    gyro: Array
    """rad/s, shape (3,)."""
    accel: Array
    """m/s2, shape (3,)."""
    check: int
    """Its CRC, which tells a repeated datagram from another one of the same time."""


def decode(datagram: bytes) -> Points | Inertial | Refusal:
    """Return what a datagram holds, or why it is not used."""
    if len(datagram) < HEAD.size:
        return Refusal.CUT
    version, length, interval, count, number, _, kind, _, check, t_ns = HEAD.unpack_from(datagram)
    layout = LAYOUTS.get(kind)
    if version != 0 or length != len(datagram):
        return Refusal.CUT
    if crc32(memoryview(datagram)[CHECKED:]) != check:
        return Refusal.CRC
    if layout is None:
        return Refusal.KIND
    if not 0 < t_ns < 1 << 62:
        return Refusal.NUMBERS
    if kind == IMU_DATA:
        count = 1
    if count == 0 or HEAD.size + count * layout.itemsize > length:
        return Refusal.CUT
    if kind != IMU_DATA:
        end = HEAD.size + count * layout.itemsize
        return Points(t_ns, interval * 100, count, number, kind, datagram[HEAD.size : end])
    row = np.frombuffer(datagram, layout, 1, HEAD.size)[0]
    gyro, accel = row["gyro"].astype(np.float64), row["accel"].astype(np.float64)
    if not (np.isfinite(gyro).all() and np.isfinite(accel).all()):
        return Refusal.NUMBERS
    return Inertial(t_ns, gyro, accel * STANDARD_GRAVITY, check)


def scan_of(packets: Sequence[Points], base_ns: int) -> Scan:
    """Return the returned points of some datagrams, at times in s since ``base_ns``."""
    times: Stamps = np.concatenate(
        [one.t_ns + np.arange(one.count) * one.span_ns // one.count for one in packets]
    )
    points = np.concatenate(
        [
            _metres(kind, b"".join(one.data for one in group))
            for kind, group in groupby(packets, lambda one: one.kind)
        ]
    )
    stamp = int(times.min())
    returned = points.any(axis=1)
    return Scan((stamp - base_ns) / 1e9, points[returned], (times[returned] - stamp) / 1e9)


def _metres(kind: int, data: bytes) -> Array:
    rows = np.frombuffer(data, LAYOUTS[kind])
    if kind == SPHERICAL:
        polar, azimuth = np.radians(rows["angles"].astype(np.float64) * 0.01).T
        flat = np.sin(polar)
        unit = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.cos(polar)), -1)
        placed: Array = unit * (rows["depth"].astype(np.float64)[:, None] * 1e-3)
        return placed
    scale = 1000.0 if kind == MILLIMETRES else 100.0
    points: Array = rows["xyz"].astype(np.float64) / scale
    return points


@dataclass(slots=True)
class Assembler:
    """Collects datagrams to scans of a period: a Livox has no turn that would end one."""

    period_ns: int = PERIOD_NS
    lost: int = 0
    """Datagrams that the count says were sent and did not come."""
    late: int = 0
    """Datagrams of a scan that was handed out already: left out."""
    repeated: int = 0
    """Datagrams that came twice: left out."""
    _waiting: dict[int, Points] = field(default_factory=dict)
    """By their times."""
    _slot: int = 0
    _number: int | None = None
    _newest_ns: int = 0

    def add(self, points: Points) -> list[Points]:
        """Take a datagram; return those of the scan that it ends, in the order of their times."""
        slot = points.t_ns // self.period_ns
        if points.t_ns in self._waiting:
            self.repeated += 1
            return []
        if 0 < self._slot - slot <= TANGLED:
            self.late += 1
            return []
        ended: list[Points] = []
        if slot > self._slot:
            ended = [self._waiting[t_ns] for t_ns in sorted(self._waiting)]
        if slot != self._slot:  # ended, or of a clock that was set back
            self._waiting.clear()
            self._slot = slot
        self._count(points)
        self._waiting[points.t_ns] = points
        return ended

    def forget(self) -> None:
        """Forget the datagrams of a scan that has not ended."""
        self._waiting.clear()
        self._slot, self._number, self._newest_ns = 0, None, 0

    def _count(self, points: Points) -> None:
        """Count what is missing between this datagram and the last one."""
        number, last = points.number, self._number
        if points.t_ns < self._newest_ns:
            self.lost = max(self.lost - 1, 0)  # it was overtaken, not lost
            return
        self._newest_ns, self._number = points.t_ns, number
        if last is None or number in (0, last):
            return
        ahead = (number - last) & 0xFFFF
        # What seems to be behind has begun to count anew
        self.lost += ahead - 1 if ahead < 1 << 15 else number
