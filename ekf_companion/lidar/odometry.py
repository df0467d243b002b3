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
from ekf_companion.lidar.deskew import Deskewed, deskew
from ekf_companion.lidar.gap import Lost, Unknown, joined, later, resumption, turn_between
from ekf_companion.lidar.motion import Path, Samples, prepare, propagate, unmeasured_turns
from ekf_companion.lidar.recording import InertialSamples, Mounting, Recording, Scan
from ekf_companion.lidar.relocation import relocate
from ekf_companion.lidar.rows import Match, noise_of_points, sum_rows
from ekf_companion.lidar.sampling import thin, within_range
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ATT,
    CALIBRATION,
    DOWN,
    EXCESS,
    MOUNT_ATT,
    MOUNT_POS,
    POS,
    POSE,
    VEL,
    N,
    State,
    exp,
)
from ekf_companion.lidar.update import Anchor, Update, at_place, correct, first, shift_by_state
from ekf_companion.lidar.voxel_map import VoxelMap
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_by_angles
from ekf_companion.nav.so3 import skew

PARTS = 3
"""Of a scan in which turns are not measured: in each what is not is constant."""
EXCESS_RATE = 1.0
"""Of it, one sigma, rad/s: a hand or a multirotor turns twice as fast as a small range."""
FIRST_PART = 3.0
"""Time over which the first part of the map is put in, of that of the others, after a start in
motion: what one second shows between trees holds nothing by itself."""


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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RelativePose:
    """Pose of the body at one time in the body at another."""

    start: float
    end: float
    C: Array
    pos: Array
    P: Array
    """Of position (body at the start) and attitude (rotation vector in the body at the end)."""


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
        self.map = VoxelMap(settings)
        self.anchors: list[Anchor] = []
        self._waiting: list[Scan] = []
        self._resumed: float | None = None
        """When samples went on after a time of which nothing is known, s; None: there was none."""
        self._lost = Lost(np.eye(3), np.zeros(3), np.zeros((POSE, POSE)))
        self.unknown: list[Unknown] = []
        self._usage: dict[int, float] = {}
        self._count = 0
        self._is_started = self._is_moving = False
        self.is_mounting_held = True
        self.x = State()
        self.P = np.zeros((N + POSE, N + POSE))
        if calibration is not None:
            self.P[CALIBRATION, CALIBRATION] = calibration
        self._marked = Marked(settings.spacing, alignment)
        self._insertions = 0
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
        self._is_moving = bool(self.x.vel_w.any())
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
        place = relocate(points, self.map, x.down_w, C, x.pos_w, yaw, P[POS, POS], self._share)
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
            self.P = at_place(self.x, P, self.anchors, place)
        return [self._step(scan) for scan in scans]

    def _begin_anew(self, P_motion: Array, motion: State) -> None:
        """Begin another map at a pose whose error is kept apart.

        Headings of a large error would be corrected by what is of second order in it.
        """
        x, P = self.x, self.P
        self._lost = Lost(x.C_wb, x.pos_w, self._lost.added(x, P)[:POSE, :POSE])
        marked = self._marked.as_exact(x, P)
        self.map, self.anchors, self._usage = VoxelMap(self.settings), [], {}
        self._is_moving = bool(motion.vel_w.any())
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
            P=self._lost.added(self.x, self.P) + self._alignment**2 * _square(by_axes(self.x)),
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
            lambda x, P, apart: sum_rows(
                some, x, P, apart, self.map, self.settings, has_mounting=has_mounting
            ),
            self.anchors,
            self.settings.iterations,
            is_mounting_held=self.is_mounting_held,
        )
        self.x, self.P = update.state, update.P
        if update.sums is not None:
            self._share = update.sums.match.used / len(some.points)
            for number, share in update.sums.usage.items():
                self._usage[number] = self._usage.get(number, 0.0) * 0.9 + 0.1 * share

        # The map learns the scan
        self._insert(whole, end_l)
        self.x = replace(self.x, excess=np.zeros(3))
        self.P[EXCESS] = self.P[:, EXCESS] = 0.0
        return update, path

    def _choose(self, scan: Scan) -> tuple[Array, Array]:
        """Return the points within range, and their times."""
        kept = within_range(scan.points, self.settings)
        return scan.points[kept], scan.times[kept]

    def _insert(self, scan: Deskewed, stamp: float) -> None:
        """Put the points of a scan into the part of the map that is being made."""
        if self.settings.anchors == 0:
            self._forget_far()
            self._put(scan, 0)
            return
        if self.settings.is_scan_to_scan and len(scan.points):
            self._forget_all()
        if not self.anchors or stamp - self.anchors[-1].stamp > self._part() - 0.01:
            self._begin_anchor(stamp)
        if not len(scan.points):
            return
        # The error of this part is the mean of those of the states by which it was made
        k = len(self.anchors) - 1
        T = shift_by_state(self.x, self.anchors[k].about_w, scan.rate_b)
        self._insertions += 1
        share = 1.0 / self._insertions
        at = slice(first(k), first(k + 1))
        self.P[at] += share * (T @ self.P[:N] - self.P[at])
        self.P[:, at] += share * (self.P[:, :N] @ T.T - self.P[:, at])
        self._put(scan, self.anchors[k].number)

    def _part(self) -> float:
        """Return how long the part of the map that is being made is put in, s."""
        is_first = len(self.anchors) == 1
        return self.settings.spacing * (FIRST_PART if is_first and self._is_moving else 1.0)

    def _put(self, scan: Deskewed, owner: int) -> None:
        """Put the points of a scan into the map where the state says they are."""
        variance = noise_of_points(scan.points, self.settings)
        self.map.insert(scan.placed(self.x)[1], variance, owner)

    def _begin_anchor(self, stamp: float) -> None:
        """Begin another part of the map, whose error is not that of the ones before."""
        n = len(self.P)
        P = np.zeros((n + POSE, n + POSE))
        P[:n, :n] = self.P
        self.P = P
        self.anchors.append(Anchor(self._count, stamp, self.x.pos_w))
        self._usage[self._count] = 1.0
        self._count += 1
        self._insertions = 0
        self._forget_far()
        self._drop_anchors()

    def _forget_all(self) -> None:
        """Begin another map, without anchors."""
        self.map = VoxelMap(self.settings)
        self.anchors, self._usage = [], {}
        self.P = self.P[: first(0), : first(0)]

    def _forget_far(self) -> None:
        """Keep the map within its radius and its number of voxels."""
        radius = self.settings.map_radius
        self.map.forget_far(self.x.pos_w, radius)
        while len(self.map) > self.settings.most_voxels:
            radius *= 0.8
            self.map.forget_far(self.x.pos_w, radius)

    def _drop_anchors(self) -> None:
        """Forget the anchors that no plane is tied to and those that are used least."""
        owned = self.map.owners()
        last = self.anchors[-2:]
        gone = [one for one in self.anchors if one.number not in owned and one not in last]
        most = max(self.settings.anchors, 2)
        rest = [one for one in self.anchors if one not in gone and one not in last]
        rest.sort(key=lambda one: self._usage[one.number])
        gone += rest[: max(len(self.anchors) - len(gone) - most, 0)]
        for one in gone:
            k = self.anchors.index(one)
            columns = slice(first(k), first(k + 1))
            self.P = np.delete(np.delete(self.P, columns, 0), columns, 1)
            del self.anchors[k], self._usage[one.number]
            if one.number in owned:
                self.map.forget_owner(one.number)


MARKED = slice(N, N + POSE)
"""Errors of the marked pose in the covariance."""
POSES = np.concatenate([np.arange(POSE), np.arange(N, N + POSE)])
"""Those of the present and of the marked one."""


class Marked:
    """The pose that the next relative one counts from; its errors stay in the covariance."""

    def __init__(self, spacing: float, alignment: float = 0.0) -> None:
        """Begin without one; ``spacing``: between two, s; ``alignment``: see ``Odometry``."""
        self._spacing, self._alignment = spacing, alignment
        self._at: tuple[float, State] | None = None

    @property
    def is_none(self) -> bool:
        """Return whether none is marked yet: the first pose is the world."""
        return self._at is None

    def travelled(self, stamp: float, x: State, P: Array) -> RelativePose | None:
        """Return the present pose relative to the marked one; None: none is."""
        if self._at is None:
            return None
        return relative_pose(*self._at, stamp, x, P, self._alignment)

    def as_exact(self, x: State, P: Array) -> Array:
        """Return the covariance of the marked pose as if the present one were exact, (6, 6)."""
        if self._at is None:
            return np.zeros((POSE, POSE))
        J = by_poses(self._at[1], x)
        to_marked = np.linalg.solve(J[:, POSE:], J)
        return np.asarray(to_marked @ P[np.ix_(POSES, POSES)] @ to_marked.T)

    def renew(self, stamp: float, x: State, P: Array) -> bool:
        """Mark the pose, in P too, where the marked one is old enough; return whether it is."""
        if self._at is not None and stamp - self._at[0] < self._spacing - 0.01:
            return False
        P[MARKED] = P[:POSE]
        P[:, MARKED] = P[:, :POSE]
        self._at = stamp, x
        return True


def relative_pose(
    start: float, then: State, end: float, x: State, P: Array, alignment: float
) -> RelativePose:
    """Return the present pose relative to a marked one.

    Args:
        start: Of the marked pose, s.
        then: The state there.
        end: Of the present pose, s.
        x: The present state.
        P: Of its error state, and from N on of the marked pose.
        alignment: Sigma of the body's axes relative to the gyro's, rad.
    """
    C = then.C_wb.T @ x.C_wb
    pos = then.C_wb.T @ (x.pos_w - then.pos_w)
    J = by_poses(then, x)
    P = J @ P[np.ix_(POSES, POSES)] @ J.T
    turned = np.vstack([skew(pos), np.eye(3) - C.T])
    P += alignment**2 * _square(turned)
    return RelativePose(start=start, end=end, C=C, pos=pos, P=0.5 * (P + P.T))


def by_poses(then: State, x: State) -> Array:
    """Return the derivative of a relative pose by the errors of the later and the earlier pose."""
    C = then.C_wb.T @ x.C_wb
    J = np.zeros((POSE, 2 * POSE))
    J[:3, POS] = then.C_wb.T
    J[:3, 9:12] = -then.C_wb.T
    J[:3, 6:9] = skew(then.C_wb.T @ (x.pos_w - then.pos_w))
    J[3:, ATT] = np.eye(3)
    J[3:, 6:9] = -C.T
    return J


def by_axes(x: State) -> Array:
    """Return the derivative of the error state by a rotation of the body's axes, (27, 3).

    The world is the body at the first pose, and turns with them.
    """
    J = np.zeros((N, 3))
    J[ATT] = np.eye(3) - x.C_wb.T
    J[POS], J[VEL] = skew(x.pos_w), skew(x.vel_w)
    J[MOUNT_ATT], J[MOUNT_POS] = -x.C_bl.T, skew(x.pos_b)
    return J


def _square(J: Array) -> Array:
    return np.asarray(J @ J.T)


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
