# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Proof by motion: when an aid that has been refused for long may have its way.

A receiver that has truly found a new place moves from fix to fix as we do: its innovations stay
the same. One that is dragged off, or says anything at all, moves otherwise. So a run of refused
innovations is kept as the sums of a straight line; a small slope and a small scatter prove it.

Source: least squares of a line, e.g. Bevington 2003, section 6.3.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import fabs, sqrt
else:
    from math import fabs, sqrt

    from ekf_companion.core import state as at

SHORTEST = cython.declare(cython.double, 3.0)
"""Least time between the first and the last of a run that proves anything, s."""
LONGEST = cython.declare(cython.double, 30.0)
"""A run that has not proved itself by then begins anew, s."""
FEWEST = cython.declare(cython.double, 4.0)
"""Least number of innovations in a run."""
SHARPEST = cython.declare(cython.double, 0.15)
"""The slope of a run must be known to this, one sigma per s, before it proves anything."""
NOISIEST = cython.declare(cython.double, 9.0)
"""How far the scatter about the line may be beyond the stated variance."""
SIGMAS = cython.declare(cython.double, 3.0)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def forgive(x: cython.double[::1], aid: cython.Py_ssize_t) -> cython.void:
    """End the run of an aid that has one: it was believed, or has its way."""
    if aid < at.AID_YAW:
        x[at.X_RUN + at.C_SIZE * aid + at.C_COUNT] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def add(
    x: cython.double[::1], w: cython.double[::1], aid: cython.Py_ssize_t, m: cython.Py_ssize_t
) -> cython.void:
    """Add m innovations (w[W_Z]) that were refused, of an aid that has a run: GNSS."""
    i: cython.Py_ssize_t
    run: cython.Py_ssize_t = at.X_RUN + at.C_SIZE * aid
    tau: cython.double = (x[at.X_T] - x[run + at.C_T0]) * 1e-9
    if x[run + at.C_COUNT] == 0.0 or tau > LONGEST:
        for i in range(at.C_SIZE):
            x[run + i] = 0.0
        x[run + at.C_T0] = x[at.X_T]
        tau = 0.0
    x[run + at.C_COUNT] += 1.0
    x[run + at.C_ST] += tau
    x[run + at.C_STT] += tau * tau
    for i in range(m):
        x[run + at.C_SZ + i] += w[at.W_Z + i]
        x[run + at.C_STZ + i] += tau * w[at.W_Z + i]
        x[run + at.C_SZZ] += w[at.W_Z + i] * w[at.W_Z + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_given(
    x: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    stated: cython.double,
    drift: cython.double,
) -> cython.bint:
    """Say whether the run of an aid has proved itself.

    Args:
        x: The state block.
        aid: Whose run.
        m: Its rows.
        stated: Variance that the receiver states for one row.
        drift: Variance of our own drift, per s^2: what slope says nothing against the aid.
    """
    i: cython.Py_ssize_t
    run: cython.Py_ssize_t = at.X_RUN + at.C_SIZE * aid
    n: cython.double = x[run + at.C_COUNT]
    slope: cython.double
    largest: cython.double = 0.0
    scatter: cython.double = x[run + at.C_SZZ]
    if n < FEWEST or x[at.X_T] - x[run + at.C_T0] < SHORTEST * 1e9:
        return False
    wide: cython.double = x[run + at.C_STT] - x[run + at.C_ST] * x[run + at.C_ST] / n
    if not wide > 0.0:
        return False

    # The line, and the scatter about it
    for i in range(m):
        slope = x[run + at.C_STZ + i] - x[run + at.C_ST] * x[run + at.C_SZ + i] / n
        scatter -= x[run + at.C_SZ + i] * x[run + at.C_SZ + i] / n + slope * slope / wide
        slope = fabs(slope / wide)
        largest = slope if slope > largest else largest
    scatter = scatter / (m * (n - 2.0))
    if not scatter <= NOISIEST * stated:
        return False

    # A slope that is none, as far as it is known, and known well enough
    if scatter < 0.0:
        scatter = 0.0
    return scatter / wide <= SHARPEST * SHARPEST and largest <= SIGMAS * sqrt(
        scatter / wide + drift
    )
