"""Optical flow: how fast the ground passes below, as angular rates across a camera's image.

The rate of a point straight below is that of the camera's own turn and its velocity over its
height. The turn is taken off by the sensor's gyro or, where it has none, by ours at the middle of
its interval. The height is that over the ground which the range finder has found or, without one,
over where the vehicle last stood: over a hill or a roof that is wrong, and with it the velocity.

A scale (focal length, height), a turn of the camera about its axis and a constant rate are slow
errors: beside a receiver they are learnt, and without one the velocity is no surer than they are.
Height, bias of the height and the ground are taken as they are: a flow corrects no height, which a
wrong sign or scale would lead away.

Source: the field of a plane's motion: Longuet-Higgins and Prazdny 1980; as ArduPilot's EKF3 and
PX4's EKF2 use it.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import reset_variance
from cython.cimports.ekf_companion.core.memory.constants import NAN, UPRIGHT
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_OPTICAL_FLOW,
    AID_RANGE_FINDER,
    E_ATT,
    E_BG,
    E_OPTICAL_FLOW,
    E_POS,
    E_RANGE_FINDER,
    E_VEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, fabs, isnan, sin

from ekf_companion.core.memory.aid import Kept, SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

SCALE_STD = cython.declare(cython.int, 0)
TURN_STD = cython.declare(cython.int, 1)
BIAS_STD = cython.declare(cython.int, 2)
LEVER_ARM = cython.declare(cython.int, 3)
TURN = cython.declare(cython.int, 6)
LEAST_QUALITY = cython.declare(cython.int, 7)
LOWEST = cython.declare(cython.int, 8)
"""Places of the settings."""
TURNING = cython.declare(cython.double, 0.1)
"""Share of a rate of turn that remains in the flow: of the axes, of the gyro's scale and time. Of a
PX4FLOW on a quadrotor 0.03 of roll and pitch and 0.15 of yaw."""
RELIEF = cython.declare(cython.double, 0.3)
"""One sigma of how much higher or lower the ground is than where the vehicle last stood, m: of a
field."""
SAME_ERROR = cython.declare(cython.double, 50.0)
"""Readings whose error by the height is one and the same: 5 s at 10 Hz."""
LARGEST_SCALE = cython.declare(cython.double, 0.6)
"""A scale that is further from 1 is none of a camera that sees the ground: it is refused."""
FEWEST = cython.declare(cython.double, 20.0)
"""Innovations from which on they tell of the noise."""
LARGEST_SHARE = cython.declare(cython.double, 4.0)
"""Largest share that they may show: noise is understated at most three times, as a receiver's."""
KNOWN = cython.declare(cython.double, 0.5)
"""One sigma of the horizontal velocity, m/s, up to which it is known beside a flow: beyond, a first
reading would be believed whatever it says."""


FROZEN = cython.declare(cython.double, 1e9)
"""Time for which a camera that works cannot repeat a reading to the bit, ns: ten readings."""


@aid(
    Kind.FLOW,
    words="optical flow",
    sensor="optical flow sensor",
    advice="Look at its mounting (optical_flow.turn), its lens and the light, raise "
    "optical_flow.std, or optical_flow.use = false.",
    yields=True,
    is_tried=True,
    shows_velocity=True,
)
class OpticalFlow:
    """The rates of the ground across the image, by the axes of the sensor."""

    flow_x = Value("rad/s", -100.0, 100.0)
    flow_y = Value("rad/s", -100.0, 100.0)
    gyro_x = Value("rad/s", -100.0, 100.0, is_optional=True)
    gyro_y = Value("rad/s", -100.0, 100.0, is_optional=True)
    quality = Value("1", -1e-9, 1.000001, is_optional=True)
    std = Value("rad/s", 0.0, 100.0, is_optional=True)
    scale = SlowError("1", walk="scale_walk", speed_walk=None)
    turn = SlowError("rad", walk=None, speed_walk=None)
    bias_x = SlowError("rad/s", walk="bias_walk", speed_walk=None)
    bias_y = SlowError("rad/s", walk="bias_walk", speed_walk=None)
    last = Kept("rad/s", 2)
    changed_t = Kept("ns")


def ground(x: State) -> float:
    """Return how far down the ground is in n, m: the range finder's, or where it last stood."""
    return x.range_finder_ground if x.has_aid[AID_RANGE_FINDER] != 0.0 else x.ground


def ground_variance(x: State) -> float:
    """Return the variance of the height over it, m^2."""
    own = x.P[E_POS + 2][E_POS + 2]
    if x.has_aid[AID_RANGE_FINDER] == 0.0:
        return own + RELIEF * RELIEF
    e = E_RANGE_FINDER
    return own + x.P[e][e] - 2.0 * x.P[e][E_POS + 2]


def is_seen(x: State, k: Parameters, row: Vector) -> bool:
    """Return whether the ground can be seen, from a height that is known."""
    if x.mode != MODE_NAVIGATE:
        return False
    if x.has_aid[AID_RANGE_FINDER] == 0.0 and x.has_ground == 0.0:
        return False
    if not isnan(row[4]) and row[4] < k.aid[AID_OPTICAL_FLOW].own[LEAST_QUALITY]:
        return False
    c = 1.0 - 2.0 * (x.q_nb[1] * x.q_nb[1] + x.q_nb[2] * x.q_nb[2])
    height = ground(x) - x.pos_n[2]
    return c > UPRIGHT and height > k.aid[AID_OPTICAL_FLOW].own[LOWEST] and height > 0.0


def is_frozen(x: State, row: Vector) -> bool:
    """Return whether a flow that counts has repeated itself to the bit for long; keep it."""
    if row[0] != x.optical_flow_last[0] or row[1] != x.optical_flow_last[1]:
        x.optical_flow_last[0] = row[0]
        x.optical_flow_last[1] = row[1]
        x.optical_flow_changed_t = x.t
    return x.has_aid[AID_OPTICAL_FLOW] == 1.0 and x.t - x.optical_flow_changed_t > FROZEN


def noise_share(x: State) -> float:
    """Return how many times larger the noise is than is stated, by the innovations so far."""
    n = x.nis_n[AID_OPTICAL_FLOW]
    mean = x.nis_sum[AID_OPTICAL_FLOW] / n if n > FEWEST else 1.0
    mean = mean if mean < LARGEST_SHARE else LARGEST_SHARE
    return mean if mean > 1.0 else 1.0


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Take the slow errors for what is known of such sensors, while the velocity is known."""
    if not is_seen(x, k, row) or x.P[E_VEL][E_VEL] + x.P[E_VEL + 1][E_VEL + 1] > KNOWN * KNOWN:
        return False
    s = address(k.aid[AID_OPTICAL_FLOW])
    height = ground(x) - x.pos_n[2]
    x.optical_flow_scale = 0.0
    x.optical_flow_turn = 0.0
    x.optical_flow_bias_x = 0.0
    x.optical_flow_bias_y = 0.0
    scale = s.own[SCALE_STD] * s.own[SCALE_STD] + ground_variance(x) / (height * height)
    reset_variance(x, E_OPTICAL_FLOW, 1, scale)
    reset_variance(x, E_OPTICAL_FLOW + 1, 1, s.own[TURN_STD] * s.own[TURN_STD])
    reset_variance(x, E_OPTICAL_FLOW + 2, 2, s.own[BIAS_STD] * s.own[BIAS_STD])
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the velocity over the height along the sensor's axes, less its turn: two rows."""
    frozen = cython.declare(cython.bint, is_frozen(x, row))
    if not is_seen(x, k, row):
        return False
    s = address(k.aid[AID_OPTICAL_FLOW])
    has_gyro = cython.declare(cython.bint, not isnan(row[2]) and not isnan(row[3]))
    to_dcm(x.q_nb, o.C_nb)
    c = o.C_nb[2][2]
    rate = c / (ground(x) - x.pos_n[2])
    for i in range(3):
        o.gain[i] = x.gyro[i] - x.gyro_bias[i]
    # the velocity of the sensor beside that of the body
    arm_x = o.gain[1] * s.own[LEVER_ARM + 2] - o.gain[2] * s.own[LEVER_ARM + 1]
    arm_y = o.gain[2] * s.own[LEVER_ARM] - o.gain[0] * s.own[LEVER_ARM + 2]
    angle = s.own[TURN] + x.optical_flow_turn
    ca = cos(angle)
    sa = sin(angle)
    scale = (1.0 + x.optical_flow_scale) * rate
    std = s.std
    if not isnan(row[5]) and row[5] > std:
        std = row[5]
    if not isnan(row[4]):
        std /= row[4] if row[4] > 0.1 else 0.1
    turning = 0.0
    for i in range(3):
        turning += o.gain[i] * o.gain[i]
    clear(o, 2, (std * std + TURNING * TURNING * turning) * noise_share(x))
    high = SAME_ERROR * ground_variance(x) * rate * rate / (c * c)
    # flow x is that to the left, flow y that forward, by the sensor's axes
    for r in range(2):
        bx = sa if r == 0 else ca
        by = -ca if r == 0 else sa
        along = bx * arm_x + by * arm_y
        across = -by * arm_x + bx * arm_y
        for i in range(3):
            o.y[i] = bx * o.C_nb[i][0] + by * o.C_nb[i][1]
            along += o.y[i] * x.vel_n[i]
            across += (-by * o.C_nb[i][0] + bx * o.C_nb[i][1]) * x.vel_n[i]
        if has_gyro:
            own_turn = row[2 + r]
        else:
            # the sensor's x axis is (ca, sa), its y axis (-sa, ca)
            own_turn = ca * o.gain[0] + sa * o.gain[1]
            if r == 1:
                own_turn = ca * o.gain[1] - sa * o.gain[0]
        bias = x.optical_flow_bias_x if r == 0 else x.optical_flow_bias_y
        o.z[r] = row[r] - (scale * along + own_turn + bias)
        for i in range(3):
            o.H[r][E_VEL + i] = scale * o.y[i]
        # theta turns the axes against the motion, and the way down to the ground
        o.H[r][E_ATT] = scale * (o.y[1] * x.vel_n[2] - o.y[2] * x.vel_n[1])
        o.H[r][E_ATT + 1] = scale * (o.y[2] * x.vel_n[0] - o.y[0] * x.vel_n[2])
        o.H[r][E_ATT + 2] = scale * (o.y[0] * x.vel_n[1] - o.y[1] * x.vel_n[0])
        o.H[r][E_ATT] += scale * along * o.C_nb[1][2] / c
        o.H[r][E_ATT + 1] -= scale * along * o.C_nb[0][2] / c
        o.H[r][E_OPTICAL_FLOW] = rate * along
        o.H[r][E_OPTICAL_FLOW + 1] = scale * across
        o.H[r][E_OPTICAL_FLOW + 2 + r] = 1.0
        # the gyro's bias turns the arm, and is in our own turn
        o.H[r][E_BG] = scale * by * s.own[LEVER_ARM + 2]
        o.H[r][E_BG + 1] = -scale * bx * s.own[LEVER_ARM + 2]
        o.H[r][E_BG + 2] = scale * (bx * s.own[LEVER_ARM + 1] - by * s.own[LEVER_ARM])
        if not has_gyro:
            o.H[r][E_BG] -= ca if r == 0 else -sa
            o.H[r][E_BG + 1] -= sa if r == 0 else ca
            o.H[r][E_OPTICAL_FLOW + 1] += (
                ca * o.gain[1] - sa * o.gain[0] if r == 0 else -sa * o.gain[1] - ca * o.gain[0]
            )
            for i in range(2):
                o.R[r][r] += x.noise[i] / x.dt if x.dt > 0.0 else 0.0
        o.R[r][r] += high * scale * along * scale * along
    if frozen or fabs(x.optical_flow_scale) > LARGEST_SCALE:
        o.z[0] = NAN
    return True
