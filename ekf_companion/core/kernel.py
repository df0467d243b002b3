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
    from cython.cimports.ekf_companion.core import align, correct, observe, propagate
    from cython.cimports.ekf_companion.core import layout as at
    from cython.cimports.libc.math import asin, atan2, cos, fabs, isnan, sin, sqrt
else:
    from math import asin, atan2, cos, fabs, isnan, sin, sqrt

    from ekf_companion.core import align, correct, observe, propagate
    from ekf_companion.core import layout as at

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
PREFERRED_AGE = cython.declare(cython.double, 5e9)
"""How long a better source keeps the worse ones out after its last word, ns."""
BLIND = cython.declare(cython.double, 0.5)
"""Between samples further apart than this any motion may have begun and ended, s."""
LARGEST_TURN = cython.declare(cython.double, 4.0)
"""Square of the turn, rad^2, that one sample may stand for."""
PROOF = cython.declare(cython.double, 9e8)
"""How long an aid must insist before it resets anything, ns: one wild fix does not."""
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
WHITE_MEMORY = cython.declare(cython.double, 40.0)
"""Fixes over which a receiver's white noise is learnt."""
LEAST_RATIO = cython.declare(cython.double, 0.01)
"""A receiver overstates its white error ten times at the most: what is learnt beyond is luck."""
LARGEST_RATIO = cython.declare(cython.double, 9.0)
MOUNTING = cython.declare(cython.double, 0.005)
"""Slow error of a dual antenna: how well its baseline is mounted, rad."""
TRUSTED = cython.declare(cython.double, 0.02)
"""Slow error up to which a heading that has jumped is believed, rad."""
REFERENCE_TILT = cython.declare(cython.double, 0.05)
"""What the tilt, not known yet, may do to a heading while levelling, rad."""
UNKNOWN_DECLINATION = cython.declare(cython.double, 0.2)
"""One sigma of the declination before the first fix, rad: most people live within it."""
LOST = cython.declare(cython.double, 1.0)
"""X_NEEDS_RESET: nothing has been heard of position and velocity since a long gap."""
TILTED = cython.declare(cython.double, 2.0)
"""X_NEEDS_RESET: fixes have come again, but they have not shown the attitude yet."""
PATIENCE = cython.declare(cython.double, 3e9)
"""Where no heading comes to find the attitude with, it is left to the filter after so long, ns."""
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
    """Take the sample rows[last]; rows[first:last] are the events true since the sample before."""
    r: cython.Py_ssize_t
    dt: cython.double
    t: cython.double = rows[last, at.ROW_T]
    span: cython.double = (t - x[at.X_T]) * 1e-9
    gx: cython.double = rows[last, at.ROW_V]
    gy: cython.double = rows[last, at.ROW_V + 1]
    gz: cython.double = rows[last, at.ROW_V + 2]
    ax: cython.double = rows[last, at.ROW_V + 3]
    ay: cython.double = rows[last, at.ROW_V + 4]
    az: cython.double = rows[last, at.ROW_V + 5]

    # The first sample only says what time it is
    if x[at.X_MODE] == at.MODE_INIT:
        begin(x, t)
        remember(x, rows, last)
        return
    if span <= 0.0:
        return

    # A sample stands for the interval before it, if it is a mean and none is missing
    if span > BLIND or (gx * gx + gy * gy + gz * gz) * span * span > LARGEST_TURN:
        hold(x, k, w)
        gx = x[at.X_GYRO]
        gy = x[at.X_GYRO + 1]
        gz = x[at.X_GYRO + 2]
        ax = x[at.X_ACCEL]
        ay = x[at.X_ACCEL + 1]
        az = x[at.X_ACCEL + 2]
    elif k[at.K_MEAN_SAMPLES] == 0.0 or span > 1.5 * x[at.X_DT]:
        gx = 0.5 * (gx + x[at.X_GYRO])
        gy = 0.5 * (gy + x[at.X_GYRO + 1])
        gz = 0.5 * (gz + x[at.X_GYRO + 2])
        ax = 0.5 * (ax + x[at.X_ACCEL])
        ay = 0.5 * (ay + x[at.X_ACCEL + 1])
        az = 0.5 * (az + x[at.X_ACCEL + 2])

    # Go to each event in turn, then to the sample's own time
    for r in range(first, last + 1):
        dt = (rows[r, at.ROW_T] - x[at.X_T]) * 1e-9
        if dt > 0.0:
            if x[at.X_MODE] == at.MODE_LEVEL:
                align.carry(x, w, dt, gx, gy, gz, ax, ay, az)
            else:
                if x[at.X_NEEDS_RESET] != 0.0:
                    align.carry(
                        x,
                        w,
                        dt,
                        gx - x[at.X_BG],
                        gy - x[at.X_BG + 1],
                        gz - x[at.X_BG + 2],
                        ax - x[at.X_BA],
                        ay - x[at.X_BA + 1],
                        az - x[at.X_BA + 2],
                    )
                propagate.move(x, k, w, dt, gx, gy, gz, ax, ay, az)
                propagate.spread(x, k, w, dt)
            x[at.X_T] = rows[r, at.ROW_T]
        if r < last:
            take(x, k, w, rows, r)
    if span > k[at.K_GAP]:
        doubt(x, k, span, span > SLOW_GAP * x[at.X_DT])

    # What the sample itself tells: noise, rest, whether all aids still speak
    learn(x, rows, last, span)
    remember(x, rows, last)
    settle(x, k, w, t, span)
    if not is_sound(x):
        start_over(x, t, at.RESET_BOUNDS)


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
    for i in range(3):
        x[at.X_WHITE + i] = 1.0
    x[at.X_ARMED] = NAN
    x[at.X_LANDED] = NAN
    x[at.X_T_FIX] = NEVER
    x[at.X_T_RAW_FIX] = NEVER
    x[at.X_T_MAG] = NEVER
    x[at.X_T_FAKE] = t
    for i in range(3):
        x[at.X_T_HEADING + i] = NEVER
    for i in range(at.AIDS):
        x[at.X_T_USED + i] = NEVER
        x[at.X_T_REFUSED + i] = NEVER
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
    """Keep the sample, and the one before it, for the next step."""
    i: cython.Py_ssize_t
    x[at.X_SAMPLES] += 1.0
    for i in range(3):
        x[at.X_PREV_G + i] = x[at.X_GYRO + i]
        x[at.X_PREV_A + i] = x[at.X_ACCEL + i]
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
    yawed: cython.double = turned
    gained: cython.double = 2.0 * span
    if is_gap:
        x[at.X_GAPS] += 1.0
    if x[at.X_MODE] == at.MODE_LEVEL:
        if is_gap:
            x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
            align.restart(x, x[at.X_T])
        return
    if is_gap and span > BLIND:
        turned = 0.5 * span
        gained = 4.0 * span
    if turned > 0.5:
        turned = 0.5
    if yawed < turned:
        yawed = turned
    if yawed > 1.8:
        yawed = 1.8
    if gained > 20.0:
        gained = 20.0
    for i in range(3):
        x[at.X_COV + (at.E_VEL + i) * (at.N + 1)] += gained * gained
        x[at.X_COV + (at.E_POS + i) * (at.N + 1)] += 0.25 * gained * gained * span * span
    for i in range(2):
        x[at.X_COV + (at.E_ATT + i) * (at.N + 1)] += turned * turned
    x[at.X_COV + (at.E_ATT + 2) * (at.N + 1)] += yawed * yawed
    if is_gap and span > k[at.K_GAP_RESET] and x[at.X_MODE] == at.MODE_NAVIGATE:
        x[at.X_NEEDS_RESET] = LOST
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

    White noise of variance s^2 gives second differences of variance 6 s^2; x keeps s^2 dt.
    """
    i: cython.Py_ssize_t
    d: cython.double
    gain: cython.double = span / NOISE_MEMORY
    if x[at.X_DT] == 0.0:
        x[at.X_DT] = span
    x[at.X_DT] += 0.05 * ((span if span < 2.0 * x[at.X_DT] else 2.0 * x[at.X_DT]) - x[at.X_DT])
    if x[at.X_SAMPLES] < 3.0 or span > 1.5 * x[at.X_DT] or gain > 0.5:
        return
    for i in range(3):
        d = rows[r, at.ROW_V + i] - 2.0 * x[at.X_GYRO + i] + x[at.X_PREV_G + i]
        x[at.X_NOISE_G + i] += gain * (d * d * span / 6.0 - x[at.X_NOISE_G + i])
        d = rows[r, at.ROW_V + 3 + i] - 2.0 * x[at.X_ACCEL + i] + x[at.X_PREV_A + i]
        x[at.X_NOISE_A + i] += gain * (d * d * span / 6.0 - x[at.X_NOISE_A + i])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def settle(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    t: cython.double,
    span: cython.double,
) -> cython.void:
    """Level when a window of rest is full; keep an attitude without GNSS from drifting off."""
    i: cython.Py_ssize_t
    align.gather(x)
    if t - x[at.X_LEVEL + at.L_T0] >= k[at.K_ALIGN_TIME] * 1e9 and (
        x[at.X_LEVEL + at.L_N] >= FEWEST
    ):
        # an autopilot that says it flies is believed: a smooth flight looks like rest
        x[at.X_AT_REST] = 0.0
        if (x[at.X_ARMED] != 1.0 or x[at.X_LANDED] == 1.0) and align.is_rest(x, k):
            x[at.X_AT_REST] = 1.0
        if x[at.X_MODE] == at.MODE_LEVEL:
            if x[at.X_AT_REST] != 0.0:
                align.level_at_rest(x, k, w)
            elif t - x[at.X_LEVEL + at.L_START] > ROUGH_AFTER and t - x[at.X_T_FIX] > ROUGH_AFTER:
                align.level_roughly(x, k, w)
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
        take_fix(x, k, w, rows, r)
    elif kind == HEADING:
        if is_heading_used(x, k, x[at.X_T], rows[r, at.ROW_V + 2]):
            take_heading(
                x, k, w, rows[r, at.ROW_V], rows[r, at.ROW_V + 1], rows[r, at.ROW_V + 2] == 0.0
            )
        else:
            count(x, at.AID_YAW, at.WHY_UNUSED)
    elif kind == MAG:
        if is_field_used(x, k, w, rows[r, at.ROW_V], rows[r, at.ROW_V + 1], rows[r, at.ROW_V + 2]):
            take_field(x, k, w, rows[r, at.ROW_V], rows[r, at.ROW_V + 1], rows[r, at.ROW_V + 2])
        else:
            count(x, at.AID_YAW, at.WHY_UNUSED)
    elif kind == BARO:
        take_baro(x, k, w, rows[r, at.ROW_V])
    elif kind == VEHICLE:
        x[at.X_ARMED] = rows[r, at.ROW_V]
        x[at.X_LANDED] = rows[r, at.ROW_V + 1]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def count(x: cython.double[::1], aid: cython.Py_ssize_t, why: cython.Py_ssize_t) -> cython.void:
    """Count what became of one measurement."""
    x[at.X_COUNT + aid * at.WHYS + why] += 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def fuse(
    x: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    gate: cython.double,
) -> cython.bint:
    """Absorb m rows if they pass the gate, and keep the account; False: they did not."""
    nis: cython.double = correct.innovate(x, w, m)
    return settle_rows(x, w, aid, m, nis, gate)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def fuse_gnss(
    x: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    gate: cython.double,
    stated: cython.double,
) -> cython.bint:
    """Do the same for a receiver's rows, and learn how white its stated error (variance) is."""
    nis: cython.double = correct.innovate(x, w, m)
    learn_white(x, w, aid, m, stated)
    return settle_rows(x, w, aid, m, nis, gate)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def settle_rows(
    x: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    nis: cython.double,
    gate: cython.double,
) -> cython.bint:
    """Absorb m rows that have been judged, or refuse them, and keep the account."""
    x[at.X_RATIO + aid] = nis / gate
    if nis > gate:
        count(x, aid, at.WHY_GATED)
        if x[at.X_T_REFUSED + aid] <= x[at.X_T_USED + aid]:
            x[at.X_T_REFUSED + aid] = x[at.X_T]
        return False
    if aid == at.AID_YAW:
        correct.absorb_yaw(x, w)
    else:
        correct.absorb(x, w, m)
    x[at.X_T_USED + aid] = x[at.X_T]
    count(x, aid, at.WHY_FUSED)
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learn_white(
    x: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
    stated: cython.double,
) -> cython.void:
    """Learn what share of the error that a receiver states is white, as a ratio of variances.

    What the innovations have beyond the filter's own doubt is white. Receivers state metres, and
    differ from fix to fix by centimetres: the rest of the stated error is slow, the filter cannot
    see it, and its position is as wrong.
    """
    r: cython.Py_ssize_t
    j: cython.Py_ssize_t
    ratio: cython.double = 0.0
    for r in range(m):
        ratio += w[at.W_Z + r] * w[at.W_Z + r]
        for j in range(at.N):
            ratio -= w[at.W_H + r * at.N + j] * w[at.W_C + r * at.N + j]
    ratio = ratio / (m * stated)
    if ratio > LARGEST_RATIO:
        ratio = LARGEST_RATIO
    if ratio < -LARGEST_RATIO:
        ratio = -LARGEST_RATIO
    x[at.X_WHITE + aid] += (ratio - x[at.X_WHITE + aid]) / WHITE_MEMORY


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def white_of(x: cython.double[::1], aid: cython.Py_ssize_t) -> cython.double:
    """Give the share learnt, within what is possible."""
    if x[at.X_WHITE + aid] < LEAST_RATIO:
        return LEAST_RATIO
    return x[at.X_WHITE + aid]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def reset(x: cython.double[::1], aid: cython.Py_ssize_t, reason: cython.double) -> cython.void:
    """Keep the account of a reset."""
    x[at.X_RESETS] += 1.0
    x[at.X_RESET_REASON] = reason
    x[at.X_T_USED + aid] = x[at.X_T]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_timed_out(
    x: cython.double[::1], aid: cython.Py_ssize_t, limit: cython.double
) -> cython.bint:
    """Say whether an aid has been refused for longer than its limit, s."""
    return x[at.X_T] - x[at.X_T_USED + aid] > limit * 1e9


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def may_reset(x: cython.double[::1], aid: cython.Py_ssize_t, limit: cython.double) -> cython.bint:
    """Say whether an aid that is past its limit (s) may have its way: not by its first word."""
    return is_timed_out(x, aid, limit) and x[at.X_T] - x[at.X_T_REFUSED + aid] >= PROOF


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_fix(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
) -> cython.void:
    """Take a GNSS fix: start with it, or correct position, height and velocity by it."""
    m: cython.Py_ssize_t
    t: cython.double = x[at.X_T]
    lat: cython.double = rows[r, at.ROW_V]
    lon: cython.double = rows[r, at.ROW_V + 1]
    alt: cython.double = rows[r, at.ROW_V + 2]
    vn: cython.double = rows[r, at.ROW_V + 3]
    ve: cython.double = rows[r, at.ROW_V + 4]
    vd: cython.double = rows[r, at.ROW_V + 5]
    std_h: cython.double = rows[r, at.ROW_V + 6]
    std_v: cython.double = rows[r, at.ROW_V + 7]
    std_vel: cython.double = rows[r, at.ROW_V + 8]
    flags: cython.int = cython.cast(cython.int, rows[r, at.ROW_V + 10])
    has_vel: cython.bint = k[at.K_USE_VEL] != 0.0 and not isnan(vn)

    # Which source, and can it be believed
    if flags & 1:
        if k[at.K_USE_DERIVED] == 0.0 or (
            k[at.K_USE_DERIVED] == 1.0 and t - x[at.X_T_RAW_FIX] < PREFERRED_AGE
        ):
            count(x, at.AID_POS, at.WHY_UNUSED)
            return
    else:
        x[at.X_T_RAW_FIX] = t
        if k[at.K_USE_DERIVED] == 2.0:
            count(x, at.AID_POS, at.WHY_UNUSED)
            return
    if flags & 2:
        count(x, at.AID_POS, at.WHY_UNUSED)
        return
    if std_h < k[at.K_POS_FLOOR]:
        std_h = k[at.K_POS_FLOOR]
    if std_v < k[at.K_HGT_FLOOR]:
        std_v = k[at.K_HGT_FLOOR]
    if isnan(std_vel):
        std_vel = k[at.K_VEL_DEFAULT]
    stated: cython.double = std_vel * std_vel
    std_vel = std_vel * sqrt(white_of(x, at.AID_VEL))
    if std_vel < k[at.K_VEL_FLOOR]:
        std_vel = k[at.K_VEL_FLOOR]
    if not isnan(rows[r, at.ROW_V + 9]):
        if isnan(x[at.X_DECLINATION]) and x[at.X_T_MAG] > NEVER and x[at.X_MODE] < at.MODE_NAVIGATE:
            # a compass gave magnetic north: take true north from whoever is next
            x[at.X_HAS_YAW] = 0.0
            x[at.X_T_MAG] = NEVER
            x[at.X_LEVEL + at.L_HAS_REF] = 0.0
        x[at.X_DECLINATION] = rows[r, at.ROW_V + 9]
        x[at.X_INCLINATION] = rows[r, at.ROW_V + 11]
        x[at.X_FIELD] = rows[r, at.ROW_V + 12]
    if x[at.X_T_FIX] > NEVER and t > x[at.X_T_FIX]:
        x[at.X_FIX_DT] = (t - x[at.X_T_FIX]) * 1e-9
    x[at.X_T_FIX] = t

    # Before navigation a fix helps to level, or begins it
    if x[at.X_MODE] == at.MODE_LEVEL:
        if has_vel and align.level_in_motion(x, k, w, t, vn, ve, vd, std_vel):
            navigate(x, k, w, lat, lon, alt, vn, ve, vd, std_h, std_v, std_vel, has_vel)
        else:
            count(x, at.AID_POS, at.WHY_UNALIGNED)
        return
    if x[at.X_MODE] == at.MODE_ATTITUDE:
        if x[at.X_HAS_YAW] != 0.0:
            navigate(x, k, w, lat, lon, alt, vn, ve, vd, std_h, std_v, std_vel, has_vel)
        else:
            count(x, at.AID_POS, at.WHY_UNALIGNED)
        return
    if x[at.X_NEEDS_RESET] != 0.0:
        resume(x, k, w, lat, lon, alt, vn, ve, vd, std_h, std_v, std_vel, has_vel)
        return

    # What of the stated error is not white is slow, and ours as well
    x[at.X_SLOW_POS] = std_h * std_h * (1.0 - white_of(x, at.AID_POS))
    x[at.X_SLOW_HGT] = std_v * std_v * (1.0 - white_of(x, at.AID_HGT))

    # Velocity first: it is the surer of the two
    if has_vel:
        m = observe.velocity(x, k, w, vn, ve, vd, std_vel)
        if not fuse_gnss(x, w, at.AID_VEL, m, k[at.K_GATE3] if m == 3 else k[at.K_GATE2], stated):
            if may_reset(x, at.AID_VEL, k[at.K_TIMEOUT_VEL]):
                if t - x[at.X_T_REFUSED + at.AID_VEL] > 0.5 * k[at.K_TIMEOUT_VEL] * 1e9:
                    # fixes kept coming and were refused: the attitude or a bias is wrong as well
                    start_over(x, t, at.RESET_VELOCITY)
                    return
                launch(x, k, w, vn, ve, vd, std_vel)
                reset(x, at.AID_VEL, at.RESET_VELOCITY)
    observe.position(x, k, w, lat, lon, std_h)
    if not fuse_gnss(x, w, at.AID_POS, 2, k[at.K_GATE2], std_h * std_h) and may_reset(
        x, at.AID_POS, k[at.K_TIMEOUT_POS]
    ):
        place(x, k, w, lat, lon, std_h)
        if is_timed_out(x, at.AID_VEL, k[at.K_TIMEOUT_POS]):
            halt(x, at.E_VEL, 2)
        reset(x, at.AID_POS, at.RESET_POSITION)
    observe.height(x, k, w, alt, std_v)
    if not fuse_gnss(x, w, at.AID_HGT, 1, k[at.K_GATE1], std_v * std_v) and may_reset(
        x, at.AID_HGT, k[at.K_TIMEOUT_HGT]
    ):
        lift(x, k, w, alt, std_v)
        if isnan(vd) or is_timed_out(x, at.AID_VEL, k[at.K_TIMEOUT_HGT]):
            halt(x, at.E_VEL + 2, 1)
        reset(x, at.AID_HGT, at.RESET_HEIGHT)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def navigate(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    lat: cython.double,
    lon: cython.double,
    alt: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std_h: cython.double,
    std_v: cython.double,
    std_vel: cython.double,
    has_vel: cython.bint,
) -> cython.void:
    """Begin to navigate at a fix; the first one ever is the origin of the local frame."""
    i: cython.Py_ssize_t
    if x[at.X_HAS_ORIGIN] == 0.0:
        propagate.originate(x, lat, lon, alt)
    x[at.X_MODE] = at.MODE_NAVIGATE
    x[at.X_HAS_BARO] = 0.0
    place(x, k, w, lat, lon, std_h)
    lift(x, k, w, alt, std_v)
    count(x, at.AID_POS, at.WHY_FUSED)
    count(x, at.AID_HGT, at.WHY_FUSED)
    if has_vel:
        launch(x, k, w, vn, ve, vd, std_vel)
        count(x, at.AID_VEL, at.WHY_FUSED)
    else:
        for i in range(3):
            x[at.X_VEL + i] = 0.0
        correct.forget(x, at.E_VEL, 3, 0.04 if x[at.X_AT_REST] != 0.0 else 100.0)
    for i in range(at.AIDS):
        if i != at.AID_YAW:
            x[at.X_T_USED + i] = x[at.X_T]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def resume(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    lat: cython.double,
    lon: cython.double,
    alt: cython.double,
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std_h: cython.double,
    std_v: cython.double,
    std_vel: cython.double,
    has_vel: cython.bint,
) -> cython.void:
    """Go by the fixes alone after a long gap, until they have shown the attitude.

    Nobody saw the vehicle turn: by an attitude that may be half a radian and more off no fix can
    be judged, and what a linear filter learns from it is wrong and claims to be right.
    """
    i: cython.Py_ssize_t
    if x[at.X_NEEDS_RESET] == LOST:
        x[at.X_NEEDS_RESET] = TILTED
        x[at.X_RESETS] += 1.0
        x[at.X_RESET_REASON] = at.RESET_GAP
    if (
        not has_vel
        or align.level_again(x, k, w, x[at.X_T], vn, ve, vd, std_vel)
        or x[at.X_T] - x[at.X_LEVEL + at.L_FIX_T] > PATIENCE
    ):
        x[at.X_NEEDS_RESET] = 0.0
        x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
    place(x, k, w, lat, lon, std_h)
    lift(x, k, w, alt, std_v)
    if has_vel:
        launch(x, k, w, vn, ve, vd, std_vel)
        count(x, at.AID_VEL, at.WHY_FUSED)
    count(x, at.AID_POS, at.WHY_FUSED)
    count(x, at.AID_HGT, at.WHY_FUSED)
    for i in range(3):
        x[at.X_T_USED + i] = x[at.X_T]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def place(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    lat: cython.double,
    lon: cython.double,
    std: cython.double,
) -> cython.void:
    """Set the horizontal position from a fix."""
    observe.position(x, k, w, lat, lon, std)
    x[at.X_POS] += w[at.W_Z]
    x[at.X_POS + 1] += w[at.W_Z + 1]
    correct.forget(x, at.E_POS, 2, std * std)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def halt(x: cython.double[::1], first: cython.Py_ssize_t, size: cython.Py_ssize_t) -> cython.void:
    """Begin a velocity anew that carried the position astray: none, give or take 5 m/s."""
    i: cython.Py_ssize_t
    for i in range(first, first + size):
        x[at.X_VEL + i - at.E_VEL] = 0.0
    correct.forget(x, first, size, 25.0)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def lift(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    alt: cython.double,
    std: cython.double,
) -> cython.void:
    """Set the height from a fix."""
    observe.height(x, k, w, alt, std)
    x[at.X_POS + 2] += w[at.W_Z]
    correct.forget(x, at.E_POS + 2, 1, std * std)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def launch(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    vn: cython.double,
    ve: cython.double,
    vd: cython.double,
    std: cython.double,
) -> cython.void:
    """Set the velocity from a fix; an unknown vertical one is none, give or take 2 m/s."""
    i: cython.Py_ssize_t
    m: cython.Py_ssize_t = observe.velocity(x, k, w, vn, ve, vd, std)
    for i in range(m):
        x[at.X_VEL + i] += w[at.W_Z + i]
    correct.forget(x, at.E_VEL, 3, std * std)
    if m == 2:
        x[at.X_VEL + 2] = 0.0
        correct.forget(x, at.E_VEL + 2, 1, 0.04 if x[at.X_AT_REST] != 0.0 else 4.0)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_heading_used(
    x: cython.double[::1], k: cython.double[::1], t: cython.double, source: cython.double
) -> cython.bint:
    """Say whether a heading is to be used: by order of the user, or the best that still speaks."""
    i: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, source)
    j: cython.Py_ssize_t
    x[at.X_T_HEADING + i] = t
    if k[at.K_HEADING] == at.HEADING_GNSS:
        return i == 0
    if k[at.K_HEADING] == at.HEADING_MAG:
        return i == 1
    if k[at.K_HEADING] == at.HEADING_AUTOPILOT:
        return i == 2
    if i > 0 and t - x[at.X_T_MAG] < PREFERRED_AGE:
        return False
    for j in range(i):
        if t - x[at.X_T_HEADING + j] < PREFERRED_AGE:
            return False
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_field_used(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    mx: cython.double,
    my: cython.double,
    mz: cython.double,
) -> cython.bint:
    """Say whether the magnetic field (b, gauss) is to be used for heading.

    Not while a dual antenna speaks, and not where it is not the Earth's: by its strength, and
    by its dip once the tilt is known.
    """
    d: cython.double
    size: cython.double = sqrt(mx * mx + my * my + mz * mz)
    if k[at.K_HEADING] == at.HEADING_AUTO:
        if x[at.X_T] - x[at.X_T_HEADING] < PREFERRED_AGE:
            return False
    elif k[at.K_HEADING] != at.HEADING_MAG:
        return False
    if x[at.X_FIELD] > 0.0:
        if fabs(size - x[at.X_FIELD]) > k[at.K_FIELD_STRENGTH] * x[at.X_FIELD]:
            return False
        if x[at.X_MODE] >= at.MODE_ATTITUDE and x[at.X_NEEDS_RESET] == 0.0:
            propagate.matrix(x, at.X_Q, w)
            d = w[at.W_C_NB + 6] * mx + w[at.W_C_NB + 7] * my + w[at.W_C_NB + 8] * mz
            d = d / size
            if d > 1.0:
                d = 1.0
            if d < -1.0:
                d = -1.0
            if fabs(asin(d) - x[at.X_INCLINATION]) > k[at.K_FIELD_DIP]:
                return False
    x[at.X_T_MAG] = x[at.X_T]
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_heading(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    heading: cython.double,
    std: cython.double,
    is_antenna: cython.bint,
) -> cython.void:
    """Take a heading: white from a dual antenna, slowly wrong from another compass or filter."""
    if std < k[at.K_HEADING_FLOOR]:
        std = k[at.K_HEADING_FLOOR]
    if is_antenna:
        take_azimuth(x, k, w, 1.0, 0.0, 0.0, heading, MOUNTING, std, 0.0, 1.0)
    else:
        take_azimuth(x, k, w, 1.0, 0.0, 0.0, heading, std, k[at.K_HEADING_FLOOR], 0.0, 2.0)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_field(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    mx: cython.double,
    my: cython.double,
    mz: cython.double,
) -> cython.void:
    """Take the magnetic field: it points to the declination, as far as that is known."""
    if isnan(x[at.X_DECLINATION]):
        take_azimuth(x, k, w, mx, my, mz, 0.0, UNKNOWN_DECLINATION, 0.01, k[at.K_MAG_NOISE], 3.0)
    else:
        take_azimuth(
            x, k, w, mx, my, mz, x[at.X_DECLINATION], k[at.K_MAG_STD], 0.01, k[at.K_MAG_NOISE], 4.0
        )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_azimuth(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    bx: cython.double,
    by: cython.double,
    bz: cython.double,
    target: cython.double,
    slow: cython.double,
    white: cython.double,
    noise: cython.double,
    source: cython.double,
) -> cython.void:
    """Take a direction's azimuth: keep it while levelling, begin or correct yaw by it.

    Its error is a slow part and a white one (one sigma each, rad) and the direction's own noise.
    Another source (any number) has another slow error.
    """
    if x[at.X_MODE] == at.MODE_LEVEL or x[at.X_NEEDS_RESET] != 0.0:
        x[at.X_HEADING_STD] = slow
        x[at.X_HEADING_SOURCE] = source
        x[at.X_LEVEL + at.L_HAS_REF] = 1.0
        x[at.X_LEVEL + at.L_REF_T] = x[at.X_T]
        x[at.X_LEVEL + at.L_REF_TARGET] = target
        x[at.X_LEVEL + at.L_REF_STD] = white + REFERENCE_TILT
        x[at.X_LEVEL + at.L_REF_V] = bx
        x[at.X_LEVEL + at.L_REF_V + 1] = by
        x[at.X_LEVEL + at.L_REF_V + 2] = bz
        count(x, at.AID_YAW, at.WHY_UNALIGNED)
        return
    x[at.X_HEADING_STD] = slow
    if source != x[at.X_HEADING_SOURCE]:
        x[at.X_HEADING_SOURCE] = source
        x[at.X_HEADING] = 0.0
        correct.forget(x, at.E_HEADING, 1, slow * slow)
    if not observe.azimuth(x, w, bx, by, bz, target, white, noise):
        count(x, at.AID_YAW, at.WHY_UNUSED)
        return
    if x[at.X_HAS_YAW] == 0.0:
        face(x, w)
        x[at.X_HAS_YAW] = 1.0
        x[at.X_T_USED + at.AID_YAW] = x[at.X_T]
        count(x, at.AID_YAW, at.WHY_FUSED)
    elif not fuse(x, w, at.AID_YAW, 1, k[at.K_GATE1]) and may_reset(
        x, at.AID_YAW, k[at.K_TIMEOUT_YAW]
    ):
        if slow > TRUSTED:
            # the compass or our yaw has jumped, and nobody knows which: neither is sure any more
            correct.forget(x, at.E_HEADING, 1, 1.0)
            x[at.X_COV + (at.E_ATT + 2) * (at.N + 1)] += w[at.W_Z] * w[at.W_Z]
            correct.innovate(x, w, 1)
            correct.absorb_yaw(x, w)
        else:
            face(x, w)
        reset(x, at.AID_YAW, at.RESET_YAW)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def face(x: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the yaw from the innovation of :func:`observe.azimuth`; it shares the slow error."""
    slow: cython.double = x[at.X_HEADING_STD] * x[at.X_HEADING_STD]
    white: cython.double = w[at.W_R] + x[at.X_COV] + x[at.X_COV + at.N + 1]
    propagate.turn(x, at.X_Q, 0.0, 0.0, w[at.W_Z] + x[at.X_HEADING])
    x[at.X_HEADING] = 0.0
    align.share(x, slow, white)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_baro(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], alt: cython.double
) -> cython.void:
    """Take a pressure altitude; the first one gives the offset, with the height's error."""
    j: cython.Py_ssize_t
    down: cython.Py_ssize_t = at.X_COV + (at.E_POS + 2) * at.N
    own: cython.Py_ssize_t = at.X_COV + at.E_BARO * at.N
    if k[at.K_USE_BARO] == 0.0 or x[at.X_MODE] == at.MODE_LEVEL:
        count(x, at.AID_BARO, at.WHY_UNUSED)
        return
    if x[at.X_HAS_BARO] != 0.0:
        observe.pressure_altitude(x, w, alt, k[at.K_BARO_STD])
        if fuse(x, w, at.AID_BARO, 1, k[at.K_GATE1]):
            return
        if not may_reset(x, at.AID_BARO, k[at.K_TIMEOUT_HGT]):
            return
    x[at.X_BARO] = alt - (x[at.X_ALT0] - x[at.X_POS + 2])
    for j in range(at.N):
        x[own + j] = x[down + j]
        x[at.X_COV + j * at.N + at.E_BARO] = x[down + j]
    x[own + at.E_BARO] = x[down + at.E_POS + 2] + k[at.K_BARO_STD] * k[at.K_BARO_STD]
    x[at.X_HAS_BARO] = 1.0
    x[at.X_T_USED + at.AID_BARO] = x[at.X_T]
    count(x, at.AID_BARO, at.WHY_FUSED)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def status(x: cython.double[::1], k: cython.double[::1]) -> cython.int:
    """Say how far the state can be trusted now."""
    late: cython.double
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
    if is_timed_out(x, at.AID_POS, late) and is_timed_out(x, at.AID_VEL, late):
        return DEAD_RECKONING
    if x[at.X_DT] > SLOW_STREAM or x[at.X_NEEDS_RESET] != 0.0:
        return DEGRADED
    if is_timed_out(x, at.AID_POS, late + 1.0) or is_timed_out(x, at.AID_YAW, 5.0):
        return DEGRADED
    if is_timed_out(x, at.AID_HGT, late + 1.0) and is_timed_out(x, at.AID_BARO, 2.0):
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
    slow: cython.double
    state: cython.int = status(x, k)
    for i in range(at.X_COV):
        y[i] = x[i]
    if k[at.K_LAG] > 0.0 and x[at.X_MODE] >= at.MODE_ATTITUDE:
        propagate.move(
            y,
            k,
            w,
            k[at.K_LAG],
            x[at.X_GYRO],
            x[at.X_GYRO + 1],
            x[at.X_GYRO + 2],
            x[at.X_ACCEL],
            x[at.X_ACCEL + 1],
            x[at.X_ACCEL + 2],
        )
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
        slow = x[at.X_SLOW_HGT] if i == 2 else x[at.X_SLOW_POS]
        out[at.OUT_SD + i] = sqrt(
            x[at.X_COV + (at.E_POS + i) * (at.N + 1)] + (slow if slow > 0.0 else 0.0)
        )
        out[at.OUT_SD + 3 + i] = sqrt(x[at.X_COV + (at.E_VEL + i) * (at.N + 1)])
    out[at.OUT_LLA] = (x[at.X_LAT0] + y[at.X_POS] / x[at.X_SCALE_N]) * DEG
    out[at.OUT_LLA + 1] = observe.wrap(x[at.X_LON0] + y[at.X_POS + 1] / x[at.X_SCALE_E]) * DEG
    out[at.OUT_LLA + 2] = x[at.X_ALT0] - y[at.X_POS + 2]
    return state
