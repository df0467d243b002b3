# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Down and north before there is a filter.

At rest the mean specific force points up and the mean rate is the gyro's bias. In motion the
specific force, summed in a frame that the gyro holds still, must equal the change of the GNSS
velocity less gravity: that gives down without standing still. North comes from a reference: a
heading, or the magnetic field.

Source: Groves 2013, section 5.6 (levelling); in motion: Silson 2011, "Coarse alignment of a ship's
strapdown inertial attitude reference system using velocity loci".
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.correct import forget
    from cython.cimports.ekf_companion.core.heading import face
    from cython.cimports.ekf_companion.core.observe import azimuth, wrap
    from cython.cimports.ekf_companion.core.propagate import matrix, turn, turn_body, unit
    from cython.cimports.libc.math import atan2, cos, isnan, sin, sqrt
else:
    from math import atan2, cos, isnan, sin, sqrt

    from ekf_companion.core import state as at
    from ekf_companion.core.correct import forget
    from ekf_companion.core.heading import face
    from ekf_companion.core.observe import azimuth, wrap
    from ekf_companion.core.propagate import matrix, turn, turn_body, unit

REFERENCE_AGE = cython.declare(cython.double, 1.5e9)
"""Oldest heading reference to start from, ns."""
LONGEST_MOTION = cython.declare(cython.double, 5e9)
"""Longest stretch to level over in motion, ns: the gyro's bias turns the frame meanwhile."""
FIELD = cython.declare(cython.double, 4.0)
"""Source of a heading, as the kernel counts them: the magnetic field where declination is known."""
UNKNOWN_YAW = cython.declare(cython.double, 3.29)
"""Variance of an angle of which nothing is known: pi^2 / 3, rad^2."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def restart(x: cython.double[::1], t: cython.double) -> cython.void:
    """Begin a window of rest statistics at t."""
    i: cython.Py_ssize_t
    for i in range(at.X_LEVEL, at.X_LEVEL + at.L_Q):
        x[i] = 0.0
    x[at.X_LEVEL + at.L_T0] = t


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def gather(x: cython.double[::1]) -> cython.void:
    """Add the newest sample to the rest statistics."""
    i: cython.Py_ssize_t
    x[at.X_LEVEL + at.L_N] += 1.0
    for i in range(3):
        x[at.X_LEVEL + at.L_GYRO + i] += x[at.X_GYRO + i]
        x[at.X_LEVEL + at.L_ACCEL + i] += x[at.X_ACCEL + i]
        x[at.X_LEVEL + at.L_GYRO2 + i] += x[at.X_GYRO + i] * x[at.X_GYRO + i]
        x[at.X_LEVEL + at.L_ACCEL2 + i] += x[at.X_ACCEL + i] * x[at.X_ACCEL + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def quiet(learnt: cython.double, largest: cython.double) -> cython.double:
    """Give the largest spread (variance) at rest: twice the sigma learnt, but for what is sure."""
    if learnt > 0.0 and 4.0 * learnt < largest * largest:
        return 4.0 * learnt
    return largest * largest


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_rest(x: cython.double[::1], k: cython.double[::1]) -> cython.bint:
    """Say whether the window saw the vehicle stand still: quiet, not turning, one g."""
    i: cython.Py_ssize_t
    n: cython.double = x[at.X_LEVEL + at.L_N]
    mean: cython.double
    size: cython.double = 0.0
    spread_g: cython.double = 0.0
    spread_a: cython.double = 0.0
    rate: cython.double = 0.0
    for i in range(3):
        mean = x[at.X_LEVEL + at.L_GYRO + i] / n
        rate += mean * mean
        spread_g += x[at.X_LEVEL + at.L_GYRO2 + i] / n - mean * mean
        mean = x[at.X_LEVEL + at.L_ACCEL + i] / n
        size += mean * mean
        spread_a += x[at.X_LEVEL + at.L_ACCEL2 + i] / n - mean * mean
    size = sqrt(size)
    if spread_g > quiet(x[at.X_REST_G], k[at.K_REST_GYRO]):
        return False
    if spread_a > quiet(x[at.X_REST_A], k[at.K_REST_ACCEL]):
        return False
    if rate > 0.01:  # 0.1 rad/s: no gyro of today has such a bias
        return False
    if size < 0.9 * k[at.K_GRAVITY] or size > 1.1 * k[at.K_GRAVITY]:
        return False
    if x[at.X_MODE] == at.MODE_LEVEL and x[at.X_LEVEL + at.L_HAS_FIX] != 0.0:
        # a receiver that says we move is believed
        mean = 0.5 + 3.0 * x[at.X_LEVEL + at.L_FIX_STD]
        rate = 0.0
        for i in range(2):
            rate += x[at.X_LEVEL + at.L_FIX_V + i] * x[at.X_LEVEL + at.L_FIX_V + i]
        return rate < mean * mean
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def orient(
    x: cython.double[::1],
    w: cython.double[::1],
    ux: cython.double,
    uy: cython.double,
    uz: cython.double,
    dn: cython.double,
    de: cython.double,
    dd: cython.double,
) -> cython.void:
    """Set the attitude: body direction u along d in n, the reference at its azimuth.

    Without a reference the body's forward axis points north.
    """
    nu: cython.double = sqrt(ux * ux + uy * uy + uz * uz)
    nd: cython.double = sqrt(dn * dn + de * de + dd * dd)
    ux = ux / nu
    uy = uy / nu
    uz = uz / nu
    dn = dn / nd
    de = de / nd
    dd = dd / nd
    # The shortest turn of u into d; opposite directions leave the axis open: take forward
    dot: cython.double = ux * dn + uy * de + uz * dd
    if dot > -0.999999:
        x[at.X_Q] = 1.0 + dot
        x[at.X_Q + 1] = uy * dd - uz * de
        x[at.X_Q + 2] = uz * dn - ux * dd
        x[at.X_Q + 3] = ux * de - uy * dn
    else:
        x[at.X_Q] = 0.0
        x[at.X_Q + 1] = 1.0
        x[at.X_Q + 2] = 0.0
        x[at.X_Q + 3] = 0.0
    unit(x, at.X_Q)
    # Then about d until the reference's azimuth is right; d is not quite vertical, so iterate
    bx: cython.double = 1.0
    by: cython.double = 0.0
    bz: cython.double = 0.0
    target: cython.double = 0.0
    if (
        x[at.X_LEVEL + at.L_HAS_REF] != 0.0
        and x[at.X_T] - x[at.X_LEVEL + at.L_REF_T] <= REFERENCE_AGE
    ):
        bx = x[at.X_LEVEL + at.L_REF_V]
        by = x[at.X_LEVEL + at.L_REF_V + 1]
        bz = x[at.X_LEVEL + at.L_REF_V + 2]
        target = x[at.X_LEVEL + at.L_REF_TARGET]
    for _ in range(4):
        matrix(x, at.X_Q, w)
        dot = wrap(
            target
            - atan2(
                w[at.W_C_NB + 3] * bx + w[at.W_C_NB + 4] * by + w[at.W_C_NB + 5] * bz,
                w[at.W_C_NB] * bx + w[at.W_C_NB + 1] * by + w[at.W_C_NB + 2] * bz,
            )
        )
        turn(x, at.X_Q, -dn * dot, -de * dot, -dd * dot)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learnt(
    x: cython.double[::1], first: cython.Py_ssize_t, count: cython.Py_ssize_t, std: cython.double
) -> cython.double:
    """Give the variance of some states while levelling: what is left of before, or the sigma's."""
    i: cython.Py_ssize_t
    variance: cython.double = 0.0
    for i in range(first, first + count):
        if x[at.X_COV + i * (at.N + 1)] > variance:
            variance = x[at.X_COV + i * (at.N + 1)]
    if x[at.X_MODE] == at.MODE_LEVEL and 0.0 < variance < std * std:
        return variance
    return std * std


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def begin_filter(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    t: cython.double,
    tilt: cython.double,
    gyro_bias: cython.double,
) -> cython.void:
    """Set the covariance of an attitude just found, by the sigmas of tilt and gyro bias.

    A levelled attitude is wrong by what is not known of the accelerometer's bias, so the two are
    correlated: ``theta_N = (C ba)_E / g``, ``theta_E = -(C ba)_N / g``. Biases, hard iron and the
    receiver's delay stay as they are, with the variances that there are: none, or what was learnt
    before the clock began anew.
    """
    i: cython.Py_ssize_t
    variance: cython.double = learnt(x, at.E_BA, 3, k[at.K_ACCEL_BIAS])
    rate: cython.double = learnt(x, at.E_BG, 3, gyro_bias)
    delay: cython.double = learnt(x, at.E_DELAY, 1, k[at.K_DELAY_STD])
    iron: cython.double = learnt(x, at.E_IRON, 3, k[at.K_IRON_STD])
    g: cython.double = k[at.K_GRAVITY]
    for i in range(at.N * at.N):
        x[at.X_COV + i] = 0.0
    forget(x, at.E_ATT, 2, tilt * tilt + variance / (g * g))
    forget(x, at.E_BA, 3, variance)
    forget(x, at.E_BG, 3, rate)
    matrix(x, at.X_Q, w)
    for i in range(3):
        x[at.X_COV + at.E_BA + i] = variance * w[at.W_C_NB + 3 + i] / g
        x[at.X_COV + at.N + at.E_BA + i] = -variance * w[at.W_C_NB + i] / g
        x[at.X_COV + (at.E_BA + i) * at.N] = x[at.X_COV + at.E_BA + i]
        x[at.X_COV + (at.E_BA + i) * at.N + 1] = x[at.X_COV + at.N + at.E_BA + i]
    forget(x, at.E_VEL, 3, 0.01)
    forget(x, at.E_POS, 3, 1.0)
    forget(x, at.E_DELAY, 1, delay)
    x[at.X_HEADING] = 0.0
    x[at.X_HAS_YAW] = 0.0
    x[at.X_COV + 2 * (at.N + 1)] = UNKNOWN_YAW
    for i in range(3):
        x[at.X_VEL + i] = 0.0
        x[at.X_POS + i] = 0.0
        x[at.X_SLOW + i] = 0.0
    forget(x, at.E_IRON, 3, iron)
    forget(x, at.E_HEADING, 1, x[at.X_HEADING_STD] * x[at.X_HEADING_STD])
    x[at.X_MODE] = at.MODE_ATTITUDE
    if (
        x[at.X_LEVEL + at.L_HAS_REF] != 0.0
        and t - x[at.X_LEVEL + at.L_REF_T] <= REFERENCE_AGE
        and azimuth(
            x,
            w,
            x[at.X_LEVEL + at.L_REF_V],
            x[at.X_LEVEL + at.L_REF_V + 1],
            x[at.X_LEVEL + at.L_REF_V + 2],
            x[at.X_LEVEL + at.L_REF_TARGET],
            x[at.X_LEVEL + at.L_REF_STD],
            x[at.X_LEVEL + at.L_REF_NOISE],
            x[at.X_LEVEL + at.L_REF_IRON] != 0.0,
        )
    ):
        # the attitude points there already; the row says how sure that is
        w[at.W_Z] = 0.0
        face(x, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def orient_up(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the attitude so that the window's mean specific force points up."""
    n: cython.double = x[at.X_LEVEL + at.L_N]
    orient(
        x,
        w,
        x[at.X_LEVEL + at.L_ACCEL] - n * x[at.X_BA],
        x[at.X_LEVEL + at.L_ACCEL + 1] - n * x[at.X_BA + 1],
        x[at.X_LEVEL + at.L_ACCEL + 2] - n * x[at.X_BA + 2],
        0.0,
        0.0,
        -1.0,
    )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def level_at_rest(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]
) -> cython.void:
    """Take attitude and gyro bias from a window in which the vehicle stood still."""
    i: cython.Py_ssize_t
    n: cython.double = x[at.X_LEVEL + at.L_N]
    mean: cython.double
    noise_g: cython.double = 0.0
    noise_a: cython.double = 0.0
    for i in range(3):
        mean = x[at.X_LEVEL + at.L_GYRO + i] / n
        noise_g += x[at.X_LEVEL + at.L_GYRO2 + i] / n - mean * mean
        x[at.X_BG + i] = mean
        mean = x[at.X_LEVEL + at.L_ACCEL + i] / n
        noise_a += x[at.X_LEVEL + at.L_ACCEL2 + i] / n - mean * mean
    orient_up(x, w)
    # Equal samples have no spread, but rounding may leave it below zero
    noise_g = noise_g if noise_g > 0.0 else 0.0
    noise_a = noise_a if noise_a > 0.0 else 0.0
    x[at.X_REST_G] = noise_g
    x[at.X_REST_A] = noise_a
    # of the mean; the gyro also sees the Earth turn, whose direction is not known yet
    noise_g = sqrt(noise_g / n + 1e-8)
    noise_a = sqrt(noise_a / n) / k[at.K_GRAVITY] + 1e-3
    begin_filter(x, k, w, x[at.X_T], noise_a, noise_g + 2e-4)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def level_roughly(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]
) -> cython.void:
    """Take the attitude from the mean specific force of a window that was not quiet."""
    orient_up(x, w)
    begin_filter(x, k, w, x[at.X_T], 0.15, k[at.K_GYRO_BIAS])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def begin_motion(
    x: cython.double[::1],
    t: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.void:
    """Begin to sum the specific force at a fix that has a velocity."""
    i: cython.Py_ssize_t
    x[at.X_LEVEL + at.L_HAS_FIX] = 1.0
    x[at.X_LEVEL + at.L_FIX_T] = t
    x[at.X_LEVEL + at.L_FIX_V] = vn
    x[at.X_LEVEL + at.L_FIX_V + 1] = ve
    x[at.X_LEVEL + at.L_FIX_V + 2] = vd
    x[at.X_LEVEL + at.L_FIX_STD] = std
    x[at.X_LEVEL + at.L_Q] = 1.0
    for i in range(3):
        x[at.X_LEVEL + at.L_Q + 1 + i] = 0.0
        x[at.X_LEVEL + at.L_U + i] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def carry(x: cython.double[::1], w: cython.double[::1], dt: cython.double) -> cython.void:
    """Carry the reference along with the turning body, and the force summed in a still frame."""
    i: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_LEVEL + at.L_REF_V
    px: cython.double = (w[at.W_RATE] - x[at.X_BG]) * dt
    py: cython.double = (w[at.W_RATE + 1] - x[at.X_BG + 1]) * dt
    pz: cython.double = (w[at.W_RATE + 2] - x[at.X_BG + 2]) * dt
    cx: cython.double
    cy: cython.double
    cz: cython.double
    if x[at.X_LEVEL + at.L_HAS_REF] != 0.0:
        # what stands still turns against the body: b - p x b + p x (p x b) / 2
        cx = py * x[b + 2] - pz * x[b + 1]
        cy = pz * x[b] - px * x[b + 2]
        cz = px * x[b + 1] - py * x[b]
        x[b] += 0.5 * (py * cz - pz * cy) - cx
        x[b + 1] += 0.5 * (pz * cx - px * cz) - cy
        x[b + 2] += 0.5 * (px * cy - py * cx) - cz
    if x[at.X_LEVEL + at.L_HAS_FIX] == 0.0:
        return
    turn_body(x, at.X_LEVEL + at.L_Q, 0.5 * px, 0.5 * py, 0.5 * pz)
    matrix(x, at.X_LEVEL + at.L_Q, w)
    for i in range(3):
        x[at.X_LEVEL + at.L_U + i] += dt * (
            w[at.W_C_NB + 3 * i] * (w[at.W_FORCE] - x[at.X_BA])
            + w[at.W_C_NB + 3 * i + 1] * (w[at.W_FORCE + 1] - x[at.X_BA + 1])
            + w[at.W_C_NB + 3 * i + 2] * (w[at.W_FORCE + 2] - x[at.X_BA + 2])
        )
    turn_body(x, at.X_LEVEL + at.L_Q, 0.5 * px, 0.5 * py, 0.5 * pz)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def turn_about(
    x: cython.double[::1],
    w: cython.double[::1],
    dn: cython.double,
    de: cython.double,
    dd: cython.double,
) -> cython.double:
    """Turn the attitude about d (unit, n) until the magnetic field points where it does here.

    Gives the variance of that turn, rad^2. The azimuth of a steep field alone would say little
    about a turn round an axis that leans towards it.
    """
    b: cython.Py_ssize_t = at.X_LEVEL + at.L_REF_V
    std: cython.double = x[at.X_LEVEL + at.L_REF_STD]
    matrix(x, at.X_Q, w)
    size: cython.double = sqrt(x[b] * x[b] + x[b + 1] * x[b + 1] + x[b + 2] * x[b + 2])
    n: cython.double = 0.0
    e: cython.double = 0.0
    d: cython.double = 0.0
    i: cython.Py_ssize_t
    for i in range(3):
        n += w[at.W_C_NB + i] * x[b + i] / size
        e += w[at.W_C_NB + 3 + i] * x[b + i] / size
        d += w[at.W_C_NB + 6 + i] * x[b + i] / size
    along: cython.double = n * dn + e * de + d * dd
    level: cython.double = n * n + e * e
    if x[at.X_HEADING_SOURCE] == FIELD and x[at.X_FIELD] > 0.0:
        fn: cython.double = cos(x[at.X_INCLINATION]) * cos(x[at.X_DECLINATION])
        fe: cython.double = cos(x[at.X_INCLINATION]) * sin(x[at.X_DECLINATION])
        fd: cython.double = sin(x[at.X_INCLINATION])
        a: cython.double = atan2(
            dn * (e * fd - d * fe) + de * (d * fn - n * fd) + dd * (n * fe - e * fn),
            n * fn + e * fe + d * fd - along * (fn * dn + fe * de + fd * dd),
        )
        turn(x, at.X_Q, a * dn, a * de, a * dd)
        level = fn * fn + fe * fe
    across: cython.double = 1.0 - along * along
    if across < 0.01:
        across = 0.01
    return (x[at.X_HEADING_STD] * x[at.X_HEADING_STD] + std * std) * level / across


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def find_down(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    t: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.double:
    """Set the attitude at a fix, from the velocity gained since the first one; give tilt's sigma.

    Turns the summed force u into the body frame of now, so that attitude is of time t. A sigma of
    zero says that it is too early, or that nothing gives north.
    """
    span: cython.double = (t - x[at.X_LEVEL + at.L_FIX_T]) * 1e-9
    if x[at.X_LEVEL + at.L_HAS_FIX] == 0.0 or t - x[at.X_LEVEL + at.L_FIX_T] > LONGEST_MOTION:
        begin_motion(x, t, vn, ve, vd, std)
        return 0.0
    if span < k[at.K_ALIGN_TIME]:
        return 0.0
    if x[at.X_LEVEL + at.L_HAS_REF] == 0.0 or t - x[at.X_LEVEL + at.L_REF_T] > REFERENCE_AGE:
        return 0.0
    down: cython.double = 0.0
    doubt: cython.double = 2.0 * std
    if isnan(vd) or isnan(x[at.X_LEVEL + at.L_FIX_V + 2]):
        doubt = doubt + 1.0  # a climb that began meanwhile; it hardly tilts
    else:
        down = vd - x[at.X_LEVEL + at.L_FIX_V + 2]
    dn: cython.double = vn - x[at.X_LEVEL + at.L_FIX_V]
    de: cython.double = ve - x[at.X_LEVEL + at.L_FIX_V + 1]
    down = down - k[at.K_GRAVITY] * span
    matrix(x, at.X_LEVEL + at.L_Q, w)
    orient(
        x,
        w,
        w[at.W_C_NB] * x[at.X_LEVEL + at.L_U]
        + w[at.W_C_NB + 3] * x[at.X_LEVEL + at.L_U + 1]
        + w[at.W_C_NB + 6] * x[at.X_LEVEL + at.L_U + 2],
        w[at.W_C_NB + 1] * x[at.X_LEVEL + at.L_U]
        + w[at.W_C_NB + 4] * x[at.X_LEVEL + at.L_U + 1]
        + w[at.W_C_NB + 7] * x[at.X_LEVEL + at.L_U + 2],
        w[at.W_C_NB + 2] * x[at.X_LEVEL + at.L_U]
        + w[at.W_C_NB + 5] * x[at.X_LEVEL + at.L_U + 1]
        + w[at.W_C_NB + 8] * x[at.X_LEVEL + at.L_U + 2],
        dn,
        de,
        down,
    )
    # A wrong turn about a force that was not upright is tilt as well
    size: cython.double = sqrt(dn * dn + de * de + down * down)
    turned: cython.double = turn_about(x, w, dn / size, de / size, down / size)
    doubt = doubt / (k[at.K_GRAVITY] * span) + k[at.K_GYRO_BIAS] * span + 0.02
    return sqrt(doubt * doubt + turned * (dn * dn + de * de) / (size * size))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def level_in_motion(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    t: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.bint:
    """Begin the filter at a fix, with an attitude found in motion; False: not yet."""
    tilt: cython.double = find_down(x, k, w, t, vn, ve, vd, std)
    if tilt == 0.0:
        return False
    begin_filter(x, k, w, t, tilt, k[at.K_GYRO_BIAS])
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def level_again(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    t: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.bint:
    """Find the attitude of a running filter anew at a fix; False: not yet."""
    tilt: cython.double = find_down(x, k, w, t, vn, ve, vd, std)
    if tilt == 0.0:
        return False
    forget(x, at.E_ATT, 2, tilt * tilt)
    # right already, but how sure it is the next heading says, by the tilt that it is seen with
    forget(x, at.E_ATT + 2, 1, UNKNOWN_YAW)
    forget(x, at.E_HEADING, 1, x[at.X_HEADING_STD] * x[at.X_HEADING_STD])
    x[at.X_HEADING] = 0.0
    return True
