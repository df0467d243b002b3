"""The frame s in which the bank of yaw filters sums forces: nearly level, and pointing anywhere.

It hangs on the gyro alone, less the bias that the bank knows, so that nothing that goes wrong in
the main filter reaches it. What it sums between two fixes: the specific force, and the turn, which
says what an error of the bias does to it.

Source: Groves 2013, section 5.4 (attitude and specific force over one interval).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import rotate, rotate_body, to_dcm
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion, YawUpdate
from cython.cimports.ekf_companion.core.memory.state import State, YawBank
from cython.cimports.libc.math import atan2, sqrt

MEMORY = cython.declare(cython.double, 2.0)
"""Of the mean force while up is being found, s."""
SMALL_TURN = cython.declare(cython.double, 0.04)
"""Square of a turn, rad^2, up to which the short series is exact to 1e-8."""
SMOOTH = cython.declare(cython.double, 0.05)
"""s; time constant of the acceleration that corrects for the delay of a fix."""
LARGEST_RATE = cython.declare(cython.double, 20.0)
"""rad/s; beyond it a gyro is near its range, and the frame that it carries is lost."""
LARGEST_FORCE = cython.declare(cython.double, 60.0)
"""m/s^2; beyond it is a shock, as of a touchdown."""
UNKNOWN_STD = cython.declare(cython.double, 3.14)
"""One sigma of an unknown yaw, rad; any large number."""


def restart(b: YawBank) -> None:
    """Reset all but the gyro bias after a gap or a shock: sum the force to level again."""
    b.is_running = 0.0
    for i in range(4):
        b.q_sb[i] = 0.0
    b.q_sb[0] = 1.0
    restart_sums(b)
    for i in range(2):
        b.accel[i] = 0.0
        b.vel_mean[i] = 0.0
    b.vel_var = 0.0
    b.refused = 0.0
    b.has_moved = 0.0
    b.yaw = 0.0
    b.yaw_std = UNKNOWN_STD
    b.tilt_std = 0.0
    b.good = 0.0


def restart_sums(b: YawBank) -> None:
    """Begin the sums of the next interval between fixes."""
    for i in range(3):
        b.sums.dv[i] = 0.0
        for j in range(3):
            b.sums.turn[i][j] = 0.0
    b.sums.dt = 0.0


def integrate(b: YawBank, m: Motion, dt: float) -> None:
    """Carry the frame's attitude, and the sums of force and turn in s, over dt (s) at ``m.rate``.

    A shock makes it begin anew.
    """
    gx = m.rate[0]
    gy = m.rate[1]
    gz = m.rate[2]
    ax = m.force[0]
    ay = m.force[1]
    az = m.force[2]
    px = (gx - b.gyro_bias[0]) * dt
    py = (gy - b.gyro_bias[1]) * dt
    pz = (gz - b.gyro_bias[2]) * dt
    # the mean of the turning force, in b at the start: f + p x f / 2
    ux = (ax + 0.5 * (py * az - pz * ay)) * dt
    uy = (ay + 0.5 * (pz * ax - px * az)) * dt
    uz = (az + 0.5 * (px * ay - py * ax)) * dt
    if (
        gx * gx + gy * gy + gz * gz > LARGEST_RATE * LARGEST_RATE
        or ax * ax + ay * ay + az * az > LARGEST_FORCE * LARGEST_FORCE
    ):
        restart(b)
    to_dcm(b.q_sb, m.C_fb)
    for i in range(3):
        u = m.C_fb[i][0] * ux + m.C_fb[i][1] * uy + m.C_fb[i][2] * uz
        b.sums.dv[i] += u
        if i < 2:
            b.accel[i] += (u - b.accel[i] * dt) / (dt + SMOOTH)
        for j in range(3):
            b.sums.turn[i][j] += m.C_fb[i][j] * dt
    b.sums.dt += dt
    rotate_frame(b.q_sb, px, py, pz)
    if b.is_running == 0.0 and b.sums.dt > MEMORY:
        halve_sums(b)


def halve_sums(b: YawBank) -> None:
    """Let the older half of the sums fade."""
    for i in range(3):
        b.sums.dv[i] = 0.5 * b.sums.dv[i]
        for j in range(3):
            b.sums.turn[i][j] = 0.5 * b.sums.turn[i][j]
    b.sums.dt = 0.5 * b.sums.dt


def rotate_frame(q: Vector, px: float, py: float, pz: float) -> None:
    """Rotate the frame's attitude by a rotation vector in b, a small one without a root."""
    qw = q[0]
    qx = q[1]
    qy = q[2]
    qz = q[3]
    a2 = px * px + py * py + pz * pz
    if a2 > SMALL_TURN:
        rotate_body(q, px, py, pz)
        return
    c = 1.0 - a2 * (0.125 - a2 * (1.0 / 384.0))
    s = 0.5 - a2 * (1.0 / 48.0 - a2 * (1.0 / 3840.0))
    px = s * px
    py = s * py
    pz = s * pz
    q[0] = c * qw - px * qx - py * qy - pz * qz
    q[1] = c * qx + px * qw - py * qz + pz * qy
    q[2] = c * qy + px * qz + py * qw - pz * qx
    q[3] = c * qz - px * qy + py * qx + pz * qw
    # the norm is one but for rounding: a step of Newton's keeps it so
    s = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    q[0] = s * q[0]
    q[1] = s * q[1]
    q[2] = s * q[2]
    q[3] = s * q[3]


def level(b: YawBank) -> None:
    """Rotate s so that the summed force points up."""
    ux = b.sums.dv[0]
    uy = b.sums.dv[1]
    size = sqrt(ux * ux + uy * uy)
    angle = atan2(size, -b.sums.dv[2])
    if size > 0.0:
        # the shortest turn of u into up (-z) is about u x up
        rotate(b.q_sb, -uy / size * angle, ux / size * angle, 0.0)
    else:
        rotate(b.q_sb, angle, 0.0, 0.0)


def lever_arm_velocity(x: State, k: Parameters, u: YawUpdate) -> None:
    """Write the velocity that the antenna has from the turn, in s, x and y."""
    b = address(x.yaw_bank)
    wx = x.gyro[0] - b.gyro_bias[0]
    wy = x.gyro[1] - b.gyro_bias[1]
    wz = x.gyro[2] - b.gyro_bias[2]
    to_dcm(b.q_sb, u.C_sb)
    for i in range(2):
        u.arm_vel[i] = (
            u.C_sb[i][0] * (wy * k.lever_arm_b[2] - wz * k.lever_arm_b[1])
            + u.C_sb[i][1] * (wz * k.lever_arm_b[0] - wx * k.lever_arm_b[2])
            + u.C_sb[i][2] * (wx * k.lever_arm_b[1] - wy * k.lever_arm_b[0])
        )
