"""PointCloud2 and Imu of ROS 2 as they come, to scans and inertial samples.

Units, and what stamps and times of points count, are decided as those of a recording are, by the
first scans and samples; what follows is handed out.
"""

from __future__ import annotations

from collections import Counter
from typing import Any
from zlib import crc32

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.livox import Inertial
from ekf_companion.lidar.readers.inertial import GRAVITY
from ekf_companion.lidar.readers.point_cloud import unpack_message
from ekf_companion.lidar.readers.source import Source, StoredInertial, StoredScan
from ekf_companion.lidar.readers.survey import survey
from ekf_companion.lidar.readers.timing import Timing, decide_timing
from ekf_companion.lidar.readers.units import ACCELERATION, nearest
from ekf_companion.lidar.recording import StampedScan

SCANS, SAMPLES = 5, 40
"""First ones that decide: half a second of a lidar, a fifth of one of an inertial sensor."""
_NONE = StoredInertial(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))


class Messages:
    """Makes scans and samples of messages. Both may be called on threads of their own."""

    def __init__(self) -> None:
        """Begin undecided."""
        self.refused: Counter[str] = Counter()
        """Messages that are not used, by the reason."""
        self._said: list[str] = []
        self._timing: Timing | None = None
        self._scans: list[StoredScan] = []
        self._scale: float | None = None
        self._forces: list[float] = []

    def decisions(self) -> list[str]:
        """Return what was decided since the last call, a sentence each."""
        said, self._said = self._said, []
        return said

    def samples(self, message: Any, t_ns: int, data: bytes) -> list[Inertial]:
        """Return the samples that a sensor_msgs/Imu gives: none until the unit is known.

        Args:
            message: The Imu.
            t_ns: Its stamp.
            data: Its bytes, by which a repeated message is known.
        """
        w, f = message.angular_velocity, message.linear_acceleration
        gyro, accel = np.array((w.x, w.y, w.z)), np.array((f.x, f.y, f.z))
        if not (np.isfinite(gyro).all() and np.isfinite(accel).all()):
            self.refused["of a sample that is not finite"] += 1
            return []
        if self._scale is not None:
            return [Inertial(t_ns, gyro, accel * self._scale, crc32(data))]
        self._forces.append(float(np.linalg.norm(accel)))
        if len(self._forces) == SAMPLES:
            size = float(np.median(self._forces))
            self._scale = nearest(size, GRAVITY, ACCELERATION) if size > 0.0 else 1.0
            self._said.append(f"specific force is in {ACCELERATION[self._scale]}")
        return []

    def scans(self, message: Any, t_ns: int) -> list[StampedScan]:
        """Return the scans that a PointCloud2 gives: none until their times are understood.

        Args:
            message: The PointCloud2.
            t_ns: Its stamp.
        """
        try:
            cloud = unpack_message(message)
        except ValueError as error:
            self.refused[f"of points: {error}"[:120]] += 1
            return []
        stored = StoredScan(t_ns / 1e9, cloud.points, cloud.times, cloud.ring)
        if self._timing is not None:
            return [_placed(t_ns, stored, self._timing)]
        self._scans.append(stored)
        if len(self._scans) == SCANS:
            self._decide(cloud.time_field)
        return []

    def _decide(self, time_field: str) -> None:
        waiting, self._scans = self._scans, []
        source = Source(
            name="the first scans",
            scans=lambda: iter(waiting),
            inertial=_NONE,
            mounting=None,
            time_field=time_field,
            stamp_unit=1.0,
        )
        try:
            self._timing, _, said = decide_timing(source, survey(source), None)
        except LogError as error:
            self.refused[f"of points: {error}"] += SCANS
        else:
            self._said += said


def _placed(t_ns: int, stored: StoredScan, timing: Timing) -> StampedScan:
    scan = timing.apply(stored)
    # The difference: a double has no room for nanoseconds since 1970
    return StampedScan(t_ns + round((scan.stamp - stored.stamp) * 1e9), scan)
