"""Inertial samples: screening, gaps, rest and levelling."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings.settings import AlignSettings, ImuSettings
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind

LARGEST_RATE, LARGEST_FORCE = 200.0, 2000.0
"""rad/s, m/s^2, per axis: the limits of the daemon's screening."""
LONGEST_GAP = ImuSettings().gap_reset
"""Longest gap in the samples that the filters bridge, s."""
LARGEST_BIAS = 0.1
"""rad/s; no gyro of today has such a bias, so a faster rate is a turn."""
LEVEL = 0.1
"""Share by which the specific force at rest may differ from gravity."""


def inertial_samples(events: Events) -> Events:
    """Return the plausible inertial samples of events in any order, stamps strictly ascending.

    Of several samples of one time the first counts.
    """
    imu = events.take(events.kind == Kind.IMU)
    # NaN is not below a limit either
    is_good = (np.abs(imu.values[:, :3]) <= LARGEST_RATE).all(axis=1)
    is_good &= (np.abs(imu.values[:, 3:6]) <= LARGEST_FORCE).all(axis=1)
    imu = imu.take(np.flatnonzero(is_good))
    return imu.take(np.unique(imu.t_ns, return_index=True)[1])


def longest_part(imu: Events, gap: float = LONGEST_GAP) -> tuple[Events, tuple[str, ...]]:
    """Return the longest part of samples without a longer gap, s, and a note if it is not all."""
    gaps = np.diff(imu.t_ns)
    cuts = np.flatnonzero(gaps > gap * 1e9) + 1
    if not len(cuts):
        return imu, ()
    parts = np.split(np.arange(len(imu)), cuts)
    kept = imu.take(max(parts, key=len))
    begin, end = (int(t) * 1e-9 for t in (kept.t_ns[0], kept.t_ns[-1]))
    return kept, (
        f"the inertial samples have {len(cuts)} gaps of more than {gap:g} s, the longest of "
        f"{gaps.max() * 1e-9:.1f} s: only the part from {begin:.1f} to {end:.1f} s is estimated; "
        "eskf goes on after a gap",
    )


def is_stationary(mean: Array, std: Array, limits: AlignSettings) -> Mask:
    """Return which windows of samples are at rest: quiet, not turning, and of one g.

    A slow and steady turn is as quiet as a rest. Means and standard deviations are of gyro (rad/s)
    and accelerometer (m/s^2) in each window, shape (..., 6).
    """
    force = np.linalg.norm(mean[..., 3:], axis=-1) / STANDARD_GRAVITY
    return np.asarray(
        (np.linalg.norm(std[..., :3], axis=-1) < limits.rest_gyro)
        & (np.linalg.norm(std[..., 3:], axis=-1) < limits.rest_accel)
        & (np.linalg.norm(mean[..., :3], axis=-1) < LARGEST_BIAS)
        & (np.abs(force - 1.0) < LEVEL)
    )


def level(force_b: Array) -> Array:
    """Return the attitude of yaw 0 in which a specific force points up, shape (4,)."""
    x, y, z = force_b.tolist()
    return so3.from_euler(np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), 0.0)


def turn(q_nb: Array, yaw: npt.ArrayLike) -> Array:
    """Return attitudes turned about down, rad."""
    return so3.multiply(so3.from_euler(0.0, 0.0, yaw), q_nb)
