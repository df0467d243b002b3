# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The frame s in which the bank of yaw filters sums forces: nearly level, and pointing anywhere.

It hangs on the gyro alone, less the bias that the bank knows, so that nothing that goes wrong in
the main filter reaches it. What it sums between two fixes: the specific force, and the turn, which
says what an error of the bias does to it.

Source: Groves 2013, section 5.4 (attitude and specific force over one interval).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.propagate import matrix, turn, turn_body
    from cython.cimports.libc.math import atan2, sqrt
else:
    from math import atan2, sqrt

    from ekf_companion.core import state as at
    from ekf_companion.core.propagate import matrix, turn, turn_body

MEMORY = cython.declare(cython.double, 2.0)
"""Of the mean force while up is being found, s."""
SMALL_TURN = cython.declare(cython.double, 0.04)
"""Square of a turn, rad^2, up to which the short series is exact to 1e-8."""
SMOOTH = cython.declare(cython.double, 0.05)
"""s; memory of the acceleration that a late fix has yet to see."""
LARGEST_RATE = cython.declare(cython.double, 20.0)
"""rad/s; beyond it a gyro is near its end, and so is the frame that hangs on it."""
LARGEST_FORCE = cython.declare(cython.double, 60.0)
"""m/s^2; a blow, as of the ground."""
UNKNOWN_STD = cython.declare(cython.double, 3.14)
"""Of a yaw of which nothing is known, rad; any large number."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def lose(x: cython.double[::1]) -> cython.void:
    """Know nothing but the gyro's bias, after a gap or a blow: sum the force to find up again."""
    i: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_BANK
    for i in range(at.B_Q, at.B_BG):
        x[b + i] = 0.0
    for i in range(at.B_U, at.B_NIS):
        x[b + i] = 0.0
    x[b + at.B_MODE] = at.BANK_LEVELLING
    x[b + at.B_Q] = 1.0
    x[b + at.B_STD] = UNKNOWN_STD


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def carry(x: cython.double[::1], w: cython.double[::1], dt: cython.double) -> cython.void:
    """Carry the frame's attitude, and the sums of force and turn in s, over dt (s) at w[W_RATE].

    A blow makes it begin anew.
    """
    i: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_BANK
    gx: cython.double = w[at.W_RATE]
    gy: cython.double = w[at.W_RATE + 1]
    gz: cython.double = w[at.W_RATE + 2]
    ax: cython.double = w[at.W_FORCE]
    ay: cython.double = w[at.W_FORCE + 1]
    az: cython.double = w[at.W_FORCE + 2]
    px: cython.double = (gx - x[b + at.B_BG]) * dt
    py: cython.double = (gy - x[b + at.B_BG + 1]) * dt
    pz: cython.double = (gz - x[b + at.B_BG + 2]) * dt
    # the mean of the turning force, in b at the start: f + p x f / 2
    ux: cython.double = (ax + 0.5 * (py * az - pz * ay)) * dt
    uy: cython.double = (ay + 0.5 * (pz * ax - px * az)) * dt
    uz: cython.double = (az + 0.5 * (px * ay - py * ax)) * dt
    u: cython.double
    if (
        gx * gx + gy * gy + gz * gz > LARGEST_RATE * LARGEST_RATE
        or ax * ax + ay * ay + az * az > LARGEST_FORCE * LARGEST_FORCE
    ):
        lose(x)
    matrix(x, b + at.B_Q, w)
    for i in range(3):
        u = (
            w[at.W_C_NB + 3 * i] * ux
            + w[at.W_C_NB + 3 * i + 1] * uy
            + w[at.W_C_NB + 3 * i + 2] * uz
        )
        x[b + at.B_U + i] += u
        if i < 2:
            x[b + at.B_A + i] += (u - x[b + at.B_A + i] * dt) / (dt + SMOOTH)
    for i in range(9):
        x[b + at.B_G + i] += w[at.W_C_NB + i] * dt
    x[b + at.B_DT] += dt
    spin(x, px, py, pz)
    if x[b + at.B_MODE] == at.BANK_LEVELLING and x[b + at.B_DT] > MEMORY:
        for i in range(at.B_U, at.B_DT + 1):
            x[b + i] = 0.5 * x[b + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def spin(
    x: cython.double[::1], px: cython.double, py: cython.double, pz: cython.double
) -> cython.void:
    """Turn the frame's attitude by a rotation vector in b, a small one without a root."""
    q: cython.Py_ssize_t = at.X_BANK + at.B_Q
    qw: cython.double = x[q]
    qx: cython.double = x[q + 1]
    qy: cython.double = x[q + 2]
    qz: cython.double = x[q + 3]
    a2: cython.double = px * px + py * py + pz * pz
    if a2 > SMALL_TURN:
        turn_body(x, q, px, py, pz)
        return
    c: cython.double = 1.0 - a2 * (0.125 - a2 * (1.0 / 384.0))
    s: cython.double = 0.5 - a2 * (1.0 / 48.0 - a2 * (1.0 / 3840.0))
    px = s * px
    py = s * py
    pz = s * pz
    x[q] = c * qw - px * qx - py * qy - pz * qz
    x[q + 1] = c * qx + px * qw - py * qz + pz * qy
    x[q + 2] = c * qy + px * qz + py * qw - pz * qx
    x[q + 3] = c * qz - px * qy + py * qx + pz * qw
    # the norm is one but for rounding: a step of Newton's keeps it so
    s = 1.5 - 0.5 * (x[q] * x[q] + x[q + 1] * x[q + 1] + x[q + 2] * x[q + 2] + x[q + 3] * x[q + 3])
    x[q] = s * x[q]
    x[q + 1] = s * x[q + 1]
    x[q + 2] = s * x[q + 2]
    x[q + 3] = s * x[q + 3]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def restart_sums(x: cython.double[::1]) -> cython.void:
    """Begin the sums of the next interval between fixes."""
    i: cython.Py_ssize_t
    for i in range(at.B_U, at.B_DT + 1):
        x[at.X_BANK + i] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def stand_up(x: cython.double[::1]) -> cython.void:
    """Turn s so that the summed force points up."""
    b: cython.Py_ssize_t = at.X_BANK
    ux: cython.double = x[b + at.B_U]
    uy: cython.double = x[b + at.B_U + 1]
    size: cython.double = sqrt(ux * ux + uy * uy)
    angle: cython.double = atan2(size, -x[b + at.B_U + 2])
    if size > 0.0:
        # the shortest turn of u into up (-z) is about u x up
        turn(x, b + at.B_Q, -uy / size * angle, ux / size * angle, 0.0)
    else:
        turn(x, b + at.B_Q, angle, 0.0, 0.0)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def antenna(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Write the velocity that the antenna has from the turn, in s, x and y, to w[W_R]."""
    i: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_BANK
    wx: cython.double = x[at.X_GYRO] - x[b + at.B_BG]
    wy: cython.double = x[at.X_GYRO + 1] - x[b + at.B_BG + 1]
    wz: cython.double = x[at.X_GYRO + 2] - x[b + at.B_BG + 2]
    matrix(x, b + at.B_Q, w)
    for i in range(2):
        w[at.W_R + i] = (
            w[at.W_C_NB + 3 * i] * (wy * k[at.K_LEVER + 2] - wz * k[at.K_LEVER + 1])
            + w[at.W_C_NB + 3 * i + 1] * (wz * k[at.K_LEVER] - wx * k[at.K_LEVER + 2])
            + w[at.W_C_NB + 3 * i + 2] * (wx * k[at.K_LEVER + 1] - wy * k[at.K_LEVER])
        )
