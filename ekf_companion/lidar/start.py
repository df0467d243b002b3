"""The first state, from the first second of scans: whether at rest or in motion.

Gyro and accelerometer move the body; the velocity at the beginning, gravity and the bias of the
gyro are what is sought, and the positions are linear in all of them. No scan by itself has planes
that can be relied upon: a sparse one strikes a trunk twice, and what it strikes is distorted by the
motion that is not known yet. So all scans are placed by one motion, and the motion is sought by
which they lie on planes: that with the least sum over voxels of the logarithm of the variance about
the plane through the voxel's points. The planes themselves are eliminated (offset and both slopes),
so that what is left of a row is what the motion between the scans says. From large voxels to small
ones, as the variance in a large one has no other minimum nearby.

Source: Liu and Zhang 2021, "BALM: bundle adjustment for lidar mapping", arXiv 2010.08215 (planes
eliminated from the adjustment of poses); Golub and Pereyra 1973, "The differentiation of
pseudo-inverses and nonlinear least squares problems whose variables separate" (elimination);
Fuller 1987, "Measurement Error Models", ch. 2 (noise of the normals).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.lidar.motion import Path, Samples, propagate
from ekf_companion.lidar.recording import Mounting, Scan
from ekf_companion.lidar.sampling import evenly, grouped, within_range
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ACCEL_BIAS,
    DOWN,
    GYRO_BIAS,
    VEL,
    N,
    State,
)
from ekf_companion.nav.arrays import Array, Indices
from ekf_companion.nav.direction import direction_by_angles

SPAN = 1.0
"""Of the scans by which the start is found, s: sigmas of 0.1 m/s^2 come of it between trees, which
is what the bias of an accelerometer leaves to know of gravity."""
SPEED, ACCELERATION = 5.0, 2.0
"""Of a vehicle under way, one sigma on each axis, m/s and m/s^2."""
STAGES = ((0.5, 8.0, 0.4, 8), (1.0, 4.0, 0.2, 6), (1.0, 2.0, 0.1, 4), (1.0, 1.0, 0.0, 4))
"""Share of the span, edge of the voxels, m, roughness that is taken for noise, m, and number of
iterations: a twentieth of the edge is smooth enough for one minimum, and enough iterations that
more change nothing."""
GRID = np.array([0.618, 0.382, 0.236])
"""Shift of the grid from one iteration to the next, of its voxels: no face stays where it is."""
LEAST_POINTS = 6
"""Of a plane: three make it, as many again say how thick it is."""
CHANCE = 3.0
"""Standard errors by which what is held must exceed the noise of the normals."""
AGAIN = 9.0
"""Factor on the covariance: the filter takes the same scans again, and this prior shall not count
for more than a tenth of them."""
BLOCKS = 5
"""Parts of the start of which the mean rates and forces are compared."""
STILL_RATE, STILL_FORCE = 0.01, 0.1
"""Largest sigma of those at rest, rad/s and m/s^2: a hand or a pilot does not hold stiller."""
REST_RATE, REST_SPEED = 3e-3, 0.05
"""Sigma of both at rest, rad/s and m/s: a vehicle rocks, or has begun to turn. What the samples
show from one part to the next is no bound: a steady turn changes nothing."""
STILL = 3.0 * 9.0
"""Largest square of a velocity that is none, in its sigmas: three on each axis."""
TAIL = 2.0
"""Sigmas at which a row has half its weight."""


def find(
    scans: Sequence[Scan],
    samples: Samples,
    mounting: Mounting,
    settings: Settings,
    delay: float = 0.0,
    *,
    vel: Array | None = None,
    may_rest: bool = True,
) -> tuple[State, Array]:
    """Return the state at the beginning of the first scan, and its covariance, shape (27, 27).

    The world is the body there; the position and the attitude are zero by definition. ``vel``
    is the velocity that is expected, m/s; what is not seen to move is at rest, if it may.
    """
    x = State(C_bl=mounting.rotation, pos_b=mounting.position, delay=delay)
    path = _path(scans, x, samples, settings)
    steps = np.diff(path.stamp)
    mean = steps @ path.accel_w / max(float(steps.sum()), 1e-9)
    expected = np.zeros(3) if vel is None else vel
    motion = prior = np.concatenate([expected, -mean, np.zeros(3)])
    P = np.diag(variances(settings))
    points = _carried(scans, path, x, settings)
    number = 0
    for share, edge, rough, times in STAGES:
        some = points.until(share * SPAN)
        for _ in range(times):
            number += 1
            motion, P = _refined(some, motion, prior, edge, number * GRID, rough, settings)
    size = float(np.linalg.norm(motion[3:6]))
    is_found = size > 0.1 * settings.gravity
    x = replace(
        x,
        vel_w=motion[:3],
        gyro_bias=motion[6:],
        down_w=motion[3:6] / size if is_found else np.array([0.0, 0.0, -1.0]),
    )
    spread = rest(scans[0].stamp, scans[-1].stamp, samples) if may_rest else None
    return settled(x, AGAIN * P, spread, mean, settings)


def together(scans: Sequence[Scan], samples: Samples, x: State, settings: Settings) -> Array:
    """Return the points of some scans in w, by the motion that was found of them, m, (n, 3)."""
    still = State(C_bl=x.C_bl, pos_b=x.pos_b, delay=x.delay)
    motion = np.concatenate([x.vel_w, settings.gravity * x.down_w, x.gyro_bias])
    return _carried(scans, _path(scans, still, samples, settings), still, settings).placed(motion)


def settled(
    x: State, P: Array, spread: tuple[Array, float] | None, mean: Array, settings: Settings
) -> tuple[State, Array]:
    """Return a first state and its covariance, at rest where nothing is seen to move.

    Args:
        x: As it was found.
        P: Of its velocity, gravity and gyro bias, shape (9, 9).
        spread: What :func:`rest` has found.
        mean: Specific force over the start, in w, m/s^2.
        settings: Bias of the accelerometer, and gravity.
    """
    if spread is not None and is_still(x.vel_w, P[:3, :3]):
        # Nothing moves that inertial samples or scans can see
        rate, sigma = spread
        x = replace(x, vel_w=np.zeros(3), gyro_bias=rate, down_w=-mean / np.linalg.norm(mean))
        P = np.diag(np.repeat(np.square([REST_SPEED, STILL_FORCE, sigma]), 3))
    return x, covariance_of(x, P, settings)


def rest(begin: float, end: float, samples: Samples) -> tuple[Array, float] | None:
    """Return the mean rate and its sigma, rad/s, if the samples do not change between two times."""
    t = samples.stamp
    inside = (t > begin) & (t < end)
    if np.count_nonzero(inside) < 2 * BLOCKS:
        return None
    rates = [part.mean(axis=0) for part in np.array_split(samples.gyro[inside], BLOCKS)]
    forces = [part.mean(axis=0) for part in np.array_split(samples.accel[inside], BLOCKS)]
    rate, force = np.std(rates, axis=0).max(), np.std(forces, axis=0).max()
    if rate > STILL_RATE or force > STILL_FORCE:
        return None
    return np.mean(rates, axis=0), max(float(rate), REST_RATE)


def is_still(vel: Array, P: Array) -> bool:
    """Return whether a velocity is none within three sigma."""
    return float(vel @ np.linalg.solve(P, vel)) < STILL


def variances(settings: Settings) -> Array:
    """Return the variances of velocity, gravity and gyro bias before the first scan."""
    return np.repeat(np.square([SPEED, ACCELERATION, settings.gyro_bias]), 3)


def _path(scans: Sequence[Scan], x: State, samples: Samples, settings: Settings) -> Path:
    """Return the motion over some scans from rest, without gravity."""
    end = max(scan.stamp + float(scan.times.max(initial=0.0)) for scan in scans)
    falling = replace(settings, gravity=0.0)
    return propagate(x, samples, scans[0].stamp + x.delay, end + x.delay, falling)[3]


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points of all scans, carried by the inertial samples from rest and without gravity."""

    after: Array
    """Time since the first scan, s, shape (n,)."""
    C: Array
    """Body at the point's time to that at the beginning, shape (n, 3, 3)."""
    y: Array
    """From the body at the point's time, in w, m, shape (n, 3)."""
    q: Array
    """In w, m, shape (n, 3)."""

    def chosen(self, k: Indices) -> _Points:
        """Return some of the points."""
        return _Points(self.after[k], self.C[k], self.y[k], self.q[k])

    def until(self, time: float) -> _Points:
        """Return the points of a first part."""
        return self.chosen(np.flatnonzero(self.after <= time))

    def placed(self, motion: Array) -> Array:
        """Return the points at a velocity, a gravity and a bias of the gyro, m, shape (n, 3)."""
        t = self.after[:, None]
        turned = self.C @ motion[6:]
        by_turn = t**3 / 6.0 * np.cross(-motion[3:6], turned) - t * np.cross(turned, self.y)
        return np.asarray(self.q + t * motion[:3] + 0.5 * t * t * motion[3:6] + by_turn)

    def derivatives(self, motion: Array, normal: Array) -> Array:
        """Return those of normal' q by velocity, gravity and bias of the gyro, shape (n, 9)."""
        t = self.after[:, None]
        by_turn = t**3 / 6.0 * np.cross(normal, -motion[3:6]) - t * np.cross(self.y, normal)
        by_bias = np.einsum("nij,ni->nj", self.C, by_turn)
        return np.hstack([t * normal, 0.5 * t * t * normal, by_bias])


def _carried(scans: Sequence[Scan], path: Path, x: State, settings: Settings) -> _Points:
    """Return the points of scans, thinned, where a path from rest puts them."""
    made: list[tuple[Array, Array, Array, Array]] = []
    for scan in scans:
        k = within_range(scan.points, settings)
        k = evenly(k, settings.most_points)
        after = scan.stamp - scans[0].stamp + scan.times[k]
        turn, pos = path.at(scans[0].stamp + x.delay + after)
        C = turn.reshape(-1, 3, 3)
        y = np.einsum("nij,nj->ni", C, scan.points[k] @ x.C_bl.T + x.pos_b)
        made.append((after, C, y, y + pos))
    after, C, y, q = (np.concatenate(part) for part in zip(*made, strict=True))
    return _Points(after, C, y, q)


def _refined(
    points: _Points,
    motion: Array,
    expected: Array,
    edge: float,
    shift: Array,
    rough: float,
    settings: Settings,
) -> tuple[Array, Array]:
    """Return velocity, gravity and gyro bias after one more iteration, and their covariance."""
    prior = variances(settings)
    q = points.placed(motion)
    order, first, count = grouped(np.floor(q / edge + shift).astype(np.int64))
    is_plane = count >= LEAST_POINTS
    if not is_plane.any():
        return expected, np.diag(prior)
    many = np.repeat(is_plane, count)
    order, count = order[many], count[is_plane]
    first = np.cumsum(count) - count
    voxel = np.repeat(np.arange(len(count)), count)
    points, q = points.chosen(order), q[order]

    # The plane of each voxel
    d = q - (np.add.reduceat(q, first) / count[:, None])[voxel]
    squares = np.add.reduceat(d[:, :, None] * d[:, None, :], first) / count[:, None, None]
    values, axes = np.linalg.eigh(squares)
    var = np.maximum(values[:, 0], 0.0) * count / (count - 3.0)
    var = (var + rough**2 + settings.range_noise**2)[voxel]
    normal = axes[voxel, :, 0]
    z = -np.einsum("ni,ni->n", normal, d)
    weight = 1.0 / (var * (1.0 + z * z / (TAIL**2 * var)))

    # Rows without what an offset and two slopes of the plane explain
    H = points.derivatives(motion, normal)
    t = points.after[:, None]
    rows = np.hstack([H, z[:, None], t, 0.5 * t * t])
    along = np.einsum("nij,ni->nj", axes[voxel, :, 1:], d)
    X = np.hstack([np.ones((len(d), 1)), along])
    weighted = weight[:, None, None] * X[:, :, None]
    XX = np.add.reduceat(weighted * X[:, None, :], first)
    XX += 1e-9 * np.trace(XX, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    spread = np.linalg.inv(XX)
    rows -= np.einsum(
        "ni,nij->nj", X, (spread @ np.add.reduceat(weighted * rows[:, None, :], first))[voxel]
    )
    A, b = (H.T * weight) @ rows[:, :9], (H.T * weight) @ rows[:, 9]

    # The noise of normals holds nothing
    slopes = axes[:, :, 1:] @ spread[:, 1:, 1:] @ axes[:, :, 1:].transpose(0, 2, 1)
    times = np.add.reduceat(weight[:, None, None] * rows[:, 10:, None] * rows[:, None, 10:], first)
    A, b = _held(A, b, np.einsum("gab,gij->gaibj", times, slopes).reshape(-1, 6, 6), prior)
    P = np.linalg.inv(A + np.diag(1.0 / prior))
    return motion + P @ (b + (expected - motion) / prior), np.asarray(P)


def _held(A: Array, b: Array, noise: Array, prior: Array) -> tuple[Array, Array]:
    """Return normal equations without what the noise of the normals of g planes has in them.

    ``noise`` is what is expected of each in velocity and gravity, shape (g, 6, 6).
    """
    size = np.trace(noise, axis1=1, axis2=2)
    planes = float(size.sum()) ** 2 / max(float(size @ size), 1e-300)
    B = np.zeros_like(A)
    B[:6, :6] = (1.0 + CHANCE * np.sqrt(2.0 / max(planes, 1.0))) * noise.sum(axis=0)
    L = np.linalg.cholesky(A + np.diag(1e-6 / prior))
    white = np.linalg.inv(L)
    share, V = np.linalg.eigh(np.eye(len(A)) - white @ B @ white.T)
    part = L @ (V * np.clip(share, 0.0, 1.0)) @ V.T
    return np.asarray(part @ L.T), np.asarray(part @ white @ b)


def by_motion(x: State, settings: Settings) -> Array:
    """Return the derivative of the error state by velocity, gravity and gyro bias, (27, 9)."""
    J = np.zeros((N, 9))
    J[VEL, :3] = J[GYRO_BIAS, 6:] = np.eye(3)
    J[DOWN, 3:6] = np.linalg.pinv(settings.gravity * direction_by_angles(x.down_w))
    return J


def covariance_of(x: State, found: Array, settings: Settings) -> Array:
    """Return the covariance of a state of which velocity, gravity and gyro bias were found."""
    J = by_motion(x, settings)
    # The bias of the accelerometer looks like gravity
    by_bias = np.zeros((N, 3))
    by_bias[ACCEL_BIAS], by_bias[DOWN] = np.eye(3), J[DOWN, 3:6]
    return np.asarray(J @ found @ J.T + settings.accel_bias**2 * by_bias @ by_bias.T)
