"""A state relative to a frame r that is fixed in n: n itself, or the body frame of some time.

Error state: the 15 of :mod:`ekf_companion.filters.strapdown` with r in place of n; the attitude of
r (rotation vector in r), its position (n), and the direction of gravity (two angles). If r is known
to be n, the first 15 are the ordinary error state; if r is moved to the body after each update, the
filter is robocentric.

A direction is a unit vector on the sphere; it is changed by two angles about the axes of
:func:`basis`, which are normal to it.

Source: Qin et al. 2020, "LINS: a lidar-inertial state estimator for robust and efficient
navigation", arXiv 1907.02233, section IV; Bloesch et al. 2017, "Iterated extended Kalman filter
based visual-inertial odometry using direct photometric feedback"; He, Xu, Zhang 2021, arXiv
2102.03804 (the sphere in a filter).
"""

from __future__ import annotations

import math
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
from ekf_companion.nav.so3 import cross, skew

FRAME_ATT, FRAME_POS, DOWN = slice(15, 18), slice(18, 21), slice(21, 23)
FULL = 23
_SMALL = 1e-4
"""Angle below which the coefficients are their series, rad: the next terms are 1e-10 of them."""


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


def basis(direction: Array) -> Array:
    """Return two axes normal to a direction and to each other, shape (3, 2)."""
    x, y, z = direction.tolist()
    # Duff et al. 2017, JCGT 6(1): no direction is singular
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])


def direction_plus(direction: Array, u: Array) -> Array:
    """Rotate a direction by two angles (rad, shape (2,)) about the axes of its basis."""
    there = so3.rotate(so3.exp(basis(direction) @ u), direction)
    return np.asarray(there / math.sqrt(float(there @ there)))


def direction_minus(to: Array, start: Array) -> Array:
    """Return the two angles that rotate one direction into another the shorter way, rad."""
    return np.asarray(basis(start).T @ (_ratio(to, start)[0] * cross(start, to)))


def direction_by_angles(direction: Array) -> Array:
    """Return the derivative of :func:`direction_plus` by the angles at 0, shape (3, 2)."""
    return np.asarray(-skew(direction) @ basis(direction))


def direction_jacobian(to: Array, start: Array) -> Array:
    """Return the derivative of (to plus u) minus start by u at 0, shape (2, 2)."""
    ratio, slope = _ratio(to, start)
    by_to = ratio * skew(start) + slope * np.outer(cross(start, to), start)
    return np.asarray(basis(start).T @ by_to @ direction_by_angles(to))


def _ratio(to: Array, start: Array) -> tuple[float, float]:
    """Return angle / sin(angle) between two directions, and its derivative by the cosine."""
    axis = cross(start, to)
    sine, cosine = math.sqrt(float(axis @ axis)), float(start @ to)
    angle = math.atan2(sine, cosine)
    if angle < _SMALL:
        return 1.0, -1.0 / 3.0
    # Opposite directions have no shorter way: any is as good
    sine = max(sine, 1e-12)
    return angle / sine, -(sine - angle * cosine) / sine**3
