"""How much later the velocity of a fix is true than its position, by the fixes alone.

Many receivers filter the velocity: of eight recorded ones five give it 0.05 to 0.2 s later than the
position. What a position gains between two fixes, less what the velocities add up to in that time,
is the lag times what the velocity gains::

    p_1 - p_0 - sum of v dt = lag (v_1 - v_0) + noise

The lag is the slope of that. Its variance is by the squares of what is left, each weighed by the
slope's own dependence on it, so that noise which comes with the motion counts as it comes.

Source: linear regression; its variance: White 1980, Econometrica 48, 4.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import wrap
from cython.cimports.ekf_companion.core.memory.constants import (
    NEVER,
    SHORTEST_GAIN,
    THREE_SIGMA2,
    WITHOUT_FIX,
)
from cython.cimports.ekf_companion.core.memory.enums import AID_VELOCITY
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import isnan

FIRST_ERROR = cython.declare(cython.double, 0.25)
"""Variance of a gain of the position, m^2, that counts as one gain until some have shown it: half a
metre. From a quarter of it to four times, the lag of 48 flights is as near to the true one: 0.004,
0.021 and 0.065 s RMS, where a position has noise of 0.1, 0.5 and 1.5 m."""


def forget(x: State) -> None:
    """Forget the lag of a receiver that is used no more."""
    lag = address(x.lag)
    lag.late = 0.0
    lag.last_t = NEVER
    lag.changed2 = 0.0
    lag.changed4 = 0.0
    lag.product = 0.0
    lag.left2 = 0.0


def take(x: State, k: Parameters, fix: Fix) -> float:
    """Learn the lag from a fix, and take the fix to have it; return by how much it moved, s."""
    before = x.lag.late
    if k.lag_std == 0.0 or k.use_velocity == 0.0 or isnan(fix.vel_n[0]):
        x.lag.last_t = NEVER
        return 0.0
    if x.origin.is_known != 0.0:
        learn(x, k, fix)
    fix.lag = x.lag.late
    fix.lag_var = variance(x, k)
    return x.lag.late - before


def variance(x: State, k: Parameters) -> float:
    """Return the variance of the lag by all gains so far and what is usual, s^2."""
    return 1.0 / (1.0 / (k.lag_std * k.lag_std) + x.lag.changed2 / error_var(x))


def learn(x: State, k: Parameters, fix: Fix) -> None:
    """Learn the lag from a fix and those of the second before it."""
    lag = address(x.lag)
    north = (fix.lat - x.origin.lat) * x.origin.scale_n
    east = wrap(fix.lon - x.origin.lon) * x.origin.scale_e
    step = x.t - lag.last_t
    if not 0.0 < step <= WITHOUT_FIX * 1e9:
        begin(x, fix, north, east)
        return
    for i in range(2):
        lag.way[i] += 0.5e-9 * step * (fix.vel_n[i] + lag.last_vel[i])
        lag.last_vel[i] = fix.vel_n[i]
    lag.last_t = x.t
    if x.t - lag.t >= SHORTEST_GAIN:
        compare(x, k, fix, north, east)
        begin(x, fix, north, east)


def begin(x: State, fix: Fix, north: float, east: float) -> None:
    """Begin a gain with a fix."""
    lag = address(x.lag)
    lag.t = x.t
    lag.last_t = x.t
    lag.pos[0] = north
    lag.pos[1] = east
    for i in range(2):
        lag.vel[i] = fix.vel_n[i]
        lag.last_vel[i] = fix.vel_n[i]
        lag.way[i] = 0.0


def compare(x: State, k: Parameters, fix: Fix, north: float, east: float) -> None:
    """Take in what a gain says, where the velocity has changed by more than its noise."""
    lag = address(x.lag)
    noise = 2.0 * THREE_SIGMA2 * fix.stated_var[AID_VELOCITY]
    for i in range(2):
        changed = fix.vel_n[i] - lag.vel[i]
        if changed * changed <= noise:
            continue
        gained = (north if i == 0 else east) - lag.pos[i] - lag.way[i]
        left = gained - lag.late * changed
        square = left * left
        # a position that jumps is none
        most = THREE_SIGMA2 * (changed * changed * variance(x, k) + error_var(x))
        share = 1.0 if square <= most else most / square
        square *= share
        changed2 = share * changed * changed
        lag.changed2 += changed2
        lag.changed4 += changed2 * changed2
        lag.product += share * changed * gained
        lag.left2 += changed2 * square
    lag.late = variance(x, k) * lag.product / error_var(x)


def error_var(x: State) -> float:
    """Return the variance of a gain, as learnt: m^2."""
    lag = address(x.lag)
    gains = 0.0
    if lag.changed4 > 0.0:
        gains = lag.changed2 * lag.changed2 / lag.changed4
    learnt = lag.left2 / lag.changed2 if lag.changed2 > 0.0 else 0.0
    return (FIRST_ERROR + gains * learnt) / (1.0 + gains)
