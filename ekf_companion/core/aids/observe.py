"""What each sensor should read, and how that depends on the error: innovation, H and R.

Each function fills an :class:`~.scratch.Observation` for :func:`.update.innovate`.

Source: Groves 2013, chapter 14.3 (GNSS with lever arm) and 6.1 (magnetic heading).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import lever_arm
from cython.cimports.ekf_companion.core.filter.past import look_back, unevenness
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm, wrap
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_BARO,
    E_BG,
    E_DELAY,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_IRON,
    E_POS,
    E_VEL,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation
from cython.cimports.ekf_companion.core.memory.state import Reference, State
from cython.cimports.libc.math import atan2, cos, fabs, isnan, sin, sqrt

EARTH_RATE = cython.declare(cython.double, 7.292115e-5)
"""rad/s."""
STEEPEST_DIP = cython.declare(cython.double, 1.5)
"""Dip beyond which the horizontal field of the model is as uncertain as it is small, rad."""


def clear(o: Observation, rows: int, variance: float) -> None:
    """Begin an observation: H is zero, R diagonal, and it does not move the delay."""
    o.rows = rows
    o.shows_delay = 0
    for r in range(rows):
        for i in range(N):
            o.H[r][i] = 0.0
        for c in range(rows):
            o.R[r][c] = 0.0
        o.R[r][r] = variance


def add_timing_noise(o: Observation, k: Parameters, rate: Vector) -> None:
    """Add to R the effect of a timing error on quantities that change at these rates, one a row."""
    for r in range(o.rows):
        for c in range(o.rows):
            o.R[r][c] += k.timing_std * k.timing_std * rate[r] * rate[c]


def write_lever_arm(x: State, k: Parameters, o: Observation) -> None:
    """Write the lever arm in n, and the velocity that the antenna has from the turn."""
    lx = k.lever_arm_b[0]
    ly = k.lever_arm_b[1]
    lz = k.lever_arm_b[2]
    wx = x.gyro[0] - x.gyro_bias[0]
    wy = x.gyro[1] - x.gyro_bias[1]
    wz = x.gyro[2] - x.gyro_bias[2]
    vx = wy * lz - wz * ly
    vy = wz * lx - wx * lz
    vz = wx * ly - wy * lx
    to_dcm(x.q_nb, o.C_nb)
    for i in range(3):
        o.turn_nb[i][0] = o.C_nb[i][1] * wz - o.C_nb[i][2] * wy
        o.turn_nb[i][1] = o.C_nb[i][2] * wx - o.C_nb[i][0] * wz
        o.turn_nb[i][2] = o.C_nb[i][0] * wy - o.C_nb[i][1] * wx
        o.arm_n[i] = o.C_nb[i][0] * lx + o.C_nb[i][1] * ly + o.C_nb[i][2] * lz
        o.arm_vel_n[i] = o.C_nb[i][0] * vx + o.C_nb[i][1] * vy + o.C_nb[i][2] * vz


def way(x: State, o: Observation, axis: int) -> float:
    """Return the way of the antenna since the fix was true, m."""
    return x.gnss_delay * (x.vel_n[axis] - 0.5 * o.then.since[axis] + o.arm_vel_n[axis])


def position(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe north and east of the antenna: two rows."""
    lat = fix.lat
    lon = fix.lon
    clear(o, 2, fix.std[0] * fix.std[0])
    add_timing_noise(o, k, x.vel_n)
    write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay, address(o.then))
    o.shows_delay = k.use_velocity == 0.0 or isnan(fix.vel_n[0])
    o.z[0] = (lat - x.origin.lat) * x.origin.scale_n - (
        x.pos_n[0] + x.gnss_offset[0] + o.arm_n[0] - way(x, o, 0)
    )
    o.z[1] = wrap(lon - x.origin.lon) * x.origin.scale_e - (
        x.pos_n[1] + x.gnss_offset[1] + o.arm_n[1] - way(x, o, 1)
    )
    # theta turns the lever arm r: theta x r
    o.H[0][E_ATT + 1] = o.arm_n[2]
    o.H[0][E_ATT + 2] = -o.arm_n[1]
    o.H[0][E_VEL] = -x.gnss_delay
    o.H[0][E_POS] = 1.0
    o.H[0][E_GNSS] = 1.0
    o.H[0][E_DELAY] = -(x.vel_n[0] - o.then.since[0] + o.arm_vel_n[0])
    o.H[1][E_ATT] = -o.arm_n[2]
    o.H[1][E_ATT + 2] = o.arm_n[0]
    o.H[1][E_VEL + 1] = -x.gnss_delay
    o.H[1][E_POS + 1] = 1.0
    o.H[1][E_GNSS + 1] = 1.0
    o.H[1][E_DELAY] = -(x.vel_n[1] - o.then.since[1] + o.arm_vel_n[1])


def height(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe the altitude of the antenna above mean sea level: one row, down."""
    clear(o, 1, fix.std[1] * fix.std[1])
    o.R[0][0] += k.timing_std * k.timing_std * x.vel_n[2] * x.vel_n[2]
    write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay, address(o.then))
    o.z[0] = (x.origin.alt - fix.alt) - (x.pos_n[2] + x.gnss_offset[2] + o.arm_n[2] - way(x, o, 2))
    o.H[0][E_ATT] = o.arm_n[1]
    o.H[0][E_ATT + 1] = -o.arm_n[0]
    o.H[0][E_VEL + 2] = -x.gnss_delay
    o.H[0][E_POS + 2] = 1.0
    o.H[0][E_GNSS + 2] = 1.0
    o.H[0][E_DELAY] = -(x.vel_n[2] - o.then.since[2] + o.arm_vel_n[2])


def velocity(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe the velocity of the antenna: two rows, or three where the fix has a down."""
    clear(o, 2 if isnan(fix.vel_n[2]) else 3, fix.std[2] * fix.std[2])
    write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay, address(o.then))
    add_timing_noise(o, k, o.then.accel_n)
    lever_arm.add_noise(x, k, o)
    unevenness(x, o.uneven)
    for i in range(o.rows):
        o.uneven[i] *= k.learn_noise  # not beside a noise that is told
        o.R[i][i] += o.uneven[i]
        antenna = x.vel_n[i] + o.arm_vel_n[i] - o.then.since[i]
        o.z[i] = fix.vel_n[i] - (antenna + x.gnss_vel_offset[i])
        o.H[i][E_VEL + i] = 1.0
        o.H[i][E_GNSS_VEL + i] = 1.0
        o.H[i][E_DELAY] = -o.then.accel_n[i]
        # the gyro bias turns the lever arm: C (l x bg)
        o.H[i][E_BG] = o.C_nb[i][1] * k.lever_arm_b[2] - o.C_nb[i][2] * k.lever_arm_b[1]
        o.H[i][E_BG + 1] = o.C_nb[i][2] * k.lever_arm_b[0] - o.C_nb[i][0] * k.lever_arm_b[2]
        o.H[i][E_BG + 2] = o.C_nb[i][0] * k.lever_arm_b[1] - o.C_nb[i][1] * k.lever_arm_b[0]
    # theta turns the antenna's extra velocity u: theta x u
    o.H[0][E_ATT + 1] = o.arm_vel_n[2]
    o.H[0][E_ATT + 2] = -o.arm_vel_n[1]
    o.H[1][E_ATT] = -o.arm_vel_n[2]
    o.H[1][E_ATT + 2] = o.arm_vel_n[0]
    if o.rows == 3:
        o.H[2][E_ATT] = o.arm_vel_n[1]
        o.H[2][E_ATT + 1] = -o.arm_vel_n[0]


def zero_velocity(x: State, o: Observation, std: float) -> None:
    """Observe zero velocity with one sigma std, m/s: three rows."""
    clear(o, 3, std * std)
    for i in range(3):
        o.z[i] = -x.vel_n[i]
        o.H[i][E_VEL + i] = 1.0


def zero_rate(x: State, o: Observation, rate: Vector, level: float, vertical: float) -> None:
    """Observe that the gyro's rate at rest is its bias and the turning Earth: three rows.

    One sigma of the vehicle's own rate, and of noise, differs about level axes and the vertical.
    """
    north = 0.0
    down = 0.0
    clear(o, 3, level * level)
    to_dcm(x.q_nb, o.C_nb)
    for i in range(3):
        for j in range(3):
            o.R[i][j] += (vertical * vertical - level * level) * o.C_nb[2][i] * o.C_nb[2][j]
    if x.origin.is_known != 0.0:
        lat = x.origin.lat + x.pos_n[0] / x.origin.scale_n
        north = EARTH_RATE * cos(lat)
        down = -EARTH_RATE * sin(lat)
    for i in range(3):
        o.z[i] = rate[i] - (x.gyro_bias[i] + o.C_nb[0][i] * north + o.C_nb[2][i] * down)
        o.H[i][E_BG + i] = 1.0


def azimuth(x: State, o: Observation, r: Reference) -> bool:
    """Observe that a direction of the body points to an azimuth: one row.

    The forward axis gives a heading; the magnetic field less the vehicle's own gives a compass,
    levelled by the filter's own tilt. Its slow error is a state; ``r.std`` is the white rest, and
    ``r.noise`` that of the direction itself, which counts the more the steeper it is. Return False
    if the direction is too near the vertical.
    """
    clear(o, 1, 0.0)
    to_dcm(x.q_nb, o.C_nb)
    bx = r.direction_b[0]
    by = r.direction_b[1]
    bz = r.direction_b[2]
    if r.has_iron != 0.0:
        bx = bx - x.hard_iron[0]
        by = by - x.hard_iron[1]
        bz = bz - x.hard_iron[2]
    n = o.C_nb[0][0] * bx + o.C_nb[0][1] * by + o.C_nb[0][2] * bz
    e = o.C_nb[1][0] * bx + o.C_nb[1][1] * by + o.C_nb[1][2] * bz
    d = o.C_nb[2][0] * bx + o.C_nb[2][1] * by + o.C_nb[2][2] * bz
    h2 = n * n + e * e
    if h2 <= 0.01 * (h2 + d * d):
        return False
    o.z[0] = wrap(r.azimuth - atan2(e, n) - x.heading_offset)

    # The slopes of the field that should be, not of the one that its noise has made: yaw, tilt and
    # hard iron are each known far worse than their sum, and a slope that shakes tears them apart
    h = sqrt(h2)
    if r.has_iron != 0.0 and x.field.strength > 0.0 and fabs(x.field.inclination) < STEEPEST_DIP:
        h = x.field.strength * cos(x.field.inclination)
        d = x.field.strength * sin(x.field.inclination)
    n = cos(r.azimuth - x.heading_offset)
    e = sin(r.azimuth - x.heading_offset)
    o.H[0][E_ATT] = -n * d / h
    o.H[0][E_ATT + 1] = -e * d / h
    o.H[0][E_ATT + 2] = 1.0
    o.H[0][E_HEADING] = 1.0
    if r.has_iron != 0.0:
        for i in range(3):
            o.H[0][E_IRON + i] = (e * o.C_nb[0][i] - n * o.C_nb[1][i]) / h
    o.R[0][0] = r.std * r.std + r.noise * r.noise / (h * h)
    return True


def pressure_altitude(x: State, o: Observation, alt: float, std: float) -> None:
    """Observe the altitude of the standard atmosphere, which has a slow offset: one row."""
    clear(o, 1, std * std)
    o.z[0] = alt - (x.origin.alt - x.pos_n[2] + x.baro_offset)
    o.H[0][E_POS + 2] = -1.0
    o.H[0][E_BARO] = 1.0
