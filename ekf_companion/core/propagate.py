# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Motion: the strapdown equations and the covariance of their error, one inertial interval.

The attitude error is a rotation vector in n: ``C_true = exp(theta) C``. The transition is of second
order in the interval, so that it serves 10 Hz as well as 1 kHz.

Source: Groves 2013, chapters 5 and 14; Sola 2017, section 7 (global angular error).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import cos, sin, sqrt
else:
    from math import cos, sin, sqrt

    from ekf_companion.core import state as at

# WGS-84, as in nav.earth
A = cython.declare(cython.double, 6378137.0)
E2 = cython.declare(cython.double, 6.69437999014131705734e-3)
RATE = cython.declare(cython.double, 7.292115e-5)
G_EQUATOR = cython.declare(cython.double, 9.7803253359)
SOMIGLIANA = cython.declare(cython.double, 0.00193185265241)
FREE_AIR = cython.declare(cython.double, 3.0877e-6)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def turn(
    x: cython.double[::1],
    q: cython.Py_ssize_t,
    px: cython.double,
    py: cython.double,
    pz: cython.double,
) -> cython.void:
    """Turn the quaternion at x[q] by a rotation vector in n: q <- exp(p) q, unit norm."""
    half: cython.double
    s: cython.double
    c: cython.double
    qw: cython.double = x[q]
    qx: cython.double = x[q + 1]
    qy: cython.double = x[q + 2]
    qz: cython.double = x[q + 3]
    a2: cython.double = px * px + py * py + pz * pz
    if a2 > 1e-6:
        half = 0.5 * sqrt(a2)
        c = cos(half)
        s = 0.5 * sin(half) / half
    else:  # the next terms are below 1e-20
        c = 1.0 - a2 * (0.125 - a2 * (1.0 / 384.0))
        s = 0.5 - a2 * (1.0 / 48.0 - a2 * (1.0 / 3840.0))
    px = s * px
    py = s * py
    pz = s * pz
    x[q] = c * qw - px * qx - py * qy - pz * qz
    x[q + 1] = c * qx + px * qw + py * qz - pz * qy
    x[q + 2] = c * qy - px * qz + py * qw + pz * qx
    x[q + 3] = c * qz + px * qy - py * qx + pz * qw
    unit(x, q)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def turn_body(
    x: cython.double[::1],
    q: cython.Py_ssize_t,
    px: cython.double,
    py: cython.double,
    pz: cython.double,
) -> cython.void:
    """Turn the quaternion at x[q] by a rotation vector in b: q <- q exp(p), unit norm."""
    # q exp(p) is the conjugate of exp(-p) q*, so one formula serves both
    x[q + 1] = -x[q + 1]
    x[q + 2] = -x[q + 2]
    x[q + 3] = -x[q + 3]
    turn(x, q, -px, -py, -pz)
    x[q + 1] = -x[q + 1]
    x[q + 2] = -x[q + 2]
    x[q + 3] = -x[q + 3]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def unit(x: cython.double[::1], q: cython.Py_ssize_t) -> cython.void:
    """Bring the quaternion at x[q] to unit norm."""
    norm: cython.double = sqrt(
        x[q] * x[q] + x[q + 1] * x[q + 1] + x[q + 2] * x[q + 2] + x[q + 3] * x[q + 3]
    )
    x[q] = x[q] / norm
    x[q + 1] = x[q + 1] / norm
    x[q + 2] = x[q + 2] / norm
    x[q + 3] = x[q + 3] / norm


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def matrix(x: cython.double[::1], q: cython.Py_ssize_t, w: cython.double[::1]) -> cython.void:
    """Write the direction cosines of the quaternion at x[q] to w[W_C_NB:+9], row by row."""
    qw: cython.double = x[q]
    qx: cython.double = x[q + 1]
    qy: cython.double = x[q + 2]
    qz: cython.double = x[q + 3]
    w[at.W_C_NB] = qw * qw + qx * qx - qy * qy - qz * qz
    w[at.W_C_NB + 1] = 2.0 * (qx * qy - qw * qz)
    w[at.W_C_NB + 2] = 2.0 * (qx * qz + qw * qy)
    w[at.W_C_NB + 3] = 2.0 * (qx * qy + qw * qz)
    w[at.W_C_NB + 4] = qw * qw - qx * qx + qy * qy - qz * qz
    w[at.W_C_NB + 5] = 2.0 * (qy * qz - qw * qx)
    w[at.W_C_NB + 6] = 2.0 * (qx * qz - qw * qy)
    w[at.W_C_NB + 7] = 2.0 * (qy * qz + qw * qx)
    w[at.W_C_NB + 8] = qw * qw - qx * qx - qy * qy + qz * qz


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def originate(
    x: cython.double[::1], lat: cython.double, lon: cython.double, alt: cython.double
) -> cython.void:
    """Put the origin of the local frame here (rad, rad, m)."""
    sl: cython.double = sin(lat)
    root: cython.double = sqrt(1.0 - E2 * sl * sl)
    x[at.X_LAT0] = lat
    x[at.X_LON0] = lon
    x[at.X_ALT0] = alt
    x[at.X_SCALE_N] = A * (1.0 - E2) / (root * root * root) + alt
    x[at.X_SCALE_E] = (A / root + alt) * cos(lat)
    x[at.X_HAS_ORIGIN] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def move(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], dt: cython.double
) -> cython.void:
    """Carry attitude, velocity and position over dt (s) at the rate and force of w.

    w[W_RATE] and w[W_FORCE] are their means over dt, w[W_RATE_SLOPE] and w[W_FORCE_SLOPE] how fast
    they change: that gives coning and sculling. Exact for the turning force: the increments are
    the first and second integral of exp(w t) f. Leaves C_nb at the start in w[W_C_NB] and the
    velocity increment of the force in w[W_DV].

    Source: of coning and sculling for a rate that changes linearly, Savage 1998, parts 1 and 2.
    """
    # Rate and force less their biases
    px: cython.double = w[at.W_RATE] - x[at.X_BG]
    py: cython.double = w[at.W_RATE + 1] - x[at.X_BG + 1]
    pz: cython.double = w[at.W_RATE + 2] - x[at.X_BG + 2]
    fx: cython.double = w[at.W_FORCE] - x[at.X_BA]
    fy: cython.double = w[at.W_FORCE + 1] - x[at.X_BA + 1]
    fz: cython.double = w[at.W_FORCE + 2] - x[at.X_BA + 2]

    # Coning turns on: dt^2/12 (w x w'); sculling pushes on: dt^2/12 (w x f' + f x w')
    h: cython.double = dt * dt / 12.0
    wx: cython.double = w[at.W_RATE_SLOPE] * h
    wy: cython.double = w[at.W_RATE_SLOPE + 1] * h
    wz: cython.double = w[at.W_RATE_SLOPE + 2] * h
    ex: cython.double = w[at.W_FORCE_SLOPE] * h
    ey: cython.double = w[at.W_FORCE_SLOPE + 1] * h
    ez: cython.double = w[at.W_FORCE_SLOPE + 2] * h
    ux: cython.double = fx + (py * ez - pz * ey) + (fy * wz - fz * wy)
    uy: cython.double = fy + (pz * ex - px * ez) + (fz * wx - fx * wz)
    uz: cython.double = fz + (px * ey - py * ex) + (fx * wy - fy * wx)
    sx: cython.double = (px + (py * wz - pz * wy)) * dt
    sy: cython.double = (py + (pz * wx - px * wz)) * dt
    sz: cython.double = (pz + (px * wy - py * wx)) * dt
    fx = ux
    fy = uy
    fz = uz
    px = sx
    py = sy
    pz = sz

    # Integrals of the turning force, in b at the start: series, the error below 1e-10 at 0.5 rad
    a2: cython.double = px * px + py * py + pz * pz
    b1: cython.double = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 / 40320.0))
    b2: cython.double = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 / 362880.0))
    b3: cython.double = 1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 * (1.0 / 40320.0 - a2 / 3628800.0))
    cx: cython.double = py * fz - pz * fy
    cy: cython.double = pz * fx - px * fz
    cz: cython.double = px * fy - py * fx
    dx: cython.double = py * cz - pz * cy
    dy: cython.double = pz * cx - px * cz
    dz: cython.double = px * cy - py * cx
    ux = (fx + b1 * cx + b2 * dx) * dt
    uy = (fy + b1 * cy + b2 * dy) * dt
    uz = (fz + b1 * cz + b2 * dz) * dt
    # a force that grows has moved us less: -dt^3/12 f'
    sx = (0.5 * fx - ex / dt + b2 * cx + b3 * dx) * dt * dt
    sy = (0.5 * fy - ey / dt + b2 * cy + b3 * dy) * dt * dt
    sz = (0.5 * fz - ez / dt + b2 * cz + b3 * dz) * dt * dt

    # Into n
    matrix(x, at.X_Q, w)
    un: cython.double = w[at.W_C_NB] * ux + w[at.W_C_NB + 1] * uy + w[at.W_C_NB + 2] * uz
    ue: cython.double = w[at.W_C_NB + 3] * ux + w[at.W_C_NB + 4] * uy + w[at.W_C_NB + 5] * uz
    ud: cython.double = w[at.W_C_NB + 6] * ux + w[at.W_C_NB + 7] * uy + w[at.W_C_NB + 8] * uz
    sn: cython.double = w[at.W_C_NB] * sx + w[at.W_C_NB + 1] * sy + w[at.W_C_NB + 2] * sz
    se: cython.double = w[at.W_C_NB + 3] * sx + w[at.W_C_NB + 4] * sy + w[at.W_C_NB + 5] * sz
    sd: cython.double = w[at.W_C_NB + 6] * sx + w[at.W_C_NB + 7] * sy + w[at.W_C_NB + 8] * sz

    # Gravity, Earth rate and transport rate where we are; plain gravity until we know where
    i: cython.Py_ssize_t
    vn: cython.double = x[at.X_VEL]
    ve: cython.double = x[at.X_VEL + 1]
    vd: cython.double = x[at.X_VEL + 2]
    cn: cython.double = 0.0  # acceleration in n that is not specific force
    ce: cython.double = 0.0
    cd: cython.double = k[at.K_GRAVITY]
    wn: cython.double = 0.0  # turn rate of n in inertial space
    we: cython.double = 0.0
    wd: cython.double = 0.0
    ratio_n: cython.double = 1.0
    ratio_e: cython.double = 1.0
    lat: cython.double
    alt: cython.double
    sl: cython.double
    cl: cython.double
    root: cython.double
    east: cython.double
    north: cython.double
    tn: cython.double
    te: cython.double
    td: cython.double
    if x[at.X_HAS_ORIGIN] != 0.0:
        lat = x[at.X_LAT0] + x[at.X_POS] / x[at.X_SCALE_N]
        alt = x[at.X_ALT0] - x[at.X_POS + 2]
        sl = sin(lat)
        cl = cos(lat)
        root = sqrt(1.0 - E2 * sl * sl)
        east = A / root + alt
        north = A * (1.0 - E2) / (root * root * root) + alt
        wn = RATE * cl
        wd = -RATE * sl
        tn = ve / east
        te = -vn / north
        td = -ve * sl / (east * cl)
        # -(2 w_ie + w_en) x v
        cn = (2.0 * wd + td) * ve - te * vd
        ce = (2.0 * wn + tn) * vd - (2.0 * wd + td) * vn
        cd = G_EQUATOR * (1.0 + SOMIGLIANA * sl * sl) / root - FREE_AIR * alt
        cd = cd - ((2.0 * wn + tn) * ve - te * vn)
        wn = wn + tn
        we = te
        wd = wd + td
        ratio_n = x[at.X_SCALE_N] / north
        ratio_e = x[at.X_SCALE_E] / (east * cl)

    # Position, velocity, attitude
    x[at.X_POS] += (vn * dt + sn + 0.5 * cn * dt * dt) * ratio_n
    x[at.X_POS + 1] += (ve * dt + se + 0.5 * ce * dt * dt) * ratio_e
    x[at.X_POS + 2] += vd * dt + sd + 0.5 * cd * dt * dt
    x[at.X_VEL] = vn + un + cn * dt
    x[at.X_VEL + 1] = ve + ue + ce * dt
    x[at.X_VEL + 2] = vd + ud + cd * dt
    turn_body(x, at.X_Q, px, py, pz)
    turn(x, at.X_Q, -wn * dt, -we * dt, -wd * dt)
    x[at.X_HEADING] -= dt / (dt + k[at.K_HEADING_TIME]) * x[at.X_HEADING]
    ratio_n = dt / (dt + k[at.K_SLOW_TIME])
    for i in range(3):
        x[at.X_SLOW + i] -= ratio_n * x[at.X_SLOW + i]

    # What the covariance and the aids need of it
    w[at.W_DV] = un
    w[at.W_DV + 1] = ue
    w[at.W_DV + 2] = ud
    x[at.X_ACC_N] = un / dt + cn
    x[at.X_ACC_N + 1] = ue / dt + ce
    x[at.X_ACC_N + 2] = ud / dt + cd


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def spread(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], dt: cython.double
) -> cython.void:
    """Carry the covariance over the interval that :func:`move` has just gone: Phi P Phi' + Q.

    With ``G = -C dt`` (from a bias) and ``S = -[dv x]`` (from attitude to velocity):

    ``theta += G bg``; ``v += S theta + S G/2 bg + G ba``;
    ``p += dt v + S dt/2 theta + S G dt/6 bg + G dt/2 ba``.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    r: cython.Py_ssize_t
    att: cython.Py_ssize_t = at.X_COV + at.E_ATT * at.N
    vel: cython.Py_ssize_t = at.X_COV + at.E_VEL * at.N
    pos: cython.Py_ssize_t = at.X_COV + at.E_POS * at.N
    bg: cython.Py_ssize_t = at.X_COV + at.E_BG * at.N
    ba: cython.Py_ssize_t = at.X_COV + at.E_BA * at.N
    h: cython.double = 0.5 * dt
    s0: cython.double
    s1: cython.double
    s2: cython.double
    g0: cython.double
    g1: cython.double
    g2: cython.double
    b0: cython.double
    b1: cython.double
    b2: cython.double

    # S by rows to w[W_S9], S G / 2 to w[W_S9 + 9]
    w[at.W_S9] = 0.0
    w[at.W_S9 + 1] = w[at.W_DV + 2]
    w[at.W_S9 + 2] = -w[at.W_DV + 1]
    w[at.W_S9 + 3] = -w[at.W_DV + 2]
    w[at.W_S9 + 4] = 0.0
    w[at.W_S9 + 5] = w[at.W_DV]
    w[at.W_S9 + 6] = w[at.W_DV + 1]
    w[at.W_S9 + 7] = -w[at.W_DV]
    w[at.W_S9 + 8] = 0.0
    for i in range(3):
        for j in range(3):
            w[at.W_S9 + 9 + 3 * i + j] = -h * (
                w[at.W_S9 + 3 * i] * w[at.W_C_NB + j]
                + w[at.W_S9 + 3 * i + 1] * w[at.W_C_NB + 3 + j]
                + w[at.W_S9 + 3 * i + 2] * w[at.W_C_NB + 6 + j]
            )

    # Rows: position first, then velocity, then attitude, each from what is still old
    for i in range(3):
        s0 = w[at.W_S9 + 3 * i]
        s1 = w[at.W_S9 + 3 * i + 1]
        s2 = w[at.W_S9 + 3 * i + 2]
        g0 = -dt * w[at.W_C_NB + 3 * i]
        g1 = -dt * w[at.W_C_NB + 3 * i + 1]
        g2 = -dt * w[at.W_C_NB + 3 * i + 2]
        b0 = w[at.W_S9 + 9 + 3 * i]
        b1 = w[at.W_S9 + 9 + 3 * i + 1]
        b2 = w[at.W_S9 + 9 + 3 * i + 2]
        for j in range(at.N):
            # the force's part of the velocity's row serves the position too, halved by dt/2
            w[at.W_ROW + j] = (
                s0 * x[att + j] + s1 * x[att + at.N + j] + s2 * x[att + 2 * at.N + j]
            ) + (g0 * x[ba + j] + g1 * x[ba + at.N + j] + g2 * x[ba + 2 * at.N + j])
            w[at.W_ROW2 + j] = b0 * x[bg + j] + b1 * x[bg + at.N + j] + b2 * x[bg + 2 * at.N + j]
        for j in range(at.N):
            x[pos + i * at.N + j] += dt * x[vel + i * at.N + j] + h * (
                w[at.W_ROW + j] + (2.0 / 3.0) * w[at.W_ROW2 + j]
            )
        for j in range(at.N):
            x[vel + i * at.N + j] += w[at.W_ROW + j] + w[at.W_ROW2 + j]
    for i in range(3):
        g0 = -dt * w[at.W_C_NB + 3 * i]
        g1 = -dt * w[at.W_C_NB + 3 * i + 1]
        g2 = -dt * w[at.W_C_NB + 3 * i + 2]
        for j in range(at.N):
            x[att + i * at.N + j] += (
                g0 * x[bg + j] + g1 * x[bg + at.N + j] + g2 * x[bg + 2 * at.N + j]
            )

    # Columns of the nine rows that moved: the same on the right
    for r in range(9):
        i = at.X_COV + r * at.N
        for j in range(3):
            s0 = (
                w[at.W_S9 + 3 * j] * x[i]
                + w[at.W_S9 + 3 * j + 1] * x[i + 1]
                + w[at.W_S9 + 3 * j + 2] * x[i + 2]
            ) - dt * (
                w[at.W_C_NB + 3 * j] * x[i + at.E_BA]
                + w[at.W_C_NB + 3 * j + 1] * x[i + at.E_BA + 1]
                + w[at.W_C_NB + 3 * j + 2] * x[i + at.E_BA + 2]
            )
            s1 = (
                w[at.W_S9 + 9 + 3 * j] * x[i + at.E_BG]
                + w[at.W_S9 + 9 + 3 * j + 1] * x[i + at.E_BG + 1]
                + w[at.W_S9 + 9 + 3 * j + 2] * x[i + at.E_BG + 2]
            )
            x[i + at.E_POS + j] += dt * x[i + at.E_VEL + j] + h * (s0 + (2.0 / 3.0) * s1)
            x[i + at.E_VEL + j] += s0 + s1
        for j in range(3):
            x[i + j] -= dt * (
                w[at.W_C_NB + 3 * j] * x[i + at.E_BG]
                + w[at.W_C_NB + 3 * j + 1] * x[i + at.E_BG + 1]
                + w[at.W_C_NB + 3 * j + 2] * x[i + at.E_BG + 2]
            )

    # Noise: white on rate and force, walks of the slow states
    for j in range(3):
        w[at.W_Q + j] = k[at.K_GYRO_NOISE] * k[at.K_GYRO_NOISE] * dt
        w[at.W_Q + 3 + j] = k[at.K_ACCEL_NOISE] * k[at.K_ACCEL_NOISE] * dt
        if k[at.K_LEARN_NOISE] != 0.0:
            if x[at.X_NOISE_G + j] * dt > w[at.W_Q + j]:
                w[at.W_Q + j] = x[at.X_NOISE_G + j] * dt
            if x[at.X_NOISE_A + j] * dt > w[at.W_Q + 3 + j]:
                w[at.W_Q + 3 + j] = x[at.X_NOISE_A + j] * dt
    for i in range(3):
        for j in range(i, 3):
            s0 = 0.0
            s1 = 0.0
            for r in range(3):
                g0 = w[at.W_C_NB + 3 * i + r] * w[at.W_C_NB + 3 * j + r]
                s0 += g0 * w[at.W_Q + r]
                s1 += g0 * w[at.W_Q + 3 + r]
            x[att + i * at.N + at.E_ATT + j] += s0
            x[vel + i * at.N + at.E_VEL + j] += s1
            x[pos + i * at.N + at.E_VEL + j] += h * s1
            if j > i:
                x[pos + j * at.N + at.E_VEL + i] += h * s1
            x[pos + i * at.N + at.E_POS + j] += (dt * dt / 3.0) * s1
        x[pos + i * at.N + at.E_POS + i] += k[at.K_POS_WALK] * k[at.K_POS_WALK] * dt
    for j in range(3):
        x[bg + j * at.N + at.E_BG + j] += k[at.K_GYRO_WALK] * k[at.K_GYRO_WALK] * dt
        x[ba + j * at.N + at.E_BA + j] += k[at.K_ACCEL_WALK] * k[at.K_ACCEL_WALK] * dt
        x[at.X_COV + (at.E_IRON + j) * (at.N + 1)] += k[at.K_IRON_WALK] * k[at.K_IRON_WALK] * dt
    x[at.X_COV + at.E_BARO * (at.N + 1)] += k[at.K_BARO_WALK] * k[at.K_BARO_WALK] * dt

    # Slow errors of heading and GNSS position forget themselves; each is kept at its level
    g0 = dt / (dt + k[at.K_HEADING_TIME])
    fade(x, at.E_HEADING, g0, x[at.X_HEADING_STD] * x[at.X_HEADING_STD])
    g0 = dt / (dt + k[at.K_SLOW_TIME])
    fade(x, at.E_SLOW, g0, x[at.X_SLOW_POS])
    fade(x, at.E_SLOW + 1, g0, x[at.X_SLOW_POS])
    fade(x, at.E_SLOW + 2, g0, x[at.X_SLOW_HGT])

    # Both halves the same: within the nine rows the lower triangle follows the upper,
    # but for velocity by position, which was made as position by velocity; then the rows below
    for i in range(3):
        for j in range(3):
            x[vel + i * at.N + at.E_POS + j] = x[pos + j * at.N + at.E_VEL + i]
    for i in range(9):
        for j in range(i + 1, 9):
            x[at.X_COV + j * at.N + i] = x[at.X_COV + i * at.N + j]
    for i in range(9):
        for j in range(9, at.N):
            x[at.X_COV + j * at.N + i] = x[at.X_COV + i * at.N + j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def fade(
    x: cython.double[::1], e: cython.Py_ssize_t, g: cython.double, level: cython.double
) -> cython.void:
    """Let the Gauss-Markov error state e lose the share g of itself, towards its level (variance).

    Within the first nine rows only the column is written: :func:`spread` mirrors those.
    """
    j: cython.Py_ssize_t
    row: cython.Py_ssize_t = at.X_COV + e * at.N
    for j in range(at.N):
        x[at.X_COV + j * at.N + e] -= g * x[at.X_COV + j * at.N + e]
    for j in range(9, at.N):
        x[row + j] -= g * x[row + j]
    x[row + e] += g * (2.0 - g) * level


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def transition(
    k: cython.double[::1], w: cython.double[::1], dt: cython.double, first: cython.Py_ssize_t
) -> cython.void:
    """Write the Phi of the interval that :func:`spread` has just gone to w[first:], N by N.

    Spread never forms it; who goes back over the interval needs it. Reads what spread has left:
    C_nb, S and S G / 2.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    row: cython.Py_ssize_t
    s: cython.double
    g: cython.double
    b: cython.double
    for i in range(at.N * at.N):
        w[first + i] = 0.0
    for i in range(at.N):
        w[first + i * (at.N + 1)] = 1.0
    for i in range(3):
        w[first + (at.E_POS + i) * at.N + at.E_VEL + i] = dt
        for j in range(3):
            s = w[at.W_S9 + 3 * i + j]
            g = -dt * w[at.W_C_NB + 3 * i + j]
            b = w[at.W_S9 + 9 + 3 * i + j]
            row = first + (at.E_ATT + i) * at.N
            w[row + at.E_BG + j] = g
            row = first + (at.E_VEL + i) * at.N
            w[row + at.E_ATT + j] = s
            w[row + at.E_BG + j] = b
            w[row + at.E_BA + j] = g
            row = first + (at.E_POS + i) * at.N
            w[row + at.E_ATT + j] = 0.5 * dt * s
            w[row + at.E_BG + j] = dt / 3.0 * b
            w[row + at.E_BA + j] = 0.5 * dt * g
    w[first + at.E_HEADING * (at.N + 1)] = 1.0 - dt / (dt + k[at.K_HEADING_TIME])
    for i in range(3):
        w[first + (at.E_SLOW + i) * (at.N + 1)] = 1.0 - dt / (dt + k[at.K_SLOW_TIME])
