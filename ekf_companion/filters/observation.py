"""Measurement models: innovation, covariance and Jacobian of position, velocity and azimuth.

Jacobians are by the error state of :mod:`ekf_companion.filters.strapdown`.

Source: Groves 2013, section 14.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ekf_companion.filters.strapdown import ATT, POS, VEL, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import STANDARD_GRAVITY

STEEPEST = 0.1
"""Least horizontal share of a direction that has a usable azimuth."""


class Observation(Protocol):
    """A measurement and its model."""

    @property
    def aid(self) -> str:
        """Return ``position``, ``velocity`` or ``heading``."""

    def covariance(self) -> Array:
        """Return the covariance of the noise, R, shape (m, m)."""

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, shape (m,); an angle in [-pi, pi).

        A state whose arrays have leading axes yields as many innovations, shape (..., m).
        """

    def jacobian(self, state: Nominal) -> Array:
        """Return the derivative of the prediction by the error state, shape (m, 15)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Position:
    """Position of the antenna."""

    pos_n: Array
    """m from the origin."""
    std: Array
    """One sigma by axis, m."""
    lever_b: Array
    """Antenna from the inertial sensor, m."""
    aid: str = "position"

    def covariance(self) -> Array:
        """Return the covariance of the noise, shape (3, 3)."""
        return np.diag(np.square(self.std))

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, m, shape (3,)."""
        return self.pos_n - state.pos_n - so3.to_matrix(state.q_nb) @ self.lever_b

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (3, 15)."""
        return _antenna_jacobian(state, POS, self.lever_b)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Velocity:
    """Velocity of the antenna, in two or three axes."""

    vel_n: Array
    """North, east and, if known, down, m/s, shape (2,) or (3,)."""
    std: float
    """One sigma per axis, m/s."""
    swing_b: Array
    """Velocity of the antenna about the inertial sensor: rate x lever arm, m/s."""
    aid: str = "velocity"

    def covariance(self) -> Array:
        """Return the covariance of the noise, shape (m, m)."""
        return self.std * self.std * np.eye(len(self.vel_n))

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, m/s, shape (m,)."""
        predicted = state.vel_n + so3.to_matrix(state.q_nb) @ self.swing_b
        return np.asarray(self.vel_n - predicted[..., : len(self.vel_n)])

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (m, 15)."""
        return _antenna_jacobian(state, VEL, self.swing_b)[: len(self.vel_n)]


def _antenna_jacobian(state: Nominal, block: slice, offset_b: Array) -> Array:
    """Return the derivative of a block of the state plus an offset in b, shape (3, 15)."""
    H = np.zeros((3, N))
    H[:, block] = np.eye(3)
    H[:, ATT] = -so3.to_matrix(state.q_nb) @ so3.skew(offset_b)
    return H


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Azimuth:
    """Azimuth of a direction known in b: of the forward axis, or of the magnetic field."""

    seen_b: Array
    """The direction, of any length, shape (3,)."""
    azimuth: float
    """Its azimuth from true north, clockwise, rad: a heading, or the declination."""
    std: float
    """One sigma, rad."""
    aid: str = "heading"

    def is_usable(self, state: Nominal) -> bool:
        """Return whether the direction is far enough from the vertical to have an azimuth."""
        seen_n = so3.to_matrix(state.q_nb) @ self.seen_b
        return bool(np.hypot(seen_n[0], seen_n[1]) > STEEPEST * np.linalg.norm(seen_n))

    def about(self, state: Nominal) -> Azimuth:
        """Return an aid of the same innovation with the error in the azimuth, not in the direction.

        The noise of the direction must not be in the Jacobian too: with a steep field the product
        of both biases the level by 2 tan(dip) of its variance at each update.
        """
        C_nb = so3.to_matrix(state.q_nb)
        apart = float(self.innovation(state)[0])
        turn = so3.to_matrix(so3.exp(np.array([0.0, 0.0, apart])))
        return replace(
            self, seen_b=C_nb.T @ turn @ C_nb @ self.seen_b, azimuth=self.azimuth + apart
        )

    def covariance(self) -> Array:
        """Return the covariance of the noise, shape (1, 1)."""
        return np.array([[self.std * self.std]])

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, rad in [-pi, pi), shape (1,)."""
        seen_n = so3.to_matrix(state.q_nb) @ self.seen_b
        return so3.wrap(self.azimuth - np.arctan2(seen_n[..., 1:2], seen_n[..., :1]))

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (1, 15); that of a yaw alone if it is not usable."""
        C_nb = so3.to_matrix(state.q_nb)
        H = np.zeros((1, N))
        if not self.is_usable(state):
            H[0, ATT] = C_nb[2]
            return H
        north, east, _ = (C_nb @ self.seen_b).tolist()
        turned = -C_nb @ so3.skew(self.seen_b)
        H[0, ATT] = (north * turned[1] - east * turned[0]) / (north * north + east * east)
        return H


def reset(
    aid: Observation, state: Nominal, seconds: float, *, has_velocity: bool = True
) -> tuple[Array, Array]:
    """Return the update by an aid that the gate has refused for too long.

    That is the gain that sets what the aid measures to the measurement, shape (15, m), and what is
    added to the covariance of the error state, shape (15, 15).

    It measures position, velocity or the turn about down, in its axes. The other states do
    not change, whatever their correlation with it in P, and its dependence on them (by a lever arm,
    a tilt) is kept. A velocity becomes wrong by a wrong attitude only, whose covariance is inflated
    by as much, given the seconds since the aid was last fused. A position becomes wrong by a wrong
    velocity, unless that has been fused meanwhile (``has_velocity``).
    """
    H = aid.jacobian(state)
    # The error states that it measures
    measured = np.zeros((1 if aid.aid == "heading" else len(H), N))
    inflation = np.zeros((N, N))
    if aid.aid == "heading":
        measured[0, ATT] = so3.to_matrix(state.q_nb)[2]
    else:
        measured[:, POS if aid.aid == "position" else VEL] = np.eye(3)[: len(measured)]
    if aid.aid == "velocity":
        error = float(np.linalg.norm(aid.innovation(state)))
        tilt = min(error / (STANDARD_GRAVITY * seconds), 1.0)
        inflation[ATT, ATT] = tilt * tilt * np.eye(3)
    if aid.aid == "position" and not has_velocity:
        drift = aid.innovation(state) / seconds
        inflation[VEL, VEL] = float(drift @ drift) * np.eye(3)
    return np.asarray(measured.T @ np.linalg.pinv(H @ measured.T)), inflation
