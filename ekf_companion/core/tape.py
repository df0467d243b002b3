# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""What the filter did, record by record, for who goes back over it.

A tape lies behind the scratch numbers, where the step finds it if it is there: the filter that runs
live has none. A record is the state block after something happened, and how its error follows from
that of the record before:

- it moved: by Phi, which the record holds, and noise;
- the same: whatever was measured in between, it is the same error of the same true state;
- fresh: the same, but some states were drawn anew meanwhile (``correct.forget`` counts them);
- cut: it does not follow, a new stretch begins here.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.propagate import transition
else:
    from ekf_companion.core import state as at
    from ekf_companion.core.propagate import transition


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def push(x: cython.double[::1], w: cython.double[::1], link: cython.int) -> cython.Py_ssize_t:
    """Append a record of the block; gives the place in w where it begins."""
    i: cython.Py_ssize_t
    count: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, w[at.TAPE_COUNT])
    first: cython.Py_ssize_t = at.TAPE + count * at.RECORD
    w[at.TAPE_COUNT] += 1.0
    w[first + at.T_LINK] = link
    w[first + at.T_IS_SAMPLE] = 0.0
    for i in range(at.BLOCK):
        w[first + at.T_BLOCK + i] = x[i]
    return first


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def moved(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], dt: cython.double
) -> cython.void:
    """Record that the state moved by dt (s), right after ``propagate.spread``."""
    transition(k, w, dt, push(x, w, at.LINK_MOVED) + at.T_PHI)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def doubted(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Record that the error grew where it was: Phi is one."""
    i: cython.Py_ssize_t
    first: cython.Py_ssize_t = push(x, w, at.LINK_MOVED) + at.T_PHI
    for i in range(at.N * at.N):
        w[first + i] = 0.0
    for i in range(at.N):
        w[first + i * (at.N + 1)] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def noted(x: cython.double[::1], w: cython.double[::1], is_sample: cython.bint) -> cython.void:
    """Record the state after an event, or at the end of a sample.

    An attitude, or a part of it, drawn anew turns the axes that all else is told in; and before
    there was one there is nothing to go back to: both cut.
    """
    i: cython.Py_ssize_t
    link: cython.int = at.LINK_SAME
    first: cython.Py_ssize_t = push(x, w, link)
    before: cython.Py_ssize_t = first - at.RECORD + at.T_BLOCK
    w[first + at.T_IS_SAMPLE] = 1.0 if is_sample else 0.0
    if first == at.TAPE:
        link = at.LINK_CUT
    elif x[at.X_MODE] < at.MODE_ATTITUDE or w[before + at.X_MODE] < at.MODE_ATTITUDE:
        link = at.LINK_CUT
    else:
        for i in range(at.N):
            if x[at.X_FRESH + i] != w[before + at.X_FRESH + i]:
                if at.E_ATT <= i < at.E_ATT + 3:
                    link = at.LINK_CUT
                elif link == at.LINK_SAME:
                    link = at.LINK_FRESH
    w[first + at.T_LINK] = link
