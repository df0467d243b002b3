"""Measurement update: test an innovation against its covariance, and apply it.

An observation of at most three rows is whitened by the Cholesky factor of its innovation
covariance; what is applied is then one scalar a row, each a rank-one step ``P -= K K'`` on one
triangle, so that P stays symmetric to the bit.

Source: Maybeck 1979, vol. 1, chapters 5 and 7; reset of the attitude error: Sola 2017, section 6.3.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.filter.rotation import rotate
from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_BG,
    E_DELAY,
    E_HEADING,
    E_IRON,
    E_VEL,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector, errors
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import atan2, fabs, sqrt

LEAST_VARIANCE = cython.declare(cython.double, 1e-16)


def innovate(x: State, o: Observation) -> float:
    """Return the normalised innovation squared; chi-square of ``o.rows`` degrees if all is well.

    Reads H, z and R; leaves P H', the Cholesky factor of S and the whitened innovation in ``o``.
    An S that is not positive definite gives NaN, which is within no gate.
    """
    nis = 0.0
    n = carried(x)

    # P H'
    for r in range(o.rows):
        for i in range(N):
            o.PHt[r][i] = 0.0
        for j in range(n):
            h = o.H[r][j]
            if h != 0.0:
                for i in range(n):
                    o.PHt[r][i] += h * x.P[j][i]

    # S = H P H' + R, its factor, the innovation whitened by it
    for r in range(o.rows):
        for c in range(r + 1):
            s = o.R[r][c]
            for j in range(n):
                s += o.H[r][j] * o.PHt[c][j]
            for j in range(c):
                s -= o.L[r][j] * o.L[c][j]
            if r == c:
                if not s > 0.0:
                    return NAN
                o.L[r][r] = sqrt(s)
            else:
                o.L[r][c] = s / o.L[c][c]
        s = o.z[r]
        for c in range(r):
            s -= o.L[r][c] * o.y[c]
        o.y[r] = s / o.L[r][r]
        nis += o.y[r] * o.y[r]
    return nis


def inflate_noise(o: Observation, factor: float) -> None:
    """Inflate R of a judged observation until S is larger by the factor, and K smaller by it."""
    root = sqrt(factor)
    for r in range(o.rows):
        for c in range(r + 1):
            o.L[r][c] *= root
        o.y[r] /= root


def apply_update(x: State, o: Observation) -> None:
    """Correct the state by an observation that :func:`innovate` has judged.

    Unless it shows the delay of the fixes, that is a consider state: its gain is zero, and its
    variance what it was (Schmidt 1966).
    """
    delay_var = x.P[E_DELAY][E_DELAY]
    n = carried(x)
    for i in range(N):
        o.dx[i] = 0.0
    for r in range(o.rows):
        # the gain of one whitened scalar is a column of P H' L^-T
        for c in range(r):
            s = o.L[r][c]
            for i in range(n):
                o.PHt[r][i] -= s * o.PHt[c][i]
        s = 1.0 / o.L[r][r]
        for i in range(n):
            o.PHt[r][i] *= s
            o.dx[i] += o.PHt[r][i] * o.y[r]
        for i in range(n):
            s = o.PHt[r][i]
            for j in range(i, n):
                x.P[i][j] -= s * o.PHt[r][j]
    if o.shows_delay == 0:
        o.dx[E_DELAY] = 0.0
        x.P[E_DELAY][E_DELAY] = delay_var
    for i in range(n):
        if x.P[i][i] < 0.0:
            x.P[i][i] = LEAST_VARIANCE
        for j in range(i):
            x.P[i][j] = x.P[j][i]
    inject(x, o)
    if o.has_bank:
        columns.correct(x, o)


def apply_yaw_update(x: State, o: Observation) -> None:
    """Correct yaw, its drift and its offsets only, by one row that :func:`innovate` has judged.

    An azimuth depends on tilt as much as on yaw, the more the steeper its direction; but its slow
    errors (a disturbed field, another filter's habits) must not become tilt. So the gain of all
    but yaw, heading offset, hard iron and the gyro bias about the vertical is zero, and the
    covariance is that of this gain: yaw stays correlated with the tilt that it was found with, and
    follows when GNSS corrects that.

    Source: Schmidt 1966 (consider states); Joseph form for any gain, Maybeck 1979, ch. 5.
    """
    down = 0.0
    s = o.L[0][0] * o.L[0][0]
    n = carried(x)
    for i in range(N):
        o.gain[i] = 0.0
    o.gain[E_ATT + 2] = o.PHt[0][E_ATT + 2] / s
    o.gain[E_HEADING] = o.PHt[0][E_HEADING] / s
    for i in range(3):
        down += o.C_nb[2][i] * o.PHt[0][E_BG + i]
    for i in range(3):
        o.gain[E_BG + i] = down * o.C_nb[2][i] / s
        o.gain[E_IRON + i] = o.PHt[0][E_IRON + i] / s
    for i in range(N):
        o.dx[i] = o.gain[i] * o.z[0]
    for i in range(n):
        for j in range(i, n):
            x.P[i][j] += (
                o.gain[i] * s * o.gain[j] - o.gain[i] * o.PHt[0][j] - o.PHt[0][i] * o.gain[j]
            )
    for i in range(n):
        for j in range(i):
            x.P[i][j] = x.P[j][i]
    inject(x, o)
    if o.has_bank:
        columns.correct_yaw(x, o)


def apply_delay_update(x: State, o: Observation) -> None:
    """Correct the delay of the fixes only, by one row that :func:`innovate` has judged.

    All else is a consider state: what the row owes to it stays as a correlation.
    """
    s = o.L[0][0] * o.L[0][0]
    gain = o.PHt[0][E_DELAY] / s
    x.gnss_delay += gain * o.z[0]
    for i in range(N):
        if i != E_DELAY:
            x.P[E_DELAY][i] -= gain * o.PHt[0][i]
            x.P[i][E_DELAY] = x.P[E_DELAY][i]
    x.P[E_DELAY][E_DELAY] -= gain * o.PHt[0][E_DELAY]
    if o.has_bank:
        columns.correct_delay(x, o, gain)


def add_columns(x: State, b: Bank, fault: int, off: Vector, weight: float) -> None:
    """Add a share of a fault's uncertainty to P: U M U', and that its mean is off by N numbers."""
    h = address(b.instance[fault])
    for c in range(h.rows):
        for d in range(h.rows):
            for i in range(N):
                s = weight * b.U[c][i][fault] * h.M[c][d]
                for j in range(N):
                    x.P[i][j] += s * b.U[d][j][fault]
    for i in range(N):
        for j in range(N):
            x.P[i][j] += weight * off[i] * off[j]
    for i in range(N):
        for j in range(i):
            x.P[i][j] = x.P[j][i]


def inject(x: State, o: Observation) -> None:
    """Move the error state dx into the nominal one, and P with it: J = I + [dx x]/2 on attitude."""
    dx = 0.5 * o.dx[0]
    dy = 0.5 * o.dx[1]
    dz = 0.5 * o.dx[2]
    rotate(x.q_nb, o.dx[0], o.dx[1], o.dx[2])
    value = errors(x)
    n = carried(x)
    for i in range(n - E_VEL):
        value[i] += o.dx[E_VEL + i]
    for i in range(n):
        p0 = x.P[0][i]
        p1 = x.P[1][i]
        p2 = x.P[2][i]
        x.P[0][i] = p0 + dy * p2 - dz * p1
        x.P[1][i] = p1 + dz * p0 - dx * p2
        x.P[2][i] = p2 + dx * p1 - dy * p0
    for i in range(3):
        p0 = x.P[i][0]
        p1 = x.P[i][1]
        p2 = x.P[i][2]
        x.P[i][0] = p0 + dy * p2 - dz * p1
        x.P[i][1] = p1 + dz * p0 - dx * p2
        x.P[i][2] = p2 + dx * p1 - dy * p0
    x.P[1][0] = x.P[0][1]
    x.P[2][0] = x.P[0][2]
    x.P[2][1] = x.P[1][2]
    for i in range(3, n):
        x.P[i][0] = x.P[0][i]
        x.P[i][1] = x.P[1][i]
        x.P[i][2] = x.P[2][i]


def difference(x: State, y: State, o: Observation) -> None:
    """Write the error dx that :func:`inject` would have to move x by to make it y.

    The inverse of what inject does to the nominal state; exact for any turn below pi.
    """
    s = 2.0
    # y x*: the turn from x to y, in n
    qw = (
        y.q_nb[0] * x.q_nb[0]
        + y.q_nb[1] * x.q_nb[1]
        + y.q_nb[2] * x.q_nb[2]
        + y.q_nb[3] * x.q_nb[3]
    )
    qx = (
        y.q_nb[1] * x.q_nb[0]
        - y.q_nb[0] * x.q_nb[1]
        - y.q_nb[2] * x.q_nb[3]
        + y.q_nb[3] * x.q_nb[2]
    )
    qy = (
        y.q_nb[2] * x.q_nb[0]
        - y.q_nb[0] * x.q_nb[2]
        - y.q_nb[3] * x.q_nb[1]
        + y.q_nb[1] * x.q_nb[3]
    )
    qz = (
        y.q_nb[3] * x.q_nb[0]
        - y.q_nb[0] * x.q_nb[3]
        - y.q_nb[1] * x.q_nb[2]
        + y.q_nb[2] * x.q_nb[1]
    )
    n2 = qx * qx + qy * qy + qz * qz
    if qw < 0.0:
        s = -2.0
    if n2 > 1e-6:
        s = s * atan2(sqrt(n2), fabs(qw)) / sqrt(n2)
    else:  # the next term is below 1e-19
        s = s * (1.0 + n2 * (1.0 / 6.0 + n2 * (3.0 / 40.0)))
    o.dx[E_ATT] = s * qx
    o.dx[E_ATT + 1] = s * qy
    o.dx[E_ATT + 2] = s * qz
    value = errors(x)
    other = errors(y)
    for i in range(N - E_VEL):
        o.dx[E_VEL + i] = other[i] - value[i]


def rebase(y: State, o: Observation) -> None:
    """Take back what :func:`inject` did to P when it moved by dx: J^-1 P J^-T.

    P of y, the error about y, becomes that about the state from which dx leads to y.
    """
    for i in range(N):
        for r in range(3):
            o.y[r] = y.P[r][i]
        rotate_back(o.y, o)
        for r in range(3):
            y.P[r][i] = o.y[r]
    for i in range(3):
        rotate_back(y.P[i], o)
    y.P[1][0] = y.P[0][1]
    y.P[2][0] = y.P[0][2]
    y.P[2][1] = y.P[1][2]
    for i in range(3, N):
        y.P[i][0] = y.P[0][i]
        y.P[i][1] = y.P[1][i]
        y.P[i][2] = y.P[2][i]


def rotate_back(v: Vector, o: Observation) -> None:
    """Multiply three numbers by J^-1.

    With ``A = [dx x]/2``: ``(I + A)^-1 = I - (A - A A) / (1 + |dx|^2/4)``, as A^3 = -|dx|^2/4 A.
    """
    dx = 0.5 * o.dx[0]
    dy = 0.5 * o.dx[1]
    dz = 0.5 * o.dx[2]
    s = 1.0 / (1.0 + dx * dx + dy * dy + dz * dz)
    p0 = v[0]
    p1 = v[1]
    p2 = v[2]
    c0 = dy * p2 - dz * p1
    c1 = dz * p0 - dx * p2
    c2 = dx * p1 - dy * p0
    v[0] = p0 - s * (c0 - (dy * c2 - dz * c1))
    v[1] = p1 - s * (c1 - (dz * c0 - dx * c2))
    v[2] = p2 - s * (c2 - (dx * c1 - dy * c0))


def copy_nominal(x: State, source: State) -> None:
    """Copy the nominal state: all that an error state is the error of."""
    for i in range(4):
        x.q_nb[i] = source.q_nb[i]
    value = errors(x)
    other = errors(source)
    for i in range(N - E_VEL):
        value[i] = other[i]
