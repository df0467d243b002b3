"""Inertial samples that a filter can go through: in order, without what no sensor says."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import AlignSettings, ImuSettings
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind

Array = npt.NDArray[np.float64]

LARGEST_RATE, LARGEST_FORCE = 200.0, 2000.0
"""rad/s, m/s^2, per axis: what the daemon takes for a reading."""
LONGEST = ImuSettings().gap_reset
"""Silence that no filter here bridges, s."""
LARGEST_BIAS = 0.1
"""rad/s; no gyro of today has such a bias, so a faster rate is a turn."""
LEVEL = 0.1
"""Share by which the specific force at rest may differ from gravity."""


def inertial(events: Events) -> Events:
    """Return the inertial samples of events in any order, stamps strictly ascending.

    What no sensor can say is no sample; of several of one time the first counts.
    """
    imu = events.take(events.kind == Kind.IMU)
    # NaN is not below a limit either
    is_good = (np.abs(imu.values[:, :3]) <= LARGEST_RATE).all(axis=1)
    is_good &= (np.abs(imu.values[:, 3:6]) <= LARGEST_FORCE).all(axis=1)
    imu = imu.take(np.flatnonzero(is_good))
    return imu.take(np.unique(imu.t_ns, return_index=True)[1])


def unbroken(imu: Events, longest: float = LONGEST) -> tuple[Events, tuple[str, ...]]:
    """Return the longest part of samples without a gap that no filter can bridge, and a note."""
    gaps = np.diff(imu.t_ns)
    cuts = np.flatnonzero(gaps > longest * 1e9) + 1
    if not len(cuts):
        return imu, ()
    parts = np.split(np.arange(len(imu)), cuts)
    kept = imu.take(max(parts, key=len))
    begin, end = (int(t) * 1e-9 for t in (kept.t_ns[0], kept.t_ns[-1]))
    return kept, (
        f"the inertial samples have {len(cuts)} gaps of more than {longest:g} s, the longest of "
        f"{gaps.max() * 1e-9:.1f} s: only the part from {begin:.1f} to {end:.1f} s is estimated; "
        "eskf goes on after a gap",
    )


def is_stationary(mean: Array, std: Array, limits: AlignSettings) -> npt.NDArray[np.bool_]:
    """Return which windows of samples are at rest: quiet, not turning, and of one g.

    A slow and steady turn is as quiet as a rest.

    Args:
        mean: Of gyro (rad/s) and accelerometer (m/s^2) in each window, shape (..., 6).
        std: Standard deviations, shape (..., 6).
        limits: Largest standard deviations at rest.
    """
    force = np.linalg.norm(mean[..., 3:], axis=-1) / STANDARD_GRAVITY
    return np.asarray(
        (np.linalg.norm(std[..., :3], axis=-1) < limits.rest_gyro)
        & (np.linalg.norm(std[..., 3:], axis=-1) < limits.rest_accel)
        & (np.linalg.norm(mean[..., :3], axis=-1) < LARGEST_BIAS)
        & (np.abs(force - 1.0) < LEVEL)
    )


def levelled(force_b: Array) -> Array:
    """Return the attitude with yaw 0 in which a specific force points up, shape (4,)."""
    x, y, z = force_b.tolist()
    return so3.from_euler(np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), 0.0)
