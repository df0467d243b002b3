"""Turn what is stored into what the filter takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.recording import InertialSamples, Mounting, Recording, Scan


def judge(source: Source, mounting: Mounting | None) -> Recording:
    """Return the recording of a source."""
    stored = source.inertial
    return Recording(
        name=source.name,
        scans=Scans(source),
        inertial=InertialSamples(stored.stamp, stored.gyro, stored.accel),
        mounting=mounting or source.mounting or Mounting(),
        decisions=source.notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """The scans of a source, read anew in each pass."""

    source: Source

    def __iter__(self) -> Iterator[Scan]:
        for scan in self.source.scans():
            times = np.zeros(len(scan.points)) if scan.times is None else scan.times
            yield Scan(scan.stamp, scan.points, np.asarray(times, np.float64), scan.ring)
