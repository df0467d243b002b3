"""The motion in Euler angles: state, kinematics, its explicit Jacobian, and its noise in steps.

State, in this order: roll, pitch, yaw (rad; yaw unwrapped), north, east, altitude (m), velocity
north, east, down (m/s), gyro bias (rad/s), accelerometer bias (m/s^2). Functions keep the state's
precision, double or single.

Source: Stevens, Lewis, Johnson 2016, "Aircraft control and simulation", section 1.3 (kinematics);
Van Loan 1978, "Computing integrals involving the matrix exponential", IEEE TAC 23(3).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from ekf_companion.errors import FilterError
from ekf_companion.filters.strapdown import ATT, POS, VEL, N, Nominal, in_n
from ekf_companion.nav import so3

Real: TypeAlias = npt.NDArray[np.floating[Any]]

ANGLES, PLACE, SPEED, GYRO, ACCEL = (slice(i, i + 3) for i in range(0, N, 3))
PITCH_LIMIT = float(np.radians(85.0))
"""rad. The Jacobian of roll's and yaw's rates holds 1 / cos^2 of the pitch. An error of the pitch
of 0.5 deg, large for such a filter, changes 1 / cos(pitch) by a tenth here, by a third at 88.5
deg: beyond, the covariance says nothing of the error. Here noise of the gyro counts eleven-fold
in roll and in yaw."""


def refuse_steep(x: Real, limit: float = PITCH_LIMIT) -> None:
    """Refuse a state whose pitch is too near 90 degrees.

    Raises:
        FilterError: It is, or is no number.
    """
    pitch = float(x[1])
    if not abs(pitch) <= limit:
        raise FilterError(
            f"the pitch is {np.degrees(pitch):.1f} deg, where roll and yaw are nearly one turn "
            f"(Euler angles end at 90 deg; limit {np.degrees(limit):.1f}): use eskf or iterated, "
            "whose quaternion knows no such place"
        )


def to_nominal(x: Real) -> Nominal:
    """Return a state as the other filters have it: a quaternion, and down instead of altitude."""
    x = np.asarray(x, dtype=np.float64)
    return Nominal(
        q_nb=so3.normalise(so3.from_euler(*x[ANGLES])),
        vel_n=x[SPEED].copy(),
        pos_n=x[PLACE] * [1.0, 1.0, -1.0],
        gyro_bias=x[GYRO].copy(),
        accel_bias=x[ACCEL].copy(),
    )


def from_nominal(state: Nominal) -> npt.NDArray[np.float64]:
    """Return another filter's state as roll, pitch, yaw and so on, shape (15,)."""
    return np.concatenate(
        [
            so3.to_euler(state.q_nb),
            state.pos_n * [1.0, 1.0, -1.0],
            *(state.vel_n, state.gyro_bias, state.accel_bias),
        ]
    )


def by_turn(x: Real) -> npt.NDArray[np.float64]:
    """Return the derivative of the state by the error state of ``strapdown``, shape (15, 15)."""
    T = np.zeros((N, N))
    T[ANGLES, ATT] = angle_rates(x)
    T[PLACE, POS] = np.diag([1.0, 1.0, -1.0])
    T[SPEED, VEL] = np.eye(3)
    T[9:, 9:] = np.eye(6)
    return T


def covariance_in_n(x: Real, P: Real) -> npt.NDArray[np.float64]:
    """Return the covariance of attitude (rotation vector in n), velocity, position (n).

    Args:
        x: State.
        P: Covariance of the state, shape (15, 15).

    Returns:
        Shape (9, 9).
    """
    back = np.linalg.inv(by_turn(x))
    return in_n(back @ P @ back.T, to_nominal(x).q_nb)


def angle_rates(x: Real) -> Real:
    """Return the derivative of roll, pitch, yaw by a turn in b, shape (3, 3)."""
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

    Args:
        x: State, shape (15,).
        gyro: Rate of b against n and the bias, rad/s, b.
        accel: Specific force and the bias, m/s^2, b.
        fall_n: Gravity and what else accelerates, m/s^2, n.
    """
    dx = np.zeros_like(x)
    dx[ANGLES] = angle_rates(x) @ (gyro - x[GYRO])
    dx[PLACE] = x[SPEED] * np.array([1.0, 1.0, -1.0], dtype=x.dtype)
    dx[SPEED] = body_to_n(x) @ (accel - x[ACCEL]) + fall_n
    return dx


def jacobian(x: Real, gyro: Real, accel: Real) -> Real:
    """Return the derivative of :func:`derivative` by the state, shape (15, 15).

    Gravity counts as the same everywhere.
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
    # The force with roll taken out: across the wings, and along the belly
    side, belly = cr * fy - sr * fz, sr * fy + cr * fz
    ahead = cp * fx + sp * belly
    F[SPEED, 0] = C[:, 2] * fy - C[:, 1] * fz
    F[SPEED, 1] = [cy * (cp * belly - sp * fx), sy * (cp * belly - sp * fx), -ahead]
    F[SPEED, 2] = [-sy * ahead - cy * side, cy * ahead - sy * side, 0.0]
    F[SPEED, ACCEL] = -C
    return F


def van_loan(F: Real, Q: Real, dt: float, is_first_order: bool = False) -> tuple[Real, Real]:
    """Return the transition over an interval, and the covariance of what noise adds.

    Args:
        F: Of dx/dt = F x + noise, shape (n, n).
        Q: Density of the noise's covariance, per second, shape (n, n).
        dt: s.
        is_first_order: Take 1 + A dt for the exponential of A dt.
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
