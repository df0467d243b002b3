"""The direct extended Kalman filter on Euler angles: it estimates the state itself, not its error.

State, in this order: roll, pitch, yaw (rad; yaw unwrapped), north, east, altitude (m), velocity
north, east, down (m/s), gyro bias (rad/s), accelerometer bias (m/s^2). Each interval is one step of
first order; the covariance is that of the state, its noise van Loan's. The rates of roll and yaw
grow as 1 / cos(pitch): near 90 degrees of pitch the filter stops, with a note; its estimates until
then are kept. The functions of the model keep the state's precision, double or single.

Source: Stevens, Lewis, Johnson 2016, "Aircraft control and simulation", section 1.3 (kinematics);
Van Loan 1978, "Computing integrals involving the matrix exponential", IEEE TAC 23(3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import FilterError, part_of
from ekf_companion.filters.gate import Decision
from ekf_companion.filters.observation import Observation
from ekf_companion.filters.sequence import MeasurementSequence, Setup, run_sequence
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import (
    ATT,
    POS,
    VEL,
    Interval,
    N,
    Noise,
    Nominal,
    covariance_in_n,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

with part_of("filters", "filter euler"):
    from scipy.linalg import expm

Real: TypeAlias = npt.NDArray[np.floating[Any]]

ANGLES, PLACE, SPEED, GYRO, ACCEL = (slice(i, i + 3) for i in range(0, N, 3))
PITCH_LIMIT = float(np.radians(85.0))
"""rad. The Jacobian of the rates of roll and yaw contains 1 / cos^2 of the pitch. An error of the
pitch of 0.5 deg, large for such a filter, changes 1 / cos(pitch) by a tenth here, by a third at
88.5 deg: beyond, the covariance does not describe the error. Here gyro noise counts eleven-fold in
roll and in yaw."""


def refuse_steep(x: Real, limit: float = PITCH_LIMIT) -> None:
    """Refuse a state whose pitch is too near 90 degrees.

    Raises:
        FilterError: It is, or is not finite.
    """
    pitch = float(x[1])
    if not abs(pitch) <= limit:
        raise FilterError(
            f"the pitch is {np.degrees(pitch):.1f} deg, where roll and yaw are nearly one turn "
            f"(Euler angles end at 90 deg; limit {np.degrees(limit):.1f}): use eskf or iterated, "
            "whose quaternion knows no such place"
        )


def to_nominal(x: Real) -> Nominal:
    """Return the state as the other filters have it: a quaternion, and down, not altitude."""
    x = np.asarray(x, dtype=np.float64)
    return Nominal(
        q_nb=so3.normalise(so3.from_euler(*x[ANGLES])),
        vel_n=x[SPEED].copy(),
        pos_n=x[PLACE] * [1.0, 1.0, -1.0],
        gyro_bias=x[GYRO].copy(),
        accel_bias=x[ACCEL].copy(),
    )


def from_nominal(state: Nominal) -> Array:
    """Return the state of another filter in Euler angles, shape (15,)."""
    place = state.pos_n * [1.0, 1.0, -1.0]
    parts = [so3.to_euler(state.q_nb), place, state.vel_n, state.gyro_bias, state.accel_bias]
    return np.concatenate(parts)


def by_error_state(x: Real) -> Array:
    """Return the derivative of the state by the error state of ``strapdown``, shape (15, 15)."""
    T = np.zeros((N, N))
    T[ANGLES, ATT] = angle_rates(x)
    T[PLACE, POS] = np.diag([1.0, 1.0, -1.0])
    T[SPEED, VEL] = np.eye(3)
    T[9:, 9:] = np.eye(6)
    return T


def navigation_covariance(x: Real, P: Real) -> Array:
    """Return the covariance of attitude, velocity and position in n, shape (9, 9)."""
    T = np.linalg.inv(by_error_state(x))
    return covariance_in_n(T @ P @ T.T, to_nominal(x).q_nb)


def angle_rates(x: Real) -> Real:
    """Return the derivative of roll, pitch, yaw by a rotation vector in b, shape (3, 3)."""
    (sr, cr), (sp, cp), _ = _sines(x)
    rows = [[1.0, sr * sp / cp, cr * sp / cp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]]
    return np.array(rows, dtype=x.dtype)


def body_to_n(x: Real) -> Real:
    """Return C_nb, shape (3, 3)."""
    (sr, cr), (sp, cp), (sy, cy) = _sines(x)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.array(rows, dtype=x.dtype)


def derivative(x: Real, gyro: Real, accel: Real, fall_n: Real) -> Real:
    """Return the rate of change of the state, shape (15,).

    ``gyro`` is the rate of b relative to n plus the bias, rad/s, ``accel`` the specific force plus
    the bias, ``fall_n`` gravity and Coriolis acceleration, m/s^2.
    """
    dx = np.zeros_like(x)
    dx[ANGLES] = angle_rates(x) @ (gyro - x[GYRO])
    dx[PLACE] = x[SPEED] * np.array([1.0, 1.0, -1.0], dtype=x.dtype)
    dx[SPEED] = body_to_n(x) @ (accel - x[ACCEL]) + fall_n
    return dx


def jacobian(x: Real, gyro: Real, accel: Real) -> Real:
    """Return the derivative of :func:`derivative` by the state, shape (15, 15).

    Gravity counts as constant.
    """
    (sr, cr), (sp, cp), (sy, cy) = _sines(x)
    _, q, r = gyro - x[GYRO]
    fx, fy, fz = accel - x[ACCEL]
    across, along = cr * q - sr * r, sr * q + cr * r  # by roll: of pitch's axis, of yaw's axis
    F = np.zeros((N, N), dtype=x.dtype)
    F[0, 0], F[0, 1] = across * sp / cp, along / (cp * cp)
    F[1, 0] = -along
    F[2, 0], F[2, 1] = across / cp, along * sp / (cp * cp)
    F[ANGLES, GYRO] = -angle_rates(x)
    F[PLACE, SPEED] = np.diag([1.0, 1.0, -1.0])
    C = body_to_n(x)
    # The force with the roll removed: across the wings, and along the belly
    side, belly = cr * fy - sr * fz, sr * fy + cr * fz
    ahead = cp * fx + sp * belly
    F[SPEED, 0] = C[:, 2] * fy - C[:, 1] * fz
    F[SPEED, 1] = [cy * (cp * belly - sp * fx), sy * (cp * belly - sp * fx), -ahead]
    F[SPEED, 2] = [-sy * ahead - cy * side, cy * ahead - sy * side, 0.0]
    F[SPEED, ACCEL] = -C
    return F


def van_loan(F: Real, Q: Real, dt: float, is_first_order: bool = False) -> tuple[Real, Real]:
    """Return the transition over an interval, s, and the covariance of its noise, shape (n, n).

    The motion is dx/dt = F x + noise of covariance density Q; ``is_first_order`` uses 1 + A dt for
    the exponential of A dt.
    """
    n = len(F)
    A = np.zeros((2 * n, 2 * n), dtype=F.dtype)
    A[:n, :n], A[:n, n:], A[n:, n:] = -F, Q, F.T
    A *= F.dtype.type(dt)
    B = np.eye(2 * n, dtype=F.dtype) + A if is_first_order else expm(A)
    Phi = B[n:, n:].T
    return Phi, Phi @ B[:n, n:]


def _sines(x: Real) -> list[tuple[Any, Any]]:
    """Return sine and cosine of roll, pitch and yaw."""
    return list(zip(np.sin(x[ANGLES]), np.cos(x[ANGLES]), strict=True))


def noise_density(x: Array, noise: Noise) -> Array:
    """Return the density of the noise's covariance, per second, shape (15, 15)."""
    E = np.asarray(angle_rates(x))
    Q = np.zeros((N, N))
    Q[ANGLES, ANGLES] = noise.gyro**2 * E @ E.T
    Q[SPEED, SPEED] = noise.accel**2 * np.eye(3)
    Q[GYRO, GYRO] = noise.gyro_walk**2 * np.eye(3)
    Q[ACCEL, ACCEL] = noise.accel_walk**2 * np.eye(3)
    return Q


class Euler:
    """The filter, with noise, gate and Earth as the other filters have them."""

    def __init__(self, setup: Setup, pitch_limit: float = PITCH_LIMIT) -> None:
        """Start at the first estimate; the largest pitch, up or down, is in rad.

        Raises:
            FilterError: It starts steeper.
        """
        self._setup, self._limit = setup, pitch_limit
        self.x: Array = from_nominal(setup.start.state)
        """State, shape (15,)."""
        refuse_steep(self.x, pitch_limit)
        T = by_error_state(self.x)
        self.P: Array = T @ setup.start.P @ T.T
        """Covariance, shape (15, 15)."""

    @property
    def state(self) -> Nominal:
        """The present estimate."""
        return to_nominal(self.x)

    def predict(self, over: Interval) -> None:
        """Predict the state by its rate of change at the start, the covariance by van Loan.

        Raises:
            FilterError: The pitch has become too steep.
        """
        x, earth = self.x, self._setup.earth
        rate_b = over.gyro - body_to_n(x).T @ earth.rate_n
        dx = derivative(x, rate_b, over.accel, earth.accel_n(self.state))
        F = jacobian(x, rate_b, over.accel)
        Phi, Q = van_loan(F, noise_density(x, self._setup.noise), over.dt)
        self.x = x + dx * over.dt
        self.P = Phi @ self.P @ Phi.T + Q
        refuse_steep(self.x, self._limit)

    def inflate(self, Q: Array) -> None:
        """Add to the covariance of the error state of ``strapdown``, shape (15, 15)."""
        T = by_error_state(self.x)
        self.P = self.P + T @ Q @ T.T

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse the aids of one time, one after the other, by the Joseph form.

        Raises:
            FilterError: The pitch has become too steep.
        """
        for aid in aids:
            now = self.state
            # The aid's Jacobian is by the error state
            H = aid.jacobian(now) @ np.linalg.inv(by_error_state(self.x))
            z, R = aid.innovation(now), aid.covariance()
            S = H @ self.P @ H.T + R
            decision = self._setup.gate.test(aid.aid, t_ns, z, S)
            if decision is Decision.REFUSED:
                continue
            if decision is Decision.RESET:
                K, inflation = self._setup.gate.reset(aid, now, t_ns)
                T = by_error_state(self.x)
                K, inflation = T @ K, T @ inflation @ T.T
            else:
                K, inflation = np.linalg.solve(S, H @ self.P).T, np.zeros((N, N))
            A = np.eye(N) - K @ H
            self.x = self.x + K @ z
            self.P = A @ self.P @ A.T + K @ R @ K.T + inflation
            refuse_steep(self.x, self._limit)

    def covariance(self) -> Array:
        """Return the covariance of attitude, velocity and position in n, shape (9, 9)."""
        return navigation_covariance(self.x, self.P)


def run(sequence: MeasurementSequence) -> Solution:
    """Run the filter over a recording; where the pitch becomes too steep, the estimates end.

    Raises:
        LogError: The recording ends before the filter can start.
        FilterError: It starts too steep.
    """
    setup = sequence.setup()
    return run_sequence("euler", Euler(setup), sequence, setup)
