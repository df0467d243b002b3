# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""One interval backwards: from what is known later to what that says of before.

With ``G = P Phi' (P-)^-1``, from the filter's covariance P before the interval, its Phi, and its
covariance P- after it: ``e = G (later - after)``; ``P_s = P + G (P_later - P-) G'``.

Source: Rauch, Tung, Striebel 1965, "Maximum likelihood estimates of linear dynamic systems";
Sarkka 2013, section 8.2.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import correct
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import sqrt
else:
    from math import sqrt

    from ekf_companion.core import correct
    from ekf_companion.core import state as at

KNOWN = cython.declare(cython.double, 1e-12)
"""A state of whose variance the others leave no more than this share is known by them."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def carry(x: cython.double[::1], y: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Give the smoothed state y the accounts of x, the filter's block of the same time."""
    if x[at.X_MODE] < at.MODE_ATTITUDE:
        y[:] = x
        return
    correct.difference(x, y, w)
    correct.rebase(y, w)
    y[: at.X_COV] = x[: at.X_COV]
    correct.inject(y, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def move(
    before: cython.double[::1],
    after: cython.double[::1],
    w: cython.double[::1],
    Phi: cython.Py_ssize_t,
    prior: cython.double[:, ::1],
    gain: cython.double[:, ::1],
) -> cython.void:
    """Write the covariance after an interval, and Phi (at w[Phi]) times that before it."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    for i in range(at.N):
        for j in range(at.N):
            prior[i, j] = after[at.X_COV + i * at.N + j]
            gain[i, j] = 0.0
        for m in range(at.N):
            s = w[Phi + i * at.N + m]
            if s != 0.0:
                for j in range(at.N):
                    gain[i, j] += s * before[at.X_COV + m * at.N + j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def renew(
    before: cython.double[::1],
    after: cython.double[::1],
    prior: cython.double[:, ::1],
    gain: cython.double[:, ::1],
) -> cython.void:
    """Do the same where some states were drawn anew: what follows says nothing of those.

    Their rows of Phi are zero and, since they tell nothing, their variance may be any. Of what was
    measured in the same event before the drawing, the states that stayed keep all, those drawn
    anew what the others know of it.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(at.N):
        for j in range(at.N):
            gain[i, j] = before[at.X_COV + i * at.N + j]
            prior[i, j] = gain[i, j]
    for i in range(at.N):
        if after[at.X_FRESH + i] != before[at.X_FRESH + i]:
            for j in range(at.N):
                gain[i, j] = 0.0
                prior[i, j] = 0.0
                prior[j, i] = 0.0
            prior[i, i] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def subtract(
    y: cython.double[::1], prior: cython.double[:, ::1], change: cython.double[:, ::1]
) -> cython.void:
    """Write P of y less the prior."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(at.N):
        for j in range(at.N):
            change[i, j] = y[at.X_COV + i * at.N + j] - prior[i, j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def factor(a: cython.double[:, ::1]) -> cython.void:
    """Replace the upper triangle of a covariance by U with U' U = it.

    A state that is known, or known by those before it, gets a row of zeros: it is left out.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    # the lower triangle is free: its first column, and the corner, remember the variances
    for i in range(1, at.N):
        a[i, 0] = a[i, i]
    least: cython.double = KNOWN * a[0, 0]
    for i in range(at.N):
        if i > 0:
            least = KNOWN * a[i, 0]
        s = 1.0 / sqrt(a[i, i]) if a[i, i] > least else 0.0
        for j in range(i, at.N):
            a[i, j] *= s
        for m in range(i + 1, at.N):
            s = a[i, m]
            for j in range(m, at.N):
                a[m, j] -= s * a[i, j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def solve(root: cython.double[:, ::1], g: cython.double[:, ::1]) -> cython.void:
    """Solve U' U X = g in place; what :func:`factor` left out stays zero."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    for i in range(at.N):
        s = 1.0 / root[i, i] if root[i, i] > 0.0 else 0.0
        for j in range(at.N):
            g[i, j] *= s
        for m in range(i + 1, at.N):
            s = root[i, m]
            for j in range(at.N):
                g[m, j] -= s * g[i, j]
    for i in range(at.N - 1, -1, -1):
        for m in range(i + 1, at.N):
            s = root[i, m]
            for j in range(at.N):
                g[i, j] -= s * g[m, j]
        s = 1.0 / root[i, i] if root[i, i] > 0.0 else 0.0
        for j in range(at.N):
            g[i, j] *= s


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def absorb(
    before: cython.double[::1],
    y: cython.double[::1],
    w: cython.double[::1],
    gain: cython.double[:, ::1],
    change: cython.double[:, ::1],
    half: cython.double[:, ::1],
) -> cython.void:
    """Make y the state before, moved by G times w[W_DX]; its P is P + G change G'. Reads G'."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    y[:] = before
    for i in range(at.N):
        w[at.W_ROW + i] = w[at.W_DX + i]
        w[at.W_DX + i] = 0.0
    for m in range(at.N):
        s = w[at.W_ROW + m]
        for i in range(at.N):
            w[at.W_DX + i] += gain[m, i] * s
    for i in range(at.N):
        for j in range(at.N):
            half[i, j] = 0.0
        for m in range(at.N):
            s = change[i, m]
            for j in range(at.N):
                half[i, j] += s * gain[m, j]
    for m in range(at.N):
        for i in range(at.N):
            s = gain[m, i]
            for j in range(i, at.N):
                y[at.X_COV + i * at.N + j] += s * half[m, j]
    for i in range(at.N):
        if y[at.X_COV + i * (at.N + 1)] < 0.0:
            y[at.X_COV + i * (at.N + 1)] = 0.0
        for j in range(i):
            y[at.X_COV + i * at.N + j] = y[at.X_COV + j * at.N + i]
    correct.inject(y, w)
