# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Probability: judge an innovation by its covariance, and absorb it.

A block of m <= 3 rows is whitened by the Cholesky factor of its innovation covariance; what is
absorbed is then m scalars, each a rank-one step ``P -= K K'`` on one triangle, so that P stays
symmetric to the bit.

Source: Maybeck 1979, vol. 1, chapters 5 and 7; reset of the attitude error: Sola 2017, section 6.3.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.propagate import turn
    from cython.cimports.libc.math import atan2, fabs, sqrt
else:
    from math import atan2, fabs, sqrt

    from ekf_companion.core import state as at
    from ekf_companion.core.propagate import turn

REFUSED = cython.declare(cython.double, 1e30)
FLOOR = cython.declare(cython.double, 1e-16)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def innovate(x: cython.double[::1], w: cython.double[::1], m: cython.Py_ssize_t) -> cython.double:
    """Give the normalised innovation squared of m rows; chi-square of m degrees if all is well.

    Reads H (w[W_H], m rows of N), the innovation (w[W_Z]) and R (w[W_R], rows of 3). Leaves P H',
    the Cholesky factor of S and the whitened innovation for :func:`absorb`. An S that is not
    positive definite gives 1e30, which no gate lets through.
    """
    r: cython.Py_ssize_t
    c: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    h: cython.double
    s: cython.double
    nis: cython.double = 0.0

    # P H'
    for r in range(m):
        for i in range(at.N):
            w[at.W_C + r * at.N + i] = 0.0
        for j in range(at.N):
            h = w[at.W_H + r * at.N + j]
            if h != 0.0:
                for i in range(at.N):
                    w[at.W_C + r * at.N + i] += h * x[at.X_COV + j * at.N + i]

    # S = H P H' + R, its factor, the innovation whitened by it
    for r in range(m):
        for c in range(r + 1):
            s = w[at.W_R + 3 * r + c]
            for j in range(at.N):
                s += w[at.W_H + r * at.N + j] * w[at.W_C + c * at.N + j]
            for j in range(c):
                s -= w[at.W_L + 3 * r + j] * w[at.W_L + 3 * c + j]
            if r == c:
                if not s > 0.0:
                    return REFUSED
                w[at.W_L + 3 * r + r] = sqrt(s)
            else:
                w[at.W_L + 3 * r + c] = s / w[at.W_L + 3 * c + c]
        s = w[at.W_Z + r]
        for c in range(r):
            s -= w[at.W_L + 3 * r + c] * w[at.W_Y + c]
        w[at.W_Y + r] = s / w[at.W_L + 3 * r + r]
        nis += w[at.W_Y + r] * w[at.W_Y + r]
    return nis


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def soften(w: cython.double[::1], m: cython.Py_ssize_t, factor: cython.double) -> cython.void:
    """Trust m judged rows less: raise R until S is larger by the factor, so K smaller by it."""
    i: cython.Py_ssize_t
    root: cython.double = sqrt(factor)
    for i in range(3 * m):
        w[at.W_L + i] *= root
    for i in range(m):
        w[at.W_Y + i] /= root


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def absorb(x: cython.double[::1], w: cython.double[::1], m: cython.Py_ssize_t) -> cython.void:
    """Absorb what :func:`innovate` has judged, and move the error into the nominal state."""
    r: cython.Py_ssize_t
    c: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    s: cython.double
    for i in range(at.N):
        w[at.W_DX + i] = 0.0
    for r in range(m):
        # the gain of one whitened scalar is a column of P H' L^-T
        for c in range(r):
            s = w[at.W_L + 3 * r + c]
            for i in range(at.N):
                w[at.W_C + r * at.N + i] -= s * w[at.W_C + c * at.N + i]
        s = 1.0 / w[at.W_L + 3 * r + r]
        for i in range(at.N):
            w[at.W_C + r * at.N + i] *= s
            w[at.W_DX + i] += w[at.W_C + r * at.N + i] * w[at.W_Y + r]
        for i in range(at.N):
            s = w[at.W_C + r * at.N + i]
            for j in range(i, at.N):
                x[at.X_COV + i * at.N + j] -= s * w[at.W_C + r * at.N + j]
    for i in range(at.N):
        if x[at.X_COV + i * (at.N + 1)] < 0.0:
            x[at.X_COV + i * (at.N + 1)] = FLOOR
        for j in range(i):
            x[at.X_COV + i * at.N + j] = x[at.X_COV + j * at.N + i]
    inject(x, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def absorb_yaw(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Absorb one row that :func:`innovate` has judged into yaw, its drift and its offsets only.

    An azimuth depends on tilt as much as on yaw, the more the steeper its direction; but its slow
    errors (a disturbed field, another filter's habits) must not become tilt. So the gain of all
    but yaw, heading offset, hard iron and the gyro bias about the vertical is zero, and the
    covariance is that of this gain: yaw stays correlated with the tilt that it was found with, and
    follows when GNSS corrects that. The vertical in b is the last row of w[W_C_NB].

    Source: Schmidt 1966 (consider states); Joseph form for any gain, Maybeck 1979, ch. 5.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    down: cython.double = 0.0
    s: cython.double = w[at.W_L] * w[at.W_L]
    for i in range(at.N):
        w[at.W_ROW + i] = 0.0
    w[at.W_ROW + at.E_ATT + 2] = w[at.W_C + at.E_ATT + 2] / s
    w[at.W_ROW + at.E_HEADING] = w[at.W_C + at.E_HEADING] / s
    for i in range(3):
        down += w[at.W_C_NB + 6 + i] * w[at.W_C + at.E_BG + i]
    for i in range(3):
        w[at.W_ROW + at.E_BG + i] = down * w[at.W_C_NB + 6 + i] / s
        w[at.W_ROW + at.E_IRON + i] = w[at.W_C + at.E_IRON + i] / s
    for i in range(at.N):
        w[at.W_DX + i] = w[at.W_ROW + i] * w[at.W_Z]
        for j in range(i, at.N):
            x[at.X_COV + i * at.N + j] += (
                w[at.W_ROW + i] * s * w[at.W_ROW + j]
                - w[at.W_ROW + i] * w[at.W_C + j]
                - w[at.W_C + i] * w[at.W_ROW + j]
            )
    for i in range(at.N):
        for j in range(i):
            x[at.X_COV + i * at.N + j] = x[at.X_COV + j * at.N + i]
    inject(x, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def inject(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Move the error state into the nominal one, and P with it: J = I + [d x]/2 on attitude."""
    i: cython.Py_ssize_t
    dx: cython.double = 0.5 * w[at.W_DX]
    dy: cython.double = 0.5 * w[at.W_DX + 1]
    dz: cython.double = 0.5 * w[at.W_DX + 2]
    p0: cython.double
    p1: cython.double
    p2: cython.double
    turn(x, at.X_Q, w[at.W_DX], w[at.W_DX + 1], w[at.W_DX + 2])
    for i in range(3):
        x[at.X_VEL + i] += w[at.W_DX + at.E_VEL + i]
        x[at.X_POS + i] += w[at.W_DX + at.E_POS + i]
        x[at.X_BG + i] += w[at.W_DX + at.E_BG + i]
        x[at.X_BA + i] += w[at.W_DX + at.E_BA + i]
        x[at.X_SLOW + i] += w[at.W_DX + at.E_SLOW + i]
        x[at.X_IRON + i] += w[at.W_DX + at.E_IRON + i]
    x[at.X_BARO] += w[at.W_DX + at.E_BARO]
    x[at.X_DELAY] += w[at.W_DX + at.E_DELAY]
    x[at.X_HEADING] += w[at.W_DX + at.E_HEADING]
    for i in range(at.N):
        p0 = x[at.X_COV + i]
        p1 = x[at.X_COV + at.N + i]
        p2 = x[at.X_COV + 2 * at.N + i]
        x[at.X_COV + i] = p0 + dy * p2 - dz * p1
        x[at.X_COV + at.N + i] = p1 + dz * p0 - dx * p2
        x[at.X_COV + 2 * at.N + i] = p2 + dx * p1 - dy * p0
    for i in range(3):
        p0 = x[at.X_COV + i * at.N]
        p1 = x[at.X_COV + i * at.N + 1]
        p2 = x[at.X_COV + i * at.N + 2]
        x[at.X_COV + i * at.N] = p0 + dy * p2 - dz * p1
        x[at.X_COV + i * at.N + 1] = p1 + dz * p0 - dx * p2
        x[at.X_COV + i * at.N + 2] = p2 + dx * p1 - dy * p0
    x[at.X_COV + at.N] = x[at.X_COV + 1]
    x[at.X_COV + 2 * at.N] = x[at.X_COV + 2]
    x[at.X_COV + 2 * at.N + 1] = x[at.X_COV + at.N + 2]
    for i in range(3, at.N):
        x[at.X_COV + i * at.N] = x[at.X_COV + i]
        x[at.X_COV + i * at.N + 1] = x[at.X_COV + at.N + i]
        x[at.X_COV + i * at.N + 2] = x[at.X_COV + 2 * at.N + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def difference(x: cython.double[::1], y: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Write the error that :func:`inject` would have to move x by to make it y, to w[W_DX].

    The inverse of what inject does to the nominal state; exact for any turn below pi.
    """
    i: cython.Py_ssize_t
    s: cython.double = 2.0
    # y x*: the turn from x to y, in n
    qw: cython.double = (
        y[at.X_Q] * x[at.X_Q]
        + y[at.X_Q + 1] * x[at.X_Q + 1]
        + y[at.X_Q + 2] * x[at.X_Q + 2]
        + y[at.X_Q + 3] * x[at.X_Q + 3]
    )
    qx: cython.double = (
        y[at.X_Q + 1] * x[at.X_Q]
        - y[at.X_Q] * x[at.X_Q + 1]
        - y[at.X_Q + 2] * x[at.X_Q + 3]
        + y[at.X_Q + 3] * x[at.X_Q + 2]
    )
    qy: cython.double = (
        y[at.X_Q + 2] * x[at.X_Q]
        - y[at.X_Q] * x[at.X_Q + 2]
        - y[at.X_Q + 3] * x[at.X_Q + 1]
        + y[at.X_Q + 1] * x[at.X_Q + 3]
    )
    qz: cython.double = (
        y[at.X_Q + 3] * x[at.X_Q]
        - y[at.X_Q] * x[at.X_Q + 3]
        - y[at.X_Q + 1] * x[at.X_Q + 2]
        + y[at.X_Q + 2] * x[at.X_Q + 1]
    )
    n2: cython.double = qx * qx + qy * qy + qz * qz
    if qw < 0.0:
        s = -2.0
    if n2 > 1e-6:
        s = s * atan2(sqrt(n2), fabs(qw)) / sqrt(n2)
    else:  # the next term is below 1e-19
        s = s * (1.0 + n2 * (1.0 / 6.0 + n2 * (3.0 / 40.0)))
    w[at.W_DX + at.E_ATT] = s * qx
    w[at.W_DX + at.E_ATT + 1] = s * qy
    w[at.W_DX + at.E_ATT + 2] = s * qz
    for i in range(3):
        w[at.W_DX + at.E_VEL + i] = y[at.X_VEL + i] - x[at.X_VEL + i]
        w[at.W_DX + at.E_POS + i] = y[at.X_POS + i] - x[at.X_POS + i]
        w[at.W_DX + at.E_BG + i] = y[at.X_BG + i] - x[at.X_BG + i]
        w[at.W_DX + at.E_BA + i] = y[at.X_BA + i] - x[at.X_BA + i]
        w[at.W_DX + at.E_SLOW + i] = y[at.X_SLOW + i] - x[at.X_SLOW + i]
        w[at.W_DX + at.E_IRON + i] = y[at.X_IRON + i] - x[at.X_IRON + i]
    w[at.W_DX + at.E_BARO] = y[at.X_BARO] - x[at.X_BARO]
    w[at.W_DX + at.E_DELAY] = y[at.X_DELAY] - x[at.X_DELAY]
    w[at.W_DX + at.E_HEADING] = y[at.X_HEADING] - x[at.X_HEADING]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def rebase(y: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Take back what :func:`inject` did to P when it moved by w[W_DX]: J^-1 P J^-T.

    y's P, the error about y, becomes that about the state from which w[W_DX] leads to y.
    """
    i: cython.Py_ssize_t
    for i in range(at.N):
        unturn(y, at.X_COV + i, at.N, w)
    for i in range(3):
        unturn(y, at.X_COV + i * at.N, 1, w)
    y[at.X_COV + at.N] = y[at.X_COV + 1]
    y[at.X_COV + 2 * at.N] = y[at.X_COV + 2]
    y[at.X_COV + 2 * at.N + 1] = y[at.X_COV + at.N + 2]
    for i in range(3, at.N):
        y[at.X_COV + i * at.N] = y[at.X_COV + i]
        y[at.X_COV + i * at.N + 1] = y[at.X_COV + at.N + i]
        y[at.X_COV + i * at.N + 2] = y[at.X_COV + 2 * at.N + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def unturn(
    y: cython.double[::1],
    first: cython.Py_ssize_t,
    stride: cython.Py_ssize_t,
    w: cython.double[::1],
) -> cython.void:
    """Multiply three numbers of y by J^-1.

    With ``A = [d x]/2``: ``(I + A)^-1 = I - (A - A A) / (1 + |d|^2/4)``, since A^3 = -|d|^2/4 A.
    """
    dx: cython.double = 0.5 * w[at.W_DX]
    dy: cython.double = 0.5 * w[at.W_DX + 1]
    dz: cython.double = 0.5 * w[at.W_DX + 2]
    s: cython.double = 1.0 / (1.0 + dx * dx + dy * dy + dz * dz)
    p0: cython.double = y[first]
    p1: cython.double = y[first + stride]
    p2: cython.double = y[first + 2 * stride]
    c0: cython.double = dy * p2 - dz * p1
    c1: cython.double = dz * p0 - dx * p2
    c2: cython.double = dx * p1 - dy * p0
    y[first] = p0 - s * (c0 - (dy * c2 - dz * c1))
    y[first + stride] = p1 - s * (c1 - (dz * c0 - dx * c2))
    y[first + 2 * stride] = p2 - s * (c2 - (dx * c1 - dy * c0))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def forget(
    x: cython.double[::1],
    first: cython.Py_ssize_t,
    count: cython.Py_ssize_t,
    variance: cython.double,
) -> cython.void:
    """Make some error states uncorrelated with all others, each of this variance.

    They are counted as drawn anew: what is known of them later says nothing of them before.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(first, first + count):
        x[at.X_FRESH + i] += 1.0
        for j in range(at.N):
            x[at.X_COV + i * at.N + j] = 0.0
            x[at.X_COV + j * at.N + i] = 0.0
        x[at.X_COV + i * (at.N + 1)] = variance
