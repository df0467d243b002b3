"""From when to when a log's sensors spoke, and which part of it has inertial samples."""

from __future__ import annotations

import numpy as np

from ekf_companion.core.memory.aid import BY_KIND
from ekf_companion.nav.measurements import Events, Kind

SENSORS = (Kind.GNSS, Kind.HEADING, Kind.MAG, *BY_KIND)
STRAY = 2
"""Events of a block that may be stamped before or after all others, damaged as they are."""
SHORT = 5.0
"""s; sensors begin and end by so much one after another in whole recordings."""


class Extent:
    """Takes blocks of a log, and keeps the first and last stamp of its samples and of the rest."""

    def __init__(self) -> None:
        """Begin before the first block."""
        self._imu_ns: tuple[int, int] | None = None
        self._ns: tuple[int, int] | None = None
        self._is_one = True

    def add(self, events: Events) -> None:
        """Add a block."""
        if (events.kind == Kind.RESTART).any():
            self._is_one = False  # stamps of two clocks are not compared
        imu_ns = events.t_ns[events.kind == Kind.IMU]
        if len(imu_ns):
            self._imu_ns = _wider(self._imu_ns, int(imu_ns.min()), int(imu_ns.max()))
        others_ns = np.sort(events.t_ns[np.isin(events.kind, SENSORS)])
        if len(others_ns) > 2 * STRAY:
            self.widen(int(others_ns[STRAY]), int(others_ns[-1 - STRAY]))

    def widen(self, first_ns: int, last_ns: int) -> None:
        """Take it that the log's sensors spoke from one stamp to another."""
        self._ns = _wider(self._ns, first_ns, last_ns)

    @property
    def first_ns(self) -> int:
        """Stamp of the first inertial sample; 0: there is none."""
        return 0 if self._imu_ns is None else self._imu_ns[0]

    def lacks(self) -> list[str]:
        """Return in a few words where inertial samples are missing at the log's begin and end."""
        if self._imu_ns is None or self._ns is None or not self._is_one:
            return []
        first_ns, last_ns = _wider(self._ns, *self._imu_ns)
        begin, end = ((one - first_ns) * 1e-9 for one in self._imu_ns)
        whole = (last_ns - first_ns) * 1e-9
        found = []
        if begin > SHORT:
            found.append(f"inertial samples begin at {begin:.0f} of {whole:.0f} s")
        if whole - end > SHORT:
            found.append(f"inertial samples end at {end:.0f} of {whole:.0f} s")
        return found


def _wider(span: tuple[int, int] | None, first: int, last: int) -> tuple[int, int]:
    return (first, last) if span is None else (min(span[0], first), max(span[1], last))
