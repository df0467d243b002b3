"""What is told to others of the estimate: position, velocity, attitude, and how well known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

_STEEP = 0.1
"""Cosine of the pitch (84 deg) beyond which Euler angles say less than their variances would."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Odometry:
    """One estimate to be told."""

    t_ns: int
    """Time of validity, autopilot clock, ns."""
    pos_n: Array
    """North, east, down of the origin, m, shape (3,)."""
    vel_n: Array
    """m/s, shape (3,)."""
    q_nb: Array
    """Shape (4,)."""
    rates_b: Array
    """Angular rate without the gyro's bias, rad/s, shape (3,)."""
    pose_covariance: Array | None
    """Of pos_n and the attitude error (a rotation vector in n), shape (6, 6); None: not known."""
    velocity_covariance: Array | None
    """Of vel_n, shape (3, 3); None: not known."""
    reset_count: int
    """Discontinuities so far, >= 0."""
    quality: int
    """-1 failed, 0 not known, 1 to 100 per cent."""


def euler_jacobian(q_nb: Array) -> Array:
    """Give d(roll, pitch, yaw) / d(rotation vector in n), shape (3, 3).

    Within 6 degrees of pitching straight up or down it is held at what it is there.

    Source: Diebel 2006, "Representing attitude", eq. 77, for the angular velocity in n.
    """
    _, pitch, yaw = so3.to_euler(q_nb)
    cos_pitch = max(float(np.cos(pitch)), _STEEP)
    c, s, tan = np.cos(yaw), np.sin(yaw), np.sin(pitch) / cos_pitch
    return np.array([[c / cos_pitch, s / cos_pitch, 0.0], [-s, c, 0.0], [c * tan, s * tan, 1.0]])
