# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Heading without a compass: what the inertial sensor felt, laid beside what GNSS saw.

The bank carries an attitude of its own into a frame s that is level, give or take a small tilt, and
points anywhere; between two fixes it sums the specific force in s. Eight small filters, spread
evenly over the circle, each suppose a yaw of s against north, and are weighed by how well they
foretell the next velocity. Their mixture is a heading once it is narrow. Nothing but the gyro's
bias at rest comes from the main filter, whose tilt and biases a wrong heading spoils.

Source: Gaussian sums: Alspach and Sorenson 1972; for yaw from GNSS velocity: the EKF-GSF of PX4 and
ArduPilot (Riseborough), which takes its tilt from a complementary filter instead.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.ekf_companion.core import yaw_filter, yaw_frame
    from cython.cimports.ekf_companion.core.observe import wrap
    from cython.cimports.ekf_companion.core.propagate import turn
    from cython.cimports.libc.math import atan2, cos, exp, log, sin, sqrt
else:
    from math import atan2, cos, exp, log, sin, sqrt

    from ekf_companion.core import state as at
    from ekf_companion.core import yaw_filter, yaw_frame
    from ekf_companion.core.observe import wrap
    from ekf_companion.core.propagate import turn

LEVEL_TIME = cython.declare(cython.double, 1.0)
"""The mean specific force of so long at least says where up is, s."""
YAW_STD = cython.declare(cython.double, 0.3)
"""One sigma of a hypothesis at first, rad; an even share of the circle has 0.23."""
STEP = cython.declare(cython.double, 0.7853981633974483)
"""Between two hypotheses at first, rad."""
LEAST_STD = cython.declare(cython.double, 0.5)
"""Least one sigma of a velocity, m/s, as in ArduPilot: what receivers state is not white."""
CHANGE = cython.declare(cython.double, 1.0)
"""m/s; before the velocity has changed by so much no heading is claimed: a hover has none."""
MEAN_TIME = cython.declare(cython.double, 10.0)
"""s; memory of the mean velocity that the change is counted from."""
FLOOR = cython.declare(cython.double, 1e-6)
"""Least weight of a hypothesis: none dies."""
REFUSE = cython.declare(cython.double, 18.0)
"""Normalised innovation squared, of 2 degrees, less twice the logarithm of the weight, with which
even the best hypothesis refuses a fix: an unlikely one must not take up what is wild."""
MOST_EVIDENCE = cython.declare(cython.double, 4.0)
"""Largest difference of the logarithms of likelihood that one fix can make."""
PATIENCE = cython.declare(cython.double, 20.0)
"""More fixes refused than believed after which the bank begins anew."""
FIRST_PATIENCE = cython.declare(cython.double, 4.0)
"""The same while it has believed none: the first fix, which it began at, may be the wrong one."""
WILD = cython.declare(cython.double, 4.0)
"""Variance of the velocity, (m/s)^2, beyond which it is the bank that must be wrong."""
LONGEST = cython.declare(cython.double, 30.0)
"""s without a fix after which the bank begins anew."""
VAGUE = cython.declare(cython.double, 0.16)
"""Variance of the likeliest hypothesis, rad^2, beyond which all are spread anew."""
SURE = cython.declare(cython.double, 0.17453292519943295)
"""One sigma of a heading that is good for something, rad: 10 degrees."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def begin(x: cython.double[::1], k: cython.double[::1]) -> cython.void:
    """Know nothing; the account of the main filter stays."""
    i: cython.Py_ssize_t
    for i in range(3):
        x[at.X_BANK + at.B_BG + i] = 0.0
    x[at.X_BANK + at.B_BG_STD] = k[at.K_GYRO_BIAS]
    yaw_frame.lose(x)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def know_bias(x: cython.double[::1], std: cython.double) -> cython.void:
    """Take the main filter's gyro bias, which rest has just shown; one sigma in rad/s."""
    n: cython.Py_ssize_t
    i: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_BANK
    x[b + at.B_BG_STD] = std
    for i in range(3):
        x[b + at.B_BG + i] = x[at.X_BG + i]
        for n in range(at.HYPOTHESES):
            yaw_filter.know(x, b + at.B_H + n * at.H_SIZE, 5 + i, 0.0, std * std)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def correct(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    vn: cython.double,
    ve: cython.double,
    std: cython.double,
) -> cython.void:
    """Take a GNSS velocity of now: north and east, one sigma per axis, m/s."""
    b: cython.Py_ssize_t = at.X_BANK
    dt: cython.double = x[b + at.B_DT]
    std = std if std > LEAST_STD else LEAST_STD
    if x[b + at.B_MODE] == at.BANK_LEVELLING:
        if dt >= LEVEL_TIME:
            level(x, k, vn, ve, std * std)
        return
    if dt <= 0.0:
        return
    if dt > LONGEST:
        begin(x, k)
        return
    if weigh(x, k, w, vn, ve, std * std):
        x[b + at.B_REFUSED] = x[b + at.B_REFUSED] - 1.0 if x[b + at.B_REFUSED] > 1.0 else 0.0
        conclude(x)
        confirm(x, vn, ve, dt)
    else:
        x[b + at.B_GOOD] = 0.0
        x[b + at.B_REFUSED] += 1.0
    if x[b + at.B_REFUSED] >= PATIENCE or not x[b + at.B_WHITE] < WILD:
        begin(x, k)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def level(
    x: cython.double[::1],
    k: cython.double[::1],
    vn: cython.double,
    ve: cython.double,
    variance: cython.double,
) -> cython.void:
    """Level s by the mean force, and begin the hypotheses at this velocity."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t
    b: cython.Py_ssize_t = at.X_BANK
    yaw_frame.stand_up(x)
    for n in range(at.HYPOTHESES):
        h = b + at.B_H + n * at.H_SIZE
        yaw_filter.begin(x, h, vn, ve, variance, x[b + at.B_BG_STD], k[at.K_DELAY_STD])
    spread(x, 0.0)
    x[b + at.B_MEAN] = vn
    x[b + at.B_MEAN + 1] = ve
    x[b + at.B_WHITE] = variance
    x[b + at.B_REFUSED] = PATIENCE - FIRST_PATIENCE
    x[b + at.B_MODE] = at.BANK_RUNNING
    yaw_frame.restart_sums(x)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def spread(x: cython.double[::1], yaw: cython.double) -> cython.void:
    """Spread the hypotheses evenly over the circle, one of them here, and all alike likely."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t
    for n in range(at.HYPOTHESES):
        h = at.X_BANK + at.B_H + n * at.H_SIZE
        x[h + at.H_W] = 1.0 / at.HYPOTHESES
        yaw_filter.know(x, h, 2, wrap(yaw + n * STEP), YAW_STD * YAW_STD)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def weigh(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    vn: cython.double,
    ve: cython.double,
    stated: cython.double,
) -> cython.bint:
    """Carry all hypotheses to now, weigh and correct them; False: none of them believes the fix."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t = at.X_BANK + at.B_H
    o: cython.Py_ssize_t
    best: cython.Py_ssize_t = at.W_C
    score: cython.double
    least: cython.double = 1e30
    top: cython.double = -1e30
    total: cython.double = 0.0
    variance: cython.double = x[at.X_BANK + at.B_WHITE]
    variance = variance if variance > stated else stated
    yaw_frame.antenna(x, k, w)
    for n in range(at.HYPOTHESES):
        o = at.W_C + 6 * n
        yaw_filter.predict(x, k, w, h + n * at.H_SIZE)
        score = yaw_filter.judge(x, w, h + n * at.H_SIZE, o, vn, ve, variance)
        score -= 2.0 * log(x[h + n * at.H_SIZE])
        if score < least:
            least = score
            best = o
        top = w[o + 5] if w[o + 5] > top else top
    yaw_frame.restart_sums(x)
    learn(x, w, best, variance)
    if not least <= REFUSE:
        return False
    for n in range(at.HYPOTHESES):
        yaw_filter.absorb(x, w, h + n * at.H_SIZE, at.W_C + 6 * n)
        score = w[at.W_C + 6 * n + 5] - top
        x[h + n * at.H_SIZE] *= exp(score if score > -MOST_EVIDENCE else -MOST_EVIDENCE)
        total += x[h + n * at.H_SIZE]
    for n in range(at.HYPOTHESES):
        x[h + n * at.H_SIZE] = x[h + n * at.H_SIZE] / total
        if x[h + n * at.H_SIZE] < FLOOR:
            x[h + n * at.H_SIZE] = FLOOR
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learn(
    x: cython.double[::1], w: cython.double[::1], o: cython.Py_ssize_t, variance: cython.double
) -> cython.void:
    """Learn the receiver's variance: what the best innovation has beyond the hypothesis' doubt.

    Quickly upwards, slowly downwards; the innovation lies at w[o].
    """
    b: cython.Py_ssize_t = at.X_BANK + at.B_WHITE
    trace: cython.double = (w[o + 2] + w[o + 4]) / (w[o + 2] * w[o + 4] - w[o + 3] * w[o + 3])
    seen: cython.double = variance + 0.5 * (w[o] * w[o] + w[o + 1] * w[o + 1] - trace)
    seen = seen if seen < 4.0 * variance else 4.0 * variance
    seen = seen if seen > 0.0 else 0.0
    x[b] += (0.1 if seen > x[b] else 0.05) * (seen - x[b])


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def mean_of(x: cython.double[::1], i: cython.Py_ssize_t) -> cython.double:
    """Give the mixture's mean of state i, and take it from each hypothesis."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t = at.X_BANK + at.B_H
    mean: cython.double = 0.0
    for n in range(at.HYPOTHESES):
        mean += x[h + n * at.H_SIZE] * x[h + n * at.H_SIZE + at.H_X + i]
    for n in range(at.HYPOTHESES):
        x[h + n * at.H_SIZE + at.H_X + i] -= mean
    return mean


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def variance_of(x: cython.double[::1], i: cython.Py_ssize_t, mean: cython.double) -> cython.double:
    """Give the mixture's variance of state i, an angle or a small number, about a mean."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t
    off: cython.double
    total: cython.double = 0.0
    for n in range(at.HYPOTHESES):
        h = at.X_BANK + at.B_H + n * at.H_SIZE
        off = wrap(x[h + at.H_X + i] - mean)
        total += x[h + at.H_W] * (x[h + at.H_P + i * (at.H_N + 1)] + off * off)
    return total


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def conclude(x: cython.double[::1]) -> cython.void:
    """Put the mean tilt and bias into the frame itself, and say what yaw it has, and how surely."""
    n: cython.Py_ssize_t
    i: cython.Py_ssize_t
    h: cython.Py_ssize_t = at.X_BANK + at.B_H
    b: cython.Py_ssize_t = at.X_BANK
    s: cython.double = 0.0
    c: cython.double = 0.0
    for n in range(at.HYPOTHESES):
        s += x[h + n * at.H_SIZE] * sin(x[h + n * at.H_SIZE + at.H_X + 2])
        c += x[h + n * at.H_SIZE] * cos(x[h + n * at.H_SIZE + at.H_X + 2])
    x[b + at.B_YAW] = atan2(s, c)
    x[b + at.B_STD] = sqrt(variance_of(x, 2, x[b + at.B_YAW]))
    s = mean_of(x, 3)
    turn(x, b + at.B_Q, s, mean_of(x, 4), 0.0)
    x[b + at.B_TILT] = sqrt(0.5 * (variance_of(x, 3, 0.0) + variance_of(x, 4, 0.0)))
    c = 0.0
    for i in range(3):
        x[b + at.B_BG + i] += mean_of(x, 5 + i)
        s = variance_of(x, 5 + i, 0.0)
        c = s if s > c else c
    x[b + at.B_BG_STD] = sqrt(c)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def confirm(
    x: cython.double[::1], vn: cython.double, ve: cython.double, dt: cython.double
) -> cython.void:
    """Count fixes with a narrow yaw that was found in a manoeuvre; what is vague is spread anew."""
    n: cython.Py_ssize_t
    h: cython.Py_ssize_t = at.X_BANK + at.B_H
    best: cython.Py_ssize_t = h
    b: cython.Py_ssize_t = at.X_BANK
    dn: cython.double = vn - x[b + at.B_MEAN]
    de: cython.double = ve - x[b + at.B_MEAN + 1]
    x[b + at.B_MEAN] += dt / (dt + MEAN_TIME) * dn
    x[b + at.B_MEAN + 1] += dt / (dt + MEAN_TIME) * de
    if dn * dn + de * de > CHANGE * CHANGE + 9.0 * x[b + at.B_WHITE]:
        x[b + at.B_MOVED] = 1.0
    if x[b + at.B_MOVED] != 0.0 and x[b + at.B_STD] < SURE:
        x[b + at.B_GOOD] += 1.0
    else:
        x[b + at.B_GOOD] = 0.0
    for n in range(at.HYPOTHESES):
        if x[h + n * at.H_SIZE] > x[best]:
            best = h + n * at.H_SIZE
    if x[best + at.H_P + 2 * (at.H_N + 1)] > VAGUE:
        spread(x, x[b + at.B_YAW])
        x[b + at.B_MOVED] = 0.0
