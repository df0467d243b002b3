"""What one lidar sends, to scans and inertial samples of one run of its clock.

A run begins with the first inertial sample, and anew where the clock leaps or samples are missing
for long.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace

from ekf_companion.lidar.heard import Heard
from ekf_companion.lidar.livox import Assembler, Inertial, Points, Refusal, decode, scan_of
from ekf_companion.lidar.recording import Scan, StampedScan

GAP_NS = 200_000_000
"""Without samples for longer a gap cannot be told from a leap of the clock: taken for a gap, a leap
of 0.3 s put a walk in a room 20 m off, one of 0.19 s 2 cm."""
BACK = 3
"""Samples in a row that are older than the newest: the clock was set back. A network that
exchanges two has one, and one that repeats them has the same ones."""
REMEMBERED = 400
"""Samples that are known again, two seconds."""
LEAPT, BACKWARDS = "its clock leapt, or its samples were missing", "its clock was set back"


@dataclass(frozen=True, slots=True, eq=False)
class Packed:
    """A scan as it came."""

    packets: tuple[Points, ...]
    base_ns: int

    @property
    def end(self) -> float:
        """Return when it ended, s since the run began."""
        return (max(one.end_ns for one in self.packets) - self.base_ns) / 1e9

    def unpacked(self) -> Scan:
        """Return its points in m."""
        return scan_of(self.packets, self.base_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """A scan that came as a whole."""

    scan: Scan
    base_ns: int
    end: float
    """When it ended, s since the run began."""

    def unpacked(self) -> Scan:
        """Return its points in m."""
        return self.scan


class Collector:
    """Sorts what comes; no socket, and no clock but the lidar's."""

    def __init__(self) -> None:
        self.run = 0
        """Number of the present run; 0: no inertial sample has come yet."""
        self.why = ""
        """Why it has begun; empty: it is the first."""
        self.heard = Heard()
        self.base_ns = 0
        """The lidar's clock when the run began."""
        self.newest_ns = 0
        """Of the samples."""
        self.refused: Counter[str] = Counter()
        """Datagrams by the reason why they are not used."""
        self.packets = 0
        """Datagrams of points."""
        self._late_samples = self._late_scans = self._repeated_samples = 0
        self._scan_ns = 0
        self._assembler = Assembler()
        self._recent: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)
        self._late: list[Inertial] = []

    @property
    def lost(self) -> int:
        """Return how many datagrams of points were sent and did not come."""
        return self._assembler.lost

    @property
    def late(self) -> int:
        """Return how many datagrams or scans came too late, and are left out."""
        return self._assembler.late + self._late_samples + self._late_scans

    @property
    def repeated(self) -> int:
        """Return how many datagrams came again, and are left out."""
        return self._assembler.repeated + self._repeated_samples

    def receive(self, datagram: bytes) -> Packed | Inertial | None:
        """Take a datagram; return the scan that it ends, or the sample that it is."""
        found = decode(datagram)
        if isinstance(found, Refusal):
            self.refused[found.value] += 1
            return None
        if isinstance(found, Inertial):
            return found if self.add(found) else None
        self.packets += 1
        ended = self._assembler.add(found)
        if not ended or self.run == 0 or ended[0].t_ns < self.base_ns:
            return None
        return Packed(tuple(ended), self.base_ns)

    def place(self, one: StampedScan) -> Ready | None:
        """Return a whole scan by times since the run began; None: it is older, or out of order."""
        if self.run == 0 or one.t_ns < self.base_ns:
            return None
        if one.t_ns <= self._scan_ns:
            self._late_scans += 1
            return None
        self._scan_ns = one.t_ns
        scan = replace(one.scan, stamp=(one.t_ns - self.base_ns) / 1e9)
        last = float(scan.times.max()) if len(scan.times) else 0.0
        return Ready(scan, self.base_ns, scan.stamp + last)

    def add(self, sample: Inertial) -> bool:
        """Take a sample into the run, or begin another by it; return whether it is used."""
        if self.run == 0:
            return self._begin([sample], "")
        if sample.t_ns <= self.newest_ns:
            if (sample.t_ns, sample.check) in self._recent:
                self._repeated_samples += 1
                return False
            self._late.append(sample)
            if len(self._late) == BACK:
                return self._begin(self._late, BACKWARDS)
            self._late_samples += 1
            return False
        if sample.t_ns - self.newest_ns > GAP_NS:
            return self._begin([sample], LEAPT)
        self._late = []
        return self._take(sample)

    def _take(self, sample: Inertial) -> bool:
        self.newest_ns = sample.t_ns
        self._recent.append((sample.t_ns, sample.check))
        self.heard.add((sample.t_ns - self.base_ns) / 1e9, sample.gyro, sample.accel)
        return True

    def _begin(self, samples: list[Inertial], why: str) -> bool:
        """Begin a run with some samples."""
        samples = sorted(samples, key=lambda one: one.t_ns)
        self.run += 1
        self.why = why
        self.base_ns = samples[0].t_ns
        self.newest_ns = self._scan_ns = 0
        self.heard = Heard()
        self._recent.clear()
        self._late = []
        if why:
            self._assembler.forget()
        for one in samples:
            if one.t_ns > self.newest_ns:
                self._take(one)
        return True
