"""GNSS: what a receiver should read at its antenna: position, height, velocity.

Source: Groves 2013, chapter 14.3 (lever arm).
"""

from __future__ import annotations

from cython import address
from cython.cimports.ekf_companion.core.aids import lever_arm
from cython.cimports.ekf_companion.core.filter.observation import add_timing_noise, clear
from cython.cimports.ekf_companion.core.filter.past import look_back, unevenness
from cython.cimports.ekf_companion.core.filter.rotation import wrap
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_BG,
    E_DELAY,
    E_GNSS,
    E_GNSS_VEL,
    E_POS,
    E_VEL,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import isnan


def way(x: State, o: Observation, axis: int) -> float:
    """Return the way of the antenna since the fix was true, m."""
    return o.then.late * (x.vel_n[axis] - 0.5 * o.then.since[axis] + o.arm_vel_n[axis])


def position(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe north and east of the antenna: two rows."""
    lat = fix.lat
    lon = fix.lon
    clear(o, 2, fix.std[0] * fix.std[0])
    add_timing_noise(o, k.timing_std * k.timing_std + fix.lag_var, x.vel_n)
    lever_arm.write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay - fix.lag, address(o.then))
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
    o.H[0][E_VEL] = -o.then.late
    o.H[0][E_POS] = 1.0
    o.H[0][E_GNSS] = 1.0
    o.H[0][E_DELAY] = -(x.vel_n[0] - o.then.since[0] + o.arm_vel_n[0])
    o.H[1][E_ATT] = -o.arm_n[2]
    o.H[1][E_ATT + 2] = o.arm_n[0]
    o.H[1][E_VEL + 1] = -o.then.late
    o.H[1][E_POS + 1] = 1.0
    o.H[1][E_GNSS + 1] = 1.0
    o.H[1][E_DELAY] = -(x.vel_n[1] - o.then.since[1] + o.arm_vel_n[1])


def height(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe the altitude of the antenna above mean sea level: one row, down."""
    clear(o, 1, fix.std[1] * fix.std[1])
    o.R[0][0] += (k.timing_std * k.timing_std + fix.lag_var) * x.vel_n[2] * x.vel_n[2]
    lever_arm.write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay - fix.lag, address(o.then))
    o.z[0] = (x.origin.alt - fix.alt) - (x.pos_n[2] + x.gnss_offset[2] + o.arm_n[2] - way(x, o, 2))
    o.H[0][E_ATT] = o.arm_n[1]
    o.H[0][E_ATT + 1] = -o.arm_n[0]
    o.H[0][E_VEL + 2] = -o.then.late
    o.H[0][E_POS + 2] = 1.0
    o.H[0][E_GNSS + 2] = 1.0
    o.H[0][E_DELAY] = -(x.vel_n[2] - o.then.since[2] + o.arm_vel_n[2])


def velocity(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Observe the velocity of the antenna: two rows, or three where the fix has a down."""
    clear(o, 2 if isnan(fix.vel_n[2]) else 3, fix.std[2] * fix.std[2])
    lever_arm.write_lever_arm(x, k, o)
    look_back(x, x.gnss_delay, address(o.then))
    add_timing_noise(o, k.timing_std * k.timing_std, o.then.accel_n)
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
