"""How late the receiver's fixes are, from what their velocity and ours gain between two of them.

A velocity compared with ours as it stands tells of the delay, but also of tilt, biases and the slow
errors of both. A wrong delay makes these follow the motion, and noise passes for acceleration: a
filter that corrects all of them together is soon sure of a delay somewhere between its first guess
and the truth. What both gain within a second has hardly any of that in it; what it owes to attitude
and bias counts, and its noise is learnt from it. So nothing else moves the delay: in all other
corrections it is a consider state, whose uncertainty counts. Positions move it where a receiver
gives no velocity.

Source: consider states: Schmidt 1966; a delay by comparing increments: the calibration of cameras
against gyros, e.g. Kelly and Sukhatme 2014, Int. J. of Robotics Research 33, 13.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import lever_arm
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.past import acceleration_noise, look_back, unevenness
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import scale_correlation, set_variance
from cython.cimports.ekf_companion.core.filter.update import apply_delay_update, innovate
from cython.cimports.ekf_companion.core.memory.constants import NEVER, SHORTEST_GAIN
from cython.cimports.ekf_companion.core.memory.enums import AID_VELOCITY, E_ATT, E_BA, E_DELAY
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import fabs

LONGEST = cython.declare(cython.double, 1.6e9)
"""ns; in a longer time tilt and biases tell."""
MEMORY = cython.declare(cython.double, 40.0)
"""Gains over which their noise is learnt."""
FIRST_MEMORY = cython.declare(cython.double, 3.0)
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
LARGEST_DOUBT = cython.declare(cython.double, 1000.0)
"""A wrong delay makes the samples doubted as well, and must be found all the same."""
AHEAD = cython.declare(cython.double, 0.06)
"""So much later than a fix is true the samples must be known, s: its acceleration is a mean."""
LONGEST_WAIT = cython.declare(cython.double, 0.6e9)
"""for that, ns."""


def keep_fix(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Keep a fix with velocity until the samples have come that say what happened meanwhile."""
    end = address(x.gain.end)
    if x.P[E_DELAY][E_DELAY] == 0.0 or end.t > NEVER or x.t - x.gain.begin.t < SHORTEST_GAIN:
        return
    lever_arm.write_lever_arm(x, k, o)
    end.t = x.t
    for i in range(2):
        end.vel_n[i] = fix.vel_n[i] - o.arm_vel_n[i]
        for j in range(3):
            end.turn[i][j] = o.turn_nb[i][j]
    if x.gain.var == 0.0:
        x.gain.var = 2.0 * fix.stated_var[AID_VELOCITY]


def is_due(x: State) -> bool:
    """Return whether a fix is kept, and the samples have come that say what happened meanwhile."""
    if x.gain.end.t == NEVER:
        return False
    return lateness(x) >= AHEAD or x.t - x.gain.end.t >= LONGEST_WAIT


def lateness(x: State) -> float:
    """Return how long ago the fix that is kept was true, s."""
    return (x.t - x.gain.end.t) * 1e-9 + x.gnss_delay


def learn(x: State, k: Parameters, w: Scratch) -> None:
    """Learn the delay by the fix that is kept and the one some time before."""
    end = address(x.gain.end)
    late = lateness(x)
    o = address(w.observation)
    look_back(x, late, address(o.then))
    end.delay = x.gnss_delay
    for i in range(2):
        end.until[i] = o.then.until[i]
        end.accel_n[i] = o.then.accel_n[i]
    if end.t - x.gain.begin.t <= LONGEST:
        compare_gains(x, k, o)
    x.gain.begin = x.gain.end
    end.t = NEVER


def compare_gains(x: State, k: Parameters, o: Observation) -> None:
    """Correct the delay by the gain of the receiver's velocity and that of the samples."""
    gain = address(x.gain)
    begin = address(x.gain.begin)
    moved = begin.delay - gain.end.delay
    north = gain.end.until[0] - begin.until[0] - moved * begin.accel_n[0]
    east = gain.end.until[1] - begin.until[1] - moved * begin.accel_n[1]
    span = (gain.end.t - begin.t) * 1e-9
    doubt = x.doubt if x.doubt < LARGEST_DOUBT else LARGEST_DOUBT
    noise = MARGIN * gain.var + doubt * k.accel_noise * k.accel_noise * span
    to_dcm(x.q_nb, o.C_nb)
    true = true_share(x)
    turning = true * lever_arm.true_share(x)
    unevenness(x, o.uneven)
    for i in range(2):
        change = gain.end.accel_n[i] - begin.accel_n[i]
        uneven = 2.0 * o.uneven[i]  # at the begin as well
        clear(o, 1, noise + uneven)
        o.H[0][E_DELAY] = -change * true
        # attitude and bias turn and move the gain of the samples: in a steady circle as a delay
        o.H[0][E_ATT + 1 - i] = k.gravity * span * (2.0 * i - 1.0)
        o.H[0][E_ATT + 2] = -east if i == 0 else north
        for j in range(3):
            o.H[0][E_BA + j] = -o.C_nb[i][j] * span
        o.z[0] = gain.end.vel_n[i] - begin.vel_n[i] - (north if i == 0 else east)
        o.z[0] += change * true * (x.gnss_delay - gain.end.delay)
        nis = innovate(x, o)
        learn_noise(x, o, nis, uneven)
        if nis < LARGEST_NIS:
            lever_arm.learn(x, k, o, i, turning)
        if nis < LARGEST_NIS and true > 0.0:
            gain.shown += o.H[0][E_DELAY] * o.H[0][E_DELAY] * MARGIN * gain.var / noise
            apply_delay_update(x, o)
    weigh_anew(x, k)


def true_share(x: State) -> float:
    """Return how much of the change in acceleration is no noise, which would pass for knowledge."""
    gain = address(x.gain)
    square = 0.0
    for i in range(2):
        change = gain.end.accel_n[i] - gain.begin.accel_n[i]
        square += 0.5 * change * change
    gain.change += (square - gain.change) / CHANGE_MEMORY
    true = gain.change - 2.0 * acceleration_noise(x)
    return true / gain.change if true > 0.0 else 0.0


def learn_noise(x: State, o: Observation, nis: float, uneven: float) -> None:
    """Learn the noise of gains; the delay that is not known and what is uneven hide it."""
    gain = address(x.gain)
    expected = o.L[0][0] * o.L[0][0]
    hidden = o.H[0][E_DELAY] * o.H[0][E_DELAY] * x.P[E_DELAY][E_DELAY] + uneven
    share = hidden / expected if hidden < expected else 1.0
    seen = (nis if nis < LARGEST_TERM else LARGEST_TERM) * expected - hidden
    weight = (1.0 - share) * (1.0 - share) / (FIRST_MEMORY + gain.n)
    gain.var += weight * (seen - gain.var)
    if gain.var < LEAST_VAR:
        gain.var = LEAST_VAR
    gain.n = gain.n + 1.0 if gain.n < MEMORY - FIRST_MEMORY else gain.n


def weigh_anew(x: State, k: Parameters) -> None:
    """Weigh all gains so far by the noise that is known only now, if it is more."""
    prior = first_variance(x, k)
    variance = 1.0 / (1.0 / prior + x.gain.shown / (MARGIN * x.gain.var))
    if x.P[E_DELAY][E_DELAY] < variance:
        share = (prior - variance) / (prior - x.P[E_DELAY][E_DELAY])
        x.gnss_delay = x.first_delay + share * (x.gnss_delay - x.first_delay)
        set_variance(x, E_DELAY, variance)


def follow_lag(x: State, k: Parameters, moved: float) -> None:
    """Let the first guess of the delay, which is of positions, go on with the velocity's lag, s.

    As far as it still counts: what the velocities have shown of their delay they have shown.
    """
    prior = first_variance(x, k)
    if prior > 0.0:
        x.first_delay += moved
        x.gnss_delay += moved * x.P[E_DELAY][E_DELAY] / prior


def first_variance(x: State, k: Parameters) -> float:
    """Return the variance of the delay's first guess, s^2."""
    return x.first_delay_var if x.first_delay_var > 0.0 else k.delay_std * k.delay_std


def take_told(x: State, k: Parameters, told: float) -> None:
    """Begin from the delay that the autopilot tells instead; what was learnt since still counts."""
    first = told - k.gnss_delay
    if k.told_delay_std < 0.0 or (first == x.first_delay and x.first_delay_var > 0.0):
        return
    was = first_variance(x, k)
    std = k.delay_std if fabs(told - k.unset_delay) < 1e-6 else k.told_delay_std
    now = std * std
    before = x.P[E_DELAY][E_DELAY]
    if before > 0.0 and now > 0.0:
        variance = 1.0 / (1.0 / before - 1.0 / was + 1.0 / now)
        change = first / now - x.first_delay / was
        x.gnss_delay = variance * (x.gnss_delay / before + change)
        scale_correlation(x, E_DELAY, variance / before if variance < before else 1.0)
        set_variance(x, E_DELAY, variance)
    else:
        x.gnss_delay = first
    x.first_delay = first
    x.first_delay_var = now


def forget_gain(x: State) -> None:
    """Count the next gain from the next fix: the samples between are missing, or wrongly turned."""
    x.gain.begin.t = NEVER
    x.gain.end.t = NEVER
