"""What sensors should read of a state, how far off they are, and the Jacobian of that.

Jacobians are by the error state of :mod:`ekf_companion.filters.strapdown`.

Source: Groves 2013, section 14.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.strapdown import ATT, POS, VEL, N, Nominal, skew
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]


class Observation(Protocol):
    """Something measured, with the model of it."""

    @property
    def aid(self) -> str:
        """Name of what it corrects: ``position``, ``velocity`` or ``heading`` (always an angle)."""

    def covariance(self) -> Array:
        """Give that of its noise, R, shape (m, m)."""

    def bound(self, state: Nominal) -> Observation:
        """Give the same, what depends on its noise settled by a state: for sigma points."""

    def innovation(self, state: Nominal) -> Array:
        """Give measured minus predicted, shape (m,); an angle in [-pi, pi).

        States whose arrays have further leading axes give as many innovations, shape (..., m).
        """

    def jacobian(self, state: Nominal) -> Array:
        """Give the derivative of what is predicted by the error state, shape (m, 15)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Position:
    """Where the antenna is."""

    pos_n: Array
    """m from the origin."""
    std: Array
    """One sigma by axis, m."""
    lever_b: Array
    """Antenna from the inertial sensor, m."""
    aid: str = "position"

    def covariance(self) -> Array:
        """Give that of its noise, shape (3, 3)."""
        return np.diag(np.square(self.std))

    def bound(self, state: Nominal) -> Position:
        """Give itself: nothing depends on its noise."""
        return self

    def innovation(self, state: Nominal) -> Array:
        """Give measured minus predicted, m, shape (3,)."""
        return self.pos_n - state.pos_n - so3.to_matrix(state.q_nb) @ self.lever_b

    def jacobian(self, state: Nominal) -> Array:
        """Give the Jacobian, shape (3, 15)."""
        H = np.zeros((3, N))
        H[:, POS] = np.eye(3)
        H[:, ATT] = -so3.to_matrix(state.q_nb) @ skew(self.lever_b)
        return H


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Velocity:
    """How the antenna moves, in two or three axes."""

    vel_n: Array
    """North, east and, if known, down, m/s, shape (2,) or (3,)."""
    std: float
    """One sigma per axis, m/s."""
    swing_b: Array
    """Velocity of the antenna about the inertial sensor: rate x lever arm, m/s."""
    aid: str = "velocity"

    def covariance(self) -> Array:
        """Give that of its noise, shape (m, m)."""
        return self.std * self.std * np.eye(len(self.vel_n))

    def bound(self, state: Nominal) -> Velocity:
        """Give itself: nothing depends on its noise."""
        return self

    def innovation(self, state: Nominal) -> Array:
        """Give measured minus predicted, m/s, shape (m,)."""
        predicted = state.vel_n + so3.to_matrix(state.q_nb) @ self.swing_b
        return np.asarray(self.vel_n - predicted[..., : len(self.vel_n)])

    def jacobian(self, state: Nominal) -> Array:
        """Give the Jacobian, shape (m, 15)."""
        H = np.zeros((3, N))
        H[:, VEL] = np.eye(3)
        H[:, ATT] = -so3.to_matrix(state.q_nb) @ skew(self.swing_b)
        return H[: len(self.vel_n)]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Azimuth:
    """Direction over ground of something seen in b: of the forward axis, or of the field.

    What is seen with noise does not serve for the Jacobian: noise times noise would pass for a
    tilt, many times a second. So a field's Jacobian is that of the field as it should be.
    """

    seen_b: Array
    """What is seen, any length, shape (3,)."""
    azimuth: float
    """Where it points, from true north, clockwise, rad: a heading, or the declination."""
    std: float
    """One sigma, rad."""
    dip: float | None = None
    """How far below the horizon it points, rad; None: what is seen is exact."""
    level: Array | None = None
    """C_nb by which what is seen is levelled, whatever the state, shape (3, 3); None: its own."""
    aid: str = "heading"

    def covariance(self) -> Array:
        """Give that of its noise, shape (1, 1)."""
        return np.array([[self.std * self.std]])

    def bound(self, state: Nominal) -> Azimuth:
        """Give the same, levelled by a state: what a filter of sigma points needs."""
        return self if self.dip is None else replace(self, level=so3.to_matrix(state.q_nb))

    def innovation(self, state: Nominal) -> Array:
        """Give measured minus predicted, rad in [-pi, pi), shape (1,)."""
        C_nb = so3.to_matrix(state.q_nb)
        if self.level is None:
            return so3.wrap(self.azimuth - _azimuth(C_nb @ self.seen_b))
        expected_b = np.swapaxes(C_nb, -1, -2) @ self._expected_n(C_nb)
        return so3.wrap(_azimuth(expected_b @ self.level.T) - _azimuth(self.level @ self.seen_b))

    def jacobian(self, state: Nominal) -> Array:
        """Give the Jacobian, shape (1, 15)."""
        C_nb = so3.to_matrix(state.q_nb)
        level = C_nb if self.level is None else self.level
        expected_b = C_nb.T @ self._expected_n(C_nb)
        north, east, _ = (level @ expected_b).tolist()
        turned = -level @ skew(expected_b)
        H = np.zeros((1, N))
        H[0, ATT] = (north * turned[1] - east * turned[0]) / (north * north + east * east)
        return H

    def _expected_n(self, C_nb: Array) -> Array:
        """Give what should be seen, in n."""
        if self.dip is None:
            return C_nb @ self.seen_b
        level = np.cos(self.dip)
        return np.array(
            [level * np.cos(self.azimuth), level * np.sin(self.azimuth), np.sin(self.dip)]
        )


def _azimuth(v: Array) -> Array:
    """Give the direction over ground of vectors, rad, shape (..., 1)."""
    return np.arctan2(v[..., 1:2], v[..., :1])
