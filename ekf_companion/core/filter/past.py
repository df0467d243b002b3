"""The velocity of the last two seconds: what it was when a late fix was true.

A fix is fused at the time when it was true by the configured delay; by the estimated one it was
true some hundredths or tenths of a second earlier. Over such a time the acceleration changes, so
the inertial samples say what the velocity was then, not its slope now. What is kept is the velocity
that they have gained, without the corrections: these hold for the whole of so short a time.

A receiver gives a velocity of its whole interval, by the phases at both ends or by a filter of its
own. Where the motion bends within it, in gusts and steep turns, that is off by as much, and by no
noise.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.memory.constants import NEVER
from cython.cimports.ekf_companion.core.memory.enums import PAST
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.scratch import Then
from cython.cimports.ekf_companion.core.memory.state import State

STEP = cython.declare(cython.double, 35e6)
"""Between what is kept, ns."""
INTERVALS = cython.declare(cython.double, 2.0)
"""Time over which the unevenness of the velocity counts, in intervals of the receiver: what bends
may lie half an interval to either side of where it shows. In gusts an airplane's roll was 1.0 deg
off with one, 0.33, 0.28 and 0.27 with 1.5, 2 and 2.5."""
LONGEST = cython.declare(cython.double, 0.5)
"""The same in seconds, at most."""
RANDOM_WALK = cython.declare(cython.double, 15.0)
"""A random walk leaves a fifteenth of its variance at the end about its own straight line: a sixth
about its mean, less a tenth that the slope takes."""
HALF = cython.declare(cython.double, 0.06)
"""Half the time over which an acceleration is a mean, s: one sample's noise would count as one."""


def forget(x: State) -> None:
    """Keep nothing of what was before."""
    for i in range(3):
        x.past.gained[i] = 0.0
    for j in range(PAST):
        x.past.kept_t[j] = NEVER


def keep_velocity(x: State) -> None:
    """Keep the velocity gained until now, if it is time for that."""
    past = address(x.past)
    step = cython.cast(cython.longlong, x.t / STEP)
    j = cython.cast(cython.int, step % PAST)
    if past.kept_t[j] >= step * STEP:
        return
    past.kept_t[j] = x.t
    for i in range(3):
        past.kept[j][i] = past.gained[i]


def look_back(x: State, late: float, then: Then) -> None:
    """Write what the motion was some time ago, s: velocity gained until and since, acceleration."""
    t = x.t - late * 1e9
    then.late = late
    acceleration_at(x, t, then.until, then.accel_n)
    gained_until(x, t, then.until)
    for i in range(3):
        then.since[i] = x.past.gained[i] - then.until[i]


def acceleration_at(x: State, t: float, before: Vector, accel_n: Vector) -> None:
    """Write the mean acceleration about a time, ns; ``before`` is working memory."""
    gained_until(x, t - HALF * 1e9, before)
    gained_until(x, t + HALF * 1e9, accel_n)
    for i in range(3):
        accel_n[i] = (accel_n[i] - before[i]) / (2.0 * HALF)


def gained_until(x: State, t: float, gained: Vector) -> None:
    """Write the velocity gained until a time, ns: between what is kept, or on as it was nearby."""
    past = address(x.past)
    before = NEVER
    after = x.t
    first = cython.declare(cython.int, -1)
    last = cython.declare(cython.int, -1)
    for j in range(PAST):
        if past.kept_t[j] > NEVER:
            if past.kept_t[j] <= t and past.kept_t[j] > before:
                before = past.kept_t[j]
                first = j
            if past.kept_t[j] > t and past.kept_t[j] < after:
                after = past.kept_t[j]
                last = j
    for i in range(3):
        end = past.gained[i] if last < 0 else past.kept[last][i]
        if t >= x.t or first < 0:
            gained[i] = end + (t - after) * 1e-9 * x.accel_n[i]
        else:
            share = (t - before) / (after - before)
            gained[i] = past.kept[first][i] + share * (end - past.kept[first][i])


def unevenness(x: State, var: Vector) -> None:
    """Write how far the velocity was off a straight line lately, as a variance of each axis.

    That is how far a receiver's velocity is off that gives a mean, (m/s)^2.
    """
    past = address(x.past)
    span = INTERVALS * x.fix_dt
    span = span if span < LONGEST else LONGEST
    for i in range(3):
        n = 1.0  # now, at which all sums count from zero
        sum_t = 0.0
        sum_tt = 0.0
        sum_v = 0.0
        sum_vv = 0.0
        sum_tv = 0.0
        for j in range(PAST):
            t = (past.kept_t[j] - x.t) * 1e-9
            if t > -span:
                v = past.kept[j][i] - past.gained[i]
                n += 1.0
                sum_t += t
                sum_tt += t * t
                sum_v += v
                sum_vv += v * v
                sum_tv += t * v
        var[i] = 0.0
        spread = sum_tt - sum_t * sum_t / n
        if n < 4.0 or spread <= 0.0:
            continue
        along = sum_tv - sum_t * sum_v / n
        left = (sum_vv - sum_v * sum_v / n - along * along / spread) / (n - 2.0)
        left -= span / RANDOM_WALK * (x.noise[3] + x.noise[4] + x.noise[5]) / 3.0
        if left > 0.0:
            var[i] = left


def acceleration_noise(x: State) -> float:
    """Return the variance that the noise of the samples gives such an acceleration, (m/s^2)^2."""
    return (x.noise[3] + x.noise[4] + x.noise[5]) / (6.0 * HALF)
