"""A state relative to a frame r that is fixed in n: n itself, or the body frame of some time.

Error state: the 15 of :mod:`ekf_companion.filters.strapdown` with r in place of n; the attitude of
r (rotation vector in r), its position (n), and the direction of gravity (two angles). If r is known
to be n, the first 15 are the ordinary error state; if r is moved to the body after each update, the
filter is robocentric.

A direction is a unit vector on the sphere; it is changed by two angles about the axes of
:func:`ekf_companion.nav.direction.basis`, which are normal to it.

Source: Qin et al. 2020, "LINS: a lidar-inertial state estimator for robust and efficient
navigation", arXiv 1907.02233, section IV; Bloesch et al. 2017, "Iterated extended Kalman filter
based visual-inertial odometry using direct photometric feedback"; He, Xu, Zhang 2021, arXiv
2102.03804 (the sphere in a filter).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ekf_companion.filters.strapdown import (
    ATT,
    POS,
    VEL,
    Earth,
    Interval,
    N,
    Nominal,
    integrate_strapdown,
    transition,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import (
    direction_by_angles,
    direction_jacobian,
    direction_minus,
    direction_plus,
)
from ekf_companion.nav.so3 import skew

FRAME_ATT, FRAME_POS, DOWN = slice(15, 18), slice(18, 21), slice(21, 23)
FULL = 23


def _identity() -> Array:
    return np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RobocentricState:
    """State relative to r, pose of r in n, and direction of gravity."""

    local: Nominal
    """In r: ``q_nb`` is from b to r, ``vel_n`` and ``pos_n`` are in r."""
    q_nr: Array = field(default_factory=_identity)
    """Attitude of r, shape (4,)."""
    pos_nr: Array = field(default_factory=lambda: np.zeros(3))
    """Position of r, m, n."""
    down_n: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Unit vector."""

    def plus(self, dx: Array) -> RobocentricState:
        """Add an error state, shape (23,)."""
        return RobocentricState(
            local=self.local.plus(dx[:N]),
            q_nr=so3.normalise(so3.multiply(self.q_nr, so3.exp(dx[FRAME_ATT]))),
            pos_nr=self.pos_nr + dx[FRAME_POS],
            down_n=direction_plus(self.down_n, dx[DOWN]),
        )

    def minus(self, other: RobocentricState) -> Array:
        """Return the error state from the other to this state, shape (23,)."""
        turn = so3.log(so3.multiply(so3.conjugate(other.q_nr), self.q_nr))
        down = direction_minus(self.down_n, other.down_n)
        gap = [self.local.minus(other.local), turn, self.pos_nr - other.pos_nr, down]
        return np.concatenate(gap)

    def jacobian(self, other: RobocentricState) -> Array:
        """Return the derivative of (this plus d) minus other by d at 0, shape (23, 23)."""
        J = np.eye(FULL)
        gap = so3.multiply(so3.conjugate(other.local.q_nb), self.local.q_nb)
        J[ATT, ATT] = so3.right_jacobian_inverse(so3.log(gap))
        gap = so3.multiply(so3.conjugate(other.q_nr), self.q_nr)
        J[FRAME_ATT, FRAME_ATT] = so3.right_jacobian_inverse(so3.log(gap))
        J[DOWN, DOWN] = direction_jacobian(self.down_n, other.down_n)
        return J

    def in_n(self) -> Nominal:
        """Return the state in n."""
        C_nr = so3.to_matrix(self.q_nr)
        return replace(
            self.local,
            q_nb=so3.normalise(so3.multiply(self.q_nr, self.local.q_nb)),
            vel_n=C_nr @ self.local.vel_n,
            pos_n=self.pos_nr + C_nr @ self.local.pos_n,
        )

    def in_n_jacobian(self) -> Array:
        """Return the derivative of the error state in n by this one, shape (15, 23)."""
        C_nr = so3.to_matrix(self.q_nr)
        T = np.eye(N, FULL)
        T[ATT, FRAME_ATT] = so3.to_matrix(self.local.q_nb).T
        T[VEL, VEL] = T[POS, POS] = C_nr
        T[VEL, FRAME_ATT] = -C_nr @ skew(self.local.vel_n)
        T[POS, FRAME_ATT] = -C_nr @ skew(self.local.pos_n)
        T[POS, FRAME_POS] = np.eye(3)
        return T

    def recentred(self) -> tuple[RobocentricState, Array]:
        """Move r to the present body frame; the relative pose becomes part of the pose of r.

        The relative pose is then zero and known. The derivative of the error state by the one
        before, shape (23, 23), loses no uncertainty.
        """
        now, C_br = self.in_n(), so3.to_matrix(self.local.q_nb).T
        vel_b = C_br @ self.local.vel_n
        G = np.eye(FULL)
        in_n = self.in_n_jacobian()
        G[FRAME_ATT], G[FRAME_POS] = in_n[ATT], in_n[POS]
        G[VEL] = 0.0
        G[VEL, VEL], G[VEL, ATT] = C_br, skew(vel_b)
        G[ATT] = G[POS] = 0.0
        here = replace(self.local, q_nb=_identity(), vel_n=vel_b, pos_n=np.zeros(3))
        return replace(self, local=here, q_nr=now.q_nb, pos_nr=now.pos_n), G

    def integrated(self, over: Interval, earth: Earth) -> tuple[RobocentricState, Array]:
        """Integrate the motion over an interval, with the state's own direction of gravity.

        The matrix is the derivative of the error state by the one before, shape (23, 23).
        """
        C_rn = so3.to_matrix(self.q_nr).T
        size, dt = earth.gravity + earth.gradient * self.pos_nr[2], over.dt
        earth_r = Earth(
            gravity=float(size),
            gradient=earth.gradient,
            rate_n=C_rn @ earth.rate_n,
            down_n=C_rn @ self.down_n,
        )
        Phi = np.eye(FULL)
        Phi[:N, :N] = transition(self.local, over, earth_r)
        fall = np.zeros((3, FULL))
        fall[:, FRAME_ATT] = skew(size * earth_r.down_n)
        fall[:, DOWN] = size * C_rn @ direction_by_angles(self.down_n)
        Phi[VEL] += dt * fall
        Phi[POS] += 0.5 * dt * dt * fall
        return replace(self, local=integrate_strapdown(self.local, over, earth_r)), Phi
