"""Wheels: how fast a ground vehicle rolls, and that it moves along its own axis.

The wheels measure the speed along their axis, times a scale: of a radius that is taken wrong, of
tyres, of tracks that slip. A vehicle on wheels moves neither sideways nor up, but for what slips
and gives way. The first reading in motion, while the velocity is known, shows the scale.

Source: odometer and non-holonomic constraints: Groves 2013, sections 6.3 and 15.4; Dissanayake et
al. 2001, IEEE Trans. Robotics and Automation 17, 731.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import add_error, reset_variance
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_WHEEL,
    E_ATT,
    E_BG,
    E_VEL,
    E_WHEEL,
    MODE_NAVIGATE,
    VEHICLE_GROUND,
    VEHICLE_UNKNOWN,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, isnan, sin

from ekf_companion.core.memory.aid import SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

SLIP = cython.declare(cython.Py_ssize_t, 0)
"""Places of the settings."""
ACROSS = cython.declare(cython.Py_ssize_t, 1)
LEVER_ARM = cython.declare(cython.Py_ssize_t, 2)
YAW = cython.declare(cython.Py_ssize_t, 5)
INTERVAL = cython.declare(cython.double, 1e9)
"""Of readings whose noise is as it is set, ns: what slips does so for a second or so."""
KNOWN = cython.declare(cython.double, 0.1)
"""Largest sigma of the velocity, as a share of the speed, that shows the scale at first."""
LARGEST_SCALE = cython.declare(cython.double, 2.0)
"""Ratio of the wheels' speed and the estimated one beyond which one of them is no speed of this
vehicle: another unit, the wheels of another axle."""
ASKEW = cython.declare(cython.double, 0.05)
"""One sigma of how the sensor is turned in the vehicle, and that on its springs, rad: 3 deg."""
SLIP_BY_FORCE = cython.declare(cython.double, 0.01)
"""Slip angle of tyres by the acceleration across, rad per m/s^2: cornering stiffness over mass is
60 to 120 m/s^2 per rad of cars on dry road, e.g. Wong 2008, chapter 1; half of that off it."""


@aid(
    Kind.WHEEL,
    words="wheel speed",
    sensor="wheel encoder",
    advice="Look at encoders and wheels, raise wheel.std or wheel.slip, or wheel.use = false.",
    patience=5,
    yields=True,
)
class Wheel:
    """The speed along the vehicle's axis, and that it has none across."""

    speed = Value("m/s", -100.0, 100.0)
    std = Value("m/s", 0.0, 100.0, is_optional=True)
    scale = SlowError("1", "scale_walk", speed_walk=None)


def is_rolling(x: State, k: Parameters) -> bool:
    """Return whether the vehicle may be one that rolls, and navigates."""
    kind = x.vehicle if k.vehicle == VEHICLE_UNKNOWN else k.vehicle
    if kind != VEHICLE_GROUND and kind != VEHICLE_UNKNOWN:
        return False
    return x.mode == MODE_NAVIGATE and x.needs_reset == 0.0


def repeated(x: State) -> float:
    """Return by how much readings that come faster than slip changes say the same again."""
    share = (x.t - x.used_t[AID_WHEEL]) / INTERVAL
    return 1.0 / share if 0.0 < share < 1.0 else 1.0


def variance(k: Parameters, row: Vector, speed: float) -> float:
    """Return the variance of the wheels' speed, (m/s)^2: white noise, and slip."""
    std = k.aid[AID_WHEEL].std
    if not isnan(row[1]) and row[1] > std:
        std = row[1]
    slip = k.aid[AID_WHEEL].own[SLIP] * speed
    return std * std + slip * slip


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Find the scale by the estimated velocity."""
    if not is_rolling(x, k):
        return False
    w = x.q_nb[0]
    bx = x.q_nb[1]
    by = x.q_nb[2]
    bz = x.q_nb[3]
    c = cos(k.aid[AID_WHEEL].own[YAW])
    s = sin(k.aid[AID_WHEEL].own[YAW])
    n = c * (1.0 - 2.0 * (by * by + bz * bz)) + s * 2.0 * (bx * by - w * bz)
    e = c * 2.0 * (bx * by + w * bz) + s * (1.0 - 2.0 * (bx * bx + bz * bz))
    d = c * 2.0 * (bx * bz - w * by) + s * 2.0 * (by * bz + w * bx)
    vn = x.vel_n[0]
    ve = x.vel_n[1]
    vd = x.vel_n[2]
    speed = n * vn + e * ve + d * vd + c * arm_velocity(x, k, 0) + s * arm_velocity(x, k, 1)
    known = x.P[E_VEL][E_VEL] + x.P[E_VEL + 1][E_VEL + 1] + x.P[E_VEL + 2][E_VEL + 2]
    if not known < KNOWN * KNOWN * speed * speed:
        return False
    ratio = row[0] / speed
    if ratio > LARGEST_SCALE or ratio * LARGEST_SCALE < 1.0:
        return False
    x.wheel_scale = ratio - 1.0
    reset_variance(x, E_WHEEL, 1, variance(k, row, speed) / (speed * speed))
    by_speed = -ratio / speed
    add_error(x, E_WHEEL, E_VEL, by_speed * n)
    add_error(x, E_WHEEL, E_VEL + 1, by_speed * e)
    add_error(x, E_WHEEL, E_VEL + 2, by_speed * d)
    add_error(x, E_WHEEL, E_ATT, by_speed * (e * vd - d * ve))
    add_error(x, E_WHEEL, E_ATT + 1, by_speed * (d * vn - n * vd))
    add_error(x, E_WHEEL, E_ATT + 2, by_speed * (n * ve - e * vn))
    return True


def arm_velocity(x: State, k: Parameters, axis: int) -> float:
    """Return the velocity along an axis of the body that the lever arm has from the turn, m/s."""
    i = axis + 1 if axis < 2 else 0
    j = 3 - axis - i
    arm = k.aid[AID_WHEEL].own
    rate_i = x.gyro[i] - x.gyro_bias[i]
    rate_j = x.gyro[j] - x.gyro_bias[j]
    return rate_i * arm[LEVER_ARM + j] - rate_j * arm[LEVER_ARM + i]


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the speed along the wheels' axis, and none across and up: one row or three."""
    if not is_rolling(x, k):
        return False
    across = k.aid[AID_WHEEL].own[ACROSS]
    slip = k.aid[AID_WHEEL].own[SLIP]
    c = cos(k.aid[AID_WHEEL].own[YAW])
    s = sin(k.aid[AID_WHEEL].own[YAW])
    clear(o, 3 if across > 0.0 else 1, 0.0)
    to_dcm(x.q_nb, o.C_nb)
    for r in range(o.rows):
        # the wheels' axes by the body's
        ahead = c if r == 0 else -s
        right = s if r == 0 else c
        if r == 2:
            ahead = 0.0
            right = 0.0
        below = 1.0 if r == 2 else 0.0
        n = ahead * o.C_nb[0][0] + right * o.C_nb[0][1] + below * o.C_nb[0][2]
        e = ahead * o.C_nb[1][0] + right * o.C_nb[1][1] + below * o.C_nb[1][2]
        d = ahead * o.C_nb[2][0] + right * o.C_nb[2][1] + below * o.C_nb[2][2]
        vn = x.vel_n[0]
        ve = x.vel_n[1]
        vd = x.vel_n[2]
        o.y[r] = n * vn + e * ve + d * vd + below * arm_velocity(x, k, 2)
        o.y[r] += ahead * arm_velocity(x, k, 0) + right * arm_velocity(x, k, 1)
        scale = 1.0 + x.wheel_scale if r == 0 else 1.0
        o.z[r] = -scale * o.y[r]
        o.H[r][E_VEL] = scale * n
        o.H[r][E_VEL + 1] = scale * e
        o.H[r][E_VEL + 2] = scale * d
        # theta turns the axis against the velocity: axis x v
        o.H[r][E_ATT] = scale * (e * vd - d * ve)
        o.H[r][E_ATT + 1] = scale * (d * vn - n * vd)
        o.H[r][E_ATT + 2] = scale * (n * ve - e * vn)
        # a gyro bias is a turn that is none: axis x arm
        arm = k.aid[AID_WHEEL].own
        o.H[r][E_BG] = scale * (right * arm[LEVER_ARM + 2] - below * arm[LEVER_ARM + 1])
        o.H[r][E_BG + 1] = scale * (below * arm[LEVER_ARM] - ahead * arm[LEVER_ARM + 2])
        o.H[r][E_BG + 2] = scale * (ahead * arm[LEVER_ARM + 1] - right * arm[LEVER_ARM])
    speed = o.y[0]
    turning = SLIP_BY_FORCE * speed * (x.gyro[2] - x.gyro_bias[2]) * speed
    o.z[0] += row[0]
    o.H[0][E_WHEEL] = speed
    again = repeated(x)
    beside = across * across + (slip * slip + ASKEW * ASKEW) * speed * speed
    o.R[0][0] = again * variance(k, row, speed)
    if o.rows == 3:
        o.R[1][1] = again * (beside + turning * turning)
        o.R[2][2] = again * beside
    return True
