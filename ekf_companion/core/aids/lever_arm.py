"""How far the antenna may be from where it is taken to be, by what turns have shown.

In a turn an antenna beside the inertial sensor has another velocity. Nobody says how well its lever
arm has been measured, so a turn makes the receiver's velocity uncertain; but an arm that is wrong
shows in what the receiver gains in velocity within a second while the rate changes, beside what
the samples do. In a steady turn it does not: there a wrong yaw looks the same. Nor while changes of
rate or acceleration are no more than noise, or the samples are doubted. What has been shown so is
no correction: it says how large the arm's error is that the velocity is uncertain by.

Source: consider states: Schmidt 1966; recursive least squares, e.g. Gelb 1974, section 4.2.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import sqrt

MARGIN = cython.declare(cython.double, 1.5)
"""Of the variance of a gain: what else is wrong in turns is not white."""
DOUBTED = cython.declare(cython.double, 0.03)
"""Doubt in the samples at which a gain tells half as much."""
CHANGE_MEMORY = cython.declare(cython.double, 8.0)
"""Pairs of fixes over which it is judged how much of a change of the rate is noise."""


def restart(x: State) -> None:
    """Take the arm for what is configured."""
    for i in range(3):
        x.lever.arm_b[i] = 0.0
        for j in range(3):
            x.lever.P[i][j] = 0.0
        x.lever.P[i][i] = 1.0
    x.lever.change = 0.0


def add_noise(x: State, k: Parameters, o: Observation) -> None:
    """Add to R of a velocity what the arm's error adds to it in this turn.

    Along the axis of the turn as well, by what is known best: the rate is that of a moment.
    """
    arm = address(x.lever)
    least = arm.P[0][0] + arm.arm_b[0] * arm.arm_b[0]
    for i in range(3):
        square = arm.P[i][i] + arm.arm_b[i] * arm.arm_b[i]
        least = square if square < least else least
        o.y[i] = 0.0
        for j in range(3):
            o.y[i] += o.C_nb[i][j] * (x.gyro[j] - x.gyro_bias[j])
    for r in range(o.rows):
        for c in range(o.rows):
            o.R[r][c] += k.lever_var * least * o.y[r] * o.y[c]
    for i in range(3):
        for j in range(3):
            square = k.lever_var * (arm.P[i][j] + arm.arm_b[i] * arm.arm_b[j])
            for r in range(o.rows):
                for c in range(o.rows):
                    o.R[r][c] += o.turn_nb[r][i] * square * o.turn_nb[c][j]


def true_share(x: State) -> float:
    """Return how much of the change of the rate is no noise, which would pass for knowledge."""
    square = 0.0
    noise = 0.0
    for i in range(2):
        for j in range(3):
            change = x.gain.end.turn[i][j] - x.gain.begin.turn[i][j]
            square += 0.5 * change * change
    for j in range(3):
        noise += x.noise[j]
    if not x.dt > 0.0:
        return 0.0
    x.lever.change += (square - x.lever.change) / CHANGE_MEMORY
    true = x.lever.change - 2.0 * noise / x.dt
    return true / x.lever.change if true > 0.0 else 0.0


def learn(x: State, k: Parameters, o: Observation, axis: int, true: float) -> None:
    """Learn from one axis, n or e, of a gain that has been judged: less, the larger the doubt."""
    arm = address(x.lever)
    scale = true * sqrt(k.lever_var)
    off = o.z[0]
    s = MARGIN * (1.0 + x.doubt / DOUBTED) * o.L[0][0] * o.L[0][0]
    for i in range(3):
        o.y[i] = scale * (x.gain.end.turn[axis][i] - x.gain.begin.turn[axis][i])
    for i in range(3):
        off -= o.y[i] * arm.arm_b[i]
        o.gain[i] = arm.P[i][0] * o.y[0] + arm.P[i][1] * o.y[1] + arm.P[i][2] * o.y[2]
        s += o.y[i] * o.gain[i]
    for i in range(3):
        arm.arm_b[i] += o.gain[i] * off / s
        for j in range(3):
            arm.P[i][j] -= o.gain[i] * o.gain[j] / s


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
