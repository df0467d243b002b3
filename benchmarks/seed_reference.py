"""How well the seed article's flight can be known: the bound, and a filter that lacks nothing.

The covariance recursion of the error states, linearised at the truth, with exactly the noise that
was drawn, is the Cramer-Rao bound of a causal estimator as long as errors are small. The filter is
the same recursion on a draw, linearised at its own estimate, begun near the truth. It knows the
flat Earth, and shares no code with the estimator.

Source: Van Trees, Bell 2007, "Bayesian bounds for parameter estimation and nonlinear filtering/
tracking", part 4 (posterior bound of nearly linear motion).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from benchmarks.seed_flight import (
    ACCEL_BIAS,
    ACCEL_NOISE,
    FIX_EVERY,
    GRAVITY,
    GYRO_BIAS,
    GYRO_NOISE,
    MAG_STD,
    PERIOD,
    POSITION_STD,
    STRETCH,
    VELOCITY_STD,
    Draw,
    Truth,
)
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]
Compass = Literal["vector", "azimuth", "level"]
"""What is taken of the magnetometer: all of it; only the azimuth by the filter's own tilt; the yaw
that it gives as if the vehicle were level, as what that is."""

ATT, VEL, POS, BG, BA = (slice(i, i + 3) for i in range(0, 15, 3))
PRIOR = np.repeat([0.05, 0.5, 1.0, GYRO_BIAS, ACCEL_BIAS], 3)
"""One sigma at the start, rad, m/s, m; after 20 s nothing is left of the first three."""


class Reference:
    """Fifteen error states, attitude as a rotation vector in n."""

    def __init__(self, motion: Truth, compass: Compass, extra: float = 0.0) -> None:
        """Begin at the truth.

        Args:
            motion: Of which it takes the start, and for the bound all.
            compass: What is taken of the magnetometer.
            extra: Further noise of a gyro sample, rad/s: what sampling at 10 Hz loses.
        """
        self._motion, self._compass = motion, compass
        self.C_nb = np.asarray(so3.to_matrix(motion.q_nb[0]))
        self.vel_n = motion.vel_n[0].copy()
        self.pos_n = motion.pos_n[0] / [*STRETCH, 1.0]
        self.bias_g, self.bias_a = np.zeros(3), np.zeros(3)
        self.P = np.diag(PRIOR**2)
        noise_g = (GYRO_NOISE**2 + extra**2) * PERIOD**2
        noise_a = ACCEL_NOISE**2 * PERIOD**2
        self._gravity_n = np.array([0.0, 0.0, GRAVITY])
        self._Q = np.zeros((15, 15))
        self._Q[ATT, ATT], self._Q[VEL, VEL] = noise_g * np.eye(3), noise_a * np.eye(3)

    def bound(self) -> Array:
        """Give one sigma along the true motion, by ``NAMES``, shape (n, 9), degrees, m, m/s."""
        motion, rows = self._motion, []
        C_nb = np.asarray(so3.to_matrix(motion.q_nb))
        force_n = so3.rotate(motion.q_nb, motion.force_b)
        for k in range(len(motion.t)):
            if k:
                self._spread(C_nb[k], 0.5 * (force_n[k] + force_n[k - 1]))
            self.C_nb = C_nb[k]
            if k % FIX_EVERY == 0:
                self._absorb(np.zeros(6), self._fix_rows(), self._fix_noise())
            self._absorb(*self._compass_rows(motion.field_b[k], float(_level(motion.field_b[k]))))
            rows.append(self._sigmas())
        return np.array(rows)

    def run(self, drawn: Draw) -> Array:
        """Give the estimates of a draw, columns as ``NAMES``, shape (n, 9), SI and radians."""
        rows = []
        for k in range(len(drawn.gyro_b)):
            if k:
                self._move(drawn, k)
            if k % FIX_EVERY == 0:
                fix = drawn.fixes[k // FIX_EVERY] / [*STRETCH, 1.0, 1.0, 1.0, 1.0]
                z = fix - np.concatenate((self.pos_n, self.vel_n))
                self._correct(z, self._fix_rows(), self._fix_noise())
            mag_b = None if drawn.mag_b is None else drawn.mag_b[k]
            self._correct(*self._compass_rows(mag_b, float(drawn.yaw[k])))
            pos_n = self.pos_n * [*STRETCH, 1.0]
            rows.append([*_euler(self.C_nb), pos_n[0], pos_n[1], -pos_n[2], *self.vel_n])
        return np.array(rows)

    def _move(self, drawn: Draw, k: int) -> None:
        """Carry the state from sample k - 1 to k by the mean of both readings."""
        turn = 0.5 * (drawn.gyro_b[k] + drawn.gyro_b[k - 1]) - self.bias_g
        before = self.C_nb @ (drawn.accel_b[k - 1] - self.bias_a)
        self.C_nb = self.C_nb @ so3.to_matrix(so3.exp(turn * PERIOD))
        force_n = 0.5 * (before + self.C_nb @ (drawn.accel_b[k] - self.bias_a))
        accel_n = force_n + self._gravity_n
        self.pos_n = self.pos_n + self.vel_n * PERIOD + 0.5 * accel_n * PERIOD**2
        self.vel_n = self.vel_n + accel_n * PERIOD
        self._spread(self.C_nb, force_n)

    def _spread(self, C_nb: Array, force_n: Array) -> None:
        Phi = np.eye(15)
        S = -_skew(force_n) * PERIOD
        G = -C_nb * PERIOD
        Phi[ATT, BG] = G
        Phi[VEL, ATT], Phi[VEL, BG], Phi[VEL, BA] = S, 0.5 * S @ G, G
        Phi[POS, ATT], Phi[POS, VEL] = 0.5 * PERIOD * S, PERIOD * np.eye(3)
        Phi[POS, BG], Phi[POS, BA] = PERIOD / 6.0 * S @ G, 0.5 * PERIOD * G
        self.P = Phi @ self.P @ Phi.T + self._Q

    def _fix_rows(self) -> Array:
        H = np.zeros((6, 15))
        H[:3, POS] = H[3:, VEL] = np.eye(3)
        return H

    def _fix_noise(self) -> Array:
        position = POSITION_STD / np.array([*STRETCH, 1.0])
        return np.diag(np.concatenate((position, np.full(3, VELOCITY_STD))) ** 2)

    def _compass_rows(self, mag_b: Array | None, yaw: float) -> tuple[Array, Array, Array]:
        """Give innovation, H and R of the magnetometer."""
        north = np.array([1.0, 0.0, 0.0])
        if self._compass == "level" or mag_b is None:
            own_b = self.C_nb.T @ north
            # d(own_b) = C' [north x] theta; the yaw of a vector by its forward and right part
            turned = self.C_nb.T @ _skew(north)
            flat = own_b[0] ** 2 + own_b[1] ** 2
            H = np.zeros((1, 15))
            H[0, ATT] = (own_b[1] * turned[0] - own_b[0] * turned[1]) / flat
            z = so3.wrap(np.array([yaw - _level(own_b)]))
            return z, H, np.array([[MAG_STD**2 / flat]])
        mag_n = self.C_nb @ mag_b
        if self._compass == "azimuth":
            H = np.zeros((1, 15))
            flat = mag_n[0] ** 2 + mag_n[1] ** 2
            H[0, ATT] = [-mag_n[0] * mag_n[2] / flat, -mag_n[1] * mag_n[2] / flat, 1.0]
            return np.array([-np.arctan2(mag_n[1], mag_n[0])]), H, np.array([[MAG_STD**2 / flat]])
        H = np.zeros((3, 15))
        H[:, ATT] = _skew(north)
        return mag_n - north, H, MAG_STD**2 * np.eye(3)

    def _absorb(self, z: Array, H: Array, R: Array) -> Array:
        """Reduce the covariance; give the error state."""
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        A = np.eye(15) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T
        return np.asarray(K @ z)

    def _correct(self, z: Array, H: Array, R: Array) -> None:
        dx = self._absorb(z, H, R)
        self.C_nb = so3.to_matrix(so3.exp(dx[ATT])) @ self.C_nb
        self.vel_n, self.pos_n = self.vel_n + dx[VEL], self.pos_n + dx[POS]
        self.bias_g, self.bias_a = self.bias_g + dx[BG], self.bias_a + dx[BA]

    def _sigmas(self) -> Array:
        yaw = np.arctan2(self.C_nb[1, 0], self.C_nb[0, 0])
        sp, cp = -self.C_nb[2, 0], np.hypot(self.C_nb[0, 0], self.C_nb[1, 0])
        c, s = np.cos(yaw), np.sin(yaw)
        J = np.array([[c / cp, s / cp, 0.0], [-s, c, 0.0], [c * sp / cp, s * sp / cp, 1.0]])
        angles = np.degrees(np.sqrt(np.diag(J @ self.P[ATT, ATT] @ J.T)))
        rest = np.sqrt(np.diag(self.P))
        return np.concatenate((angles, rest[POS] * [*STRETCH, 1.0], rest[VEL]))


def _level(field_b: Array) -> Array:
    return np.asarray(np.arctan2(-field_b[1], field_b[0]))


def _euler(C_nb: Array) -> tuple[float, float, float]:
    return (
        float(np.arctan2(C_nb[2, 1], C_nb[2, 2])),
        float(-np.arcsin(np.clip(C_nb[2, 0], -1.0, 1.0))),
        float(np.arctan2(C_nb[1, 0], C_nb[0, 0])),
    )


def _skew(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
