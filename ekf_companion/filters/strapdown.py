"""The motion model that the filters share: 15 states, strapdown integration, its Jacobian.

Error state, in this order, everywhere in this room: attitude (rotation vector in b, rad: q_nb
(true) = q_nb exp(theta_b)), velocity (n), position (n), gyro bias, accelerometer bias: true less
estimated. The Earth is curved in :class:`~ekf_companion.nav.earth.LocalFrame` only; its rotation
and gravity are those of the origin, with the free-air gradient.

Source: Sola 2017, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508,
section 5; Groves 2013, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import FREE_AIR, LocalFrame, earth_rate_n, gravity

N = 15
ATT, VEL, POS, BG, BA = (slice(i, i + 3) for i in range(0, N, 3))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Nominal:
    """The nominal state."""

    q_nb: Array
    """From b to n, shape (4,)."""
    vel_n: Array
    """m/s."""
    pos_n: Array
    """m from the origin."""
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    """rad/s, b."""
    accel_bias: Array = field(default_factory=lambda: np.zeros(3))
    """m/s^2, b."""

    def plus(self, dx: Array) -> Nominal:
        """Add an error state, shape (15,)."""
        return Nominal(
            q_nb=so3.normalise(so3.multiply(self.q_nb, so3.exp(dx[ATT]))),
            vel_n=self.vel_n + dx[VEL],
            pos_n=self.pos_n + dx[POS],
            gyro_bias=self.gyro_bias + dx[BG],
            accel_bias=self.accel_bias + dx[BA],
        )

    def minus(self, other: Nominal) -> Array:
        """Return the error state from the other to this state, shape (15,)."""
        turn = so3.log(so3.multiply(so3.conjugate(other.q_nb), self.q_nb))
        motion = [self.vel_n - other.vel_n, self.pos_n - other.pos_n]
        biases = [self.gyro_bias - other.gyro_bias, self.accel_bias - other.accel_bias]
        return np.concatenate([turn, *motion, *biases])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Interval:
    """Inertial measurements over a time; where a sample is a mean, both ends are equal."""

    dt: float
    """s, > 0."""
    gyro0: Array
    """At the start, rad/s, b."""
    gyro1: Array
    """At the end."""
    accel0: Array
    """m/s^2, b."""
    accel1: Array

    @property
    def gyro(self) -> Array:
        """Return the rate at the middle."""
        return 0.5 * (self.gyro0 + self.gyro1)

    @property
    def accel(self) -> Array:
        """Return the specific force at the middle."""
        return 0.5 * (self.accel0 + self.accel1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Earth:
    """Gravity and rotation of the Earth."""

    gravity: float
    """At the origin's altitude, m/s^2."""
    gradient: float
    """Gain of gravity per metre down, 1/s^2."""
    rate_n: Array
    """Its rotation, rad/s."""
    down_n: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Direction of gravity; another one if n is not level."""

    @classmethod
    def at(cls, frame: LocalFrame) -> Earth:
        """Return the Earth at a place."""
        return cls(
            gravity=float(gravity(frame.lat, frame.alt)),
            gradient=FREE_AIR,
            rate_n=earth_rate_n(frame.lat),
        )

    @classmethod
    def flat(cls, gravity: float) -> Earth:
        """Return a flat Earth that does not turn."""
        return cls(gravity=gravity, gradient=0.0, rate_n=np.zeros(3))

    def accel_n(self, state: Nominal) -> Array:
        """Return gravity and Coriolis, m/s^2, n."""
        size = self.gravity + self.gradient * float(self.down_n @ state.pos_n)
        return np.asarray(size * self.down_n - 2.0 * so3.cross(self.rate_n, state.vel_n))


def integrate_strapdown(state: Nominal, over: Interval, earth: Earth) -> Nominal:
    """Integrate the motion over an interval by the midpoint rule."""
    rate_b = over.gyro - state.gyro_bias - so3.to_matrix(state.q_nb).T @ earth.rate_n
    q_mid = so3.multiply(state.q_nb, so3.exp(rate_b * (0.5 * over.dt)))
    accel_n = so3.to_matrix(q_mid) @ (over.accel - state.accel_bias) + earth.accel_n(state)
    return replace(
        state,
        q_nb=so3.normalise(so3.multiply(state.q_nb, so3.exp(rate_b * over.dt))),
        vel_n=state.vel_n + accel_n * over.dt,
        pos_n=state.pos_n + state.vel_n * over.dt + accel_n * (0.5 * over.dt * over.dt),
    )


def transition(state: Nominal, over: Interval, earth: Earth) -> Array:
    """Return the Jacobian of :func:`integrate_strapdown` by the error state, shape (15, 15).

    It is of second order in time. Coriolis and the gradient of gravity are left out: 1e-4 and 3e-6
    of what is kept, per second.
    """
    dt = over.dt
    rate_b = over.gyro - state.gyro_bias - so3.to_matrix(state.q_nb).T @ earth.rate_n
    back = so3.to_matrix(so3.exp(-rate_b * dt))
    C_mid = so3.to_matrix(so3.multiply(state.q_nb, so3.exp(rate_b * (0.5 * dt))))
    back_mid = so3.to_matrix(so3.exp(-rate_b * (0.5 * dt)))
    force = -C_mid @ so3.skew(over.accel - state.accel_bias)
    Phi = np.eye(N)
    Phi[ATT, ATT] = back
    Phi[ATT, BG] = -dt * back_mid
    Phi[VEL, ATT] = force @ back_mid * dt
    Phi[VEL, BG] = -0.5 * dt * dt * force
    Phi[VEL, BA] = -dt * C_mid
    Phi[POS, ATT] = 0.5 * dt * Phi[VEL, ATT]
    Phi[POS, VEL] = dt * np.eye(3)
    Phi[POS, BG] = 0.5 * dt * Phi[VEL, BG]
    Phi[POS, BA] = 0.5 * dt * Phi[VEL, BA]
    return Phi


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Process noise: densities of white noise, per square root of Hz."""

    gyro: float
    """rad/s."""
    accel: float
    """m/s^2."""
    gyro_walk: float
    """rad/s per square root of s."""
    accel_walk: float
    """m/s^2 per square root of s."""

    def covariance(self, dt: float) -> Array:
        """Return the covariance that an interval adds to the error state, shape (15, 15)."""
        Q = np.zeros((N, N))
        one = np.eye(3)
        accel2 = self.accel * self.accel
        Q[ATT, ATT] = self.gyro * self.gyro * dt * one
        Q[VEL, VEL] = accel2 * dt * one
        Q[POS, VEL] = Q[VEL, POS] = 0.5 * accel2 * dt * dt * one
        Q[POS, POS] = accel2 * dt**3 / 3.0 * one
        Q[BG, BG] = self.gyro_walk * self.gyro_walk * dt * one
        Q[BA, BA] = self.accel_walk * self.accel_walk * dt * one
        return Q


def covariance_in_n(P: Array, q_nb: Array) -> Array:
    """Return the covariance of attitude (rotated into n), velocity, position, shape (9, 9)."""
    T = np.eye(9)
    T[ATT, ATT] = so3.to_matrix(q_nb)
    return np.asarray(T @ P[:9, :9] @ T.T)
