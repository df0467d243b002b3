"""A lidar's odometry while it flies: what it sends in, poses with the covariance of their way out.

No socket and no clock: the shell receives, and runs :meth:`Live.process` beside the reception.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.collector import Collector, Packed, Ready
from ekf_companion.lidar.livox import Inertial
from ekf_companion.lidar.motion import Samples
from ekf_companion.lidar.odometry import Estimate, Odometry
from ekf_companion.lidar.recording import InertialSamples, Mounting, StampedScan
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import DOWN
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import levelled
from ekf_companion.nav.relative_pose import drift_by_tilt
from ekf_companion.nav.stamps import least_lag

MOST_WAITING = 2
"""Scans that wait to be processed: what is older than two is worth less than the next."""
BRIDGED = 10.0
"""Time without scans that is bridged by the inertial samples, s: their errors are decimetres then
(docs/LIDAR.md), and as long are they kept."""
NONE = InertialSamples(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
_SLOW, _ALONE = "too slow", "no inertial samples"


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the body is in a level world of its own."""

    t_ns: int
    """The lidar's clock."""
    ours_ns: int
    """Our clock."""
    pos: Array
    """m, shape (3,), z up."""
    C: Array
    """Body (forward, left, up) to world, shape (3, 3)."""
    P: Array
    """Of the way since the run began, as the sum of its relative poses: position (m) and rotation
    vector (rad), both in the world, shape (6, 6). Its growth is how far the pose may have
    drifted."""
    world: int
    """Another number where another world begins."""
    estimate: Estimate


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A scan to process, with the samples that it needs."""

    run: int
    packed: Packed | Ready
    samples: Samples
    lag_ns: int
    """Our clock less the lidar's."""


class Way:
    """Composes relative poses: each step is levelled by what is known of gravity at its end."""

    def __init__(self) -> None:
        self.pos, self.P = np.zeros(3), np.zeros((6, 6))
        self._marked = np.zeros((6, 6))
        self._last: tuple[float, Array] | None = None

    def add(self, one: Estimate) -> Array:
        """Take the next estimate; return the filter's world to the level one, shape (3, 3)."""
        x, level = one.state, levelled(one.state.down_w)
        if self._last is not None:
            seconds, step = one.stamp - self._last[0], level @ (x.pos_w - self._last[1])
            self.pos = self.pos + step
            tilt = float(np.sqrt(np.linalg.eigvalsh(one.P[DOWN, DOWN])[-1]))
            way = np.linalg.norm(step[:2])
            self._marked[2, 2] += float(drift_by_tilt(tilt, way, np.float64(seconds)))
        self._last = one.stamp, x.pos_w
        if (travelled := one.travelled) is not None:
            T = np.zeros((6, 6))
            T[:3, :3] = level @ x.C_wb @ travelled.C.T
            T[3:, 3:] = level @ x.C_wb
            self.P = self._marked + T @ travelled.P @ T.T
        if one.relative is not None:
            self._marked = self.P.copy()
        return level


class Live:
    """The odometry of one lidar; ``process`` may run on a thread of its own."""

    def __init__(self, mounting: Mounting, settings: Settings) -> None:
        """Begin with a mounting of the lidar on its inertial sensor."""
        self.collector = Collector()
        self.dropped = {_SLOW: 0, _ALONE: 0}
        """Scans that were not processed, by the reason."""
        self.processed = 0
        self._mounting, self._settings = mounting, settings
        self._waiting: deque[Packed | Ready] = deque()
        self._run = self._world = 0
        self._end = 0.0
        self._lag_ns: int | None = None
        self._heard_ns = 0
        self._odometry, self._way = self._afresh()

    def receive(self, datagram: bytes, now_ns: int) -> bool:
        """Take a datagram that arrived at a time of our clock; return whether it is used."""
        run, before = self.collector.run, self.collector.packets
        found = self.collector.receive(datagram)
        self._keep(found, run, now_ns)
        return isinstance(found, Inertial) or self.collector.packets > before

    def take_in(self, one: Inertial | StampedScan, now_ns: int) -> bool:
        """Take a sample or a whole scan, as :meth:`receive` does a datagram."""
        run = self.collector.run
        found: Ready | Inertial | None
        if isinstance(one, Inertial):
            found = one if self.collector.add(one) else None
        else:
            found = self.collector.place(one)
        self._keep(found, run, now_ns)
        return found is not None

    def _keep(self, found: Packed | Ready | Inertial | None, run: int, now_ns: int) -> None:
        if self.collector.run != run:
            self._waiting.clear()
            self._lag_ns = None
        if isinstance(found, Inertial):
            lag_ns, since = now_ns - found.t_ns, now_ns - self._heard_ns
            self._lag_ns = (
                lag_ns if self._lag_ns is None else least_lag(self._lag_ns, lag_ns, since)
            )
            self._heard_ns = now_ns
            newest = (self.collector.newest_ns - self.collector.base_ns) / 1e9
            self.collector.heard.forget(newest - BRIDGED - 1.0)
        elif found is not None:
            self._waiting.append(found)
            if len(self._waiting) > MOST_WAITING:
                self.dropped[_SLOW if self._is_heard(self._waiting.popleft()) else _ALONE] += 1

    @property
    def is_ready(self) -> bool:
        """Return whether a scan can be processed."""
        return bool(self._waiting) and self._is_heard(self._waiting[0])

    def take(self) -> Job | None:
        """Return the next scan to process; None: there is none yet."""
        if not self.is_ready:
            return None
        samples = self.collector.heard.samples()
        return Job(self.collector.run, self._waiting.popleft(), samples, self._lag_ns or 0)

    def process(self, job: Job) -> list[Pose]:
        """Return the poses that a scan gives: none before the start is found, then those of it."""
        scan = job.packed.unpacked()
        if job.run != self._run or scan.stamp - self._end > BRIDGED:
            self._run = job.run
            self._world += 1
            self._odometry, self._way = self._afresh()
        self._end = job.packed.end
        self.processed += 1
        self._odometry.hear(job.samples)
        return [self._pose(job, one) for one in self._odometry.process(scan)]

    def _pose(self, job: Job, one: Estimate) -> Pose:
        level = self._way.add(one)
        t_ns = job.packed.base_ns + round(one.stamp * 1e9)
        C = level @ one.state.C_wb
        return Pose(t_ns, t_ns + job.lag_ns, self._way.pos, C, self._way.P, self._world, one)

    def _afresh(self) -> tuple[Odometry, Way]:
        return Odometry(NONE, self._mounting, self._settings), Way()

    def _is_heard(self, packed: Packed | Ready) -> bool:
        return self.collector.heard.judged >= packed.end
