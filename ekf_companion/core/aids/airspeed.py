"""Airspeed: how fast the vehicle moves through the air, which the wind carries along.

A pitot tube measures the speed against the air, so velocity less wind, times a scale. Of a fixed
wing in flight it is known besides that the air comes from ahead, but for some sideslip. So while
the velocity is known the wind is learnt, and afterwards it and the airspeed hold the velocity. The
first reading finds the wind by the heading; turns tell wind, scale and heading apart.

The wind is taken to be level, and the same wherever the vehicle is. On the ground and below a least
airspeed nothing counts.

Source: the observations of wind-relative velocity of PX4's EKF2 and ArduPilot's EKF3; true and
equivalent airspeed: ISO 2533, standard atmosphere.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import (
    add_covariance,
    add_error,
    add_variance,
    copy_error,
    reset_variance,
)
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_AIRSPEED,
    E_AIRSPEED,
    E_ATT,
    E_VEL,
    MODE_NAVIGATE,
    VEHICLE_FIXED_WING,
    VEHICLE_UNKNOWN,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import acos, atan2, cos, fabs, isnan, pow, sin, sqrt

from ekf_companion.core.memory.aid import SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

SCALE = cython.declare(cython.Py_ssize_t, 0)
"""Places of the settings: one sigma of the scale at first."""
LEAST_SPEED = cython.declare(cython.Py_ssize_t, 1)
SIDESLIP = cython.declare(cython.Py_ssize_t, 2)
ANY_SIDE = cython.declare(cython.double, 0.5)
"""One sigma of the sideslip, rad, of a vehicle that may roll, and for the first wind of any: by a
crosswind of half the speed."""
UPRIGHT = cython.declare(cython.double, 0.5)
"""Least cosine of the tilt at which the first wind is found: 60 deg, a steep turn."""
LOW = cython.declare(cython.double, 5.0)
"""Height above the last rest below which the vehicle may roll, m: then crosswind is sideslip."""
KNOWN = cython.declare(cython.double, 3.0)
"""One sigma of the wind, both axes together, up to which it is known, m/s: it took over ten minutes
without a reading that fits to know less."""
FARTHEST = cython.declare(cython.double, 3.0)
"""Largest scale, of its first sigma."""
STRONGEST = cython.declare(cython.double, 10.0)
"""Wind in which no fixed wing is flown, m/s, beside a share of its airspeed: another unit."""
WINDY = cython.declare(cython.double, 0.3)
MOVING = cython.declare(cython.double, 2.0)
"""Speed from which a vehicle flies that does not say so, m/s."""
INTERVAL = cython.declare(cython.double, 1e8)
"""Of readings whose noise is as it is set, ns: both autopilots fuse ten a second. In two flights an
airspeed leaves 0.57 and 0.8 m/s of the motion, over some 0.6 s the same."""
LAPSE = cython.declare(cython.double, 2.25577e-5)
"""Of the standard atmosphere below 11 km: lapse rate over temperature at sea level, 1/m."""
DENSITY_POWER = cython.declare(cython.double, 4.25588)
"""Its density is by this power of the temperature."""
HIGHEST = cython.declare(cython.double, 11000.0)
"""m."""


@aid(
    Kind.AIRSPEED,
    words="airspeed",
    sensor="airspeed sensor",
    advice="Look at the pitot tube and its hoses, raise airspeed.std, or airspeed.use = false.",
    stuck_after=2.0,
    patience=5,
)
class Airspeed:
    """The speed against the air, and of a fixed wing that the air comes from ahead."""

    airspeed = Value("m/s", -100.0, 400.0)
    std = Value("m/s", 0.0, 100.0, is_optional=True)
    is_indicated = Value("1", -1.0, 2.0, is_optional=True)
    wind_n = SlowError("m/s", "wind_walk", speed_walk=None, climb_walk="wind_climb_walk")
    wind_e = SlowError("m/s", "wind_walk", speed_walk=None, climb_walk="wind_climb_walk")
    scale = SlowError("1", "scale_walk", speed_walk=None)


def vehicle_type(x: State, k: Parameters) -> float:
    """Return how the vehicle moves: as it is set, or as the autopilot reports it."""
    return x.vehicle if k.vehicle == VEHICLE_UNKNOWN else k.vehicle


def is_flying(x: State, k: Parameters) -> bool:
    """Return whether the vehicle flies, and may do so on wings."""
    kind = vehicle_type(x, k)
    if kind != VEHICLE_FIXED_WING and kind != VEHICLE_UNKNOWN:
        return False
    if x.mode != MODE_NAVIGATE or x.needs_reset != 0.0 or x.at_rest != 0.0:
        return False
    if x.landed == 1.0 or x.armed == 0.0:
        return False
    moving = x.vel_n[0] * x.vel_n[0] + x.vel_n[1] * x.vel_n[1] + x.vel_n[2] * x.vel_n[2]
    return x.armed == 1.0 or moving > MOVING * MOVING


def sideslip(x: State, k: Parameters) -> float:
    """Return one sigma of the sideslip, rad; 0: nothing is assumed of it.

    Near the height of the last rest a vehicle may roll, unless it says that it flies.
    """
    std = k.aid[AID_AIRSPEED].own[SIDESLIP]
    if vehicle_type(x, k) != VEHICLE_FIXED_WING:
        return 0.0
    is_low = cython.declare(cython.bint, x.has_ground != 0.0 and fabs(x.ground - x.pos_n[2]) < LOW)
    if is_low and x.landed != 0.0 and 0.0 < std < ANY_SIDE:
        return ANY_SIDE
    return std


def is_plausible(x: State, k: Parameters) -> bool:
    """Return whether the scale can be one: else it is another unit, or no pitot tube at all."""
    return fabs(x.airspeed_scale) <= FARTHEST * k.aid[AID_AIRSPEED].own[SCALE]


def true_airspeed(x: State, row: Vector) -> float:
    """Return the true airspeed: an indicated one by the standard air's density at this height."""
    alt = x.origin.alt - x.pos_n[2]
    if not row[2] > 0.5 or alt > HIGHEST:
        return row[0]
    return row[0] / sqrt(pow(1.0 - LAPSE * alt, DENSITY_POWER))


def repeated(x: State) -> float:
    """Return by how much readings that come faster than gusts change say the same again."""
    share = (x.t - x.used_t[AID_AIRSPEED]) / INTERVAL
    return 1.0 / share if 0.0 < share < 1.0 else 1.0


def variance(k: Parameters, row: Vector) -> float:
    """Return the variance of the airspeed's white noise, (m/s)^2."""
    std = k.aid[AID_AIRSPEED].std
    if not isnan(row[1]) and row[1] > std:
        std = row[1]
    return std * std


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Find the wind by velocity, airspeed and heading, as if there were no sideslip."""
    speed = true_airspeed(x, row)
    down = x.vel_n[2]
    if not is_flying(x, k) or x.has_yaw == 0.0 or speed < k.aid[AID_AIRSPEED].own[LEAST_SPEED]:
        return False
    # a sensor that contradicts a wind that is known is wrong: it does not find another one
    known = x.P[E_AIRSPEED][E_AIRSPEED] + x.P[E_AIRSPEED + 1][E_AIRSPEED + 1]
    if x.has_aid[AID_AIRSPEED] != 0.0 and known < KNOWN * KNOWN:
        return False
    w = x.q_nb[0]
    bx = x.q_nb[1]
    by = x.q_nb[2]
    bz = x.q_nb[3]
    # the body's right axis in n
    right_n = 2.0 * (bx * by - w * bz)
    right_e = w * w - bx * bx + by * by - bz * bz
    right_d = 2.0 * (by * bz + w * bx)
    level = sqrt(right_n * right_n + right_e * right_e)
    if 1.0 - 2.0 * (bx * bx + by * by) < UPRIGHT or speed < 2.0 * fabs(down):
        return False
    # the level direction in which the vehicle moves through the air, so that none is from its side
    through = sqrt(speed * speed - down * down)
    beside = -down * right_d / (level * through)
    if fabs(beside) > 0.5:
        return False
    course = atan2(right_e, right_n) - acos(beside)
    n = cos(course)
    e = sin(course)
    wind_n = x.vel_n[0] - through * n
    wind_e = x.vel_n[1] - through * e
    if sqrt(wind_n * wind_n + wind_e * wind_e) > STRONGEST + WINDY * speed:
        return False
    x.airspeed_wind_n = wind_n
    x.airspeed_wind_e = wind_e
    x.airspeed_scale = 0.0

    side = sideslip(x, k)
    if side == 0.0:
        side = ANY_SIDE
    along = variance(k, row) * (speed / through) * (speed / through)
    across = through * through * side * side
    scale = k.aid[AID_AIRSPEED].own[SCALE]
    reset_variance(x, E_AIRSPEED + 2, 1, scale * scale)
    copy_error(x, E_AIRSPEED, E_VEL, 0.0)
    copy_error(x, E_AIRSPEED + 1, E_VEL + 1, 0.0)
    add_error(x, E_AIRSPEED, E_ATT + 2, through * e)
    add_error(x, E_AIRSPEED + 1, E_ATT + 2, -through * n)
    add_error(x, E_AIRSPEED, E_VEL + 2, down / through * n)
    add_error(x, E_AIRSPEED + 1, E_VEL + 2, down / through * e)
    add_error(x, E_AIRSPEED, E_AIRSPEED + 2, speed * speed / through * n)
    add_error(x, E_AIRSPEED + 1, E_AIRSPEED + 2, speed * speed / through * e)
    add_variance(x, E_AIRSPEED, n * n * along + e * e * across)
    add_variance(x, E_AIRSPEED + 1, e * e * along + n * n * across)
    add_covariance(x, E_AIRSPEED, E_AIRSPEED + 1, n * e * (along - across))
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the airspeed, and of a fixed wing that none is from the side: one row or two."""
    measured = true_airspeed(x, row)
    least = k.aid[AID_AIRSPEED].own[LEAST_SPEED]
    vn = x.vel_n[0] - x.airspeed_wind_n
    ve = x.vel_n[1] - x.airspeed_wind_e
    vd = x.vel_n[2]
    speed = sqrt(vn * vn + ve * ve + vd * vd)
    if not is_flying(x, k) or speed < least or not is_plausible(x, k):
        return False
    scale = 1.0 + x.airspeed_scale
    again = repeated(x)
    clear(o, 1, again * variance(k, row))
    o.z[0] = measured - scale * speed
    o.H[0][E_VEL] = scale * vn / speed
    o.H[0][E_VEL + 1] = scale * ve / speed
    o.H[0][E_VEL + 2] = scale * vd / speed
    o.H[0][E_AIRSPEED] = -scale * vn / speed
    o.H[0][E_AIRSPEED + 1] = -scale * ve / speed
    o.H[0][E_AIRSPEED + 2] = speed
    side = sideslip(x, k)
    if side > 0.0:
        observe_sideslip(x, o, vn, ve, vd, side * side * speed * speed * again)
    return True


def observe_sideslip(
    x: State, o: Observation, vn: float, ve: float, vd: float, square: float
) -> None:
    """Add the row of no velocity through the air along the body's right axis."""
    to_dcm(x.q_nb, o.C_nb)
    right_n = o.C_nb[0][1]
    right_e = o.C_nb[1][1]
    right_d = o.C_nb[2][1]
    o.rows = 2
    for i in range(N):
        o.H[1][i] = 0.0
    o.R[0][1] = 0.0
    o.R[1][0] = 0.0
    o.R[1][1] = square
    o.z[1] = -(right_n * vn + right_e * ve + right_d * vd)
    o.H[1][E_VEL] = right_n
    o.H[1][E_VEL + 1] = right_e
    o.H[1][E_VEL + 2] = right_d
    o.H[1][E_AIRSPEED] = -right_n
    o.H[1][E_AIRSPEED + 1] = -right_e
    # theta turns the body against the air: right x v
    o.H[1][E_ATT] = right_e * vd - right_d * ve
    o.H[1][E_ATT + 1] = right_d * vn - right_n * vd
    o.H[1][E_ATT + 2] = right_n * ve - right_e * vn
