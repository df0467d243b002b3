# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""One small filter of the bank: what if the bank's frame s pointed there?

Its state is the velocity (north, east), the yaw psi of s against north, the tilt phi of s about
its axes x and y, the error b of the bank's gyro bias, and how much later than its stamp a fix is,
d. With the sums between two fixes, of force u and of turn G = int C_sb dt, both in s:

``v += R(psi) (u_x + phi_y u_z, u_y - phi_x u_z)``; ``(phi_x, phi_y, psi) -= G b``.

With the acceleration a and the antenna's extra velocity l, both in s, a fix reads
``v + R(psi) (l - d a)``.

h is where the hypothesis lies in the state block x; w is scratch.

Source: Groves 2013, chapter 14 (transfer alignment by velocity); second-order term: Maybeck 1982,
vol. 2, section 12.3.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core.observe import wrap
    from cython.cimports.libc.math import cos, log, sin
else:
    from math import cos, log, sin

    from ekf_companion.core import state as at
    from ekf_companion.core.observe import wrap

LEVEL_STD = cython.declare(cython.double, 0.3)
"""One sigma of a tilt taken from the mean force, rad: it may have been in a turn, or taking off."""
FORCE_NOISE = cython.declare(cython.double, 0.35)
"""White noise of the horizontal force, m/s^2 per square root of Hz: biases, vibration and slow
errors of GNSS velocity. What is felt must be more than that to say where north is."""
TILT_WALK = cython.declare(cython.double, 5e-3)
"""rad per square root of s: an accelerometer's bias that turns with the body."""
YAW_WALK = cython.declare(cython.double, 1e-2)
"""rad per square root of s: the gyro's scale, which its bias does not explain."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def begin(
    x: cython.double[::1],
    h: cython.Py_ssize_t,
    vn: cython.double,
    ve: cython.double,
    variance: cython.double,
    bias: cython.double,
    delay: cython.double,
) -> cython.void:
    """Begin at a velocity of this variance, level give or take; sigmas of bias and delay."""
    i: cython.Py_ssize_t
    p: cython.Py_ssize_t = h + at.H_P
    for i in range(at.H_SIZE):
        x[h + i] = 0.0
    x[h + at.H_X] = vn
    x[h + at.H_X + 1] = ve
    for i in range(2):
        x[p + i * (at.H_N + 1)] = variance
        x[p + (3 + i) * (at.H_N + 1)] = LEVEL_STD * LEVEL_STD
    for i in range(5, 8):
        x[p + i * (at.H_N + 1)] = bias * bias
    x[p + 8 * (at.H_N + 1)] = delay * delay


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def know(
    x: cython.double[::1],
    h: cython.Py_ssize_t,
    i: cython.Py_ssize_t,
    value: cython.double,
    variance: cython.double,
) -> cython.void:
    """Set state i, uncorrelated with all others."""
    j: cython.Py_ssize_t
    for j in range(at.H_N):
        x[h + at.H_P + i * at.H_N + j] = 0.0
        x[h + at.H_P + j * at.H_N + i] = 0.0
    x[h + at.H_X + i] = value
    x[h + at.H_P + i * (at.H_N + 1)] = variance


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def predict(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], h: cython.Py_ssize_t
) -> cython.void:
    """Carry the hypothesis over the interval that the bank's sums stand for.

    Leaves F - I, five rows of H_N, at w[W_H].
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    g: cython.Py_ssize_t = at.X_BANK + at.B_G
    f: cython.Py_ssize_t = at.W_H
    uz: cython.double = x[at.X_BANK + at.B_U + 2]
    for i in range(3):  # the turn of s by the bias, about x, y and z
        w[at.W_Y + i] = (
            x[g + 3 * i] * x[h + at.H_X + 5]
            + x[g + 3 * i + 1] * x[h + at.H_X + 6]
            + x[g + 3 * i + 2] * x[h + at.H_X + 7]
        )
    # The force in n, by the mean yaw and tilt of the interval
    yaw: cython.double = x[h + at.H_X + 2] - 0.5 * w[at.W_Y + 2]
    s: cython.double = sin(yaw)
    c: cython.double = cos(yaw)
    ux: cython.double = x[at.X_BANK + at.B_U] + (x[h + at.H_X + 4] - 0.5 * w[at.W_Y + 1]) * uz
    uy: cython.double = x[at.X_BANK + at.B_U + 1] - (x[h + at.H_X + 3] - 0.5 * w[at.W_Y]) * uz
    dn: cython.double = c * ux - s * uy
    de: cython.double = s * ux + c * uy
    x[h + at.H_X] += dn
    x[h + at.H_X + 1] += de
    x[h + at.H_X + 2] = wrap(x[h + at.H_X + 2] - w[at.W_Y + 2])
    x[h + at.H_X + 3] -= w[at.W_Y]
    x[h + at.H_X + 4] -= w[at.W_Y + 1]

    # F - I: velocity by yaw, tilt and (half the interval late) bias; yaw and tilt by bias
    for i in range(5 * at.H_N):
        w[f + i] = 0.0
    w[f + 2] = -de
    w[f + 3] = s * uz
    w[f + 4] = c * uz
    w[f + at.H_N + 2] = dn
    w[f + at.H_N + 3] = -c * uz
    w[f + at.H_N + 4] = s * uz
    for j in range(3):
        for i in range(2):
            w[f + i * at.H_N + 5 + j] = -0.5 * (
                w[f + i * at.H_N + 2] * x[g + 6 + j]
                + w[f + i * at.H_N + 3] * x[g + j]
                + w[f + i * at.H_N + 4] * x[g + 3 + j]
            )
        w[f + 2 * at.H_N + 5 + j] = -x[g + 6 + j]
        w[f + 3 * at.H_N + 5 + j] = -x[g + j]
        w[f + 4 * at.H_N + 5 + j] = -x[g + 3 + j]
    widen(x, k, w, h, dn * dn + de * de)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def widen(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    h: cython.Py_ssize_t,
    gained: cython.double,
) -> cython.void:
    """Carry the covariance likewise: F P F' + Q; gained is the square of the velocity gained."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    r: cython.Py_ssize_t
    f: cython.Py_ssize_t = at.W_H
    p: cython.Py_ssize_t = h + at.H_P
    s: cython.double
    dt: cython.double = x[at.X_BANK + at.B_DT]
    yaw: cython.double = x[p + 2 * (at.H_N + 1)]
    # rows, then columns, each from what is still old
    for i in range(5):
        for j in range(at.H_N):
            s = 0.0
            for r in range(2 if i < 2 else 5, 8):
                s += w[f + i * at.H_N + r] * x[p + r * at.H_N + j]
            x[p + i * at.H_N + j] += s
    for i in range(at.H_N):
        for j in range(5):
            s = 0.0
            for r in range(2 if j < 2 else 5, 8):
                s += w[f + j * at.H_N + r] * x[p + i * at.H_N + r]
            x[p + i * at.H_N + j] += s
    # what the turn of the force by yaw has of second order is noise to a filter of first order
    s = FORCE_NOISE * FORCE_NOISE * dt + 0.5 * yaw * yaw * gained
    x[p] += s
    x[p + at.H_N + 1] += s
    x[p + 2 * (at.H_N + 1)] += YAW_WALK * YAW_WALK * dt
    for i in range(3, 5):
        x[p + i * (at.H_N + 1)] += TILT_WALK * TILT_WALK * dt
    for i in range(5, 8):
        x[p + i * (at.H_N + 1)] += k[at.K_GYRO_WALK] * k[at.K_GYRO_WALK] * dt


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def project(x: cython.double[::1], w: cython.double[::1], h: cython.Py_ssize_t) -> cython.void:
    """Write what a fix adds to the velocity, R(psi) (l - d a), to w[W_ROW:+2], and P H' to w[W_H].

    ``H = (1, 0, -e, 0 ... -a_n; 0, 1, n, 0 ... -a_e)`` with (n, e) that addition.
    """
    i: cython.Py_ssize_t
    r: cython.Py_ssize_t
    s: cython.double = sin(x[h + at.H_X + 2])
    c: cython.double = cos(x[h + at.H_X + 2])
    ax: cython.double = x[at.X_BANK + at.B_A]
    ay: cython.double = x[at.X_BANK + at.B_A + 1]
    lx: cython.double = w[at.W_R] - x[h + at.H_X + 8] * ax
    ly: cython.double = w[at.W_R + 1] - x[h + at.H_X + 8] * ay
    n: cython.double = c * lx - s * ly
    e: cython.double = s * lx + c * ly
    an: cython.double = c * ax - s * ay
    ae: cython.double = s * ax + c * ay
    w[at.W_ROW] = n
    w[at.W_ROW + 1] = e
    w[at.W_ROW + 2] = an
    w[at.W_ROW + 3] = ae
    for i in range(at.H_N):
        r = h + at.H_P + i * at.H_N
        w[at.W_H + 2 * i] = x[r] - e * x[r + 2] - an * x[r + 8]
        w[at.W_H + 2 * i + 1] = x[r + 1] + n * x[r + 2] - ae * x[r + 8]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def judge(
    x: cython.double[::1],
    w: cython.double[::1],
    h: cython.Py_ssize_t,
    o: cython.Py_ssize_t,
    vn: cython.double,
    ve: cython.double,
    variance: cython.double,
) -> cython.double:
    """Give the normalised innovation squared of a velocity (2 degrees of freedom).

    Leaves at w[o:+6] for :func:`absorb` the innovation, the inverse of its covariance (nn, ne, ee)
    and the logarithm of the likelihood. The antenna's extra velocity in s, x and y, is at w[W_R].
    """
    a: cython.Py_ssize_t = at.W_H
    d: cython.Py_ssize_t = at.W_ROW
    nis: cython.double
    project(x, w, h)
    nn: cython.double = w[a] - w[d + 1] * w[a + 4] - w[d + 2] * w[a + 16] + variance
    ne: cython.double = w[a + 1] - w[d + 1] * w[a + 5] - w[d + 2] * w[a + 17]
    ee: cython.double = w[a + 3] + w[d] * w[a + 5] - w[d + 3] * w[a + 17] + variance
    det: cython.double = nn * ee - ne * ne
    w[o] = vn - x[h + at.H_X] - w[d]
    w[o + 1] = ve - x[h + at.H_X + 1] - w[d + 1]
    w[o + 2] = ee / det
    w[o + 3] = -ne / det
    w[o + 4] = nn / det
    nis = w[o] * w[o] * w[o + 2] + w[o + 1] * w[o + 1] * w[o + 4]
    nis += 2.0 * w[o] * w[o + 1] * w[o + 3]
    w[o + 5] = -0.5 * (nis + log(det))
    return nis


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def absorb(
    x: cython.double[::1], w: cython.double[::1], h: cython.Py_ssize_t, o: cython.Py_ssize_t
) -> cython.void:
    """Correct the hypothesis by what :func:`judge` left at w[o]: A = P H', P -= A S^-1 A'."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    p: cython.Py_ssize_t = h + at.H_P
    a: cython.Py_ssize_t = at.W_H
    n: cython.double
    e: cython.double
    project(x, w, h)
    for i in range(at.H_N):
        n = w[a + 2 * i] * w[o + 2] + w[a + 2 * i + 1] * w[o + 3]
        e = w[a + 2 * i] * w[o + 3] + w[a + 2 * i + 1] * w[o + 4]
        x[h + at.H_X + i] += n * w[o] + e * w[o + 1]
        for j in range(i, at.H_N):
            x[p + i * at.H_N + j] -= n * w[a + 2 * j] + e * w[a + 2 * j + 1]
            x[p + j * at.H_N + i] = x[p + i * at.H_N + j]
    x[h + at.H_X + 2] = wrap(x[h + at.H_X + 2])
