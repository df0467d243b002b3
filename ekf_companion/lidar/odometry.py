"""Lidar-inertial odometry: the page that leads.

The filter keeps the pose together with anchors, poses of the past that the planes of its local map
are tied to. A scan measures the pose relative to those; what is not known of an anchor stays
unknown, so that the covariance of a relative pose and of the pose since the start are both honest.
With no anchors the map is taken as known: FAST-LIO's form. With the last scan as the map and its
pose as the only anchor the pose relative to it begins without covariance: LINS's form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.lidar import start
from ekf_companion.lidar.deskew import deskew
from ekf_companion.lidar.gap import Lost, Unknown, joined, later, resumption, turn_between
from ekf_companion.lidar.local_map import LocalMap
from ekf_companion.lidar.motion import Path, Samples, prepare, propagate, unmeasured_turns
from ekf_companion.lidar.recording import InertialSamples, Mounting, Recording, Scan
from ekf_companion.lidar.relative import MARKED, Marked, RelativePose, by_axes, square
from ekf_companion.lidar.relocation import relocate
from ekf_companion.lidar.rows import Match, sum_rows
from ekf_companion.lidar.sampling import evenly, thin, within_range
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ATT,
    CALIBRATION,
    DOWN,
    EXCESS,
    POS,
    POSE,
    VEL,
    N,
    State,
    exp,
)
from ekf_companion.lidar.update import Update, at_place, correct, first
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_by_angles
from ekf_companion.nav.so3 import skew

PARTS = 3
"""Of a scan in which turns are not measured: in each what is not is constant."""
EXCESS_RATE = 1.0
"""Of it, one sigma, rad/s: a hand or a multirotor turns twice as fast as a small range."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Estimate:
    """The pose at the end of a scan."""

    stamp: float
    """s, lidar clock."""
    state: State
    P: Array
    """Of the error state without the anchors, shape (27, 27)."""
    travelled: RelativePose | None
    """Since the pose that was marked last; None: this is the first."""
    relative: RelativePose | None
    """The same, where this pose is marked."""
    match: Match | None
    """None: no point was matched."""
    clipped: int
    lost: float
    evaluations: int


class Odometry:
    """Takes scans in the order of their stamps."""

    def __init__(
        self,
        inertial: InertialSamples,
        mounting: Mounting,
        settings: Settings,
        *,
        delay: float = 0.0,
        calibration: Array | None = None,
        alignment: float = 0.0,
    ) -> None:
        """Begin with a mounting and a delay of the inertial stamps, s.

        ``calibration`` is the covariance of both, shape (7, 7); None: they are known. Until they
        are released what the map and the poses have of their error is considered, not corrected.
        ``alignment`` is the sigma of the body's axes relative to the gyro's, rad: it shows in what
        is returned only.
        """
        self._alignment = alignment
        self.settings, self._mounting, self._delay = settings, mounting, delay
        self._samples: Samples = prepare(inertial)
        self.map = LocalMap(settings)
        self._waiting: list[Scan] = []
        self._resumed: float | None = None
        """When samples went on after a time of which nothing is known, s; None: there was none."""
        self._lost = Lost(np.eye(3), np.zeros(3), np.zeros((POSE, POSE)))
        self.unknown: list[Unknown] = []
        self._is_started = False
        self.is_mounting_held = True
        self.x = State()
        self.P = np.zeros((N + POSE, N + POSE))
        if calibration is not None:
            self.P[CALIBRATION, CALIBRATION] = calibration
        self._marked = Marked(settings.spacing, alignment)
        self._share = 0.0
        """Of the points of the last scan that were compared with planes."""
        self._time = 0.0
        """Of the state, inertial clock, s."""

    def hear(self, samples: Samples) -> None:
        """Take the inertial samples anew: up to the end of the next scan, and one after it."""
        self._samples = samples

    def process(self, scan: Scan) -> list[Estimate]:
        """Take the next scan; return the new estimates: none before the start is found."""
        made: list[Estimate] = []
        resumed = self._resumption(scan)
        if resumed is not None:
            # What came before it goes by itself
            made, self._is_started, self._resumed = self.finish(), False, resumed
        if self._is_started:
            return [self._step(scan)]
        if self._resumed is not None:
            scan = later(scan, self._resumed - self.x.delay)
            if not len(scan.times) and scan.stamp <= self._resumed - self.x.delay:
                return made
        self._waiting.append(scan)
        if scan.stamp - self._waiting[0].stamp < start.SPAN:
            return made
        return made + self.finish()

    def _resumption(self, scan: Scan) -> float | None:
        """Return when samples go on, if nothing is known of a time before a scan; else None."""
        if self._is_started:
            since = self._time
        elif self._waiting:
            last = self._waiting[-1]
            since = last.stamp + float(last.times.max(initial=0.0)) + self.x.delay
        else:
            return None
        first = scan.stamp + float(scan.times.min(initial=0.0)) + self.x.delay
        return resumption(self._samples, since, first)

    def finish(self) -> list[Estimate]:
        """Return the estimates of a recording that ended before its start was found."""
        if self._is_started or not self._waiting:
            return []
        return self._begin() if self._resumed is None else self._resume()

    def release(self, calibration: Array | None = None) -> None:
        """Correct mounting and delay from now on, with another covariance if there is one."""
        self.is_mounting_held = False
        if calibration is not None:
            self.P[CALIBRATION, CALIBRATION] = calibration

    @property
    def calibration(self) -> Array:
        """Return the covariance of mounting and delay, shape (7, 7)."""
        return np.array(self.P[CALIBRATION, CALIBRATION])

    def _begin(self) -> list[Estimate]:
        """Find the start, and take the scans that it was found by."""
        scans, self._is_started = self._waiting, True
        self.x, P = start.find(scans, self._samples, self._mounting, self.settings, self._delay)
        self._time = scans[0].stamp + self._delay
        self.P[:N, :N] += P
        self.map = LocalMap(self.settings, is_moving=bool(self.x.vel_w.any()))
        self._waiting = []
        return [self._step(scan) for scan in scans]

    def _resume(self) -> list[Estimate]:
        """Find the motion after a time of which nothing is known, and the place in the map."""
        scans, self._is_started = self._waiting, True
        self._waiting, self._resumed = [], None
        since, begin = self._time, scans[0].stamp + self.x.delay
        was_at_rest = start.is_still(self.x.vel_w, start.REST_SPEED**2 * np.eye(3))
        x, Phi, Q, _ = propagate(self.x, self._samples, since, begin, self.settings)
        P = self.P
        P[:N] = Phi @ P[:N]
        P[:, :N] = P[:, :N] @ Phi.T
        P[:N, :N] += Q
        mounting = Mounting(x.C_bl, x.pos_b)
        # Steady motion that nothing shows is not taken for rest
        motion, P_motion = start.find(
            scans,
            self._samples,
            mounting,
            self.settings,
            x.delay,
            vel=x.C_wb.T @ x.vel_w,
            may_rest=was_at_rest,
        )
        points = start.together(scans, self._samples, motion, self.settings)

        # The tilt is that of gravity, and the heading the predicted one
        C = exp(turn_between(x.C_wb @ motion.down_w, x.down_w)) @ x.C_wb
        yaw = float(np.sqrt(motion.down_w @ P[ATT, ATT] @ motion.down_w))
        place = relocate(
            points, self.map.voxels, x.down_w, C, x.pos_w, yaw, P[POS, POS], self._share
        )
        if place is not None:
            C, x = place.C, replace(x, pos_w=place.pos_w)
        T, M = joined(C, motion, x.down_w)
        P[:N] = T @ P[:N]
        P[:, :N] = P[:, :N] @ T.T
        P[:N, :N] += M @ P_motion @ M.T
        self.x, self._time = x.moved(C, x.pos_w, C @ motion.vel_w), begin
        self.unknown.append(Unknown(since - x.delay, begin - x.delay, is_found=place is not None))
        if place is None:
            self._begin_anew(P_motion, motion)
        else:
            self.P = at_place(self.x, P, self.map.anchors, place)
        return [self._step(scan) for scan in scans]

    def _begin_anew(self, P_motion: Array, motion: State) -> None:
        """Begin another map at a pose whose error is kept apart.

        Headings of a large error would be corrected by what is of second order in it.
        """
        x, P = self.x, self.P
        self._lost = Lost(x.C_wb, x.pos_w, self._lost.added(x, P)[:POSE, :POSE])
        marked = self._marked.as_exact(x, P)
        self.map = LocalMap(self.settings, is_moving=bool(motion.vel_w.any()))
        G = np.eye(N)
        G[VEL, VEL] = x.C_wb
        to_angles = direction_by_angles(x.down_w).T
        G[DOWN, DOWN] = to_angles @ x.C_wb @ direction_by_angles(motion.down_w)
        calibration = P[CALIBRATION, CALIBRATION].copy()
        self.P = np.zeros((first(0), first(0)))
        self.P[:N, :N] = G @ P_motion @ G.T
        self.P[CALIBRATION, CALIBRATION] = calibration
        self.P[MARKED, MARKED] = marked
        self.x = replace(x, gyro_bias=motion.gyro_bias, accel_bias=motion.accel_bias)

    def _step(self, scan: Scan) -> Estimate:
        end_l = scan.stamp + (float(scan.times.max()) if len(scan.times) else 0.0)
        clipped, lost, evaluations, update = 0, 0.0, 0, None
        for part, until in self._parts(scan, end_l):
            update, path = self._advance(part, until)
            clipped, lost = clipped + path.clipped, lost + path.lost
            evaluations += update.evaluations
        travelled = self._marked.travelled(end_l, self.x, self.P)
        return Estimate(
            stamp=end_l,
            state=self.x,
            P=self._lost.added(self.x, self.P) + self._alignment**2 * square(by_axes(self.x)),
            travelled=travelled,
            relative=travelled if self._marked.renew(end_l, self.x, self.P) else None,
            match=None if update is None or update.sums is None else update.sums.match,
            clipped=clipped,
            lost=lost,
            evaluations=evaluations,
        )

    def _parts(self, scan: Scan, end_l: float) -> Iterator[tuple[Scan, float]]:
        """Yield a scan, or its parts if turns within it are not measured, and the end of each.

        How fast the body turned besides is estimated for each part.
        """
        end = end_l + self.x.delay
        is_measured = not unmeasured_turns(self._samples, self._time, end).any()
        if self._marked.is_none or is_measured:
            yield scan, end_l
            return
        edges = np.linspace(min(self._time - self.x.delay, end_l), end_l, PARTS + 1)
        which = np.clip(np.searchsorted(edges, scan.stamp + scan.times) - 1, 0, PARTS - 1)
        for k in range(PARTS):
            mine = which == k
            yield Scan(scan.stamp, scan.points[mine], scan.times[mine]), float(edges[k + 1])

    def _advance(self, scan: Scan, end_l: float) -> tuple[Update, Path]:
        """Take a scan, or part of one, up to a time on the lidar's clock."""
        # Carry the state to its end
        end = max(end_l + self.x.delay, self._time)
        P = self.P.copy()
        is_unmeasured = unmeasured_turns(self._samples, self._time, end)
        P[EXCESS, EXCESS] = np.diag(EXCESS_RATE**2 * is_unmeasured)
        x, Phi, Q, path = propagate(
            self.x,
            self._samples,
            self._time,
            end,
            self.settings,
            is_turn_estimated=bool(is_unmeasured.all()),
        )
        P[:N] = Phi @ P[:N]
        P[:, :N] = P[:, :N] @ Phi.T
        P[:N, :N] += Q
        self._time = end

        # The first pose is the world
        there = x
        if self._marked.is_none:
            x, G = recentred(x)
            P[:N, :N] = G @ P[:N, :N] @ G.T

        # Each point from where the body was at its time
        points, times = self._choose(scan)
        stamp = np.clip(scan.stamp + times + x.delay, path.stamp[0], end)
        whole = deskew(points, stamp, path, there, x)
        some = whole.chosen(thin(points, self.settings.scan_voxel, self.settings.most_points))

        # Compare them with the map
        has_mounting = bool(self.P[CALIBRATION, CALIBRATION].any())
        update = correct(
            x,
            P,
            lambda x, P, known: sum_rows(
                some,
                x,
                P,
                known,
                self.map.voxels,
                self.settings,
                self.map.time_of(end_l),
                has_mounting=has_mounting,
            ),
            self.map.anchors,
            self.settings.iterations,
            is_mounting_held=self.is_mounting_held,
        )
        self.x, self.P = update.state, update.P
        if update.sums is not None:
            self._share = update.sums.match.used / len(some.points)
            self.map.note(update.sums.usage)

        # The map learns the scan
        self.P = self.map.insert(whole, self.x, self.P, end_l)
        self.x = replace(self.x, excess=np.zeros(3))
        self.P[EXCESS] = self.P[:, EXCESS] = 0.0
        return update, path

    def _choose(self, scan: Scan) -> tuple[Array, Array]:
        """Return the points within range, or as many as the map takes, and their times."""
        kept = evenly(within_range(scan.points, self.settings), self.settings.most_map_points)
        return scan.points[kept], scan.times[kept]


def recentred(x: State) -> tuple[State, Array]:
    """Return the state with the body's pose as the world, and the derivative of its error state."""
    C = x.C_wb.T
    vel, down = C @ x.vel_w, C @ x.down_w
    here = replace(x.moved(np.eye(3), np.zeros(3), vel), down_w=down)
    G = np.eye(N)
    G[ATT, ATT] = G[POS, POS] = 0.0
    G[VEL, VEL], G[VEL, ATT] = C, skew(vel)
    to_angles = direction_by_angles(down).T
    G[DOWN, DOWN] = to_angles @ C @ direction_by_angles(x.down_w)
    G[DOWN, ATT] = to_angles @ skew(down)
    return here, G


def run(recording: Recording, settings: Settings) -> Iterator[Estimate]:
    """Yield the estimate at the end of each scan of a recording."""
    odometry = Odometry(recording.inertial, recording.mounting, settings)
    for scan in recording.scans:
        yield from odometry.process(scan)
    yield from odometry.finish()
