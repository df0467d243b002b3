"""How late the receiver's fixes are, from what their velocity and ours gain between two of them.

A velocity that is compared with ours as it stands tells of the delay, but also of tilt, biases and
the slow errors of both; these follow the vehicle's motion, since a wrong delay makes them, and a
filter that takes them for independent is soon sure of a delay somewhere between its first guess and
the truth. What is gained within a second has hardly any of them in it, whatever it has in its noise
is learnt from it, and both gains are of the same motion, some time apart. So no other correction
moves the delay: it is a consider state, whose uncertainty counts in each of them.

Source: consider states: Schmidt 1966; a delay by comparing increments: the calibration of cameras
against gyros, e.g. Kelly and Sukhatme 2014, Int. J. of Robotics Research 33, 13.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core import observe
from cython.cimports.ekf_companion.core.correct import apply_update, innovate
from cython.cimports.ekf_companion.core.enums import AID_VELOCITY, E_ATT, E_DELAY
from cython.cimports.ekf_companion.core.parameters import Parameters
from cython.cimports.ekf_companion.core.past import acceleration_noise, look_back
from cython.cimports.ekf_companion.core.scratch import Fix, Observation
from cython.cimports.ekf_companion.core.state import State

NEVER = cython.declare(cython.double, -1e18)
SHORTEST = cython.declare(cython.double, 0.7e9)
"""Between the fixes that are compared, ns: long enough for the velocity to change."""
LONGEST = cython.declare(cython.double, 1.6e9)
"""ns; in a longer time tilt and biases tell."""
MEMORY = cython.declare(cython.double, 40.0)
"""Gains over which their noise is learnt."""
FIRST_MEMORY = cython.declare(cython.double, 8.0)
"""Weight of what the receiver states, in gains."""
CHANGE_MEMORY = cython.declare(cython.double, 8.0)
"""Pairs of fixes over which it is judged how much of a change of acceleration is noise."""
MARGIN = cython.declare(cython.double, 2.0)
"""Of its variance: the noise of neighbouring gains is not independent."""
LEAST_VAR = cython.declare(cython.double, 0.0018)
"""Least variance of the noise of a gain, (m/s)^2: 0.03 m/s in either velocity."""
LARGEST_NIS = cython.declare(cython.double, 16.0)
"""One gain that is further off is a fault of either."""
LARGEST_TERM = cython.declare(cython.double, 9.0)
"""Largest share of one gain in the noise learnt, of the variance expected."""
AHEAD = cython.declare(cython.double, 0.03)
"""So much later than a fix is true the samples must be known, s: its acceleration is a mean."""
LONGEST_WAIT = cython.declare(cython.double, 0.3e9)
"""for that, ns."""


def keep_fix(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Keep a fix with velocity until the samples have come that say what happened meanwhile."""
    end = address(x.gain.end)
    if x.P[E_DELAY][E_DELAY] == 0.0 or end.t > NEVER or x.t - x.gain.begin.t < SHORTEST:
        return
    observe.lever_arm(x, k, o)
    end.t = x.t
    for i in range(2):
        end.vel_n[i] = fix.vel_n[i] - o.arm_vel_n[i]
    if x.gain.var == 0.0:
        x.gain.var = 2.0 * fix.stated_var[AID_VELOCITY]


def learn_delay(x: State, k: Parameters, o: Observation) -> None:
    """Learn the delay by the fix that is kept and the one some time before, once it is time."""
    begin = address(x.gain.begin)
    end = address(x.gain.end)
    late = (x.t - end.t) * 1e-9 + x.gnss_delay
    if end.t == NEVER or (late < AHEAD and x.t - end.t < LONGEST_WAIT):
        return
    look_back(x, late, address(o.then))
    end.delay = x.gnss_delay
    for i in range(2):
        end.until[i] = o.then.until[i]
        end.accel_n[i] = o.then.accel_n[i]
    if end.t - begin.t <= LONGEST:
        compare_gains(x, k, o)
    begin.t = end.t
    begin.delay = end.delay
    for i in range(2):
        begin.vel_n[i] = end.vel_n[i]
        begin.until[i] = end.until[i]
        begin.accel_n[i] = end.accel_n[i]
    end.t = NEVER


def compare_gains(x: State, k: Parameters, o: Observation) -> None:
    """Correct the delay by the gain of the receiver's velocity and that of the samples."""
    gain = address(x.gain)
    moved = gain.begin.delay - gain.end.delay
    north = gain.end.until[0] - gain.begin.until[0] - moved * gain.begin.accel_n[0]
    east = gain.end.until[1] - gain.begin.until[1] - moved * gain.begin.accel_n[1]
    span = (gain.end.t - gain.begin.t) * 1e-9
    fallen = k.gravity * span
    own = (
        x.P[E_ATT + 2][E_ATT + 2] * (north * north + east * east)
        + 0.5 * (x.P[E_ATT][E_ATT] + x.P[E_ATT + 1][E_ATT + 1]) * fallen * fallen
        + x.doubt * k.accel_noise * k.accel_noise * span
    )
    if gain.var < LEAST_VAR:
        gain.var = LEAST_VAR
    share = MARGIN * gain.var / (MARGIN * gain.var + own)
    # Noise would pass for knowledge of the delay, and hold it where it is
    square = 0.0
    for i in range(2):
        change = gain.end.accel_n[i] - gain.begin.accel_n[i]
        square += 0.5 * change * change
    gain.change += (square - gain.change) / CHANGE_MEMORY
    true = gain.change - 2.0 * acceleration_noise(x)
    true = true / gain.change if true > 0.0 else 0.0
    for i in range(2):
        change = gain.end.accel_n[i] - gain.begin.accel_n[i]
        seen = gain.end.vel_n[i] - gain.begin.vel_n[i]
        observe.clear(o, 1, MARGIN * gain.var + own)
        o.shows_delay = 1
        o.H[0][E_DELAY] = -change * true
        o.z[0] = seen - (north if i == 0 else east)
        o.z[0] += change * true * (x.gnss_delay - gain.end.delay)
        nis = innovate(x, o)
        error = o.z[0] * o.z[0]
        largest = LARGEST_TERM * o.L[0][0] * o.L[0][0]
        gain.var += ((error if error < largest else largest) - gain.var) / (FIRST_MEMORY + gain.n)
        gain.n = gain.n + 1.0 if gain.n < MEMORY - FIRST_MEMORY else gain.n
        if nis < LARGEST_NIS:
            gain.shown += share * o.H[0][E_DELAY] * o.H[0][E_DELAY]
            apply_update(x, o)
    # All of them had the noise that is known only now
    largest = 1.0 / (1.0 / (k.delay_std * k.delay_std) + gain.shown / (MARGIN * gain.var))
    if x.P[E_DELAY][E_DELAY] < largest:
        x.P[E_DELAY][E_DELAY] = largest


def forget_gain(x: State) -> None:
    """Count the next gain from the next fix: the samples between are missing, or wrongly turned."""
    x.gain.begin.t = NEVER
    x.gain.end.t = NEVER
