"""Prediction: strapdown equations and error covariance over one inertial interval.

The attitude error is a rotation vector in n: ``C_true = exp(theta) C``. The transition is of second
order in the interval, so that it serves 10 Hz as well as 1 kHz.

Source: Groves 2013, chapters 5 and 14; Sola 2017, section 7 (global angular error).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import rotate, rotate_body, to_dcm
from cython.cimports.ekf_companion.core.memory.enums import (
    AZIMUTH_FIELD,
    E_ATT,
    E_BA,
    E_BG,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_IRON,
    E_POS,
    E_VEL,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Square
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust.doubt import (
    gyro_walk_share,
    new_bias_share,
    walk_share,
    write_noise,
)
from cython.cimports.ekf_companion.core.trust.walk import (
    add_baro_walk,
    add_gyro_walk,
    learn_walk,
    note_fading,
)
from cython.cimports.libc.math import cos, sin, sqrt

# WGS-84, as in nav.earth
A = cython.declare(cython.double, 6378137.0)
E2 = cython.declare(cython.double, 6.69437999014131705734e-3)
EARTH_RATE = cython.declare(cython.double, 7.292115e-5)
G_EQUATOR = cython.declare(cython.double, 9.7803253359)
SOMIGLIANA = cython.declare(cython.double, 0.00193185265241)
FREE_AIR = cython.declare(cython.double, 3.0877e-6)
SMOOTH = cython.declare(cython.double, 0.05)
"""s; time constant of the acceleration, of which one sample has too much noise."""
PROVEN_SHARE = cython.declare(cython.double, 0.25)
"""Least share of the variance of a compass's slow error that counts: one look at it by GNSS, which
found none, makes no more of the little that is known before."""
SLOW_INTERVAL = cython.declare(cython.double, 0.0199)
"""Interval at which the slow errors of heading and GNSS are carried on, s: 20 ms, give or take."""


def set_origin(x: State, lat: float, lon: float, alt: float) -> None:
    """Set the origin of the local frame (rad, rad, m)."""
    sl = sin(lat)
    root = sqrt(1.0 - E2 * sl * sl)
    x.origin.lat = lat
    x.origin.lon = lon
    x.origin.alt = alt
    x.origin.scale_n = A * (1.0 - E2) / (root * root * root) + alt
    x.origin.scale_e = (A / root + alt) * cos(lat)
    x.origin.is_known = 1.0


def integrate_strapdown(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Integrate attitude, velocity and position over dt (s) at the rate and force of ``m``.

    Adds to ``x.pending`` what the covariance needs.
    """
    integrate_increments(x, m, dt)
    to_dcm(x.q_nb, m.C_nb)
    un = m.C_nb[0][0] * m.dv_b[0] + m.C_nb[0][1] * m.dv_b[1] + m.C_nb[0][2] * m.dv_b[2]
    ue = m.C_nb[1][0] * m.dv_b[0] + m.C_nb[1][1] * m.dv_b[1] + m.C_nb[1][2] * m.dv_b[2]
    ud = m.C_nb[2][0] * m.dv_b[0] + m.C_nb[2][1] * m.dv_b[1] + m.C_nb[2][2] * m.dv_b[2]
    sn = m.C_nb[0][0] * m.dp_b[0] + m.C_nb[0][1] * m.dp_b[1] + m.C_nb[0][2] * m.dp_b[2]
    se = m.C_nb[1][0] * m.dp_b[0] + m.C_nb[1][1] * m.dp_b[1] + m.C_nb[1][2] * m.dp_b[2]
    sd = m.C_nb[2][0] * m.dp_b[0] + m.C_nb[2][1] * m.dp_b[1] + m.C_nb[2][2] * m.dp_b[2]

    earth_motion(x, k, m)
    cn = m.gravity_n[0]
    ce = m.gravity_n[1]
    cd = m.gravity_n[2]
    vn = x.vel_n[0]
    ve = x.vel_n[1]
    vd = x.vel_n[2]
    x.pos_n[0] += (vn * dt + sn + 0.5 * cn * dt * dt) * m.scale[0]
    x.pos_n[1] += (ve * dt + se + 0.5 * ce * dt * dt) * m.scale[1]
    x.pos_n[2] += vd * dt + sd + 0.5 * cd * dt * dt
    x.vel_n[0] = vn + un + cn * dt
    x.vel_n[1] = ve + ue + ce * dt
    x.vel_n[2] = vd + ud + cd * dt
    rotate_body(x.q_nb, m.turn_b[0], m.turn_b[1], m.turn_b[2])
    rotate(x.q_nb, -m.frame_rate[0] * dt, -m.frame_rate[1] * dt, -m.frame_rate[2] * dt)

    m.dv_n[0] = un
    m.dv_n[1] = ue
    m.dv_n[2] = ud
    add_to_pending(x, m, dt)
    x.past.gained[0] += un + cn * dt
    x.past.gained[1] += ue + ce * dt
    x.past.gained[2] += ud + cd * dt
    x.force_sum[0] += un
    x.force_sum[1] += ue
    x.force_sum[2] += ud
    share = dt / (dt + SMOOTH)
    x.accel_n[0] += share * (un / dt + cn - x.accel_n[0])
    x.accel_n[1] += share * (ue / dt + ce - x.accel_n[1])
    x.accel_n[2] += share * (ud / dt + cd - x.accel_n[2])


def add_to_pending(x: State, m: Motion, dt: float) -> None:
    """Add the motion over dt (s) to that which P is to be carried on by."""
    p = address(x.pending)
    p.dt += dt
    for i in range(3):
        p.dv_n[i] += m.dv_n[i]
        for j in range(3):
            p.C_nb_dt[i][j] += m.C_nb[i][j] * dt


def integrate_increments(x: State, m: Motion, dt: float) -> None:
    """Write the turn, velocity and position increments of the force, in b at the start.

    ``m.rate`` and ``m.force`` are means over dt, their slopes how fast they change: that gives
    coning and sculling. Exact for the turning force: the increments are the first and second
    integral of exp(w t) f.

    Source: of coning and sculling for a rate that changes linearly, Savage 1998, parts 1 and 2.
    """
    # Rate and force less their biases
    px = m.rate[0] - x.gyro_bias[0]
    py = m.rate[1] - x.gyro_bias[1]
    pz = m.rate[2] - x.gyro_bias[2]
    fx = m.force[0] - x.accel_bias[0]
    fy = m.force[1] - x.accel_bias[1]
    fz = m.force[2] - x.accel_bias[2]

    # Coning turns on: dt^2/12 (w x w'); sculling pushes on: dt^2/12 (w x f' + f x w')
    h = dt * dt / 12.0
    wx = m.rate_slope[0] * h
    wy = m.rate_slope[1] * h
    wz = m.rate_slope[2] * h
    ex = m.force_slope[0] * h
    ey = m.force_slope[1] * h
    ez = m.force_slope[2] * h
    ux = fx + (py * ez - pz * ey) + (fy * wz - fz * wy)
    uy = fy + (pz * ex - px * ez) + (fz * wx - fx * wz)
    uz = fz + (px * ey - py * ex) + (fx * wy - fy * wx)
    sx = (px + (py * wz - pz * wy)) * dt
    sy = (py + (pz * wx - px * wz)) * dt
    sz = (pz + (px * wy - py * wx)) * dt
    fx = ux
    fy = uy
    fz = uz
    px = sx
    py = sy
    pz = sz

    # Integrals of the turning force, in b at the start: series, the error below 1e-10 at 0.5 rad
    a2 = px * px + py * py + pz * pz
    b1 = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 / 40320.0))
    b2 = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 / 362880.0))
    b3 = 1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 * (1.0 / 40320.0 - a2 / 3628800.0))
    cx = py * fz - pz * fy
    cy = pz * fx - px * fz
    cz = px * fy - py * fx
    dx = py * cz - pz * cy
    dy = pz * cx - px * cz
    dz = px * cy - py * cx
    m.dv_b[0] = (fx + b1 * cx + b2 * dx) * dt
    m.dv_b[1] = (fy + b1 * cy + b2 * dy) * dt
    m.dv_b[2] = (fz + b1 * cz + b2 * dz) * dt
    # a force that grows has moved us less: -dt^3/12 f'
    m.dp_b[0] = (0.5 * fx - ex / dt + b2 * cx + b3 * dx) * dt * dt
    m.dp_b[1] = (0.5 * fy - ey / dt + b2 * cy + b3 * dy) * dt * dt
    m.dp_b[2] = (0.5 * fz - ez / dt + b2 * cz + b3 * dz) * dt * dt
    m.turn_b[0] = px
    m.turn_b[1] = py
    m.turn_b[2] = pz


def earth_motion(x: State, k: Parameters, m: Motion) -> None:
    """Write the acceleration in n that is not specific force, and how fast n turns.

    Gravity, Coriolis and transport rate where we are; plain gravity until that is known.
    """
    m.gravity_n[0] = 0.0
    m.gravity_n[1] = 0.0
    m.gravity_n[2] = k.gravity
    for i in range(3):
        m.frame_rate[i] = 0.0
    for i in range(2):
        m.scale[i] = 1.0
    if x.origin.is_known == 0.0:
        return
    vn = x.vel_n[0]
    ve = x.vel_n[1]
    vd = x.vel_n[2]
    lat = x.origin.lat + x.pos_n[0] / x.origin.scale_n
    alt = x.origin.alt - x.pos_n[2]
    sl = sin(lat)
    cl = cos(lat)
    root = sqrt(1.0 - E2 * sl * sl)
    east = A / root + alt
    north = A * (1.0 - E2) / (root * root * root) + alt
    wn = EARTH_RATE * cl
    wd = -EARTH_RATE * sl
    tn = ve / east
    te = -vn / north
    td = -ve * sl / (east * cl)
    # -(2 w_ie + w_en) x v
    m.gravity_n[0] = (2.0 * wd + td) * ve - te * vd
    m.gravity_n[1] = (2.0 * wn + tn) * vd - (2.0 * wd + td) * vn
    down = G_EQUATOR * (1.0 + SOMIGLIANA * sl * sl) / root - FREE_AIR * alt
    m.gravity_n[2] = down - ((2.0 * wn + tn) * ve - te * vn)
    m.frame_rate[0] = wn + tn
    m.frame_rate[1] = te
    m.frame_rate[2] = wd + td
    m.scale[0] = x.origin.scale_n / north
    m.scale[1] = x.origin.scale_e / (east * cl)


def propagate_covariance(x: State, k: Parameters, m: Motion) -> None:
    """Propagate P over the motion that is pending: Phi P Phi' + Q.

    With ``G = -C dt`` (from a bias) and ``S = -[dv x]`` (from attitude to velocity):

    ``theta += G bg``; ``v += S theta + S G/2 bg + G ba``;
    ``p += dt v + S dt/2 theta + S G dt/6 bg + G dt/2 ba``.
    """
    dt = x.pending.dt
    if dt == 0.0:
        return
    write_transition_blocks(x, m)
    multiply_rows(x, m, dt)
    multiply_columns(x, m, dt)
    add_noise(x, k, m, dt)

    # What changes within a minute need not be carried on every few milliseconds
    x.slow_dt += dt
    m.slow_dt = 0.0
    m.heading_faded = 0.0
    if x.slow_dt >= SLOW_INTERVAL:
        m.slow_dt = x.slow_dt
        x.slow_dt = 0.0
        fade_slow_errors(x, k, m, m.slow_dt)

    # Both halves the same: within the nine rows the lower triangle follows the upper,
    # but for velocity by position, which was made as position by velocity; then the rows below
    for i in range(3):
        for j in range(3):
            x.P[E_VEL + i][E_POS + j] = x.P[E_POS + j][E_VEL + i]
    for i in range(9):
        for j in range(i + 1, 9):
            x.P[j][i] = x.P[i][j]
    for i in range(9):
        for j in range(9, N):
            x.P[j][i] = x.P[i][j]
    forget_pending(x)


def forget_pending(x: State) -> None:
    """Begin to gather anew what P is to be carried on by."""
    p = address(x.pending)
    p.dt = 0.0
    for i in range(3):
        p.dv_n[i] = 0.0
        for j in range(3):
            p.C_nb_dt[i][j] = 0.0


def write_transition_blocks(x: State, m: Motion) -> None:
    """Write G, S and S G / 2 of the motion that is pending."""
    for i in range(3):
        m.dv_n[i] = x.pending.dv_n[i]
        for j in range(3):
            m.G[i][j] = -x.pending.C_nb_dt[i][j]
    m.S[0][0] = 0.0
    m.S[0][1] = m.dv_n[2]
    m.S[0][2] = -m.dv_n[1]
    m.S[1][0] = -m.dv_n[2]
    m.S[1][1] = 0.0
    m.S[1][2] = m.dv_n[0]
    m.S[2][0] = m.dv_n[1]
    m.S[2][1] = -m.dv_n[0]
    m.S[2][2] = 0.0
    for i in range(3):
        for j in range(3):
            m.SG[i][j] = 0.5 * (
                m.S[i][0] * m.G[0][j] + m.S[i][1] * m.G[1][j] + m.S[i][2] * m.G[2][j]
            )


def multiply_rows(x: State, m: Motion, dt: float) -> None:
    """Multiply P by Phi from the left: the nine rows of position, velocity, attitude."""
    h = 0.5 * dt
    # position first, then velocity, then attitude: each from what is still old
    for i in range(3):
        s0 = m.S[i][0]
        s1 = m.S[i][1]
        s2 = m.S[i][2]
        g0 = m.G[i][0]
        g1 = m.G[i][1]
        g2 = m.G[i][2]
        b0 = m.SG[i][0]
        b1 = m.SG[i][1]
        b2 = m.SG[i][2]
        for j in range(N):
            # the force's part of the velocity's row serves the position too, halved by dt/2
            m.row[j] = (s0 * x.P[E_ATT][j] + s1 * x.P[E_ATT + 1][j] + s2 * x.P[E_ATT + 2][j]) + (
                g0 * x.P[E_BA][j] + g1 * x.P[E_BA + 1][j] + g2 * x.P[E_BA + 2][j]
            )
            m.row2[j] = b0 * x.P[E_BG][j] + b1 * x.P[E_BG + 1][j] + b2 * x.P[E_BG + 2][j]
        for j in range(N):
            x.P[E_POS + i][j] += dt * x.P[E_VEL + i][j] + h * (m.row[j] + (2.0 / 3.0) * m.row2[j])
        for j in range(N):
            x.P[E_VEL + i][j] += m.row[j] + m.row2[j]
    for i in range(3):
        g0 = m.G[i][0]
        g1 = m.G[i][1]
        g2 = m.G[i][2]
        for j in range(N):
            x.P[E_ATT + i][j] += g0 * x.P[E_BG][j] + g1 * x.P[E_BG + 1][j] + g2 * x.P[E_BG + 2][j]


def multiply_columns(x: State, m: Motion, dt: float) -> None:
    """Multiply P by Phi' from the right: the columns of the nine rows that moved."""
    h = 0.5 * dt
    for r in range(9):
        for j in range(3):
            s0 = (m.S[j][0] * x.P[r][0] + m.S[j][1] * x.P[r][1] + m.S[j][2] * x.P[r][2]) + (
                m.G[j][0] * x.P[r][E_BA]
                + m.G[j][1] * x.P[r][E_BA + 1]
                + m.G[j][2] * x.P[r][E_BA + 2]
            )
            s1 = (
                m.SG[j][0] * x.P[r][E_BG]
                + m.SG[j][1] * x.P[r][E_BG + 1]
                + m.SG[j][2] * x.P[r][E_BG + 2]
            )
            x.P[r][E_POS + j] += dt * x.P[r][E_VEL + j] + h * (s0 + (2.0 / 3.0) * s1)
            x.P[r][E_VEL + j] += s0 + s1
        for j in range(3):
            x.P[r][j] += (
                m.G[j][0] * x.P[r][E_BG]
                + m.G[j][1] * x.P[r][E_BG + 1]
                + m.G[j][2] * x.P[r][E_BG + 2]
            )


def add_noise(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Add Q to the upper triangle of P: white noise of rate and force, walks of the slow states."""
    h = 0.5 * dt
    write_noise(x, k, m, dt)
    for i in range(3):
        for j in range(i, 3):
            s0 = 0.0
            s1 = 0.0
            for r in range(3):
                g0 = m.C_nb[i][r] * m.C_nb[j][r]
                s0 += g0 * m.q[r]
                s1 += g0 * m.q[r + 3]
            x.P[E_ATT + i][E_ATT + j] += s0
            x.P[E_VEL + i][E_VEL + j] += s1
            x.P[E_POS + i][E_VEL + j] += h * s1
            if j > i:
                x.P[E_POS + j][E_VEL + i] += h * s1
            x.P[E_POS + i][E_POS + j] += (dt * dt / 3.0) * s1
    share = 1.0
    gyro_share = 1.0
    new = 0.0
    if k.learn_noise != 0.0:
        new = new_bias_share(x)
        share = walk_share(x)
        gyro_share = gyro_walk_share(x, share)
        learn_walk(x, dt)
    for j in range(3):
        add_gyro_walk(x, j, gyro_share * k.gyro_bias_walk * k.gyro_bias_walk * dt)
        x.P[E_BA + j][E_BA + j] += share * k.accel_bias_walk * k.accel_bias_walk * dt
        x.P[E_BA + j][E_BA + j] += new * k.accel_bias_std * k.accel_bias_std
        x.P[E_IRON + j][E_IRON + j] += k.iron_walk * k.iron_walk * dt
    speed2 = x.vel_n[0] * x.vel_n[0] + x.vel_n[1] * x.vel_n[1] + x.vel_n[2] * x.vel_n[2]
    by_speed = k.baro_speed_walk * k.baro_speed_walk * speed2 * dt
    if k.learn_noise != 0.0:
        by_speed *= x.walk.speed_share
    add_baro_walk(x, k.baro_walk * k.baro_walk * dt, by_speed, speed2)


def fade_slow_errors(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Let the slow errors of heading and GNSS forget themselves; each is kept at its level."""
    share = x.walk.heading_share if k.learn_noise != 0.0 else 1.0
    faded = share * dt / (share * dt + k.heading_time)
    level = heading_level(x, k)
    x.heading_offset -= faded * x.heading_offset
    decay(x, E_HEADING, faded, level)
    note_fading(x, faded, level)
    m.heading_faded = faded
    faded = dt / (dt + k.gnss_offset_time)
    for i in range(3):
        x.gnss_offset[i] -= faded * x.gnss_offset[i]
        decay(x, E_GNSS + i, faded, x.gnss_offset_var[0 if i < 2 else 1])
    faded = dt / (dt + k.gnss_vel_offset_time)
    for i in range(3):
        x.gnss_vel_offset[i] -= faded * x.gnss_vel_offset[i]
        decay(x, E_GNSS_VEL + i, faded, x.gnss_vel_offset_var)


def heading_level(x: State, k: Parameters) -> float:
    """Return the variance that the heading's slow error has in the long run, rad^2.

    A compass whose error GNSS has shown to be small counts as better than expected: the level is
    then what is left of the error, estimate and variance, but no less than a share of what is set.
    While nothing shows the error, its variance is the level already, and nothing changes.
    """
    level = x.heading_std * x.heading_std
    if x.azimuth != AZIMUTH_FIELD or k.learn_noise == 0.0:
        return level
    seen = x.heading_offset * x.heading_offset + x.P[E_HEADING][E_HEADING]
    least = PROVEN_SHARE * level
    if seen > level:
        return level
    return seen if seen > least else least


def decay(x: State, e: int, g: float, level: float) -> None:
    """Decay the Gauss-Markov error state e by the share g, towards its stationary variance.

    Within the first nine rows only the column is written: those are mirrored afterwards.
    """
    for j in range(N):
        x.P[j][e] -= g * x.P[j][e]
    for j in range(9, N):
        x.P[e][j] -= g * x.P[e][j]
    x.P[e][e] += g * (2.0 - g) * level


def write_transition(k: Parameters, m: Motion, dt: float, Phi: Square) -> None:
    """Write the Phi of the interval that P was just propagated over, shape (N, N).

    The filter never forms it; who goes back over the interval needs it.
    """
    for i in range(N):
        for j in range(N):
            Phi[i][j] = 0.0
        Phi[i][i] = 1.0
    for i in range(3):
        Phi[E_POS + i][E_VEL + i] = dt
        for j in range(3):
            s = m.S[i][j]
            g = m.G[i][j]
            b = m.SG[i][j]
            Phi[E_ATT + i][E_BG + j] = g
            Phi[E_VEL + i][E_ATT + j] = s
            Phi[E_VEL + i][E_BG + j] = b
            Phi[E_VEL + i][E_BA + j] = g
            Phi[E_POS + i][E_ATT + j] = 0.5 * dt * s
            Phi[E_POS + i][E_BG + j] = dt / 3.0 * b
            Phi[E_POS + i][E_BA + j] = 0.5 * dt * g
    faded = m.slow_dt
    Phi[E_HEADING][E_HEADING] = 1.0 - m.heading_faded
    for i in range(3):
        Phi[E_GNSS + i][E_GNSS + i] = 1.0 - faded / (faded + k.gnss_offset_time)
        Phi[E_GNSS_VEL + i][E_GNSS_VEL + i] = 1.0 - faded / (faded + k.gnss_vel_offset_time)
