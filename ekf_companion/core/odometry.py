# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""What is told of the estimate: the numbers of ODOMETRY, in its order, frames and limits.

Position in n; the quaternion from b to n, of unit norm and w >= 0; velocity and rates in b; and the
upper triangles, row by row, of two covariances: of position and roll, pitch, yaw; of velocity in b
and the rates, of which nothing is known but the floor.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import NAN, cos, isfinite, sin, sqrt
else:
    from math import cos, isfinite, nan, sin, sqrt

    from ekf_companion.core import state as at

    NAN = nan

STEEP = cython.declare(cython.double, 0.1)
"""Cosine of the pitch (84 deg) beyond which Euler angles say less than their variances would."""
FLOOR = cython.declare(cython.double, 1e-6)
"""Least variance: one of zero claims perfection."""
LARGEST = cython.declare(cython.double, 1e12)
"""Most that a covariance says: a million metres, and far from what float32 can hold."""


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def tell(
    x: cython.double[::1],
    out: cython.double[::1],
    w: cython.double[::1],
    told: cython.double[::1],
) -> cython.void:
    """Write the numbers to be told, told[TOLD], of a block x and its estimate of now, out.

    A covariance that is not finite is unknown: its first number is NaN, the rest is zero.

    Source: MAVLink common.xml, ODOMETRY; Diebel 2006, "Representing attitude", eq. 77, for roll,
    pitch and yaw over a rotation vector in n, held within 6 degrees of straight up or down.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    norm: cython.double = 0.0
    for i in range(4):
        norm += out[at.OUT_Q + i] * out[at.OUT_Q + i]
    norm = sqrt(norm) if out[at.OUT_Q] >= 0.0 else -sqrt(norm)
    for i in range(3):
        told[at.TOLD_POS + i] = out[at.OUT_POS + i]
        told[at.TOLD_RATE + i] = x[at.X_GYRO + i] - x[at.X_BG + i]
    for i in range(4):
        told[at.TOLD_Q + i] = out[at.OUT_Q + i] / norm
    for i in range(at.TOLD_POSE, at.TOLD):
        told[i] = 0.0

    # Velocity and its covariance, turned into b
    direction_cosines(told, w)
    for i in range(3):
        told[at.TOLD_VEL + i] = 0.0
        for j in range(3):
            told[at.TOLD_VEL + i] += w[at.W_C_NB + 3 * j + i] * out[at.OUT_VEL + j]
    if gather(x, w, at.E_VEL, at.E_VEL):
        for i in range(9):
            w[at.W_R + i] = w[at.W_C_NB + 3 * (i % 3) + i // 3]
        turn_block(w, at.W_R, 0)
        triangle(w, told, at.TOLD_TWIST, 3)
    else:
        told[at.TOLD_TWIST] = NAN

    # Position as it is, the attitude error as angles
    if gather(x, w, at.E_POS, at.E_ATT):
        jacobian(out, w)
        turn_block(w, at.W_R, 3)
        triangle(w, told, at.TOLD_POSE, 6)
    else:
        told[at.TOLD_POSE] = NAN


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def direction_cosines(told: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Write the direction cosines of the quaternion told to w[W_C_NB:+9], row by row."""
    qw: cython.double = told[at.TOLD_Q]
    qx: cython.double = told[at.TOLD_Q + 1]
    qy: cython.double = told[at.TOLD_Q + 2]
    qz: cython.double = told[at.TOLD_Q + 3]
    w[at.W_C_NB] = qw * qw + qx * qx - qy * qy - qz * qz
    w[at.W_C_NB + 1] = 2.0 * (qx * qy - qw * qz)
    w[at.W_C_NB + 2] = 2.0 * (qx * qz + qw * qy)
    w[at.W_C_NB + 3] = 2.0 * (qx * qy + qw * qz)
    w[at.W_C_NB + 4] = qw * qw - qx * qx + qy * qy - qz * qz
    w[at.W_C_NB + 5] = 2.0 * (qy * qz - qw * qx)
    w[at.W_C_NB + 6] = 2.0 * (qx * qz - qw * qy)
    w[at.W_C_NB + 7] = 2.0 * (qy * qz + qw * qx)
    w[at.W_C_NB + 8] = qw * qw - qx * qx - qy * qy + qz * qz


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def gather(
    x: cython.double[::1],
    w: cython.double[::1],
    first: cython.Py_ssize_t,
    second: cython.Py_ssize_t,
) -> cython.bint:
    """Write the covariance of two threes of errors, bounded, to w[W_H:+36]; False: not finite."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    row: cython.Py_ssize_t
    column: cython.Py_ssize_t
    value: cython.double
    for i in range(6):
        row = first + i if i < 3 else second + i - 3
        for j in range(6):
            column = first + j if j < 3 else second + j - 3
            value = x[at.X_COV + at.N * row + column]
            if not isfinite(value):
                return False
            w[at.W_H + 6 * i + j] = min(max(value, -LARGEST), LARGEST)
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def jacobian(out: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Write d(roll, pitch, yaw) / d(rotation vector in n) to w[W_R:+9]."""
    cp: cython.double = max(cos(out[at.OUT_EULER + 1]), STEEP)
    tp: cython.double = sin(out[at.OUT_EULER + 1]) / cp
    cy: cython.double = cos(out[at.OUT_EULER + 2])
    sy: cython.double = sin(out[at.OUT_EULER + 2])
    w[at.W_R] = cy / cp
    w[at.W_R + 1] = sy / cp
    w[at.W_R + 2] = 0.0
    w[at.W_R + 3] = -sy
    w[at.W_R + 4] = cy
    w[at.W_R + 5] = 0.0
    w[at.W_R + 6] = cy * tp
    w[at.W_R + 7] = sy * tp
    w[at.W_R + 8] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def turn_block(
    w: cython.double[::1], turn: cython.Py_ssize_t, at_row: cython.Py_ssize_t
) -> cython.void:
    """Turn three of the six errors of w[W_H:+36], from at_row on, by the matrix w[turn:+9]."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t = at.W_H + 6 * at_row
    for j in range(6):
        for i in range(3):
            w[at.W_Y + i] = (
                w[turn + 3 * i] * w[m + j]
                + w[turn + 3 * i + 1] * w[m + 6 + j]
                + w[turn + 3 * i + 2] * w[m + 12 + j]
            )
        for i in range(3):
            w[m + 6 * i + j] = w[at.W_Y + i]
    m = at.W_H + at_row
    for j in range(6):
        for i in range(3):
            w[at.W_Y + i] = (
                w[turn + 3 * i] * w[m + 6 * j]
                + w[turn + 3 * i + 1] * w[m + 6 * j + 1]
                + w[turn + 3 * i + 2] * w[m + 6 * j + 2]
            )
        for i in range(3):
            w[m + 6 * j + i] = w[at.W_Y + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def triangle(
    w: cython.double[::1], told: cython.double[::1], start: cython.Py_ssize_t, known: cython.int
) -> cython.void:
    """Write the upper triangle of w[W_H:+36] to told[start:+21], variances floored.

    Beyond the first errors that are known there is the floor alone.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    n: cython.Py_ssize_t = start
    value: cython.double
    for i in range(6):
        for j in range(i, 6):
            value = w[at.W_H + 6 * i + j] if j < known else 0.0
            told[n] = max(value, FLOOR) if i == j else value
            n += 1
