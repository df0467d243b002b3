"""What a recording gives: the trajectory with its covariance, relative poses, map and a verdict.

World: the body at the first pose, turned so that the last estimate of gravity points down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.lidar import radar
from ekf_companion.lidar.calibration import calibrate
from ekf_companion.lidar.gap import Unknown
from ekf_companion.lidar.odometry import Odometry
from ekf_companion.lidar.recording import Recording
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import ATT, DOWN, POS, VEL
from ekf_companion.lidar.track import SEEN, Track
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import levelled
from ekf_companion.nav.relative_pose import COVARIANCE, LEVEL, SINCE, UPPER

NAMED = 1.0
"""Shortest time without hold that is named, s."""
POOR = 0.01
"""Share of the way that its own sigma may be in a good result: what odometry is bought for."""
MOST_OPEN = 0.5
"""Share of the time without hold in a good result: beyond it the way is the inertial sensor's, and
what seems to hold in between are planes that were put in by it."""
POOR_BY_DOPPLER = 0.02
"""The same of a radar, whose heading and height nothing holds."""
LEAST_SIGMA = 0.1
"""Own sigma below which a result is good however short the way, m."""


@dataclass(frozen=True, slots=True)
class OpenStretch:
    """A time without hold along one direction."""

    start: float
    end: float
    direction: tuple[float, float, float]
    """Unit vector in the levelled world."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution:
    """The result of one recording."""

    name: str
    decisions: tuple[str, ...]
    track: Track = field(repr=False)
    C_level: Array
    """World of the filter to the levelled one, shape (3, 3)."""
    points: Array = field(repr=False)
    """Of the map, levelled, m, shape (n, 3)."""
    share: float = POOR
    """Of the way that the sigma may be in a good result."""
    unknown: tuple[Unknown, ...] = ()
    """Times of which nothing is known."""

    @property
    def poses(self) -> Array:
        """Return rows of t, x, y, z, qx, qy, qz, qw."""
        track, C = self.track, self.C_level
        q = np.array([_xyzw(one) for one in C @ track.attitude]).reshape(-1, 4)
        return np.hstack([track.stamp[:, None], track.pos_w @ C.T, q])

    def covariances(self) -> Array:
        """Return rows of t and the upper triangle of the covariance of position and attitude.

        Relative to the first pose; position in the levelled world, attitude as a rotation vector of
        the body.
        """
        T = np.zeros((6, SEEN))
        T[:3, POS], T[3:, ATT] = self.C_level, np.eye(3)
        P = T @ self.track.covariance @ T.T
        return np.hstack([self.track.stamp[:, None], P[:, UPPER[0], UPPER[1]]])

    def relatives(self) -> Array:
        """Return rows of both times, relative pose, and the upper triangle of its covariance."""
        return self.track.relatives

    @property
    def way(self) -> float:
        """Return the length of the path, m."""
        steps = np.diff(self.track.pos_w, axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def sigma(self) -> float:
        """Return the largest sigma of the last position along any axis, m."""
        if self.track.last is None:
            return float("nan")
        return float(np.sqrt(np.linalg.eigvalsh(self.track.last.P[POS, POS])[-1]))

    @property
    def level(self) -> float:
        """Return one sigma of how the levelled world is tilted, rad."""
        if self.track.last is None:
            return float("nan")
        return float(np.sqrt(np.linalg.eigvalsh(self.track.last.P[DOWN, DOWN])[-1]))

    def sigmas(self, block: slice) -> Array:
        """Return those of attitude (body), position or velocity (levelled world), shape (n, 3)."""
        turn = np.eye(3) if block == ATT else self.C_level
        P = turn @ self.track.covariance[:, block, block] @ turn.T
        return np.asarray(np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0)))

    def open_stretches(self) -> list[OpenStretch]:
        """Return the times without hold, with the direction of each."""
        stamp, axes = self.track.stamp, self.track.open_w
        # The first scan has no map to be held by
        which = 1 + np.flatnonzero(self.track.open_axes[1:])
        made: list[OpenStretch] = []
        for part in np.split(which, 1 + np.flatnonzero(np.diff(stamp[which]) > NAMED)):
            if not len(part) or stamp[part[-1]] - stamp[part[0]] < NAMED:
                continue
            along = self.C_level @ np.linalg.eigh(axes[part].sum(axis=0))[1][:, -1]
            along *= 1.0 if along[np.argmax(np.abs(along))] > 0 else -1.0
            x, y, z = along.tolist()
            made.append(OpenStretch(float(stamp[part[0]]), float(stamp[part[-1]]), (x, y, z)))
        return made

    def verdict(self) -> str:
        """Return what the result is good for, in one line."""
        way, sigma, stretches = self.way, self.sigma, self.open_stretches()
        count, matched = len(self.track), int(self.track.is_matched.sum())
        if matched < 0.5 * count:
            return f"poor: {count - matched} of {count} scans match nothing"
        spans = [one.end - one.start for one in stretches]
        is_held = sum(spans) <= MOST_OPEN * float(np.diff(self.track.stamp).sum())
        is_good = is_held and sigma <= max(self.share * way, LEAST_SIGMA)
        grade = "good" if is_good else "poor"
        text = f"{grade}: {way:.0f} m, own sigma {sigma:.{1 if sigma >= 1.0 else 2}f} m"
        if stretches:
            longest = stretches[int(np.argmax(spans))]
            x, y, z = longest.direction
            text += (
                f"; {sum(spans):.0f} s without hold along ({x:.2f}, {y:.2f}, {z:.2f})"
                f" from {longest.start:.1f} s on"
            )
        return text

    def remarks(self) -> list[str]:
        """Return what was decided, and what was found about the inertial samples."""
        lines = list(self.decisions)
        if self.track.clipped:
            lines.append(
                f"{self.track.clipped} inertial samples at the end of their range: noise widened"
            )
        if self.track.lost > 0.0:
            lines.append(f"{self.track.lost:.1f} s without inertial samples: noise widened")
        for one in self.unknown:
            found = (
                "the place in the map was found again"
                if one.is_found
                else "it was not found again in the map: another map begins where it was thought "
                "to be, and how far that may be off is in the sigmas"
            )
            lines.append(
                f"inertial samples are missing from {one.start:.1f} to {one.end:.1f} s: {found}"
            )
        if (last := self.track.last) is not None:
            if last.P[23, 23] > 0.0:
                lines.append(
                    f"delay of the inertial stamps {1e3 * last.state.delay:.1f} ms, "
                    f"sigma {1e3 * np.sqrt(last.P[23, 23]):.1f} ms"
                )
            if last.P[17:23, 17:23].any():
                angle = np.degrees(np.sqrt(np.trace(last.P[17:20, 17:20]) / 3.0))
                x, y, z = last.state.pos_b.tolist()
                q = ", ".join(f"{one:.4f}" for one in _xyzw(last.state.C_bl))
                lines.append(
                    f"mounted at ({x:.3f}, {y:.3f}, {z:.3f}) m, quaternion x, y, z, w ({q}), "
                    f"sigma {angle:.2f} deg"
                )
        return lines


def start(recording: Recording, settings: Settings) -> Odometry:
    """Return the odometry of a recording, its mounting and delay found where that is asked."""
    found = calibrate(recording, settings)
    return Odometry(
        recording.inertial,
        found.mounting,
        settings,
        delay=found.delay,
        calibration=found.P,
        alignment=found.alignment,
    )


def solve(recording: Recording, settings: Settings) -> Solution:
    """Return the trajectory of a recording: by its radial speeds, or by its surroundings."""
    if recording.by_doppler:
        track, x, found = radar.solve(recording, settings)
        return Solution(
            name=recording.name,
            decisions=(*recording.decisions, *found),
            track=track,
            C_level=levelled(x.down_w),
            points=np.zeros((0, 3)),
            share=POOR_BY_DOPPLER,
        )
    odometry = start(recording, settings)
    track = Track()
    for scan in recording.scans:
        for one in odometry.process(scan):
            track.add(one)
    for one in odometry.finish():
        track.add(one)
    C_level = levelled(odometry.x.down_w)
    return Solution(
        name=recording.name,
        decisions=tuple(recording.decisions),
        track=track,
        C_level=C_level,
        points=odometry.map.voxels.points() @ C_level.T,
        unknown=tuple(odometry.unknown),
    )


def _xyzw(C: Array) -> list[float]:
    w, x, y, z = so3.from_matrix(C).tolist()
    return [x, y, z, w]


def lines_of(solution: Solution, kind: str) -> Iterator[str]:
    """Yield the lines of an output: .tum, .csv, rel, cov or ply."""
    if kind == ".tum":
        for row in solution.poses:
            yield " ".join(f"{one:.6f}" for one in row[:4]) + "".join(
                f" {one:.9f}" for one in row[4:]
            )
    elif kind == ".csv":
        yield (
            "t_s,x_m,y_m,z_m,qx,qy,qz,qw,vx_m_s,vy_m_s,vz_m_s,"
            "sigma_x_m,sigma_y_m,sigma_z_m,sigma_rx_rad,sigma_ry_rad,sigma_rz_rad,"
            f"sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s,rows,{LEVEL},{SINCE}," + ",".join(COVARIANCE)
        )
        track = solution.track
        vel = track.vel_w @ solution.C_level.T
        sigmas = [solution.sigmas(block) for block in (POS, ATT, VEL)]
        numbers = np.hstack([solution.poses, vel, *sigmas])
        ends = {float(one[1]): one for one in solution.relatives()}
        for row, used in zip(numbers, track.used, strict=True):
            words = [f"{value:.9g}" for value in row[1:]]
            words += [str(int(used)), f"{solution.level:.9g}"]
            if (relative := ends.get(float(row[0]))) is None:
                words += [""] * (1 + len(COVARIANCE))
            else:
                words += [f"{relative[0]:.6f}", *(f"{one:.9g}" for one in relative[9:])]
            yield ",".join([f"{row[0]:.6f}", *words])
    elif kind == "ply":
        yield "ply\nformat ascii 1.0"
        yield f"element vertex {len(solution.points)}"
        yield "property float x\nproperty float y\nproperty float z\nend_header"
        for x, y, z in solution.points.tolist():
            yield f"{x:.3f} {y:.3f} {z:.3f}"
    else:
        table = solution.relatives() if kind == "rel" else solution.covariances()
        stamps = 2 if kind == "rel" else 1
        for row in table:
            times = [f"{one:.6f}" for one in row[:stamps]]
            yield ",".join([*times, *(f"{one:.9g}" for one in row[stamps:])])
