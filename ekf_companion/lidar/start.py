"""The first state: at rest, or in motion from the first scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.motion import Samples
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
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_by_angles


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A state and its covariance."""

    state: State
    P: Array
    time: float
    """Inertial clock, s."""


def begin(
    scans: Sequence[Scan], samples: Samples, mounting: Mounting, settings: Settings
) -> Start | None:
    """Return the first state, at the end of the first scan; None: more scans are needed."""
    if len(scans) < 5:
        return None
    first = scans[0].stamp
    upto = scans[-1].stamp
    inside = (samples.stamp > first) & (samples.stamp < upto)
    gyro, accel = samples.gyro[inside], samples.accel[inside]
    mean = accel.mean(axis=0)
    x = State(
        gyro_bias=gyro.mean(axis=0),
        down_w=-mean / np.linalg.norm(mean),
        C_bl=mounting.rotation,
        pos_b=mounting.position,
    )
    P = first_covariance(x, mounting, settings)
    P[VEL, VEL] = 0.01**2 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] = 0.001**2 * np.eye(3)
    return Start(x, P, first)


def first_covariance(x: State, mounting: Mounting, settings: Settings) -> Array:
    """Return the covariance before anything is known; the pose is zero by definition."""
    P = np.zeros((N, N))
    P[VEL, VEL] = 1.0 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] = settings.gyro_bias**2 * np.eye(3)
    P[ACCEL_BIAS, ACCEL_BIAS] = settings.accel_bias**2 * np.eye(3)
    # The bias of the accelerometer tilts the direction that its mean shows
    T = -np.linalg.pinv(settings.gravity * direction_by_angles(x.down_w))
    P[DOWN, ACCEL_BIAS] = -T @ P[ACCEL_BIAS, ACCEL_BIAS]
    P[ACCEL_BIAS, DOWN] = P[DOWN, ACCEL_BIAS].T
    P[DOWN, DOWN] = T @ P[ACCEL_BIAS, ACCEL_BIAS] @ T.T + 0.005**2 * np.eye(2)
    if settings.is_mounting_estimated:
        P[MOUNT_ATT, MOUNT_ATT] = mounting.rotation_sigma**2 * np.eye(3)
        P[MOUNT_POS, MOUNT_POS] = mounting.position_sigma**2 * np.eye(3)
    P[DELAY, DELAY] = settings.delay_sigma**2
    return P
