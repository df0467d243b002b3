"""Gaps in a vehicle's inertial samples: its motion in them, by the model of the main estimator.

Rate and specific force are a first-order Gauss-Markov process each, whose values at both ends of a
gap are known. The numbers are those of ``inflate_after_gap`` in
:mod:`ekf_companion.core.order.step`, whose equations are compiled for its own state;
``tests/filters/test_gap.py`` compares both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.core.settings.settings import ImuSettings
from ekf_companion.filters.strapdown import ATT, POS, VEL, Earth, Interval, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

SHORTEST = ImuSettings().gap
"""Longest step between samples that is not a gap, s."""
SLOW = 3.0
"""Multiple of the usual step beyond which there is a gap, even at a low rate."""
IRREGULAR = 1.5
"""Multiple of the usual step beyond which a sample is not the mean since the one before."""
MOTION_TIME = 0.4
"""Correlation time of a vehicle's motion, s."""
RATE_STD, FORCE_STD = 0.5, 6.7
"""One sigma of its rate, rad/s, unless both ends show more, and of its specific force, m/s^2."""
LARGEST_TURN = 2.0
"""Largest rotation that is expected to continue over a whole gap, rad."""


@dataclass(frozen=True, slots=True)
class Lost:
    """One sigma of the unknown motion in a gap, per axis."""

    tilt: float
    """rad."""
    yaw: float
    """rad."""
    velocity: float
    """m/s."""
    position: float
    """m."""

    def covariance(self, q_nb: Array) -> Array:
        """Return what to add to the covariance of the error state, shape (15, 15)."""
        C_nb = so3.to_matrix(q_nb)
        Q = np.zeros((N, N))
        Q[ATT, ATT] = C_nb.T @ np.diag([self.tilt**2, self.tilt**2, self.yaw**2]) @ C_nb
        Q[VEL, VEL] = self.velocity**2 * np.eye(3)
        Q[POS, POS] = self.position**2 * np.eye(3)
        return Q


def lost_motion(span: float, shortest: float = SHORTEST, gyro: Array | None = None) -> Lost | None:
    """Return the unknown motion in a step between samples, or None if it is not a gap.

    Args:
        span: Its length, s.
        shortest: The longest step that is not a gap, s.
        gyro: The rates at both its ends, rad/s, shape (2, 3).
    """
    if not span > shortest:
        return None
    shown = 0.0 if gyro is None else math.sqrt(float(np.mean(gyro * gyro)))
    ratio = span / MOTION_TIME
    spread = MOTION_TIME * math.sqrt(2.0 * (ratio - 2.0 * math.tanh(0.5 * ratio)))
    return hidden(span, max(RATE_STD, shown) * spread, FORCE_STD * spread)


def hidden(span: float, turned: float, gained: float) -> Lost:
    """Return the unknown motion in a gap, with bounds: tilt by half a radian at most.

    Args:
        span: Its length, s.
        turned: One sigma of the rotation in it, rad.
        gained: One sigma of the change of velocity, m/s.
    """
    velocity = min(gained, 20.0)
    return Lost(
        tilt=min(turned, 0.5),
        yaw=min(turned, 1.8),
        velocity=velocity,
        position=0.5 * velocity * span,
    )


def seen_share(span: float, gyro: Array | None = None) -> float:
    """Return the share of the mean of both ends that is expected over a gap, 1 down to 0.

    Args:
        span: Its length, s.
        gyro: The rate at its end, rad/s, shape (3,): no vehicle turns so fast for long.
    """
    if gyro is not None and float(gyro @ gyro) * span * span > LARGEST_TURN**2:
        return 0.0
    ratio = 0.5 * span / MOTION_TIME
    return math.tanh(ratio) / ratio


def over_gap(over: Interval, state: Nominal, earth: Earth, share: float) -> Interval:
    """Return the interval of a gap with a share of the mean of its ends; 0: no motion.

    For the rest the vehicle is assumed neither to turn nor to accelerate.
    """
    C_bn = so3.to_matrix(state.q_nb).T
    rate_b = state.gyro_bias + C_bn @ earth.rate_n
    force_b = state.accel_bias - C_bn @ earth.accel_n(state)
    rate_b = rate_b + share * (over.gyro - rate_b)
    force_b = force_b + share * (over.accel - force_b)
    return replace(over, gyro0=rate_b, gyro1=rate_b, accel0=force_b, accel1=force_b)
