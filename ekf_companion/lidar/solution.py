"""What a recording gives: the trajectory with its covariance, relative poses, map and a verdict.

World: the body at the first pose, turned so that the last estimate of gravity points down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.lidar.calibration import calibrate
from ekf_companion.lidar.odometry import Estimate, Odometry, RelativePose
from ekf_companion.lidar.recording import Recording
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import ATT, POS, VEL, N, exp
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

UPPER = np.triu_indices(6)
NAMED = 1.0
"""Shortest time without hold that is named, s."""
POOR = 0.01
"""Share of the way that its own sigma may be in a good result: what odometry is bought for."""
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
    estimates: list[Estimate] = field(repr=False)
    C_level: Array
    """World of the filter to the levelled one, shape (3, 3)."""
    points: Array = field(repr=False)
    """Of the map, levelled, m, shape (n, 3)."""

    @property
    def poses(self) -> Array:
        """Return rows of t, x, y, z, qx, qy, qz, qw."""
        rows = [
            [one.stamp, *(self.C_level @ one.state.pos_w), *_xyzw(self.C_level @ one.state.C_wb)]
            for one in self.estimates
        ]
        return np.array(rows).reshape(-1, 8)

    def covariances(self) -> Array:
        """Return rows of t and the upper triangle of the covariance of position and attitude.

        Relative to the first pose; position in the levelled world, attitude as a rotation vector of
        the body.
        """
        T = np.zeros((6, N))
        T[:3, POS], T[3:, ATT] = self.C_level, np.eye(3)
        rows = [[one.stamp, *(T @ one.P @ T.T)[UPPER]] for one in self.estimates]
        return np.array(rows).reshape(-1, 22)

    def relatives(self) -> Array:
        """Return rows of both times, relative pose, and the upper triangle of its covariance."""
        found = [one.relative for one in self.estimates if one.relative is not None]
        return np.array([_relative_row(one) for one in found]).reshape(-1, 30)

    @property
    def way(self) -> float:
        """Return the length of the path, m."""
        steps = np.diff(self.poses[:, 1:4], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def sigma(self) -> float:
        """Return the largest sigma of the last position along any axis, m."""
        if not self.estimates:
            return float("nan")
        return float(np.sqrt(np.linalg.eigvalsh(self.estimates[-1].P[POS, POS])[-1]))

    def open_stretches(self) -> list[OpenStretch]:
        """Return the times without hold, with the direction of each."""
        made: list[OpenStretch] = []
        begin: Estimate | None = None
        total, last = np.zeros((3, 3)), 0.0
        for one in [*self.estimates, None]:
            axes = None if one is None else (np.eye(3) if one.match is None else one.match.open_w)
            if (
                one is not None
                and axes is not None
                and axes.shape[1]
                and one is not self.estimates[0]
            ):
                begin = one if begin is None else begin
                total = total + axes @ axes.T
                last = one.stamp
            elif begin is not None and (one is None or one.stamp - last > NAMED):
                if last - begin.stamp >= NAMED:
                    along = self.C_level @ np.linalg.eigh(total)[1][:, -1]
                    along *= 1.0 if along[np.argmax(np.abs(along))] > 0 else -1.0
                    x, y, z = along.tolist()
                    made.append(OpenStretch(begin.stamp, last, (x, y, z)))
                begin, total = None, np.zeros((3, 3))
        return made

    def verdict(self) -> str:
        """Return what the result is good for, in one line."""
        way, sigma, stretches = self.way, self.sigma, self.open_stretches()
        matched = sum(one.match is not None for one in self.estimates)
        if matched < 0.5 * len(self.estimates):
            count = len(self.estimates)
            return f"poor: {count - matched} of {count} scans match nothing"
        grade = "good" if sigma <= max(POOR * way, LEAST_SIGMA) else "poor"
        text = f"{grade}: {way:.0f} m, own sigma {sigma:.{1 if sigma >= 1.0 else 2}f} m"
        if stretches:
            spans = [one.end - one.start for one in stretches]
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
        if clipped := sum(one.clipped for one in self.estimates):
            lines.append(f"{clipped} inertial samples at the end of their range: noise widened")
        if (lost := sum(one.lost for one in self.estimates)) > 0.0:
            lines.append(f"{lost:.1f} s without inertial samples: noise widened")
        if self.estimates:
            last = self.estimates[-1]
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
                    f"lidar at ({x:.3f}, {y:.3f}, {z:.3f}) m, quaternion x, y, z, w ({q}), "
                    f"sigma {angle:.2f} deg"
                )
        return lines


def solve(recording: Recording, settings: Settings) -> Solution:
    """Return the trajectory of a recording."""
    found = calibrate(recording, settings)
    odometry = Odometry(
        recording.inertial, found.mounting, settings, delay=found.delay, calibration=found.P
    )
    estimates: list[Estimate] = []
    for scan in recording.scans:
        estimates += odometry.process(scan)
    estimates += odometry.finish()
    down = estimates[-1].state.down_w if estimates else np.array([0.0, 0.0, -1.0])
    C_level = levelled(down)
    return Solution(
        name=recording.name,
        decisions=tuple(recording.decisions),
        estimates=estimates,
        C_level=C_level,
        points=odometry.map.points() @ C_level.T,
    )


def levelled(down: Array) -> Array:
    """Return the smallest rotation that turns a direction down, shape (3, 3)."""
    axis = so3.cross(down, np.array([0.0, 0.0, -1.0]))
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, -down[2]))
    return exp(axis * (angle / sine)) if sine > 1e-12 else exp(np.array([angle, 0.0, 0.0]))


def _xyzw(C: Array) -> list[float]:
    w, x, y, z = so3.from_matrix(C).tolist()
    return [x, y, z, w]


def _relative_row(one: RelativePose) -> list[float]:
    return [one.start, one.end, *one.pos.tolist(), *_xyzw(one.C), *one.P[UPPER].tolist()]


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
            "sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s,rows"
        )
        for row, one in zip(solution.poses, solution.estimates, strict=True):
            C = solution.C_level
            vel = C @ one.state.vel_w
            blocks = (C @ one.P[POS, POS] @ C.T, one.P[ATT, ATT], C @ one.P[VEL, VEL] @ C.T)
            sigmas = [np.sqrt(np.maximum(np.diag(block), 0.0)) for block in blocks]
            numbers = [f"{value:.9g}" for value in np.concatenate([row[1:], vel, *sigmas])]
            used = 0 if one.match is None else one.match.used
            yield ",".join([f"{row[0]:.6f}", *numbers, str(used)])
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
