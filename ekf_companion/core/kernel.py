# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The step: one inertial sample, and the events that were true since the one before.

Everything that decides is here and lives in the state block: which aid is used, gated or timed out,
what is reset and why. So a block and the events after it always give the same bits, live, replayed
or in another order of arrival.

x is the state block, k the parameters, w scratch, rows the events (layout.py says what lies where).
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import (
        align,
        correct,
        gate,
        gnss,
        heading,
        observe,
        propagate,
        tape,
        yaw_bank,
        yaw_frame,
    )
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import asin, atan2, cos, fabs, sin, sqrt
else:
    from math import asin, atan2, cos, fabs, sin, sqrt

    from ekf_companion.core import (
        align,
        correct,
        gate,
        gnss,
        heading,
        observe,
        propagate,
        tape,
        yaw_bank,
        yaw_frame,
    )
    from ekf_companion.core import state as at

# Kinds of events, as in nav.measurements.Kind
GNSS = cython.declare(cython.double, 1.0)
HEADING = cython.declare(cython.double, 2.0)
MAG = cython.declare(cython.double, 3.0)
BARO = cython.declare(cython.double, 4.0)
VEHICLE = cython.declare(cython.double, 5.0)

# States of health, as in nav.state.Status
INIT = cython.declare(cython.int, 0)
ALIGNING = cython.declare(cython.int, 1)
ATTITUDE = cython.declare(cython.int, 2)
OK = cython.declare(cython.int, 3)
DEGRADED = cython.declare(cython.int, 4)
DEAD_RECKONING = cython.declare(cython.int, 5)
INVALID = cython.declare(cython.int, 6)

NAN = cython.declare(cython.double, float("nan"))
NEVER = cython.declare(cython.double, -1e18)
DEG = cython.declare(cython.double, 57.29577951308232)
BLIND = cython.declare(cython.double, 0.5)
"""Between samples further apart than this any motion may have begun and ended, s."""
LARGEST_TURN = cython.declare(cython.double, 4.0)
"""Square of the turn, rad^2, that one sample may stand for."""
RESTORE_AGAIN = cython.declare(cython.double, 1e10)
"""A restored state that cannot be either within so long is not restored again, ns."""
SLOW_STREAM = cython.declare(cython.double, 0.15)
"""Usual interval beyond which a vehicle's attitude is a guess, s."""
SLOW_GAP = cython.declare(cython.double, 3.0)
"""Silence of so many usual intervals is a gap, however slow the stream."""
FEWEST = cython.declare(cython.double, 5.0)
"""Samples to judge rest by."""
ROUGH_AFTER = cython.declare(cython.double, 6e9)
"""Without rest and without GNSS the attitude is taken roughly after this long, ns."""
FAKE_INTERVAL = cython.declare(cython.double, 2e8)
"""Between two assumptions that the vehicle is not going anywhere, while it has no GNSS, ns."""
FIRST_SHARE = cython.declare(cython.double, 0.3)
"""Share of the variance that a receiver states for its position that is white, to begin with."""
VAGUE = cython.declare(cython.double, 0.0305)
"""Variance of an angle beyond which the attitude is not well known, rad^2: 10 degrees."""
LOST = cython.declare(cython.double, 100.0)
"""So many times the limit (as variances), a position is not worth keeping."""
LONGEST_OUTAGE = cython.declare(cython.double, 60.0)
"""And after so long without GNSS, s."""
REST_SPEED = cython.declare(cython.double, 0.05)
"""One sigma of the velocity of what stands still, m/s."""
REST_RATE = cython.declare(cython.double, 1e-4)
"""One sigma of its rate, rad/s, beside noise: the ground gives way, the wind rocks."""
GROUND_EFFECT = cython.declare(cython.double, 2.0)
"""What rotors near the ground add to the barometer's noise, m."""
GROUND_EFFECT_HEIGHT = cython.declare(cython.double, 3.0)
"""Up to this height above the last rest, m."""
NOISE_BLOCK = cython.declare(cython.double, 0.0095)
"""Least length of a block of samples, s: 10 ms, give or take their jitter."""
NOISE_MEMORY = cython.declare(cython.double, 2.0)
"""Time constant of the noise learnt from the samples, s."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def step(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    first: cython.Py_ssize_t,
    last: cython.Py_ssize_t,
) -> cython.void:
    """Take the sample rows[last]; rows[first:last] are the events true since the sample before.

    Where w goes on behind the scratch numbers, what happens is recorded there (core/tape.py).
    """
    is_taped: cython.bint = w.shape[0] > at.SCRATCH
    i: cython.Py_ssize_t
    r: cython.Py_ssize_t
    dt: cython.double
    part: cython.double
    t: cython.double = rows[last, at.ROW_T]
    start: cython.double = x[at.X_T]
    span: cython.double = (t - start) * 1e-9

    # The first sample only says what time it is
    if x[at.X_MODE] == at.MODE_INIT:
        begin(x, t)
        yaw_bank.begin(x, k)
        remember(x, rows, last)
        return
    if span <= 0.0:
        return

    # Go to each event in turn, then to the sample's own time
    measure(x, k, w, rows, last, span)
    for r in range(first, last + 1):
        dt = (rows[r, at.ROW_T] - x[at.X_T]) * 1e-9
        if dt > 0.0:
            # the mean over this part of the interval, from that over the whole
            part = ((rows[r, at.ROW_T] - start) + (x[at.X_T] - start)) * 0.5e-9 - 0.5 * span
            for i in range(6):
                w[at.W_RATE + i] = w[at.W_MEAN + i] + part * w[at.W_RATE_SLOPE + i]
            if x[at.X_MODE] == at.MODE_LEVEL:
                align.carry(x, w, dt)
            else:
                propagate.move(x, k, w, dt)
                propagate.spread(x, k, w, dt)
                if is_taped:
                    tape.moved(x, k, w, dt)
                if x[at.X_NEEDS_RESET] != 0.0:
                    align.carry(x, w, dt)
            yaw_frame.carry(x, w, dt)
            x[at.X_T] = rows[r, at.ROW_T]
        if r < last:
            take(x, k, w, rows, r)
            if is_taped:
                tape.noted(x, w, False)
    if span > k[at.K_GAP]:
        doubt(x, k, span, span > SLOW_GAP * x[at.X_DT])
        yaw_frame.lose(x)
        if is_taped:
            tape.doubted(x, w)

    # What the sample itself tells: noise, rest, whether all aids still speak
    learn(x, rows, last, span)
    remember(x, rows, last)
    settle(x, k, w, t)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def measure(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
    span: cython.double,
) -> cython.void:
    """Write the mean rate and force of the interval before a sample to w[W_MEAN], and their slopes.

    A sample stands for the interval before it, if it is a mean and none is missing; else it is a
    reading at its end. Either way two in a row say how fast rate and force change.
    """
    i: cython.Py_ssize_t
    turn: cython.double = 0.0
    is_regular: cython.bint = span <= 1.5 * x[at.X_DT]
    for i in range(3):
        turn += rows[r, at.ROW_V + i] * rows[r, at.ROW_V + i]
    if span > BLIND or turn * span * span > LARGEST_TURN:
        hold(x, k, w)
        is_regular = False
        for i in range(6):
            w[at.W_MEAN + i] = x[at.X_GYRO + i]
    else:
        for i in range(6):
            w[at.W_MEAN + i] = rows[r, at.ROW_V + i]
            if k[at.K_MEAN_SAMPLES] == 0.0 or not is_regular:
                w[at.W_MEAN + i] = 0.5 * (w[at.W_MEAN + i] + x[at.X_GYRO + i])
    for i in range(6):
        w[at.W_RATE_SLOPE + i] = 0.0
        if is_regular and x[at.X_SAMPLES] > 1.0:
            w[at.W_RATE_SLOPE + i] = (rows[r, at.ROW_V + i] - x[at.X_GYRO + i]) / span


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def begin(x: cython.double[::1], t: cython.double) -> cython.void:
    """Start with nothing known but the time; what was counted before stays counted."""
    i: cython.Py_ssize_t
    x[at.X_T] = t
    x[at.X_MODE] = at.MODE_LEVEL
    x[at.X_Q] = 1.0
    x[at.X_DECLINATION] = NAN
    if x[at.X_WHITE + at.AID_POS] == 0.0:
        # of a receiver that nothing is known of from before
        x[at.X_WHITE + at.AID_POS] = FIRST_SHARE
        x[at.X_WHITE + at.AID_HGT] = FIRST_SHARE
        x[at.X_WHITE + at.AID_VEL] = 1.0
    x[at.X_ARMED] = NAN
    x[at.X_LANDED] = NAN
    x[at.X_T_FIX] = NEVER
    x[at.X_T_RAW_FIX] = NEVER
    x[at.X_T_MAG] = NEVER
    x[at.X_T_FAKE] = t
    x[at.X_T_RESTORED] = NEVER
    for i in range(3):
        x[at.X_T_HEADING + i] = NEVER
    for i in range(at.AIDS):
        x[at.X_T_USED + i] = NEVER
        x[at.X_T_REFUSED + i] = NEVER
    for i in range(3 * at.C_SIZE):
        x[at.X_RUN + i] = 0.0
    x[at.X_LEVEL + at.L_START] = t
    align.restart(x, t)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_sound(x: cython.double[::1]) -> cython.bint:
    """Say whether the state is one that a vehicle can be in; one NaN anywhere makes it none."""
    i: cython.Py_ssize_t
    speed: cython.double = 0.0
    bias: cython.double = 0.0
    largest: cython.double = x[at.X_Q] * x[at.X_Q] + fabs(x[at.X_BARO]) + fabs(x[at.X_HEADING])
    if not fabs(x[at.X_DELAY]) < 1.0:
        return False
    for i in range(3):
        speed += x[at.X_VEL + i] * x[at.X_VEL + i]
        bias += x[at.X_BG + i] * x[at.X_BG + i] * 100.0 + x[at.X_BA + i] * x[at.X_BA + i]
        largest += x[at.X_Q + 1 + i] * x[at.X_Q + 1 + i] + fabs(x[at.X_POS + i])
    for i in range(at.N):
        if not x[at.X_COV + i * (at.N + 1)] >= 0.0:
            return False
        largest += x[at.X_COV + i * (at.N + 1)]
    # 1 km/s, 1 rad/s or 10 m/s^2 of bias; a sigma of 1000 km
    return speed < 1e6 and bias < 100.0 and largest < 1e12


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def recover(
    x: cython.double[::1],
    k: cython.double[::1],
    good: cython.double[::1],
    t: cython.double,
) -> cython.void:
    """Put an earlier, good state in the place of one that cannot be, and doubt it by its age.

    The accounts and the last sample live on. A second time so soon, or without a good state in
    flight, the filter starts over.
    """
    i: cython.Py_ssize_t
    if t - x[at.X_T_RESTORED] < RESTORE_AGAIN or good[at.X_MODE] < at.MODE_ATTITUDE:
        start_over(x, t, at.RESET_BOUNDS)
        x[at.X_T_RESTORED] = t
        return
    for i in range(at.X_Q, at.X_GYRO):
        x[i] = good[i]
    for i in range(at.X_COV, at.BLOCK):
        x[i] = good[i]
    for i in range(3):
        x[at.X_ACC_N + i] = 0.0
    gate.announce(x, at.RESET_BOUNDS)
    x[at.X_T] = t
    x[at.X_T_RESTORED] = t
    doubt(x, k, (t - good[at.X_T]) * 1e-9, False)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def start_over(x: cython.double[::1], t: cython.double, reason: cython.double) -> cython.void:
    """Forget a state that cannot be, and level again; origin and accounts live on."""
    i: cython.Py_ssize_t
    for i in range(at.X_Q, at.X_LAT0):
        x[i] = 0.0
    for i in range(at.X_COV, at.BLOCK):
        x[i] = 0.0
    for i in range(3):
        x[at.X_ACC_N + i] = 0.0
    x[at.X_HEADING] = 0.0
    x[at.X_HAS_YAW] = 0.0
    x[at.X_HAS_BARO] = 0.0
    x[at.X_NEEDS_RESET] = 0.0
    x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
    x[at.X_LEVEL + at.L_HAS_REF] = 0.0
    for i in range(3):
        x[at.X_NOISE_G + i] = 0.0
        x[at.X_NOISE_A + i] = 0.0
        x[at.X_WHITE + i] = 0.0
    x[at.X_RESETS] += 1.0
    x[at.X_RESET_REASON] = reason
    armed: cython.double = x[at.X_ARMED]
    landed: cython.double = x[at.X_LANDED]
    begin(x, t)
    x[at.X_ARMED] = armed
    x[at.X_LANDED] = landed


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def remember(
    x: cython.double[::1], rows: cython.double[:, ::1], r: cython.Py_ssize_t
) -> cython.void:
    """Keep the sample for the next step."""
    i: cython.Py_ssize_t
    x[at.X_SAMPLES] += 1.0
    for i in range(3):
        x[at.X_GYRO + i] = rows[r, at.ROW_V + i]
        x[at.X_ACCEL + i] = rows[r, at.ROW_V + 3 + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def hold(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Over a long time assume no turn and no acceleration: one sample says nothing of it."""
    i: cython.Py_ssize_t
    propagate.matrix(x, at.X_Q, w)
    for i in range(3):
        x[at.X_GYRO + i] = x[at.X_BG + i]
        x[at.X_ACCEL + i] = x[at.X_BA + i] - k[at.K_GRAVITY] * w[at.W_C_NB + 6 + i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def doubt(
    x: cython.double[::1], k: cython.double[::1], span: cython.double, is_gap: cython.bint
) -> cython.void:
    """Count in what may have happened while no sample came; after a long gap begin velocity anew.

    A vehicle turns by some 0.2 rad/s and accelerates by some 2 m/s^2 (one sigma) beside what the
    samples at both ends of a silence show. Where they show nothing, one that is flown hard is off
    by half a radian and 4 m/s^2 in a second; tilt is bounded, heading and speed hardly are. A
    stream that is always as slow has no gap, only doubt.
    """
    i: cython.Py_ssize_t
    turned: cython.double = 0.2 * span
    gained: cython.double = 2.0 * span
    yawed: cython.double = turned
    if is_gap:
        x[at.X_GAPS] += 1.0
        align.restart(x, x[at.X_T])
    if x[at.X_MODE] == at.MODE_LEVEL:
        if is_gap:
            x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
        return
    if is_gap and span > BLIND:
        turned = 0.5 * span
        gained = 4.0 * span
    if yawed < turned:
        yawed = turned
    if yawed > 1.8:
        yawed = 1.8
    if turned > 0.5:
        turned = 0.5
    if gained > 20.0:
        gained = 20.0
    for i in range(2):
        x[at.X_COV + (at.E_ATT + i) * (at.N + 1)] += turned * turned
    x[at.X_COV + (at.E_ATT + 2) * (at.N + 1)] += yawed * yawed
    for i in range(3):
        x[at.X_COV + (at.E_VEL + i) * (at.N + 1)] += gained * gained
        x[at.X_COV + (at.E_POS + i) * (at.N + 1)] += 0.25 * gained * gained * span * span
    if is_gap and span > k[at.K_GAP_RESET] and x[at.X_MODE] == at.MODE_NAVIGATE:
        x[at.X_NEEDS_RESET] = at.NEEDS_FIX
        x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
        x[at.X_LEVEL + at.L_HAS_REF] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learn(
    x: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
    span: cython.double,
) -> cython.void:
    """Learn the white noise of each axis from second differences, which smooth motion leaves small.

    Of means over a block of samples: a rotor's jitter that a gyro samples now and then is not white
    from sample to sample, and what counts is how it adds up. White noise of variance s^2 gives
    second differences of variance 6 s^2; x keeps s^2 dt.
    """
    i: cython.Py_ssize_t
    d: cython.double
    gain: cython.double
    if x[at.X_DT] == 0.0:
        x[at.X_DT] = span
    x[at.X_DT] += 0.05 * ((span if span < 2.0 * x[at.X_DT] else 2.0 * x[at.X_DT]) - x[at.X_DT])
    if x[at.X_SAMPLES] < 2.0 or span > 1.5 * x[at.X_DT] or span > 0.5 * NOISE_MEMORY:
        for i in range(at.X_BLOCK_SUM, at.X_BLOCK1):
            x[i] = 0.0
        return
    for i in range(6):
        x[at.X_BLOCK_SUM + i] += rows[r, at.ROW_V + i]
    x[at.X_BLOCK_N] += 1.0
    x[at.X_BLOCK_DT] += span
    if x[at.X_BLOCK_DT] < NOISE_BLOCK:
        return
    gain = x[at.X_BLOCK_DT] / NOISE_MEMORY
    for i in range(6):
        d = x[at.X_BLOCK_SUM + i] / x[at.X_BLOCK_N]
        if x[at.X_BLOCKS] >= 2.0:
            x[at.X_NOISE_G + i] += gain * (
                second(d, x[at.X_BLOCK1 + i], x[at.X_BLOCK2 + i]) * x[at.X_BLOCK_DT]
                - x[at.X_NOISE_G + i]
            )
        x[at.X_BLOCK2 + i] = x[at.X_BLOCK1 + i]
        x[at.X_BLOCK1 + i] = d
        x[at.X_BLOCK_SUM + i] = 0.0
    x[at.X_BLOCKS] += 1.0
    x[at.X_BLOCK_N] = 0.0
    x[at.X_BLOCK_DT] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def second(a: cython.double, b: cython.double, c: cython.double) -> cython.double:
    """Give the variance that a second difference shows, if its parts are equally noisy."""
    d: cython.double = a - 2.0 * b + c
    return d * d / 6.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def settle(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], t: cython.double
) -> cython.void:
    """Level, or stand still, when a window of rest is full; keep an attitude without GNSS."""
    i: cython.Py_ssize_t
    align.gather(x)
    if t - x[at.X_LEVEL + at.L_T0] >= k[at.K_ALIGN_TIME] * 1e9 and (
        x[at.X_LEVEL + at.L_N] >= FEWEST
    ):
        # an autopilot that says it flies is believed: a smooth flight looks like rest
        x[at.X_AT_REST] = 0.0
        if (
            (x[at.X_ARMED] != 1.0 or x[at.X_LANDED] == 1.0)
            and align.is_rest(x, k)
            and not is_moving(x)
        ):
            x[at.X_AT_REST] = 1.0
        if x[at.X_MODE] == at.MODE_LEVEL:
            if x[at.X_AT_REST] != 0.0:
                align.level_at_rest(x, k, w)
                yaw_bank.know_bias(x, sqrt(x[at.X_COV + at.E_BG * (at.N + 1)]))
            elif t - x[at.X_LEVEL + at.L_START] > ROUGH_AFTER and t - x[at.X_T_FIX] > ROUGH_AFTER:
                align.level_roughly(x, k, w)
        elif x[at.X_AT_REST] != 0.0 and k[at.K_USE_REST] != 0.0 and x[at.X_NEEDS_RESET] == 0.0:
            stand(x, k, w)
        align.restart(x, t)
    if x[at.X_MODE] == at.MODE_ATTITUDE and t - x[at.X_T_FAKE] >= FAKE_INTERVAL:
        # It goes nowhere, by a lot or by nothing: that bounds the tilt, as gravity does
        x[at.X_T_FAKE] = t
        observe.zero_velocity(x, w, 0.1 if x[at.X_AT_REST] != 0.0 else 30.0)
        correct.innovate(x, w, 3)
        correct.absorb(x, w, 3)
        correct.forget(x, at.E_POS, 2, 1.0)
        for i in range(2):
            x[at.X_POS + i] = 0.0
    elif (
        x[at.X_MODE] == at.MODE_NAVIGATE
        and gate.is_timed_out(x, at.AID_POS, LONGEST_OUTAGE)
        and x[at.X_COV + at.E_POS * (at.N + 1)] > LOST * k[at.K_LIMIT_POS] * k[at.K_LIMIT_POS]
    ):
        # so long without GNSS that only the attitude is left to keep
        x[at.X_MODE] = at.MODE_ATTITUDE
        correct.forget(x, at.E_VEL, 3, 100.0)
        for i in range(3):
            x[at.X_VEL + i] = 0.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_moving(x: cython.double[::1]) -> cython.bint:
    """Say whether our own velocity speaks against rest: wings fly as quietly as they stand."""
    i: cython.Py_ssize_t
    speed: cython.double = 0.0
    sigma: cython.double = 0.0
    if x[at.X_MODE] != at.MODE_NAVIGATE or x[at.X_LANDED] == 1.0:
        return False
    for i in range(3):
        speed += x[at.X_VEL + i] * x[at.X_VEL + i]
        sigma += x[at.X_COV + (at.E_VEL + i) * (at.N + 1)]
    # a velocity that is not known speaks against it as well
    if sigma > 1.0:
        return True
    return speed > 0.25 + 9.0 * sigma


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def stand(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Stand still: no velocity, and what the gyro showed over the window is its bias.

    Only where a rest has been seen before, or the autopilot says that it has landed: so a first
    hover is not taken for one.
    """
    i: cython.Py_ssize_t
    n: cython.double = x[at.X_LEVEL + at.L_N]
    spread: cython.double = 0.0
    if not x[at.X_REST_G] > 0.0 and x[at.X_LANDED] != 1.0:
        return
    if x[at.X_MODE] == at.MODE_NAVIGATE:
        observe.zero_velocity(x, w, REST_SPEED)
        if not gate.fuse(x, k, w, at.AID_REST, 3):
            return
        x[at.X_GROUND] = x[at.X_POS + 2]
        x[at.X_HAS_GROUND] = 1.0
    for i in range(3):
        w[at.W_RATE + i] = x[at.X_LEVEL + at.L_GYRO + i] / n
        spread += x[at.X_LEVEL + at.L_GYRO2 + i] / n - w[at.W_RATE + i] * w[at.W_RATE + i]
    if spread < 0.0:
        spread = 0.0
    observe.zero_rate(x, w, sqrt(spread / n) + REST_RATE)
    gate.fuse(x, k, w, at.AID_REST, 3)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
) -> cython.void:
    """Take one event, at its own time."""
    kind: cython.double = rows[r, at.ROW_KIND]
    if kind == GNSS:
        if not gnss.take_fix(x, k, w, rows, r):
            # fixes kept coming and were refused: the attitude or a bias is wrong as well
            start_over(x, x[at.X_T], at.RESET_VELOCITY)
    elif kind == HEADING:
        if heading.is_heading_used(x, k, x[at.X_T], rows[r, at.ROW_V + 2]):
            heading.take_heading(
                x, k, w, rows[r, at.ROW_V], rows[r, at.ROW_V + 1], rows[r, at.ROW_V + 2] == 0.0
            )
        else:
            gate.count(x, at.AID_YAW, at.WHY_UNUSED)
    elif kind == MAG:
        if heading.is_field_used(x, k):
            heading.take_field(
                x, k, w, rows[r, at.ROW_V], rows[r, at.ROW_V + 1], rows[r, at.ROW_V + 2]
            )
        else:
            gate.count(x, at.AID_YAW, at.WHY_UNUSED)
    elif kind == BARO:
        take_baro(x, k, w, rows[r, at.ROW_V])
    elif kind == VEHICLE:
        x[at.X_ARMED] = rows[r, at.ROW_V]
        x[at.X_LANDED] = rows[r, at.ROW_V + 1]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_baro(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], alt: cython.double
) -> cython.void:
    """Take a pressure altitude; the first one gives the offset, with the height's error."""
    j: cython.Py_ssize_t
    std: cython.double
    down: cython.Py_ssize_t = at.X_COV + (at.E_POS + 2) * at.N
    own: cython.Py_ssize_t = at.X_COV + at.E_BARO * at.N
    if k[at.K_USE_BARO] == 0.0 or x[at.X_MODE] == at.MODE_LEVEL:
        gate.count(x, at.AID_BARO, at.WHY_UNUSED)
        return
    if x[at.X_HAS_BARO] != 0.0:
        std = k[at.K_BARO_STD]
        if (
            x[at.X_ARMED] == 1.0
            and x[at.X_HAS_GROUND] != 0.0
            and x[at.X_GROUND] - x[at.X_POS + 2] < GROUND_EFFECT_HEIGHT
        ):
            std = std + GROUND_EFFECT
        observe.pressure_altitude(x, w, alt, std)
        if gate.fuse(x, k, w, at.AID_BARO, 1):
            return
        if not gate.is_timed_out(x, at.AID_BARO, k[at.K_TIMEOUT_HGT]):
            return
    x[at.X_BARO] = alt - (x[at.X_ALT0] - x[at.X_POS + 2])
    for j in range(at.N):
        x[own + j] = x[down + j]
        x[at.X_COV + j * at.N + at.E_BARO] = x[down + j]
    x[own + at.E_BARO] = x[down + at.E_POS + 2] + k[at.K_BARO_STD] * k[at.K_BARO_STD]
    x[at.X_FRESH + at.E_BARO] += 1.0
    x[at.X_HAS_BARO] = 1.0
    x[at.X_T_USED + at.AID_BARO] = x[at.X_T]
    gate.count(x, at.AID_BARO, at.WHY_FUSED)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def status(x: cython.double[::1], k: cython.double[::1]) -> cython.int:
    """Say how far the state can be trusted now."""
    late: cython.double
    e: cython.Py_ssize_t
    if x[at.X_MODE] == at.MODE_INIT:
        return INIT
    if x[at.X_MODE] == at.MODE_LEVEL:
        return ALIGNING
    if x[at.X_MODE] == at.MODE_ATTITUDE:
        return ATTITUDE
    if not (
        x[at.X_COV + at.E_POS * (at.N + 1)] + x[at.X_COV + (at.E_POS + 1) * (at.N + 1)]
        <= k[at.K_LIMIT_POS] * k[at.K_LIMIT_POS]
    ):
        return INVALID
    # one second beyond the interval at which the receiver speaks, and its delay
    late = 1.0 + (x[at.X_FIX_DT] if x[at.X_FIX_DT] < 2.0 else 2.0)
    if gate.is_timed_out(x, at.AID_POS, late) and gate.is_timed_out(x, at.AID_VEL, late):
        return DEAD_RECKONING
    if x[at.X_DT] > SLOW_STREAM or x[at.X_NEEDS_RESET] != 0.0:
        return DEGRADED
    if gate.is_timed_out(x, at.AID_POS, late + 1.0):
        return DEGRADED
    for e in range(at.E_ATT, at.E_ATT + 3):
        if x[at.X_COV + e * (at.N + 1)] > VAGUE:
            return DEGRADED
    if gate.is_timed_out(x, at.AID_YAW, 5.0) and x[at.X_HEADING_SOURCE] != 0.0:
        # where there never was a compass, turns show the heading as well
        return DEGRADED
    if gate.is_timed_out(x, at.AID_HGT, late + 1.0) and gate.is_timed_out(x, at.AID_BARO, 2.0):
        return DEGRADED
    return OK


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def describe(
    x: cython.double[::1],
    k: cython.double[::1],
    y: cython.double[::1],
    w: cython.double[::1],
    out: cython.double[::1],
) -> cython.int:
    """Write the estimate of now to out, in the order of nav.state.COLUMNS but for the time.

    Now is the sample's stamp: the state is carried on, in y, by the lag of the inertial sensor.
    Gives the status; what is not known yet is NaN.
    """
    i: cython.Py_ssize_t
    state: cython.int = status(x, k)
    for i in range(at.X_BANK):
        y[i] = x[i]
    if k[at.K_LAG] > 0.0 and x[at.X_MODE] >= at.MODE_ATTITUDE:
        for i in range(6):
            w[at.W_RATE + i] = x[at.X_GYRO + i]
            w[at.W_RATE_SLOPE + i] = 0.0
        propagate.move(y, k, w, k[at.K_LAG])
    for i in range(at.OUT):
        out[i] = NAN
    out[at.OUT_STATUS] = state
    out[at.OUT_RESETS] = x[at.X_RESETS]
    if x[at.X_MODE] < at.MODE_ATTITUDE:
        return state

    # Attitude, biases
    propagate.matrix(y, at.X_Q, w)
    sp: cython.double = -w[at.W_C_NB + 6]
    if sp > 1.0:
        sp = 1.0
    if sp < -1.0:
        sp = -1.0
    yaw: cython.double = atan2(w[at.W_C_NB + 3], w[at.W_C_NB])
    sign: cython.double = -1.0 if y[at.X_Q] < 0.0 else 1.0
    for i in range(4):
        out[at.OUT_Q + i] = sign * y[at.X_Q + i]
    out[at.OUT_EULER] = atan2(w[at.W_C_NB + 7], w[at.W_C_NB + 8])
    out[at.OUT_EULER + 1] = asin(sp)
    out[at.OUT_EULER + 2] = yaw
    for i in range(3):
        out[at.OUT_BG + i] = x[at.X_BG + i]
        out[at.OUT_BA + i] = x[at.X_BA + i]

    # Attitude error in n as errors of the Euler angles
    cp: cython.double = sqrt(1.0 - sp * sp)
    if cp < 1e-3:
        cp = 1e-3
    c: cython.double = cos(yaw)
    s: cython.double = sin(yaw)
    p00: cython.double = x[at.X_COV]
    p01: cython.double = x[at.X_COV + 1]
    p02: cython.double = x[at.X_COV + 2]
    p11: cython.double = x[at.X_COV + at.N + 1]
    p12: cython.double = x[at.X_COV + at.N + 2]
    p22: cython.double = x[at.X_COV + 2 * at.N + 2]
    along: cython.double = c * c * p00 + 2.0 * c * s * p01 + s * s * p11
    out[at.OUT_SD + 6] = sqrt(along) / cp
    out[at.OUT_SD + 7] = sqrt(s * s * p00 - 2.0 * c * s * p01 + c * c * p11)
    out[at.OUT_SD + 8] = sqrt(
        fabs(p22 + sp * sp / (cp * cp) * along + 2.0 * sp / cp * (c * p02 + s * p12))
    )
    if x[at.X_HAS_YAW] == 0.0:
        out[at.OUT_EULER + 2] = NAN
        out[at.OUT_SD + 8] = NAN

    # Height without GNSS is over the start, by the barometer
    if x[at.X_MODE] < at.MODE_NAVIGATE:
        if x[at.X_HAS_BARO] != 0.0:
            out[at.OUT_POS + 2] = y[at.X_POS + 2]
            out[at.OUT_VEL + 2] = y[at.X_VEL + 2]
            out[at.OUT_SD + 2] = sqrt(x[at.X_COV + (at.E_POS + 2) * (at.N + 1)])
            out[at.OUT_SD + 5] = sqrt(x[at.X_COV + (at.E_VEL + 2) * (at.N + 1)])
        return state
    for i in range(3):
        out[at.OUT_POS + i] = y[at.X_POS + i]
        out[at.OUT_VEL + i] = y[at.X_VEL + i]
        out[at.OUT_SD + i] = sqrt(x[at.X_COV + (at.E_POS + i) * (at.N + 1)])
        out[at.OUT_SD + 3 + i] = sqrt(x[at.X_COV + (at.E_VEL + i) * (at.N + 1)])
    out[at.OUT_LLA] = (x[at.X_LAT0] + y[at.X_POS] / x[at.X_SCALE_N]) * DEG
    out[at.OUT_LLA + 1] = observe.wrap(x[at.X_LON0] + y[at.X_POS + 1] / x[at.X_SCALE_E]) * DEG
    out[at.OUT_LLA + 2] = x[at.X_ALT0] - y[at.X_POS + 2]
    return state
