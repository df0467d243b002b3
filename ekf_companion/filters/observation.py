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
from ekf_companion.nav.earth import STANDARD_GRAVITY

Array = npt.NDArray[np.float64]

STEEPEST = 0.1
"""Share of its length that a direction must have over ground to show an azimuth."""


class Observation(Protocol):
    """Something measured, with the model of it."""

    @property
    def aid(self) -> str:
        """Name of what it corrects: ``position``, ``velocity`` or ``heading``."""

    def covariance(self) -> Array:
        """Return that of its noise, R, shape (m, m)."""

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, shape (m,); an angle in [-pi, pi).

        States whose arrays have further leading axes give as many innovations, shape (..., m).
        """

    def jacobian(self, state: Nominal) -> Array:
        """Return the derivative of what is predicted by the error state, shape (m, 15)."""


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
        """Return that of its noise, shape (3, 3)."""
        return np.diag(np.square(self.std))

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, m, shape (3,)."""
        return self.pos_n - state.pos_n - so3.to_matrix(state.q_nb) @ self.lever_b

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (3, 15)."""
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
        """Return that of its noise, shape (m, m)."""
        return self.std * self.std * np.eye(len(self.vel_n))

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, m/s, shape (m,)."""
        predicted = state.vel_n + so3.to_matrix(state.q_nb) @ self.swing_b
        return np.asarray(self.vel_n - predicted[..., : len(self.vel_n)])

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (m, 15)."""
        H = np.zeros((3, N))
        H[:, VEL] = np.eye(3)
        H[:, ATT] = -so3.to_matrix(state.q_nb) @ skew(self.swing_b)
        return H[: len(self.vel_n)]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Azimuth:
    """Direction over ground of something seen in b: of the forward axis, or of the field."""

    seen_b: Array
    """What is seen, any length, shape (3,)."""
    azimuth: float
    """Where it points, from true north, clockwise, rad: a heading, or the declination."""
    std: float
    """One sigma, rad."""
    aid: str = "heading"

    def is_seen(self, state: Nominal) -> bool:
        """Return whether it is far enough from the vertical to point anywhere over ground."""
        seen_n = so3.to_matrix(state.q_nb) @ self.seen_b
        return bool(np.hypot(seen_n[0], seen_n[1]) > STEEPEST * np.linalg.norm(seen_n))

    def about(self, state: Nominal) -> Azimuth:
        """Return the same as an azimuth that was misread of a thing seen in its place.

        The noise of what is seen must not be in the Jacobian too: with a steep field the product
        of both pushes the level aside by 2 tan(dip) of its variance at each update, one way.

        Args:
            state: Best guess; there the innovation is the same.
        """
        C_nb = so3.to_matrix(state.q_nb)
        apart = float(self.innovation(state)[0])
        turn = so3.to_matrix(so3.exp(np.array([0.0, 0.0, apart])))
        return replace(
            self, seen_b=C_nb.T @ turn @ C_nb @ self.seen_b, azimuth=self.azimuth + apart
        )

    def covariance(self) -> Array:
        """Return that of its noise, shape (1, 1)."""
        return np.array([[self.std * self.std]])

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, rad in [-pi, pi), shape (1,)."""
        seen_n = so3.to_matrix(state.q_nb) @ self.seen_b
        return so3.wrap(self.azimuth - np.arctan2(seen_n[..., 1:2], seen_n[..., :1]))

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (1, 15); that of a yaw alone if :meth:`is_seen` is false."""
        C_nb = so3.to_matrix(state.q_nb)
        H = np.zeros((1, N))
        if not self.is_seen(state):
            H[0, ATT] = C_nb[2]
            return H
        north, east, _ = (C_nb @ self.seen_b).tolist()
        turned = -C_nb @ skew(self.seen_b)
        H[0, ATT] = (north * turned[1] - east * turned[0]) / (north * north + east * east)
        return H


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reset:
    """How an aid is taken that the estimate has not agreed with for too long."""

    gain: Array
    """Takes what the aid shows from it alone, shape (15, m)."""
    inflation: Array
    """What is added to the covariance of the error state, shape (15, 15)."""


def reset(aid: Observation, state: Nominal, seconds: float) -> Reset:
    """Return the update of a filter that knew nothing of what an aid shows.

    That block is position, velocity or the turn about down, in the axes that were told. The other
    states do not move, whatever P ties them to it, and what the block owes to them (a lever arm, a
    tilt) stays tied. A velocity does not go astray by itself: it was carried there by an attitude
    that is wrong, which is doubted by as much.

    Args:
        aid: What was measured.
        state: The estimate, with the wrong innovation.
        seconds: How long the estimate has gone without this aid.
    """
    H = aid.jacobian(state)
    # Its directions in the error state
    shown = np.zeros((1 if aid.aid == "heading" else len(H), N))
    inflation = np.zeros((N, N))
    if aid.aid == "heading":
        shown[0, ATT] = so3.to_matrix(state.q_nb)[2]
    else:
        shown[:, POS if aid.aid == "position" else VEL] = np.eye(3)[: len(shown)]
    if aid.aid == "velocity":
        astray = float(np.linalg.norm(aid.innovation(state)))
        tilt = min(astray / (STANDARD_GRAVITY * seconds), 1.0)
        inflation[ATT, ATT] = tilt * tilt * np.eye(3)
    return Reset(gain=np.asarray(shown.T @ np.linalg.pinv(H @ shown.T)), inflation=inflation)
