"""A state relative to an anchor: a frame somewhere in n, known or not, that itself stands still.

Error state: the 15 of :mod:`ekf_companion.filters.strapdown` with the anchor's frame ``a`` in
place of n; then the anchor's attitude (rotation vector in a), its position (n), and gravity's
direction (two angles, see :mod:`ekf_companion.filters.manifold`). With an anchor known to be n,
the first 15 are the ordinary state; with one that is set anew into the body after each update, the
filter is robocentric.

Source: Qin et al. 2020, "LINS: a lidar-inertial state estimator for robust and efficient
navigation", arXiv 1907.02233, section IV; Bloesch et al. 2017, "Iterated extended Kalman filter
based visual-inertial odometry using direct photometric feedback".
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.manifold import (
    direction_by_turn,
    direction_jacobian,
    direction_minus,
    direction_plus,
    turn_jacobian_inverse,
)
from ekf_companion.filters.strapdown import (
    ATT,
    POS,
    VEL,
    Earth,
    Interval,
    N,
    Nominal,
    move,
    skew,
    transition,
)
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

ANCHOR_ATT, ANCHOR_POS, DOWN = slice(15, 18), slice(18, 21), slice(21, 23)
FULL = 23


def _north_east_down() -> Array:
    return np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Anchored:
    """Where it is in a, where a is in n, and where gravity points."""

    local: Nominal
    """In a: ``q_nb`` turns b into a, ``vel_n`` and ``pos_n`` are in a."""
    q_na: Array = field(default_factory=_north_east_down)
    """The anchor's attitude, shape (4,)."""
    pos_na: Array = field(default_factory=lambda: np.zeros(3))
    """The anchor's position, m, n."""
    down_n: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Unit vector."""

    def plus(self, dx: Array) -> Anchored:
        """Add an error state, shape (23,)."""
        return Anchored(
            local=self.local.plus(dx[:N]),
            q_na=so3.normalise(so3.multiply(self.q_na, so3.exp(dx[ANCHOR_ATT]))),
            pos_na=self.pos_na + dx[ANCHOR_POS],
            down_n=direction_plus(self.down_n, dx[DOWN]),
        )

    def minus(self, other: Anchored) -> Array:
        """Return the error state that leads from the other to this one, shape (23,)."""
        turn = so3.log(so3.multiply(so3.conjugate(other.q_na), self.q_na))
        down = direction_minus(self.down_n, other.down_n)
        gap = [self.local.minus(other.local), turn, self.pos_na - other.pos_na, down]
        return np.concatenate(gap)

    def jacobian(self, other: Anchored) -> Array:
        """Return the derivative of (this plus d) minus other by d at 0, shape (23, 23)."""
        J = np.eye(FULL)
        gap = so3.multiply(so3.conjugate(other.local.q_nb), self.local.q_nb)
        J[ATT, ATT] = turn_jacobian_inverse(so3.log(gap))
        gap = so3.multiply(so3.conjugate(other.q_na), self.q_na)
        J[ANCHOR_ATT, ANCHOR_ATT] = turn_jacobian_inverse(so3.log(gap))
        J[DOWN, DOWN] = direction_jacobian(self.down_n, other.down_n)
        return J

    def in_n(self) -> Nominal:
        """Return the state in n."""
        C_na = so3.to_matrix(self.q_na)
        return replace(
            self.local,
            q_nb=so3.normalise(so3.multiply(self.q_na, self.local.q_nb)),
            vel_n=C_na @ self.local.vel_n,
            pos_n=self.pos_na + C_na @ self.local.pos_n,
        )

    def in_n_jacobian(self) -> Array:
        """Return the derivative of the error state in n by this one, shape (15, 23)."""
        C_na = so3.to_matrix(self.q_na)
        T = np.eye(N, FULL)
        T[ATT, ANCHOR_ATT] = so3.to_matrix(self.local.q_nb).T
        T[VEL, VEL] = T[POS, POS] = C_na
        T[VEL, ANCHOR_ATT] = -C_na @ skew(self.local.vel_n)
        T[POS, ANCHOR_ATT] = -C_na @ skew(self.local.pos_n)
        T[POS, ANCHOR_POS] = np.eye(3)
        return T

    def re_anchored(self) -> tuple[Anchored, Array]:
        """Set the anchor into the body of now: the way since the last one becomes part of it.

        Returns:
            The state, its relative pose zero and known, and the derivative of its error state by
            that before, shape (23, 23): nothing of what was unsure is lost.
        """
        now, back = self.in_n(), so3.to_matrix(self.local.q_nb).T
        vel_b = back @ self.local.vel_n
        G = np.eye(FULL)
        in_n = self.in_n_jacobian()
        G[ANCHOR_ATT], G[ANCHOR_POS] = in_n[ATT], in_n[POS]
        G[VEL] = 0.0
        G[VEL, VEL], G[VEL, ATT] = back, skew(vel_b)
        G[ATT] = G[POS] = 0.0
        here = replace(self.local, q_nb=_north_east_down(), vel_n=vel_b, pos_n=np.zeros(3))
        return replace(self, local=here, q_na=now.q_nb, pos_na=now.pos_n), G

    def moved(self, over: Interval, earth: Earth) -> tuple[Anchored, Array]:
        """Carry it over an interval.

        Args:
            over: Inertial readings.
            earth: As n sees it; its direction of gravity does not count, the state's does.

        Returns:
            The state, and the derivative of its error state by that before, shape (23, 23).
        """
        C_an = so3.to_matrix(self.q_na).T
        size, dt = earth.gravity + earth.gradient * self.pos_na[2], over.dt
        seen = Earth(
            gravity=float(size),
            gradient=earth.gradient,
            rate_n=C_an @ earth.rate_n,
            down_n=C_an @ self.down_n,
        )
        Phi = np.eye(FULL)
        Phi[:N, :N] = transition(self.local, over, seen)
        fall = np.zeros((3, FULL))
        fall[:, ANCHOR_ATT] = skew(size * seen.down_n)
        fall[:, DOWN] = size * C_an @ direction_by_turn(self.down_n)
        Phi[VEL] += dt * fall
        Phi[POS] += 0.5 * dt * dt * fall
        return replace(self, local=move(self.local, over, seen)), Phi
