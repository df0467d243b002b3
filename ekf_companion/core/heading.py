# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""North: which of the headings that speak is used, and how it corrects yaw.

The magnetic field of a vehicle is that of the Earth, turned, and its own: three hard-iron states
in the body tell the two apart as soon as the vehicle turns. Its strength and its dip are only
judged by: they say whether this is the Earth's field at all.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import correct, gate, observe, propagate, yaw_reset
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import asin, fabs, isnan, sqrt
else:
    from math import asin, fabs, isnan, sqrt

    from ekf_companion.core import correct, gate, observe, propagate, yaw_reset
    from ekf_companion.core import state as at

PREFERRED_AGE = cython.declare(cython.double, 5e9)
"""How long a better source keeps the worse ones out after its last word, ns."""
MOUNTING = cython.declare(cython.double, 0.005)
"""Slow error of a dual antenna: how well its baseline is mounted, rad."""
TRUSTED = cython.declare(cython.double, 0.02)
"""Slow error up to which a heading that has jumped is believed, rad."""
UNKNOWN_DECLINATION = cython.declare(cython.double, 0.2)
"""One sigma of the declination before the first fix, rad: most people live within it."""
WHITE = cython.declare(cython.double, 0.003)
"""White error of a magnetic azimuth beside that of the field, rad."""
PROOF = cython.declare(cython.double, 9e8)
"""How long a heading must insist before it resets anything, ns: one wild one does not."""
STEADY = cython.declare(cython.double, 0.1)
"""Share by which the strength of an undisturbed field may differ from its own mean."""
STEADY_TIME = cython.declare(cython.double, 10.0)
"""Time constant of that mean, s."""
DISTURBED_TIME = cython.declare(cython.double, 60.0)
"""Time constant while the field differs: a lasting change is the new normal, s."""
ANTENNA = cython.declare(cython.double, 1.0)
"""Sources of an azimuth: a dual antenna, another estimate, a field before its declination is known,
and after."""
OTHER = cython.declare(cython.double, 2.0)
MAGNETIC = cython.declare(cython.double, 3.0)
FIELD = cython.declare(cython.double, 4.0)
UNKNOWN_HEADING = cython.declare(cython.double, 3.29)
"""Variance of an angle of which nothing is known: pi^2 / 3, rad^2."""
ANY = cython.declare(cython.double, 100.0)
"""Variance of a yaw of which nothing is known, rad^2."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_heading_used(
    x: cython.double[::1], k: cython.double[::1], t: cython.double, source: cython.double
) -> cython.bint:
    """Say whether a heading is to be used: by order of the user, or the best that still speaks."""
    i: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, source)
    j: cython.Py_ssize_t
    x[at.X_T_HEADING + i] = t
    if k[at.K_HEADING] == at.HEADING_GNSS:
        return i == 0
    if k[at.K_HEADING] == at.HEADING_MAG:
        return i == 1
    if k[at.K_HEADING] == at.HEADING_AUTOPILOT:
        return i == 2
    if i > 0 and t - x[at.X_T_MAG] < PREFERRED_AGE:
        return False
    for j in range(i):
        if t - x[at.X_T_HEADING + j] < PREFERRED_AGE:
            return False
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_field_used(x: cython.double[::1], k: cython.double[::1]) -> cython.bint:
    """Say whether the magnetic field is to be used for heading: not while a dual antenna speaks."""
    if k[at.K_HEADING] == at.HEADING_AUTO:
        return x[at.X_T] - x[at.X_T_HEADING] >= PREFERRED_AGE
    return k[at.K_HEADING] == at.HEADING_MAG


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_natural(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    mx: cython.double,
    my: cython.double,
    mz: cython.double,
) -> cython.bint:
    """Say whether a magnetic field (b, gauss) is the Earth's.

    By the strength and the dip that the World Magnetic Model gives (the dip once the tilt is
    known), and by its own mean strength, from which a passing piece of iron makes it differ.
    """
    d: cython.double
    gain: cython.double
    memory: cython.double
    is_steady: cython.bint
    mx = mx - x[at.X_IRON]
    my = my - x[at.X_IRON + 1]
    mz = mz - x[at.X_IRON + 2]
    size: cython.double = sqrt(mx * mx + my * my + mz * mz)
    if not size > 0.0:
        return False

    # Its own mean, which follows slowly while it differs
    if not x[at.X_FIELD_SIZE] > 0.0:
        x[at.X_FIELD_SIZE] = size
        x[at.X_T_FIELD] = x[at.X_T]
        x[at.X_T_FIELD0] = x[at.X_T]
    is_steady = fabs(size - x[at.X_FIELD_SIZE]) <= STEADY * x[at.X_FIELD_SIZE]
    gain = (x[at.X_T] - x[at.X_T_FIELD]) * 1e-9
    memory = DISTURBED_TIME
    if is_steady:
        memory = (x[at.X_T] - x[at.X_T_FIELD0]) * 1e-9
        memory = memory if memory < STEADY_TIME else STEADY_TIME
    if gain > 0.0:
        gain = gain / (gain + memory)
    x[at.X_FIELD_SIZE] += gain * (size - x[at.X_FIELD_SIZE])
    x[at.X_T_FIELD] = x[at.X_T]
    if not is_steady:
        return False

    # The model
    if x[at.X_FIELD] > 0.0:
        if fabs(size - x[at.X_FIELD]) > k[at.K_FIELD_STRENGTH] * x[at.X_FIELD]:
            return False
        if x[at.X_MODE] >= at.MODE_ATTITUDE and x[at.X_NEEDS_RESET] == 0.0:
            propagate.matrix(x, at.X_Q, w)
            d = (w[at.W_C_NB + 6] * mx + w[at.W_C_NB + 7] * my + w[at.W_C_NB + 8] * mz) / size
            d = 1.0 if d > 1.0 else (-1.0 if d < -1.0 else d)
            if fabs(asin(d) - x[at.X_INCLINATION]) > k[at.K_FIELD_DIP]:
                return False
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_heading(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    heading: cython.double,
    std: cython.double,
    is_antenna: cython.bint,
) -> cython.void:
    """Take a heading: white from a dual antenna, slowly wrong from another compass or filter."""
    if std < k[at.K_HEADING_FLOOR]:
        std = k[at.K_HEADING_FLOOR]
    if is_antenna:
        take_azimuth(x, k, w, 1.0, 0.0, 0.0, heading, MOUNTING, std, 0.0, ANTENNA)
    else:
        take_azimuth(x, k, w, 1.0, 0.0, 0.0, heading, std, k[at.K_HEADING_FLOOR], 0.0, OTHER)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_field(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    mx: cython.double,
    my: cython.double,
    mz: cython.double,
) -> cython.void:
    """Take the magnetic field: it points to the declination, as far as that is known."""
    if not is_natural(x, k, w, mx, my, mz):
        gate.count(x, at.AID_YAW, at.WHY_DISTURBED)
        return
    x[at.X_T_MAG] = x[at.X_T]
    if isnan(x[at.X_DECLINATION]):
        take_azimuth(
            x, k, w, mx, my, mz, 0.0, UNKNOWN_DECLINATION, WHITE, k[at.K_MAG_NOISE], MAGNETIC
        )
    else:
        take_azimuth(
            x,
            k,
            w,
            mx,
            my,
            mz,
            x[at.X_DECLINATION],
            k[at.K_MAG_STD],
            WHITE,
            k[at.K_MAG_NOISE],
            FIELD,
        )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_azimuth(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    bx: cython.double,
    by: cython.double,
    bz: cython.double,
    target: cython.double,
    slow: cython.double,
    white: cython.double,
    noise: cython.double,
    source: cython.double,
) -> cython.void:
    """Take a direction's azimuth: keep it while levelling, begin or correct yaw by it.

    Its error is a slow part and a white one (one sigma each, rad) and the direction's own noise.
    Another source has another slow error; a field has the vehicle's own in it.
    """
    has_iron: cython.bint = source >= MAGNETIC
    if x[at.X_MODE] == at.MODE_LEVEL or x[at.X_NEEDS_RESET] != 0.0:
        x[at.X_HEADING_STD] = slow
        x[at.X_HEADING_SOURCE] = source
        x[at.X_LEVEL + at.L_HAS_REF] = 1.0
        x[at.X_LEVEL + at.L_REF_T] = x[at.X_T]
        x[at.X_LEVEL + at.L_REF_TARGET] = target
        x[at.X_LEVEL + at.L_REF_STD] = white
        x[at.X_LEVEL + at.L_REF_NOISE] = noise
        x[at.X_LEVEL + at.L_REF_IRON] = has_iron
        x[at.X_LEVEL + at.L_REF_V] = bx
        x[at.X_LEVEL + at.L_REF_V + 1] = by
        x[at.X_LEVEL + at.L_REF_V + 2] = bz
        gate.count(x, at.AID_YAW, at.WHY_UNALIGNED)
        return
    slow = yaw_reset.slow_error(x, slow)
    x[at.X_HEADING_STD] = slow
    if source != x[at.X_HEADING_SOURCE]:
        x[at.X_HEADING_SOURCE] = source
        x[at.X_HEADING] = 0.0
        correct.forget(x, at.E_HEADING, 1, slow * slow)
    if not observe.azimuth(x, w, bx, by, bz, target, white, noise, has_iron):
        gate.count(x, at.AID_YAW, at.WHY_UNUSED)
        return
    if x[at.X_HAS_YAW] == 0.0:
        face(x, w)
        gate.count(x, at.AID_YAW, at.WHY_FUSED)
    elif (
        not gate.fuse(x, k, w, at.AID_YAW, 1)
        and gate.is_timed_out(x, at.AID_YAW, k[at.K_TIMEOUT_YAW])
        and x[at.X_T] - x[at.X_T_REFUSED + at.AID_YAW] >= PROOF
    ):
        if yaw_reset.agrees(x):
            # it is the compass that has jumped: the motion says so
            correct.forget(x, at.E_HEADING, 1, UNKNOWN_HEADING)
            correct.innovate(x, w, 1)
            correct.absorb_yaw(x, w)
            gate.settle(x, at.AID_YAW)
            return
        gate.announce(x, at.RESET_YAW)
        if slow > TRUSTED:
            # the compass or our yaw has jumped, and nobody knows which: neither is sure any more
            correct.forget(x, at.E_HEADING, 1, 1.0)
            x[at.X_COV + (at.E_ATT + 2) * (at.N + 1)] += w[at.W_Z] * w[at.W_Z]
            x[at.X_FRESH + at.E_ATT + 2] += 1.0
            correct.innovate(x, w, 1)
            correct.absorb_yaw(x, w)
            x[at.X_DELTA + 6] += w[at.W_DX + at.E_ATT + 2]
            gate.settle(x, at.AID_YAW)
        else:
            face(x, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def face(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the yaw by the row of :func:`observe.azimuth`; it shares the slow errors from then on."""
    propagate.turn(x, at.X_Q, 0.0, 0.0, w[at.W_Z])
    x[at.X_DELTA + 6] += w[at.W_Z]
    w[at.W_Z] = 0.0
    correct.forget(x, at.E_ATT + 2, 1, ANY)
    correct.innovate(x, w, 1)
    correct.absorb_yaw(x, w)
    x[at.X_HAS_YAW] = 1.0
    x[at.X_T_USED + at.AID_YAW] = x[at.X_T]
