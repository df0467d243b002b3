# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Whom to believe: gates, what is counted, and what a reset leaves behind.

An innovation inside the soft gate counts in full. Between the soft and the hard gate it counts the
less the further out it is, as if its noise had been larger. Beyond the hard gate it is refused; an
aid that goes on being refused has to prove itself (:mod:`ekf_companion.core.proof`).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import correct, proof
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import log
else:
    from math import log

    from ekf_companion.core import correct, proof
    from ekf_companion.core import state as at


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def count(x: cython.double[::1], aid: cython.Py_ssize_t, why: cython.Py_ssize_t) -> cython.void:
    """Count what became of one measurement."""
    x[at.X_COUNT + aid * at.WHYS + why] += 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def fuse(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
) -> cython.bint:
    """Absorb m rows if they pass the gate, and keep the account; False: they did not."""
    return weigh(x, k, w, aid, m, correct.innovate(x, w, m))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def weigh(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    nis: cython.double,
) -> cython.bint:
    """Absorb m rows that have been judged, in full or in part, or refuse them."""
    hard: cython.double = k[at.K_GATE + m - 1]
    soft: cython.double = k[at.K_SOFT + m - 1]
    x[at.X_RATIO + aid] = nis / hard
    x[at.X_NIS_SUM + aid] += (nis if nis < hard else hard) / m
    x[at.X_NIS_N + aid] += 1.0
    if nis > hard:
        count(x, aid, at.WHY_GATED)
        if x[at.X_T_REFUSED + aid] <= x[at.X_T_USED + aid]:
            x[at.X_T_REFUSED + aid] = x[at.X_T]
        if aid < at.AID_YAW:
            proof.add(x, w, aid, m)
        return False
    if nis > soft:
        correct.soften(w, m, nis / soft)
        count(x, aid, at.WHY_SOFT)
    else:
        count(x, aid, at.WHY_FUSED)
    if aid == at.AID_YAW:
        correct.absorb_yaw(x, w)
    else:
        correct.absorb(x, w, m)
    proof.forgive(x, aid)
    x[at.X_T_USED + aid] = x[at.X_T]
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def score(
    x: cython.double[::1],
    w: cython.double[::1],
    m: cython.Py_ssize_t,
    nis: cython.double,
    gate: cython.double,
) -> cython.void:
    """Add what m judged rows say to the sum of log-likelihoods; an outlier says what a gate does.

    Nothing in the filter reads the sum: it compares settings over the same log.
    """
    i: cython.Py_ssize_t
    cost: cython.double = nis if nis < gate else gate
    if nis >= 1e30:  # no covariance to judge by
        return
    for i in range(m):
        cost += 2.0 * log(w[at.W_L + 4 * i])
    x[at.X_LOGLIK] -= 0.5 * cost


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_timed_out(
    x: cython.double[::1], aid: cython.Py_ssize_t, limit: cython.double
) -> cython.bint:
    """Say whether an aid has not been used for longer than its limit, s."""
    return x[at.X_T] - x[at.X_T_USED + aid] > limit * 1e9


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def announce(x: cython.double[::1], reason: cython.double) -> cython.void:
    """Open the account of a reset: what it moves is added to X_DELTA."""
    i: cython.Py_ssize_t
    x[at.X_RESETS] += 1.0
    x[at.X_RESET_REASON] = reason
    x[at.X_T_RESET] = x[at.X_T]
    for i in range(7):
        x[at.X_DELTA + i] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def settle(x: cython.double[::1], aid: cython.Py_ssize_t) -> cython.void:
    """Close it for an aid that has had its way."""
    proof.forgive(x, aid)
    x[at.X_T_USED + aid] = x[at.X_T]
