# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""What each sensor should read, and how that depends on the error: innovation, H and R.

Each function fills w[W_Z], w[W_H] and w[W_R] for :func:`ekf_companion.core.correct.innovate`.

Source: Groves 2013, chapter 14.3 (GNSS with lever arm) and 6.1 (magnetic heading).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.propagate import matrix
    from cython.cimports.libc.math import atan2, cos, floor, isnan, sin, sqrt
else:
    from math import atan2, cos, floor, isnan, sin, sqrt

    from ekf_companion.core import state as at
    from ekf_companion.core.propagate import matrix

PI = cython.declare(cython.double, 3.14159265358979323846)
RATE = cython.declare(cython.double, 7.292115e-5)
"""Of the Earth, rad/s."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def wrap(angle: cython.double) -> cython.double:
    """Bring an angle into [-pi, pi)."""
    return angle - 2.0 * PI * floor((angle + PI) / (2.0 * PI))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def blank(w: cython.double[::1], m: cython.Py_ssize_t, variance: cython.double) -> cython.void:
    """Begin m rows: H zero, R diagonal."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(m * at.N):
        w[at.W_H + i] = 0.0
    for i in range(m):
        for j in range(m):
            w[at.W_R + 3 * i + j] = 0.0
        w[at.W_R + 4 * i] = variance


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def hurry(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    m: cython.Py_ssize_t,
    rate: cython.Py_ssize_t,
) -> cython.void:
    """Add to R what a wrong stamp does to what changes at the rate x[rate:+m]."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(m):
        for j in range(m):
            w[at.W_R + 3 * i + j] += k[at.K_TIMING] * k[at.K_TIMING] * x[rate + i] * x[rate + j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def antenna(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Write the lever arm in n to w[W_ROW:+3] and the antenna's extra velocity to w[W_ROW+3:+3]."""
    i: cython.Py_ssize_t
    lx: cython.double = k[at.K_LEVER]
    ly: cython.double = k[at.K_LEVER + 1]
    lz: cython.double = k[at.K_LEVER + 2]
    wx: cython.double = x[at.X_GYRO] - x[at.X_BG]
    wy: cython.double = x[at.X_GYRO + 1] - x[at.X_BG + 1]
    wz: cython.double = x[at.X_GYRO + 2] - x[at.X_BG + 2]
    vx: cython.double = wy * lz - wz * ly
    vy: cython.double = wz * lx - wx * lz
    vz: cython.double = wx * ly - wy * lx
    matrix(x, at.X_Q, w)
    for i in range(3):
        w[at.W_ROW + i] = (
            w[at.W_C_NB + 3 * i] * lx
            + w[at.W_C_NB + 3 * i + 1] * ly
            + w[at.W_C_NB + 3 * i + 2] * lz
        )
        w[at.W_ROW + 3 + i] = (
            w[at.W_C_NB + 3 * i] * vx
            + w[at.W_C_NB + 3 * i + 1] * vy
            + w[at.W_C_NB + 3 * i + 2] * vz
        )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def position(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Two rows: north and east of the antenna, by the fix in w[W_FIX]."""
    late: cython.double = x[at.X_DELAY]
    lat: cython.double = w[at.W_FIX]
    lon: cython.double = w[at.W_FIX + 1]
    blank(w, 2, w[at.W_FIX + 6] * w[at.W_FIX + 6])
    hurry(x, k, w, 2, at.X_VEL)
    antenna(x, k, w)
    w[at.W_Z] = (lat - x[at.X_LAT0]) * x[at.X_SCALE_N] - (
        x[at.X_POS] + x[at.X_SLOW] + w[at.W_ROW] - late * (x[at.X_VEL] + w[at.W_ROW + 3])
    )
    w[at.W_Z + 1] = wrap(lon - x[at.X_LON0]) * x[at.X_SCALE_E] - (
        x[at.X_POS + 1]
        + x[at.X_SLOW + 1]
        + w[at.W_ROW + 1]
        - late * (x[at.X_VEL + 1] + w[at.W_ROW + 4])
    )
    # theta turns the lever arm r: theta x r
    w[at.W_H + at.E_ATT + 1] = w[at.W_ROW + 2]
    w[at.W_H + at.E_ATT + 2] = -w[at.W_ROW + 1]
    w[at.W_H + at.E_VEL] = -late
    w[at.W_H + at.E_POS] = 1.0
    w[at.W_H + at.E_SLOW] = 1.0
    w[at.W_H + at.E_DELAY] = -(x[at.X_VEL] + w[at.W_ROW + 3])
    w[at.W_H + at.N + at.E_ATT] = -w[at.W_ROW + 2]
    w[at.W_H + at.N + at.E_ATT + 2] = w[at.W_ROW]
    w[at.W_H + at.N + at.E_VEL + 1] = -late
    w[at.W_H + at.N + at.E_POS + 1] = 1.0
    w[at.W_H + at.N + at.E_SLOW + 1] = 1.0
    w[at.W_H + at.N + at.E_DELAY] = -(x[at.X_VEL + 1] + w[at.W_ROW + 4])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def height(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """One row: altitude of the antenna above mean sea level, by the fix in w[W_FIX]."""
    late: cython.double = x[at.X_DELAY]
    blank(w, 1, w[at.W_FIX + 7] * w[at.W_FIX + 7])
    hurry(x, k, w, 1, at.X_VEL + 2)
    antenna(x, k, w)
    w[at.W_Z] = (x[at.X_ALT0] - w[at.W_FIX + 2]) - (
        x[at.X_POS + 2]
        + x[at.X_SLOW + 2]
        + w[at.W_ROW + 2]
        - late * (x[at.X_VEL + 2] + w[at.W_ROW + 5])
    )
    w[at.W_H + at.E_ATT] = w[at.W_ROW + 1]
    w[at.W_H + at.E_ATT + 1] = -w[at.W_ROW]
    w[at.W_H + at.E_VEL + 2] = -late
    w[at.W_H + at.E_POS + 2] = 1.0
    w[at.W_H + at.E_SLOW + 2] = 1.0
    w[at.W_H + at.E_DELAY] = -(x[at.X_VEL + 2] + w[at.W_ROW + 5])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def velocity(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]
) -> cython.Py_ssize_t:
    """Two rows, or three where it has a down: velocity of the antenna, by the fix in w[W_FIX].

    Gives their number.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t = 2 if isnan(w[at.W_FIX + 5]) else 3
    late: cython.double = x[at.X_DELAY]
    blank(w, m, w[at.W_FIX + 8] * w[at.W_FIX + 8])
    hurry(x, k, w, m, at.X_ACC_N)
    antenna(x, k, w)
    for i in range(m):
        w[at.W_Z + i] = w[at.W_FIX + 3 + i] - (
            x[at.X_VEL + i] + w[at.W_ROW + 3 + i] - late * x[at.X_ACC_N + i]
        )
        w[at.W_H + i * at.N + at.E_VEL + i] = 1.0
        w[at.W_H + i * at.N + at.E_DELAY] = -x[at.X_ACC_N + i]
        # the gyro bias turns the lever arm: C (l x bg)
        j = at.W_H + i * at.N + at.E_BG
        w[j] = (
            w[at.W_C_NB + 3 * i + 1] * k[at.K_LEVER + 2]
            - w[at.W_C_NB + 3 * i + 2] * k[at.K_LEVER + 1]
        )
        w[j + 1] = (
            w[at.W_C_NB + 3 * i + 2] * k[at.K_LEVER] - w[at.W_C_NB + 3 * i] * k[at.K_LEVER + 2]
        )
        w[j + 2] = (
            w[at.W_C_NB + 3 * i] * k[at.K_LEVER + 1] - w[at.W_C_NB + 3 * i + 1] * k[at.K_LEVER]
        )
    # theta turns the antenna's extra velocity u: theta x u
    w[at.W_H + at.E_ATT + 1] = w[at.W_ROW + 5]
    w[at.W_H + at.E_ATT + 2] = -w[at.W_ROW + 4]
    w[at.W_H + at.N + at.E_ATT] = -w[at.W_ROW + 5]
    w[at.W_H + at.N + at.E_ATT + 2] = w[at.W_ROW + 3]
    if m == 3:
        w[at.W_H + 2 * at.N + at.E_ATT] = w[at.W_ROW + 4]
        w[at.W_H + 2 * at.N + at.E_ATT + 1] = -w[at.W_ROW + 3]
    return m


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def zero_velocity(x: cython.double[::1], w: cython.double[::1], std: cython.double) -> cython.void:
    """Three rows: the vehicle stands still, give or take std, m/s."""
    i: cython.Py_ssize_t
    blank(w, 3, std * std)
    for i in range(3):
        w[at.W_Z + i] = -x[at.X_VEL + i]
        w[at.W_H + i * at.N + at.E_VEL + i] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def zero_rate(x: cython.double[::1], w: cython.double[::1], std: cython.double) -> cython.void:
    """Three rows: what the gyro shows at rest, w[W_RATE], is its bias and the turning Earth."""
    i: cython.Py_ssize_t
    north: cython.double = 0.0
    down: cython.double = 0.0
    lat: cython.double
    blank(w, 3, std * std)
    matrix(x, at.X_Q, w)
    if x[at.X_HAS_ORIGIN] != 0.0:
        lat = x[at.X_LAT0] + x[at.X_POS] / x[at.X_SCALE_N]
        north = RATE * cos(lat)
        down = -RATE * sin(lat)
    for i in range(3):
        w[at.W_Z + i] = w[at.W_RATE + i] - (
            x[at.X_BG + i] + w[at.W_C_NB + i] * north + w[at.W_C_NB + 6 + i] * down
        )
        w[at.W_H + i * at.N + at.E_BG + i] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def azimuth(
    x: cython.double[::1],
    w: cython.double[::1],
    bx: cython.double,
    by: cython.double,
    bz: cython.double,
    target: cython.double,
    std: cython.double,
    noise: cython.double,
    has_iron: cython.bint,
) -> cython.bint:
    """One row: a direction of the body, (bx, by, bz), points to an azimuth in n (rad).

    The forward axis gives a heading; the magnetic field less the vehicle's own (has_iron) gives a
    compass, levelled by the filter's own tilt. Its slow error is a state; ``std`` is the white
    rest, rad, and ``noise`` that of the direction itself, in its units, which counts the more the
    steeper it is. False: the direction is too near the vertical.
    """
    i: cython.Py_ssize_t
    blank(w, 1, 0.0)
    matrix(x, at.X_Q, w)
    if has_iron:
        bx = bx - x[at.X_IRON]
        by = by - x[at.X_IRON + 1]
        bz = bz - x[at.X_IRON + 2]
    n: cython.double = w[at.W_C_NB] * bx + w[at.W_C_NB + 1] * by + w[at.W_C_NB + 2] * bz
    e: cython.double = w[at.W_C_NB + 3] * bx + w[at.W_C_NB + 4] * by + w[at.W_C_NB + 5] * bz
    d: cython.double = w[at.W_C_NB + 6] * bx + w[at.W_C_NB + 7] * by + w[at.W_C_NB + 8] * bz
    h2: cython.double = n * n + e * e
    if h2 <= 0.01 * (h2 + d * d):
        return False
    # The slope where the direction should be, not where its noise has put it: or noise times noise
    # would look like hard iron along the field
    h: cython.double = sqrt(h2)
    w[at.W_Z] = wrap(target - atan2(e, n) - x[at.X_HEADING])
    n = cos(target - x[at.X_HEADING])
    e = sin(target - x[at.X_HEADING])
    w[at.W_H + at.E_ATT] = -n * d / h
    w[at.W_H + at.E_ATT + 1] = -e * d / h
    w[at.W_H + at.E_ATT + 2] = 1.0
    w[at.W_H + at.E_HEADING] = 1.0
    if has_iron:
        for i in range(3):
            w[at.W_H + at.E_IRON + i] = (e * w[at.W_C_NB + i] - n * w[at.W_C_NB + 3 + i]) / h
    w[at.W_R] = std * std + noise * noise / h2
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def pressure_altitude(
    x: cython.double[::1], w: cython.double[::1], alt: cython.double, std: cython.double
) -> cython.void:
    """One row: altitude of the standard atmosphere, which differs from ours by a slow offset."""
    blank(w, 1, std * std)
    w[at.W_Z] = alt - (x[at.X_ALT0] - x[at.X_POS + 2] + x[at.X_BARO])
    w[at.W_H + at.E_POS + 2] = -1.0
    w[at.W_H + at.E_BARO] = 1.0
