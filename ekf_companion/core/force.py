"""Whether a receiver's velocity changes as much as the specific force lets it.

What a vehicle gains in velocity, less what gravity gives, is the integral of its specific force.
Of that integral the attitude turns only the direction: its length follows from the inertial samples
alone. So where receiver and accelerometers disagree about it, one of them is wrong itself, however
much the attitude, the biases or the filter are in doubt: the one that shows what no flight is like,
further from the one g that carries a vehicle. A receiver runs wild, an accelerometer vibrates.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.scratch import Fix
from cython.cimports.ekf_companion.core.state import State
from cython.cimports.libc.math import exp, fabs, isnan, sqrt

MEMORY = cython.declare(cython.double, 0.5)
"""Time constant of the integrals, s."""
LONGEST = cython.declare(cython.double, 1.5)
"""Longest interval between two fixes to compare over, s."""
GRAVITY = cython.declare(cython.double, 9.81)
LARGEST_FAULT = cython.declare(cython.double, 2.0)
"""Error of a specific force that vibration may cause in the mean, m/s^2."""
ARM = cython.declare(cython.double, 0.2)
"""Distance of the antenna that is not configured, m."""
SIGMAS = cython.declare(cython.double, 3.0)


def compare(x: State, fix: Fix, dt: float) -> None:
    """Add what both gained since the fix dt (s) before, whose velocity is ``x.split_vel``."""
    is_known = cython.declare(cython.bint, 0.0 < dt < LONGEST)
    for i in range(3):  # after a gap, or samples at the end of their range, no sum is known
        is_known = is_known and not isnan(fix.vel_n[i]) and not isnan(x.force_sum[i])
    faded = exp(-dt / MEMORY)
    for i in range(3):
        if is_known:
            x.fix_force[i] = faded * (x.fix_force[i] + fix.vel_n[i] - x.split_vel[i])
            x.felt_force[i] = faded * (x.felt_force[i] + x.force_sum[i])
        else:
            x.fix_force[i] = 0.0
            x.felt_force[i] = 0.0
        x.force_sum[i] = 0.0
    if is_known:
        x.fix_force[2] -= faded * GRAVITY * dt
        x.force_time = faded * (x.force_time + dt)
    else:
        x.force_time = 0.0


def is_contradicted(x: State, fix: Fix) -> bool:
    """Return whether the receiver's velocity changed otherwise than the samples allow."""
    claimed = 0.0
    felt = 0.0
    for i in range(3):
        claimed += x.fix_force[i] * x.fix_force[i]
        felt += x.felt_force[i] * x.felt_force[i]
    return is_odd(x, sqrt(claimed), sqrt(felt)) and fabs(sqrt(claimed) - sqrt(felt)) > limit(x, fix)


def is_denied(x: State, fix: Fix, way: float) -> bool:
    """Return whether the samples deny a change of the vertical velocity; ``way`` > 0 is a fall.

    What an attitude is wrong by tells little in the vertical.
    """
    more = x.fix_force[2] - x.felt_force[2]
    return is_odd(x, -x.fix_force[2], -x.felt_force[2]) and (more if way > 0.0 else -more) > limit(
        x, fix
    )


def is_odd(x: State, claimed: float, felt: float) -> bool:
    """Return whether the receiver's claim is further from one g than what the samples felt."""
    usual = GRAVITY * x.force_time
    return fabs(claimed - usual) > fabs(felt - usual)


def limit(x: State, fix: Fix) -> float:
    """Return what the two may differ by, m/s."""
    rate = 0.0
    for i in range(3):
        rate += x.gyro[i] * x.gyro[i]
    return LARGEST_FAULT * MEMORY + ARM * sqrt(rate) + SIGMAS * sqrt(fix.stated_var[2])
