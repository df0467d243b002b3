"""The numbers of ODOMETRY, in its order, frames and limits.

Position in n; the quaternion from b to n, of unit norm and w >= 0; velocity and rates in b; and the
upper triangles, row by row, of two covariances: of position and roll, pitch, yaw; of velocity in b
and the rates, of which nothing is known but the floor.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import E_ATT, E_GNSS, E_POS, E_VEL
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.scratch import (
    Estimate,
    OdometryNumbers,
    Pose,
    Scratch,
)
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, isfinite, sin, sqrt

STEEP = cython.declare(cython.double, 0.1)
"""Cosine of the pitch (84 deg) beyond which Euler angles say less than their variances would."""
LEAST_VAR = cython.declare(cython.double, 1e-6)
"""Least variance."""
LARGEST_VAR = cython.declare(cython.double, 1e12)
"""Largest variance: (1000 km)^2, well within float32."""


def write_odometry(x: State, y: State, out: Estimate, w: Scratch, n: OdometryNumbers) -> None:
    """Write ODOMETRY's numbers of a state and its estimate of now.

    A covariance that is not finite is unknown: its first number is NaN, the rest is zero.

    Source: MAVLink common.xml, ODOMETRY; Diebel 2006, "Representing attitude", eq. 77, for roll,
    pitch and yaw over a rotation vector in n, held within 6 degrees of straight up or down.
    """
    p = address(w.pose)
    norm = 0.0
    for i in range(4):
        norm += out.q_nb[i] * out.q_nb[i]
    norm = sqrt(norm) if out.q_nb[0] >= 0.0 else -sqrt(norm)
    for i in range(3):
        n.pos_n[i] = out.pos_n[i]
        n.rate_b[i] = x.gyro[i] - x.gyro_bias[i]
    for i in range(4):
        n.q_nb[i] = out.q_nb[i] / norm
    for i in range(21):
        n.pose_cov[i] = 0.0
        n.twist_cov[i] = 0.0
        n.relative_cov[i] = 0.0

    # Velocity and its covariance, turned into b
    to_dcm(n.q_nb, p.C_nb)
    for i in range(3):
        n.vel_b[i] = 0.0
        for j in range(3):
            n.vel_b[i] += p.C_nb[j][i] * out.vel_n[j]
    if read_covariance(y, p, E_VEL, E_VEL):
        for i in range(3):
            for j in range(3):
                p.turn[i][j] = p.C_nb[j][i]
        turn_errors(p, 0)
        write_triangle(p, n.twist_cov, 3)
    else:
        n.twist_cov[0] = NAN

    # Position as it is, the attitude error as angles; then the same beside the receiver's offset
    if read_covariance(y, p, E_POS, E_ATT):
        write_euler_jacobian(out, p)
        turn_errors(p, 3)
        write_triangle(p, n.pose_cov, 6)
        read_covariance(y, p, E_POS, E_ATT)
        add_offset(x, p)
        turn_errors(p, 3)
        write_triangle(p, n.relative_cov, 6)
    else:
        n.pose_cov[0] = NAN
        n.relative_cov[0] = NAN


def read_covariance(y: State, p: Pose, first: int, second: int) -> bool:
    """Read the bounded covariance of two groups of three errors; False if not finite."""
    for i in range(6):
        row = first + i if i < 3 else second + i - 3
        for j in range(6):
            column = first + j if j < 3 else second + j - 3
            value = y.P[row][column]
            if not isfinite(value):
                return False
            p.cov[i][j] = min(max(value, -LARGEST_VAR), LARGEST_VAR)
    return True


def add_offset(x: State, p: Pose) -> None:
    """Make the covariance of position and attitude that of the place in the receiver's own frame.

    That is the position plus the receiver's slow error, which the fixes show without it: an offset
    that is the same for minutes is no noise of a message.
    """
    for i in range(3):
        for j in range(3):
            p.cov[i][j] += x.P[E_GNSS + i][E_POS + j] + x.P[E_POS + i][E_GNSS + j]
            p.cov[i][j] += x.P[E_GNSS + i][E_GNSS + j]
            p.cov[i][j + 3] += x.P[E_GNSS + i][E_ATT + j]
            p.cov[i + 3][j] += x.P[E_ATT + i][E_GNSS + j]


def write_euler_jacobian(out: Estimate, p: Pose) -> None:
    """Write d(roll, pitch, yaw) / d(rotation vector in n)."""
    cp = max(cos(out.euler[1]), STEEP)
    tp = sin(out.euler[1]) / cp
    cy = cos(out.euler[2])
    sy = sin(out.euler[2])
    p.turn[0][0] = cy / cp
    p.turn[0][1] = sy / cp
    p.turn[0][2] = 0.0
    p.turn[1][0] = -sy
    p.turn[1][1] = cy
    p.turn[1][2] = 0.0
    p.turn[2][0] = cy * tp
    p.turn[2][1] = sy * tp
    p.turn[2][2] = 1.0


def turn_errors(p: Pose, first: int) -> None:
    """Turn three of the six errors, from the first on, by the matrix ``p.turn``."""
    for j in range(6):
        a = p.cov[first][j]
        b = p.cov[first + 1][j]
        c = p.cov[first + 2][j]
        for i in range(3):
            p.cov[first + i][j] = p.turn[i][0] * a + p.turn[i][1] * b + p.turn[i][2] * c
    for j in range(6):
        a = p.cov[j][first]
        b = p.cov[j][first + 1]
        c = p.cov[j][first + 2]
        for i in range(3):
            p.cov[j][first + i] = p.turn[i][0] * a + p.turn[i][1] * b + p.turn[i][2] * c


def write_triangle(p: Pose, triangle: Vector, known: int) -> None:
    """Write the upper triangle of the covariance, shape (21,), variances floored.

    Beyond the first errors that are known there is the floor alone.
    """
    n = 0
    for i in range(6):
        for j in range(i, 6):
            value = p.cov[i][j] if j < known else 0.0
            triangle[n] = max(value, LEAST_VAR) if i == j else value
            n += 1
