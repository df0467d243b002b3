"""Velocity of another estimator: in the body, or in a level frame of its own.

A velocity has no drift that grows with the way; its slow errors are the scale (of a single camera,
or of a flow whose height is wrong), the delay, and the yaw of its frame where it is not the body's.
Where the same estimator states its pose, which holds all of it, this counts only while that does
not.

Source: Groves 2013, chapter 16.2 (body-frame velocity aids).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.past import look_back
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import reset_variance
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_VISUAL_ODOMETRY,
    AID_VISUAL_VELOCITY,
    E_ATT,
    E_BG,
    E_VEL,
    E_VISUAL_VELOCITY,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, isnan, sin

from ekf_companion.core.memory.aid import Kept, SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

E_SCALE = cython.declare(cython.int, E_VISUAL_VELOCITY + 1)
E_LATE = cython.declare(cython.int, E_VISUAL_VELOCITY + 2)
YAW_STD = cython.declare(cython.int, 0)
SCALE_STD = cython.declare(cython.int, 1)
DELAY_STD = cython.declare(cython.int, 3)
LEVER_ARM = cython.declare(cython.int, 4)
TIMING_STD = cython.declare(cython.int, 7)
"""Places of its own settings."""
BESIDE_POSE = cython.declare(cython.double, 1e9)
"""Time after the last pose in which a velocity is not used, ns."""


@aid(
    Kind.VELOCITY,
    words="velocity of visual odometry",
    sensor="visual velocity",
    advice="Look at its quality, raise visual_velocity.std, or visual_velocity.use = false.",
    yields=True,
    shows_velocity=True,
)
class VisualVelocity:
    """Velocity in the body (forward, right, down), or in a frame whose down is down."""

    x = Value("m/s", -1e3, 1e3)
    y = Value("m/s", -1e3, 1e3)
    z = Value("m/s", -1e3, 1e3)
    std = Value("m/s", 0.0, 1e3, is_optional=True)
    is_level = Value("1", -0.5, 1.5, is_optional=True)
    frame_yaw = SlowError("rad", walk="yaw_walk", speed_walk=None)
    scale = SlowError("1", walk="scale_walk", speed_walk=None)
    delay = SlowError("s", walk="delay_walk", speed_walk=None)
    has_begun = Kept("1")
    learnt = Kept("rad^2, 1, s^2", 3)
    last = Kept("m/s", 3)
    then = Kept("m/s", 3)
    turn = Kept("rad/s", 3)
    arm = Kept("m/s", 3)


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Begin with what is set of scale, delay and frame; what was learnt of them stays."""
    own = k.aid[AID_VISUAL_VELOCITY].own
    if x.mode != MODE_NAVIGATE:
        return False
    if x.visual_velocity_has_begun == 0.0:
        x.visual_velocity_has_begun = 1.0
        x.visual_velocity_frame_yaw = 0.0
        x.visual_velocity_scale = 0.0
        x.visual_velocity_delay = 0.0
        reset_variance(x, E_VISUAL_VELOCITY, 1, own[YAW_STD] * own[YAW_STD])
        reset_variance(x, E_SCALE, 1, own[SCALE_STD] * own[SCALE_STD])
        reset_variance(x, E_LATE, 1, own[DELAY_STD] * own[DELAY_STD])
    elif x.P[E_SCALE][E_SCALE] < 0.5 * x.visual_velocity_learnt[1]:
        # the filter has started over
        for i in range(3):
            reset_variance(x, E_VISUAL_VELOCITY + i, 1, x.visual_velocity_learnt[i])
    return True


def is_frozen(x: State, row: Vector) -> bool:
    """Return whether a velocity repeats the one before to the bit; keep it."""
    same = cython.declare(cython.bint, x.at_rest == 0.0)
    for i in range(3):
        if row[i] != x.visual_velocity_last[i]:
            same = False
        x.visual_velocity_last[i] = row[i]
    return same


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the velocity of the sensor when it was true: three rows."""
    own = k.aid[AID_VISUAL_VELOCITY].own
    if x.mode != MODE_NAVIGATE or is_frozen(x, row):
        return False
    has_pose = cython.declare(cython.bint, x.has_aid[AID_VISUAL_ODOMETRY] != 0.0)
    if has_pose and x.t - x.used_t[AID_VISUAL_ODOMETRY] < BESIDE_POSE:
        return False
    for i in range(3):
        x.visual_velocity_learnt[i] = x.P[E_VISUAL_VELOCITY + i][E_VISUAL_VELOCITY + i]
    std = k.aid[AID_VISUAL_VELOCITY].std
    if not isnan(row[3]) and row[3] > std:
        std = row[3]
    clear(o, 3, std * std)
    to_dcm(x.q_nb, o.C_nb)
    look_back(x, x.visual_velocity_delay, address(o.then))
    w = x.visual_velocity_turn
    for i in range(3):
        w[i] = x.gyro[i] - x.gyro_bias[i]
        x.visual_velocity_then[i] = x.vel_n[i] - o.then.since[i]
    # what the sensor has from the turn
    x.visual_velocity_arm[0] = w[1] * own[LEVER_ARM + 2] - w[2] * own[LEVER_ARM + 1]
    x.visual_velocity_arm[1] = w[2] * own[LEVER_ARM] - w[0] * own[LEVER_ARM + 2]
    x.visual_velocity_arm[2] = w[0] * own[LEVER_ARM + 1] - w[1] * own[LEVER_ARM]
    if row[4] == 1.0:
        observe_in_frame(x, k, o, row)
    else:
        observe_in_body(x, k, o, row)
    timing = own[TIMING_STD] * own[TIMING_STD]
    for i in range(3):
        for j in range(3):
            o.R[i][j] += timing * o.H[i][E_LATE] * o.H[j][E_LATE]
    return True


def observe_in_body(x: State, k: Parameters, o: Observation, row: Vector) -> None:
    """Write the rows of a velocity in the axes that the body had then: turned by the rate of now.

    ``u = (1 + d [w x]) C' v + w x l``; the attitude's error turns v: ``C' (v x theta)``; that of
    the gyro's bias turns the body back: ``(d C' v + l) x bg``.
    """
    own = k.aid[AID_VISUAL_VELOCITY].own
    s = 1.0 + x.visual_velocity_scale
    d = x.visual_velocity_delay
    w = x.visual_velocity_turn
    v = x.visual_velocity_then
    for j in range(3):
        o.H[0][E_VEL + j] = o.C_nb[j][0] + d * (w[1] * o.C_nb[j][2] - w[2] * o.C_nb[j][1])
        o.H[1][E_VEL + j] = o.C_nb[j][1] + d * (w[2] * o.C_nb[j][0] - w[0] * o.C_nb[j][2])
        o.H[2][E_VEL + j] = o.C_nb[j][2] + d * (w[0] * o.C_nb[j][1] - w[1] * o.C_nb[j][0])
        o.y[j] = o.C_nb[0][j] * v[0] + o.C_nb[1][j] * v[1] + o.C_nb[2][j] * v[2]
    a0 = d * o.y[0] + own[LEVER_ARM]
    a1 = d * o.y[1] + own[LEVER_ARM + 1]
    a2 = d * o.y[2] + own[LEVER_ARM + 2]
    o.H[0][E_BG + 1] = -a2
    o.H[0][E_BG + 2] = a1
    o.H[1][E_BG] = a2
    o.H[1][E_BG + 2] = -a0
    o.H[2][E_BG] = -a1
    o.H[2][E_BG + 1] = a0
    o.H[0][E_LATE] = w[1] * o.y[2] - w[2] * o.y[1]
    o.H[1][E_LATE] = w[2] * o.y[0] - w[0] * o.y[2]
    o.H[2][E_LATE] = w[0] * o.y[1] - w[1] * o.y[0]
    for i in range(3):
        m0 = o.H[i][E_VEL]
        m1 = o.H[i][E_VEL + 1]
        m2 = o.H[i][E_VEL + 2]
        o.H[i][E_ATT] = m1 * v[2] - m2 * v[1]
        o.H[i][E_ATT + 1] = m2 * v[0] - m0 * v[2]
        o.H[i][E_ATT + 2] = m0 * v[1] - m1 * v[0]
        a = o.then.accel_n
        o.H[i][E_LATE] -= m0 * a[0] + m1 * a[1] + m2 * a[2]
        u = m0 * v[0] + m1 * v[1] + m2 * v[2] + x.visual_velocity_arm[i]
        # as we see it: the noise in its own would pass for scale
        o.H[i][E_SCALE] = -u / s
        o.z[i] = s * row[i] - u


def observe_in_frame(x: State, k: Parameters, o: Observation, row: Vector) -> None:
    """Write the rows of a velocity in a level frame of its own, which yaw turns into n."""
    own = k.aid[AID_VISUAL_VELOCITY].own
    s = 1.0 + x.visual_velocity_scale
    c = cos(x.visual_velocity_frame_yaw)
    n = sin(x.visual_velocity_frame_yaw)
    o.y[0] = c * row[0] - n * row[1]
    o.y[1] = n * row[0] + c * row[1]
    o.y[2] = row[2]
    a = o.then.until
    for i in range(3):
        a[i] = 0.0
        for j in range(3):
            a[i] += o.C_nb[i][j] * x.visual_velocity_arm[j]
        # the gyro's bias turns the lever arm: C (l x bg)
        o.H[i][E_BG] = o.C_nb[i][1] * own[LEVER_ARM + 2] - o.C_nb[i][2] * own[LEVER_ARM + 1]
        o.H[i][E_BG + 1] = o.C_nb[i][2] * own[LEVER_ARM] - o.C_nb[i][0] * own[LEVER_ARM + 2]
        o.H[i][E_BG + 2] = o.C_nb[i][0] * own[LEVER_ARM + 1] - o.C_nb[i][1] * own[LEVER_ARM]
        o.H[i][E_VEL + i] = 1.0
        o.H[i][E_LATE] = -o.then.accel_n[i]
        u = x.visual_velocity_then[i] + a[i]
        o.z[i] = s * o.y[i] - u
        # as we see it: the noise in its own would pass for scale and yaw
        o.H[i][E_SCALE] = -u / s
        o.y[i] = u
    o.H[0][E_VISUAL_VELOCITY] = o.y[1]
    o.H[1][E_VISUAL_VELOCITY] = -o.y[0]
    # theta turns what the sensor has from the turn
    o.H[0][E_ATT + 1] = a[2]
    o.H[0][E_ATT + 2] = -a[1]
    o.H[1][E_ATT] = -a[2]
    o.H[1][E_ATT + 2] = a[0]
    o.H[2][E_ATT] = a[1]
    o.H[2][E_ATT + 1] = -a[0]
