# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""When the bank's heading is used: to begin with, or against a main filter that is wrong.

The main filter may have begun by a compass that lies by 180 degrees, or have been led astray by one
in flight. Then it foretells velocities that the receiver contradicts, and the bank knows better. It
must not be disturbed for less: a reset is worse than a poor minute.

Source: the conditions are those asked for in PX4 pull request 27533 and ArduPilot issue 15813.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.observe import wrap
    from cython.cimports.ekf_companion.core.propagate import turn
    from cython.cimports.libc.math import atan2, fabs
else:
    from math import atan2, fabs

    from ekf_companion.core import state as at
    from ekf_companion.core.observe import wrap
    from ekf_companion.core.propagate import turn

ENOUGH = cython.declare(cython.double, 5.0)
"""Consecutive fixes with a narrow heading after which it is used."""
FAILING = cython.declare(cython.double, 4.0)
"""Mean normalised innovation squared, per degree, of velocities that contradict the filter."""
LARGEST_NIS = cython.declare(cython.double, 20.0)
"""What one fix can add to that mean."""
FAIL_TIME = cython.declare(cython.double, 1e9)
"""So long they must, ns; memory of the mean, too."""
FAIR_STD = cython.declare(cython.double, 0.5)
"""Largest stated sigma of velocities that may contradict it, m/s."""
LEAST_ERROR = cython.declare(cython.double, 0.2617993877991494)
"""Smallest error of its yaw that is put right, rad: 15 degrees."""
UNKNOWN_STD = cython.declare(cython.double, 1.8137993642342178)
"""One sigma of an angle of which nothing is known: pi / sqrt(3), rad."""
MOST_REPAIRS = cython.declare(cython.double, 3.0)
BETWEEN = cython.declare(cython.double, 5e9)
"""Time between two of them, ns."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_ready(x: cython.double[::1]) -> cython.bint:
    """Say whether the bank's heading can be used."""
    return x[at.X_BANK + at.B_GOOD] >= ENOUGH


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def excess(x: cython.double[::1]) -> cython.double:
    """Give the turn about the vertical that would bring the filter's attitude to the bank's, rad.

    Of the turn between the two attitudes it is the part about down, so that it has a meaning in
    any attitude, a dive included.
    """
    b: cython.Py_ssize_t = at.X_BANK + at.B_Q
    q: cython.Py_ssize_t = at.X_Q
    w: cython.double = x[b] * x[q] + x[b + 1] * x[q + 1] + x[b + 2] * x[q + 2] + x[b + 3] * x[q + 3]
    z: cython.double = x[b + 3] * x[q] - x[b] * x[q + 3] + x[b + 2] * x[q + 1] - x[b + 1] * x[q + 2]
    return wrap(x[at.X_BANK + at.B_YAW] + 2.0 * atan2(z, w))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def agrees(x: cython.double[::1]) -> cython.bint:
    """Say whether the bank has a heading, and it is the filter's."""
    return is_ready(x) and fabs(excess(x)) <= 3.0 * x[at.X_BANK + at.B_STD]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_needed(
    x: cython.double[::1], nis: cython.double, dt: cython.double, std: cython.double
) -> cython.bint:
    """Say whether the main filter's heading is wrong beyond doubt, at a velocity just judged.

    Takes its normalised innovation squared per degree, the time since the fix before (s) and the
    sigma that the receiver states (m/s).
    """
    b: cython.Py_ssize_t = at.X_BANK
    gain: cython.double = dt / (dt + FAIL_TIME * 1e-9)
    off: cython.double
    nis = nis if nis < LARGEST_NIS else LARGEST_NIS
    x[b + at.B_NIS] += gain * (nis - x[b + at.B_NIS])
    if x[b + at.B_NIS] < FAILING:
        x[b + at.B_T_FAIL] = x[at.X_T]
        return False
    if x[at.X_T] - x[b + at.B_T_FAIL] < FAIL_TIME or std > FAIR_STD or not is_ready(x):
        return False
    if x[b + at.B_REPAIRS] >= MOST_REPAIRS:
        return False
    if x[b + at.B_REPAIRS] > 0.0 and x[at.X_T] - x[b + at.B_T_REPAIR] < BETWEEN:
        return False
    off = fabs(excess(x))
    return off > LEAST_ERROR and off > 3.0 * x[b + at.B_STD]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def adopt(x: cython.double[::1]) -> cython.void:
    """Give the main filter the bank's attitude and gyro bias; its delay was learnt in error."""
    i: cython.Py_ssize_t
    for i in range(4):
        x[at.X_Q + i] = x[at.X_BANK + at.B_Q + i]
    turn(x, at.X_Q, 0.0, 0.0, x[at.X_BANK + at.B_YAW])
    for i in range(3):
        x[at.X_BG + i] = x[at.X_BANK + at.B_BG + i]
    x[at.X_DELAY] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def record(x: cython.double[::1]) -> cython.void:
    """Keep the account of a repair."""
    x[at.X_BANK + at.B_NIS] = 0.0
    x[at.X_BANK + at.B_T_FAIL] = x[at.X_T]
    x[at.X_BANK + at.B_REPAIRS] += 1.0
    x[at.X_BANK + at.B_T_REPAIR] = x[at.X_T]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def slow_error(x: cython.double[::1], stated: cython.double) -> cython.double:
    """Give one sigma of a compass' slow error, rad: of one that lies, as much as it is wrong."""
    error: cython.double = fabs(wrap(x[at.X_HEADING]))
    x[at.X_HEADING] = wrap(x[at.X_HEADING])
    if error < LEAST_ERROR or error < stated:
        return stated
    return error if error < UNKNOWN_STD else UNKNOWN_STD
