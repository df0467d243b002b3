"""Drag: what a multirotor's sideways specific force tells of its velocity while there is no GNSS.

Thrust points along the body's axis, so what is left across it is drag, nearly proportional to the
velocity through the air. The coefficient and the wind are learnt while the velocity is known, and
how well they explain the force; what explains nothing (a wing, a car) gets a variance that makes it
count for nothing. Without GNSS the same force then bounds the velocity, and with it the tilt.

Source: Abeywardena et al. 2013, "Improved state estimation in quadrotor MAVs"; recursive least
squares, e.g. Ljung 1999, section 11.2.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_BA,
    E_VEL,
)
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import sqrt

BLOCK = cython.declare(cython.double, 2e8)
"""Length of the means of the force, ns."""
SAME_ERROR = cython.declare(cython.double, 50.0)
"""Blocks whose errors are one and the same: gusts, and what the model lacks, last 10 s."""
MEMORY = cython.declare(cython.double, 150.0)
"""Blocks over which the residual is learnt."""
FIRST_STD = cython.declare(cython.double, 0.5)
"""One sigma of the coefficient before anything is known, 1/s."""
FIRST_WIND = cython.declare(cython.double, 5.0)
"""One sigma of the wind, m/s."""
WIND_WALK = cython.declare(cython.double, 0.1)
"""Random walk of the wind, m/s/sqrt(s)."""
FLYING = cython.declare(cython.double, 2.0)
"""Speed at which a vehicle flies that does not say so, m/s."""
PROVEN = cython.declare(cython.double, 5.0)
"""Sigmas by which the coefficient must differ from none."""


def restart(x: State) -> None:
    """Forget all."""
    drag = address(x.drag)
    drag.t0 = x.t
    drag.n = 0.0
    drag.variance = 1.0
    for i in range(3):
        drag.force[i] = 0.0
        drag.theta[i] = 0.0
        for j in range(3):
            drag.P[i][j] = 0.0
    drag.P[0][0] = FIRST_STD * FIRST_STD
    for i in range(1, 3):
        drag.P[i][i] = FIRST_STD * FIRST_STD * FIRST_WIND * FIRST_WIND


def add_force(x: State) -> bool:
    """Add the newest sample; return whether the block is full."""
    drag = address(x.drag)
    drag.n += 1.0
    for i in range(2):
        drag.force[i] += x.accel[i]
    return x.t - drag.t0 >= BLOCK


def begin_block(x: State) -> None:
    """Begin a block of samples."""
    drag = address(x.drag)
    drag.t0 = x.t
    drag.n = 0.0
    for i in range(2):
        drag.force[i] = 0.0


def is_flying(x: State) -> bool:
    """Return whether the vehicle says that it flies, or is fast."""
    if x.landed == 1.0 or x.armed == 0.0:
        return False
    speed = 0.0
    for i in range(3):
        speed += x.vel_n[i] * x.vel_n[i]
    return x.armed == 1.0 or speed > FLYING * FLYING


def is_proven(x: State) -> bool:
    """Return whether the force is known to depend on the velocity."""
    return x.drag.theta[0] > PROVEN * sqrt(x.drag.P[0][0])


def let_wind_walk(x: State) -> None:
    """Let the wind change over a block."""
    drag = address(x.drag)
    walk = drag.theta[0] * WIND_WALK
    for i in range(1, 3):
        drag.P[i][i] += walk * walk * BLOCK * 1e-9


def learn(x: State, o: Observation) -> None:
    """Learn coefficient and wind from the block's mean force and the estimated velocity."""
    drag = address(x.drag)
    to_dcm(x.q_nb, o.C_nb)
    let_wind_walk(x)
    for axis in range(2):
        o.y[0] = 0.0
        for i in range(3):
            o.y[0] -= o.C_nb[i][axis] * x.vel_n[i]
        o.y[1] = o.C_nb[0][axis]
        o.y[2] = o.C_nb[1][axis]
        residual = drag.force[axis] / drag.n - x.accel_bias[axis]
        s = drag.variance * SAME_ERROR
        for i in range(3):
            residual -= o.y[i] * drag.theta[i]
            o.z[i] = 0.0
            for j in range(3):
                o.z[i] += drag.P[i][j] * o.y[j]
        drag.variance += (residual * residual - drag.variance) / MEMORY
        for i in range(3):
            s += o.y[i] * o.z[i]
        for i in range(3):
            drag.theta[i] += o.z[i] * residual / s
            for j in range(3):
                drag.P[i][j] -= o.z[i] * o.z[j] / s


def observe(x: State, o: Observation) -> None:
    """Observe the velocity through the air by the block's mean force: two rows."""
    drag = address(x.drag)
    d = drag.theta[0]
    to_dcm(x.q_nb, o.C_nb)
    let_wind_walk(x)
    vn = x.vel_n[0] - drag.theta[1] / d
    ve = x.vel_n[1] - drag.theta[2] / d
    vd = x.vel_n[2]
    clear(o, 2, 0.0)
    for axis in range(2):
        cn = o.C_nb[0][axis]
        ce = o.C_nb[1][axis]
        cd = o.C_nb[2][axis]
        through = cn * vn + ce * ve + cd * vd
        o.z[axis] = drag.force[axis] / drag.n - x.accel_bias[axis] + d * through
        o.H[axis][E_VEL] = -d * cn
        o.H[axis][E_VEL + 1] = -d * ce
        o.H[axis][E_VEL + 2] = -d * cd
        # theta turns the body against the air: C' (v x theta)
        o.H[axis][E_ATT] = -d * (ce * vd - cd * ve)
        o.H[axis][E_ATT + 1] = -d * (cd * vn - cn * vd)
        o.H[axis][E_ATT + 2] = -d * (cn * ve - ce * vn)
        o.H[axis][E_BA + axis] = 1.0
        unknown = through * through * drag.P[0][0] + cn * cn * drag.P[1][1] + ce * ce * drag.P[2][2]
        # what is not known of coefficient and wind is the same in all blocks
        o.R[axis][axis] = SAME_ERROR * (drag.variance + unknown)
