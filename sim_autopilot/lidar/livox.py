"""A simulated recording as the datagrams of a Livox Mid-360: points in mm, samples in g.

Layout: Livox-SDK2 1.4.3, include/livox_lidar_def.h (LivoxLidarEthernetPacket).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from sim_autopilot.lidar.motion import GRAVITY
from sim_autopilot.lidar.record import TICK, UNIT, Simulated

POINT_PORT = 56301
IMU_PORT = 56401
_HEAD = struct.Struct("<BHHHHBBB12xIQ")
_POINTS = 96
"""Of a datagram."""
_IMU, _MILLIMETRES = 0, 1


def datagrams(flown: Simulated, begin_ns: int = 0) -> Iterator[tuple[int, int, bytes]]:
    """Return when each datagram leaves the lidar, the port of the host, and its bytes.

    Args:
        flown: The recording; its lidar fires evenly within a datagram, as a Livox does.
        begin_ns: The lidar's clock at t = 0, ns: free-running since it was switched on.
    """
    rows = [*_points(flown, begin_ns), *_samples(flown, begin_ns)]
    rows.sort(key=lambda row: row[0])
    yield from rows


def _points(flown: Simulated, begin_ns: int) -> Iterator[tuple[int, int, bytes]]:
    layout = np.dtype([("xyz", "<i4", 3), ("reflectivity", "u1"), ("tag", "u1")])
    count = 0
    for k, stamp in enumerate(flown.stamp):
        for first in range(flown.first[k], flown.first[k + 1], _POINTS):
            part = slice(first, min(first + _POINTS, flown.first[k + 1]))
            times = begin_ns + np.round((stamp + flown.dt[part] * TICK) * 1e9).astype(np.int64)
            data = np.zeros(len(times), layout)
            data["xyz"] = np.round(flown.xyz[part] * (UNIT * 1e3))
            data["reflectivity"] = 50
            # From the first point to where the next one would be
            span = int(times[-1] - times[0]) * len(times) // max(len(times) - 1, 1) // 100
            packet = _packet(_MILLIMETRES, count, len(times), span, int(times[0]), data.tobytes())
            yield int(times[-1]), POINT_PORT, packet
            count += 1


def _samples(flown: Simulated, begin_ns: int) -> Iterator[tuple[int, int, bytes]]:
    for count, stamp in enumerate(flown.imu_stamp):
        t_ns = begin_ns + round(stamp * 1e9)
        force = flown.accel[count].astype(np.float64) / GRAVITY
        data = np.concatenate((flown.gyro[count], force)).astype("<f4").tobytes()
        yield t_ns, IMU_PORT, _packet(_IMU, count, 1, 0, t_ns, data)


def _packet(kind: int, count: int, points: int, span: int, t_ns: int, data: bytes) -> bytes:
    length = _HEAD.size + len(data)
    head = (0, length, min(span, 65535), points, count & 0xFFFF, 0, kind, 0, 0, t_ns)
    return _HEAD.pack(*head) + data
