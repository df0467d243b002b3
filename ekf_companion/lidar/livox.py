"""Datagrams of a Livox (Mid-360, HAP, Avia 2): bytes in, points and inertial samples out.

Layout: Livox-SDK2 1.4.3, include/livox_lidar_def.h (LivoxLidarEthernetPacket). Little-endian; the
times of points are spread over the datagram's interval, as livox_ros_driver2 does it. Ports of the
host: `POINT_PORT` and `IMU_PORT`. The lidar starts to send when it is configured to.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.lidar.recording import Mounting, Scan
from ekf_companion.nav.arrays import Array, Stamps

POINT_PORT = 56301
IMU_PORT = 56401
HEAD = struct.Struct("<BHHHHBBB12xIQ")
"""Version, length, interval (0.1 us), points, count, frame, data, time, CRC, time (ns)."""
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
G = 9.80665
"""m/s2: its accelerometer measures in g."""
MID_360 = Mounting(np.eye(3), np.array((-0.011, -0.02329, 0.04412)), np.radians(0.2), 0.002)
"""Of a Mid-360 on its own inertial sensor: that is at (11.0, 23.29, -44.12) mm in the lidar."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """The points of a datagram."""

    t_ns: Stamps
    """The lidar's clock, shape (n,)."""
    points: Array
    """m, shape (n, 3), forward, left, up; 0 0 0 where nothing returned."""


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """One inertial sample."""

    t_ns: int
    """The lidar's clock."""
    gyro: Array
    """rad/s, shape (3,)."""
    accel: Array
    """m/s2, shape (3,)."""


def decode(datagram: bytes) -> Points | Inertial | None:
    """Return what a datagram holds, or None if it is none of a Livox, damaged or of another kind.

    The CRC is not compared: UDP has one of its own.
    """
    if len(datagram) < HEAD.size:
        return None
    _, length, interval, count, _, _, kind, _, _, t_ns = HEAD.unpack_from(datagram)
    layout = LAYOUTS.get(kind)
    if layout is None or length > len(datagram) or not 0 < t_ns < 1 << 63:
        return None
    if kind == IMU_DATA:
        count = 1
    if count == 0 or HEAD.size + count * layout.itemsize > length:
        return None
    rows = np.frombuffer(datagram, layout, count, HEAD.size)
    if kind == IMU_DATA:
        gyro, accel = rows[0]["gyro"].astype(np.float64), rows[0]["accel"].astype(np.float64)
        if not (np.isfinite(gyro).all() and np.isfinite(accel).all()):
            return None
        return Inertial(t_ns, gyro, accel * G)
    times = t_ns + np.arange(count, dtype=np.int64) * (interval * 100) // count
    return Points(times, _metres(kind, rows))


def _metres(kind: int, rows: np.ndarray[tuple[int], np.dtype[np.void]]) -> Array:
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

    period_ns: int = 100_000_000
    _waiting: list[Points] = field(default_factory=list)
    _begin: int = 0
    late: int = 0
    """Datagrams of a scan that was handed out already: left out."""

    def add(self, points: Points) -> Iterator[Scan]:
        """Take a datagram, and return the scan that it ends, if it does."""
        t_ns = int(points.t_ns[0])
        slot = t_ns // self.period_ns
        if slot < self._begin:
            # A clock that was set back by more than a few scans begins anew
            if self._begin - slot <= 10:
                self.late += 1
                return
            self._waiting.clear()
        if slot != self._begin:
            if self._waiting:
                yield self._join()
            self._begin = slot
        self._waiting.append(points)

    def _join(self) -> Scan:
        times = np.concatenate([one.t_ns for one in self._waiting])
        points = np.concatenate([one.points for one in self._waiting])
        self._waiting.clear()
        stamp = int(times.min())
        returned = points.any(axis=1)
        return Scan(stamp / 1e9, points[returned], (times[returned] - stamp) / 1e9)
