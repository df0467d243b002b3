"""Whether a receiver's velocity changes as much as the specific force lets it.

What a vehicle gains in velocity, less what gravity gives, is the integral of its specific force.
Of that integral the attitude turns only the direction: its length follows from the inertial samples
alone. So where receiver and accelerometers disagree about it, one of them is wrong itself, however
much the attitude, the biases or the filter are in doubt: the one that shows what no flight is like,
further from the one g that carries a vehicle. A receiver runs wild, an accelerometer vibrates.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.scratch import Fix
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import exp, fabs, isnan, sqrt

MEMORY = cython.declare(cython.double, 0.5)
"""Time constant of the integrals, s."""
SLOW_MEMORY = cython.declare(cython.double, 10.0)
"""The same of the vertical velocity alone, s: the barometer tells who is wrong by less."""
LONGEST = cython.declare(cython.double, 3.0)
"""Time after which a velocity that is denied is begun with anew, s."""
GRAVITY = cython.declare(cython.double, 9.81)
LARGEST_FAULT = cython.declare(cython.double, 2.0)
"""Error of a specific force that vibration may cause in the mean, m/s^2."""
ARM = cython.declare(cython.double, 0.2)
"""Distance of the antenna that is not configured, m."""
SIGMAS = cython.declare(cython.double, 3.0)


def compare(x: State, fix: Fix) -> None:
    """Compare what both gained since the last fix that was not denied.

    What is denied is not kept: the next fix is compared with the one before it.
    """
    dt = (x.t - x.force_t) * 1e-9
    is_known = cython.declare(cython.bint, 0.0 < dt < LONGEST)
    for i in range(3):  # after a gap, or samples at the end of their range, no sum is known
        is_known = is_known and not isnan(fix.vel_n[i]) and not isnan(x.force_sum[i])
    x.is_force_denied = 0.0
    x.is_fall_denied = 0.0
    faded = exp(-dt / MEMORY) if is_known else 0.0
    if is_known:
        judge(x, fix, dt, faded)
        if x.is_force_denied != 0.0:
            return
    if is_known and x.voices.is_rushing == 0.0:  # else it is known who is wrong
        gained = fix.vel_n[2] - x.force_vel[2] - GRAVITY * dt
        x.fall_gap = exp(-dt / SLOW_MEMORY) * (x.fall_gap + gained - x.force_sum[2])
    else:
        x.fall_gap = 0.0
    for i in range(3):
        x.fix_force[i] = claimed(x, fix, dt, faded, i) if is_known else 0.0
        x.felt_force[i] = faded * (x.felt_force[i] + x.force_sum[i]) if is_known else 0.0
        x.force_vel[i] = 0.0 if isnan(fix.vel_n[i]) else fix.vel_n[i]
        x.force_sum[i] = 0.0
    x.force_time = faded * (x.force_time + dt) if is_known else 0.0
    x.force_t = x.t


def claimed(x: State, fix: Fix, dt: float, faded: float, axis: int) -> float:
    """Return the integral of the force by the receiver, m/s; ``faded`` is what dt (s) leaves."""
    gained = fix.vel_n[axis] - x.force_vel[axis] - (GRAVITY * dt if axis == 2 else 0.0)
    return faded * (x.fix_force[axis] + gained)


def judge(x: State, fix: Fix, dt: float, faded: float) -> None:
    """Find out whether the samples deny the fix, or its vertical velocity.

    What an attitude is wrong by tells little in the vertical.
    """
    usual = faded * GRAVITY * (x.force_time + dt)
    most = limit(x, fix)
    way = 0.0
    felt = 0.0
    down = 0.0
    felt_down = 0.0
    for i in range(3):
        down = claimed(x, fix, dt, faded, i)
        felt_down = faded * (x.felt_force[i] + x.force_sum[i])
        way += down * down
        felt += felt_down * felt_down
    way = sqrt(way)
    felt = sqrt(felt)
    x.is_force_denied = is_denied(way, felt, usual, most)
    if is_denied(down, felt_down, -usual, most) != 0.0:
        x.is_fall_denied = 1.0 if down > felt_down else -1.0


def is_denied(way: float, felt: float, usual: float, most: float) -> float:
    """Return 1 if what is claimed is too far from what was felt, and less like any flight."""
    return 1.0 if fabs(way - felt) > most and fabs(way - usual) > fabs(felt - usual) else 0.0


def limit(x: State, fix: Fix) -> float:
    """Return what the two may differ by, m/s."""
    rate = 0.0
    for i in range(3):
        rate += x.gyro[i] * x.gyro[i]
    return LARGEST_FAULT * MEMORY + ARM * sqrt(rate) + SIGMAS * sqrt(fix.stated_var[2])
