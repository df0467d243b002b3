"""The first state, from the first scans: whether at rest or in motion.

Gyro and accelerometer move the body; the velocity at the beginning, gravity and the bias of the
gyro are what is sought: over half a second the positions are linear in the first two. Points of
later scans are compared with planes of the first one, which are distorted themselves by what is not
known yet: both are made anew at each iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ekf_companion.lidar.motion import Path, Samples, propagate
from ekf_companion.lidar.recording import Mounting, Scan
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ACCEL_BIAS,
    DELAY,
    DOWN,
    GYRO_BIAS,
    MOUNT_ATT,
    MOUNT_POS,
    VEL,
    N,
    State,
)
from ekf_companion.lidar.voxel_map import VoxelMap
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_by_angles

SCANS = 6
"""Of which the start is found."""
SPEED, ACCELERATION = 5.0, 2.0
"""Of a vehicle under way, one sigma on each axis, m/s and m/s^2."""
SEEDS = ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
"""Velocities to begin with: between far ones the planes of one scan may hold a wrong one."""
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
TAIL = 2.0
"""Sigmas at which a row has half its weight."""


def find(
    scans: Sequence[Scan],
    samples: Samples,
    mounting: Mounting,
    settings: Settings,
    delay: float = 0.0,
) -> tuple[State, Array]:
    """Return the state at the beginning of the first scan, and its covariance, shape (27, 27).

    The world is the body there; the position and the attitude are zero by definition.
    """
    x = State(C_bl=mounting.rotation, pos_b=mounting.position, delay=delay)
    path = _path(scans, np.zeros(3), x, samples, settings)
    steps = np.diff(path.stamp)
    mean = steps @ path.accel_w / max(float(steps.sum()), 1e-9)
    motion = prior = np.concatenate([np.zeros(3), -mean, np.zeros(3)])
    P = np.diag(_variances(settings))
    found = []
    for seed in SEEDS:
        motion = prior + np.concatenate([SPEED * np.array(seed), np.zeros(6)])
        for count in (1, 1, 1, 2):
            motion, _, score = _fit(scans[: count + 1], motion, prior, x, samples, settings)
        found.append((score, motion))
    motion = max(found, key=lambda one: one[0])[1]
    for count in (2, 3, *([len(scans) - 1] * 4)):
        motion, P, _ = _fit(scans[: count + 1], motion, prior, x, samples, settings)
    size = float(np.linalg.norm(motion[3:6]))
    is_found = size > 0.1 * settings.gravity
    x = replace(
        x,
        vel_w=motion[:3],
        gyro_bias=motion[6:],
        down_w=motion[3:6] / size if is_found else np.array([0.0, 0.0, -1.0]),
    )
    P = AGAIN * P
    if (spread := _rest(scans, samples)) is not None and _is_still(motion[:3], P[:3, :3]):
        # Nothing moves that inertial samples or lidar can see
        rate, sigma = spread
        x = replace(x, vel_w=np.zeros(3), gyro_bias=rate, down_w=-mean / np.linalg.norm(mean))
        P = np.diag(np.repeat(np.square([REST_SPEED, STILL_FORCE, sigma]), 3))
    return x, _covariance(x, P, mounting, settings)


def _rest(scans: Sequence[Scan], samples: Samples) -> tuple[Array, float] | None:
    """Return the mean rate and its sigma, rad/s, if the inertial samples do not change."""
    t = samples.stamp
    inside = (t > scans[0].stamp) & (t < scans[-1].stamp)
    if np.count_nonzero(inside) < 2 * BLOCKS:
        return None
    rates = [part.mean(axis=0) for part in np.array_split(samples.gyro[inside], BLOCKS)]
    forces = [part.mean(axis=0) for part in np.array_split(samples.accel[inside], BLOCKS)]
    rate, force = np.std(rates, axis=0).max(), np.std(forces, axis=0).max()
    if rate > STILL_RATE or force > STILL_FORCE:
        return None
    return np.mean(rates, axis=0), max(float(rate), REST_RATE)


def _is_still(vel: Array, P: Array) -> bool:
    """Return whether a velocity is none within three sigma."""
    return float(vel @ np.linalg.solve(P, vel)) < 3.0 * 9.0


def _variances(settings: Settings) -> Array:
    """Return the variances of velocity, gravity and gyro bias before the first scan."""
    return np.repeat(np.square([SPEED, ACCELERATION, settings.gyro_bias]), 3)


def _path(
    scans: Sequence[Scan], gyro_bias: Array, x: State, samples: Samples, settings: Settings
) -> Path:
    """Return the motion over some scans from rest, without gravity."""
    end = max(scan.stamp + float(scan.times.max(initial=0.0)) for scan in scans)
    still, falling = replace(x, gyro_bias=gyro_bias), replace(settings, gravity=0.0)
    return propagate(still, samples, scans[0].stamp + x.delay, end + x.delay, falling)[3]


def _fit(
    scans: Sequence[Scan],
    motion: Array,
    expected: Array,
    x: State,
    samples: Samples,
    settings: Settings,
) -> tuple[Array, Array, float]:
    """Return velocity, gravity and gyro bias after one more iteration, covariance and score.

    The score is the number of points on planes at the motion that it began with.
    """
    start = scans[0].stamp
    path = _path(scans, motion[6:], x, samples, settings)
    placed = []
    for scan in scans:
        square = np.einsum("ni,ni->n", scan.points, scan.points)
        kept = (square > settings.least_range**2) & (square < settings.most_range**2)
        after = scan.stamp - start + scan.times[kept]
        turn, pos = path.at(start + x.delay + after)
        C = turn.reshape(-1, 3, 3)
        y = np.einsum("nij,nj->ni", C, scan.points[kept] @ x.C_bl.T + x.pos_b)
        q = y + pos + after[:, None] * (motion[:3] + 0.5 * after[:, None] * motion[3:6])
        placed.append((after, C, y, q))
    var = settings.range_noise**2
    voxels = VoxelMap(settings)
    after, _, _, q = placed[0]
    if len(q):
        voxels.insert(q, np.full(len(q), var), 0)
    middle = float(after.mean()) if len(after) else 0.0
    prior = _variances(settings)
    A, b, score = np.diag(1.0 / prior), (expected - motion) / prior, 0.0
    for after, C, y, q in placed[1:]:
        planes = voxels.match(q)
        k = planes.index
        if not len(k):
            continue
        normal = planes.normal
        z = np.einsum("ni,ni->n", normal, planes.centre - q[k])
        dt = (after[k] - middle)[:, None]
        square = 0.5 * (after[k] ** 2 - middle**2)[:, None]
        turn = np.einsum("nij,ni->nj", C[k], np.cross(y[k], normal))
        H = np.hstack([dt * normal, square * normal, -dt * turn])
        slope = np.einsum("nki,ni->nk", planes.along, q[k] - planes.centre)
        offset = planes.spread[:, 0]
        R = var + offset + (slope * slope).sum(axis=1)
        spread = (1.5 * float(np.median(np.abs(z)))) ** 2
        w = 1.0 / (R * (1.0 + z * z / (TAIL**2 * (R + spread))))
        score += float((1.0 / (1.0 + z * z / (TAIL**2 * R))).sum())
        # Points on the same plane share its error
        _, back, each = np.unique(planes.voxel, return_inverse=True, return_counts=True)
        w /= 1.0 + (each * len(placed))[back] * offset / R
        A += (H * w[:, None]).T @ H
        b += (H * w[:, None]).T @ z
    P = np.linalg.inv(A)
    return motion + P @ b, np.asarray(P, dtype=np.float64), score


def _covariance(x: State, found: Array, mounting: Mounting, settings: Settings) -> Array:
    """Return the covariance of a state of which velocity, gravity and gyro bias were found."""
    P = np.zeros((N, N))
    P[VEL, VEL] = found[:3, :3]
    P[GYRO_BIAS, GYRO_BIAS] = found[6:, 6:]
    P[VEL, GYRO_BIAS] = found[:3, 6:]
    P[GYRO_BIAS, VEL] = found[6:, :3]
    P[ACCEL_BIAS, ACCEL_BIAS] = settings.accel_bias**2 * np.eye(3)
    # The bias of the accelerometer looks like gravity
    T = np.linalg.pinv(settings.gravity * direction_by_angles(x.down_w))
    P[DOWN, ACCEL_BIAS] = T @ P[ACCEL_BIAS, ACCEL_BIAS]
    P[ACCEL_BIAS, DOWN] = P[DOWN, ACCEL_BIAS].T
    P[DOWN, DOWN] = T @ (P[ACCEL_BIAS, ACCEL_BIAS] + found[3:6, 3:6]) @ T.T
    P[DOWN, VEL] = T @ found[3:6, :3]
    P[VEL, DOWN] = P[DOWN, VEL].T
    P[DOWN, GYRO_BIAS] = T @ found[3:6, 6:]
    P[GYRO_BIAS, DOWN] = P[DOWN, GYRO_BIAS].T
    if settings.is_mounting_estimated:
        P[MOUNT_ATT, MOUNT_ATT] = mounting.rotation_sigma**2 * np.eye(3)
        P[MOUNT_POS, MOUNT_POS] = mounting.position_sigma**2 * np.eye(3)
    P[DELAY, DELAY] = settings.delay_sigma**2
    return P
