"""Gaps in the inertial samples: what happens meanwhile, as the main estimator takes it.

The numbers are those of ``inflate_after_gap`` in :mod:`ekf_companion.core.kernel`, whose equations
are compiled for its own state; ``tests/filters/test_gap.py`` compares both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.core.settings import ImuSettings
from ekf_companion.filters.strapdown import ATT, POS, VEL, Earth, Interval, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

SHORTEST = ImuSettings().gap
"""Longest step between samples that is no gap, s."""
SLOW = 3.0
"""Usual steps beyond which there is a gap, however slow the samples come."""
IRREGULAR = 1.5
"""Usual steps beyond which a sample does not stand for the whole time since the one before."""
BLIND = 0.5
"""Longest step over which the motion is interpolated, s; over a longer one none is assumed."""


@dataclass(frozen=True, slots=True)
class Lost:
    """One sigma of what a gap hides, per axis."""

    tilt: float
    """rad."""
    yaw: float
    """rad."""
    velocity: float
    """m/s."""
    position: float
    """m."""

    def covariance(self, q_nb: Array) -> Array:
        """Return what is added to the covariance of the error state, shape (15, 15)."""
        C_nb = so3.to_matrix(q_nb)
        Q = np.zeros((N, N))
        Q[ATT, ATT] = C_nb.T @ np.diag([self.tilt**2, self.tilt**2, self.yaw**2]) @ C_nb
        Q[VEL, VEL] = self.velocity**2 * np.eye(3)
        Q[POS, POS] = self.position**2 * np.eye(3)
        return Q


def lost_motion(
    span: float,
    usual: float,
    shortest: float = SHORTEST,
    seen: tuple[float, float] = (0.2, 2.0),
    unseen: tuple[float, float] = (0.5, 4.0),
) -> Lost | None:
    """Return what a step between samples hides, or None if it is no gap; all in s.

    A vehicle turns by some 0.2 rad/s and accelerates by some 2 m/s^2 (one sigma) beside what both
    ends of a gap show (``seen``); where they show nothing (``unseen``), by 0.5 rad/s and 4 m/s^2.
    Tilt is bounded.
    """
    if not span > shortest:
        return None
    is_blind = span > BLIND and span > SLOW * usual
    turned, gained = unseen if is_blind else seen
    velocity = min(gained * span, 20.0)
    return Lost(
        tilt=min(turned * span, 0.5),
        yaw=min(turned * span, 1.8),
        velocity=velocity,
        position=0.5 * velocity * span,
    )


def without_motion(over: Interval, state: Nominal, earth: Earth) -> Interval:
    """Return an interval in which the vehicle neither turns nor accelerates."""
    C_bn = so3.to_matrix(state.q_nb).T
    rate_b = state.gyro_bias + C_bn @ earth.rate_n
    force_b = state.accel_bias - C_bn @ earth.accel_n(state)
    return replace(over, gyro0=rate_b, gyro1=rate_b, accel0=force_b, accel1=force_b)
