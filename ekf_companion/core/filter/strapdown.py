"""Strapdown equations: attitude, velocity and position over one inertial interval.

Source: Groves 2013, chapter 5; Savage 1998 (coning and sculling).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import rotate, rotate_body, to_dcm
from cython.cimports.ekf_companion.core.memory.constants import EARTH_RATE
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, sin, sqrt

# WGS-84, as in nav.earth
A = cython.declare(cython.double, 6378137.0)
E2 = cython.declare(cython.double, 6.69437999014131705734e-3)
G_EQUATOR = cython.declare(cython.double, 9.7803253359)
SOMIGLIANA = cython.declare(cython.double, 0.00193185265241)
FREE_AIR = cython.declare(cython.double, 3.0877e-6)
SMOOTH = cython.declare(cython.double, 0.05)
"""s; time constant of the acceleration, of which one sample has too much noise."""


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


def forget_pending(x: State) -> None:
    """Begin to gather anew what P is to be carried on by."""
    p = address(x.pending)
    p.dt = 0.0
    for i in range(3):
        p.dv_n[i] = 0.0
        for j in range(3):
            p.C_nb_dt[i][j] = 0.0


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
