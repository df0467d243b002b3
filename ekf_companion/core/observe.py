# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""What each sensor should read, and how that depends on the error: innovation, H and R.

Each function fills w[W_Z], w[W_H] and w[W_R] for :func:`ekf_companion.core.correct.innovate`.

Source: Groves 2013, chapter 14.3 (GNSS with lever arm) and 6.1 (magnetic heading).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import layout as at
    from cython.cimports.ekf_companion.core.propagate import matrix
    from cython.cimports.libc.math import atan2, floor, isnan
else:
    from math import atan2, floor, isnan

    from ekf_companion.core import layout as at
    from ekf_companion.core.propagate import matrix

PI = cython.declare(cython.double, 3.14159265358979323846)


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
def position(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    lat: cython.double,
    lon: cython.double,
    std: cython.double,
) -> cython.void:
    """Two rows: north and east of the antenna; lat, lon in rad, std in m."""
    late: cython.double = x[at.X_DELAY]
    blank(w, 2, std * std)
    antenna(x, k, w)
    w[at.W_Z] = (lat - x[at.X_LAT0]) * x[at.X_SCALE_N] - (
        x[at.X_POS] + w[at.W_ROW] - late * (x[at.X_VEL] + w[at.W_ROW + 3])
    )
    w[at.W_Z + 1] = wrap(lon - x[at.X_LON0]) * x[at.X_SCALE_E] - (
        x[at.X_POS + 1] + w[at.W_ROW + 1] - late * (x[at.X_VEL + 1] + w[at.W_ROW + 4])
    )
    # theta turns the lever arm r: theta x r
    w[at.W_H + at.E_ATT + 1] = w[at.W_ROW + 2]
    w[at.W_H + at.E_ATT + 2] = -w[at.W_ROW + 1]
    w[at.W_H + at.E_VEL] = -late
    w[at.W_H + at.E_POS] = 1.0
    w[at.W_H + at.E_DELAY] = -(x[at.X_VEL] + w[at.W_ROW + 3])
    w[at.W_H + at.N + at.E_ATT] = -w[at.W_ROW + 2]
    w[at.W_H + at.N + at.E_ATT + 2] = w[at.W_ROW]
    w[at.W_H + at.N + at.E_VEL + 1] = -late
    w[at.W_H + at.N + at.E_POS + 1] = 1.0
    w[at.W_H + at.N + at.E_DELAY] = -(x[at.X_VEL + 1] + w[at.W_ROW + 4])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def height(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    alt: cython.double,
    std: cython.double,
) -> cython.void:
    """One row: altitude of the antenna above mean sea level, m."""
    late: cython.double = x[at.X_DELAY]
    blank(w, 1, std * std)
    antenna(x, k, w)
    w[at.W_Z] = (x[at.X_ALT0] - alt) - (
        x[at.X_POS + 2] + w[at.W_ROW + 2] - late * (x[at.X_VEL + 2] + w[at.W_ROW + 5])
    )
    w[at.W_H + at.E_ATT] = w[at.W_ROW + 1]
    w[at.W_H + at.E_ATT + 1] = -w[at.W_ROW]
    w[at.W_H + at.E_VEL + 2] = -late
    w[at.W_H + at.E_POS + 2] = 1.0
    w[at.W_H + at.E_DELAY] = -(x[at.X_VEL + 2] + w[at.W_ROW + 5])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def velocity(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.Py_ssize_t:
    """Two rows, or three where vd is known: velocity of the antenna, m/s. Gives their number."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t = 2 if isnan(vd) else 3
    late: cython.double = x[at.X_DELAY]
    blank(w, m, std * std)
    antenna(x, k, w)
    w[at.W_Z] = vn
    w[at.W_Z + 1] = ve
    w[at.W_Z + 2] = vd
    for i in range(m):
        w[at.W_Z + i] -= x[at.X_VEL + i] + w[at.W_ROW + 3 + i] - late * x[at.X_ACC_N + i]
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
def azimuth(
    x: cython.double[::1],
    w: cython.double[::1],
    bx: cython.double,
    by: cython.double,
    bz: cython.double,
    target: cython.double,
    std: cython.double,
    noise: cython.double,
) -> cython.bint:
    """One row: a direction of the body, (bx, by, bz), points to an azimuth in n (rad).

    The forward axis gives a heading; the magnetic field gives a compass, levelled by the filter's
    own tilt. Its slow error is a state; ``std`` is the white rest, rad, and ``noise`` that of the
    direction itself, in its units, which counts the more the steeper it is. False: the direction
    is too near the vertical.
    """
    blank(w, 1, 0.0)
    matrix(x, at.X_Q, w)
    n: cython.double = w[at.W_C_NB] * bx + w[at.W_C_NB + 1] * by + w[at.W_C_NB + 2] * bz
    e: cython.double = w[at.W_C_NB + 3] * bx + w[at.W_C_NB + 4] * by + w[at.W_C_NB + 5] * bz
    d: cython.double = w[at.W_C_NB + 6] * bx + w[at.W_C_NB + 7] * by + w[at.W_C_NB + 8] * bz
    h2: cython.double = n * n + e * e
    if h2 <= 0.01 * (h2 + d * d):
        return False
    w[at.W_Z] = wrap(target - atan2(e, n) - x[at.X_HEADING])
    w[at.W_H + at.E_ATT] = -n * d / h2
    w[at.W_H + at.E_ATT + 1] = -e * d / h2
    w[at.W_H + at.E_ATT + 2] = 1.0
    w[at.W_H + at.E_HEADING] = 1.0
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
