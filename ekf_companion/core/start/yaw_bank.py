"""Heading without a compass, from specific force and GNSS velocity.

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
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import rotate, wrap
from cython.cimports.ekf_companion.core.memory.enums import YAW_FILTERS
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import YawUpdate
from cython.cimports.ekf_companion.core.memory.state import State, YawBank
from cython.cimports.ekf_companion.core.start import yaw_filter, yaw_frame
from cython.cimports.libc.math import atan2, cos, exp, log, sin, sqrt

LEVEL_TIME = cython.declare(cython.double, 1.0)
"""The mean specific force of so long at least says where up is, s."""
YAW_STD = cython.declare(cython.double, 0.3)
"""One sigma of a filter at first, rad; an even share of the circle has 0.23."""
YAW_STEP = cython.declare(cython.double, 0.7853981633974483)
"""Between two filters at first, rad."""
LEAST_STD = cython.declare(cython.double, 0.5)
"""Least one sigma of a velocity, m/s, as in ArduPilot: what receivers state is not white."""
LEAST_CHANGE = cython.declare(cython.double, 1.0)
"""m/s; before the velocity has changed by so much no heading is claimed: a hover has none."""
MEAN_TIME = cython.declare(cython.double, 10.0)
"""s; memory of the mean velocity that the change is counted from."""
LEAST_WEIGHT = cython.declare(cython.double, 1e-6)
"""Least weight of a filter."""
LARGEST_SCORE = cython.declare(cython.double, 18.0)
"""Normalised innovation squared, of 2 degrees, less twice the logarithm of the weight, with which
even the best filter refuses a fix: an unlikely one must not take up what is wild."""
MOST_EVIDENCE = cython.declare(cython.double, 4.0)
"""Largest difference of the logarithms of likelihood that one fix can make."""
PATIENCE = cython.declare(cython.double, 20.0)
"""Refused less accepted fixes after which the bank begins anew."""
FIRST_PATIENCE = cython.declare(cython.double, 4.0)
"""The same before one was accepted: the first fix, which it began at, may be wrong."""
LARGEST_VAR = cython.declare(cython.double, 4.0)
"""Variance of the velocity beyond which the bank begins anew, (m/s)^2."""
LONGEST = cython.declare(cython.double, 30.0)
"""s without a fix after which the bank begins anew."""
VAGUE_VAR = cython.declare(cython.double, 0.16)
"""Variance of the likeliest filter, rad^2, beyond which all are spread anew."""
NARROW_STD = cython.declare(cython.double, 0.17453292519943295)
"""One sigma up to which a heading is usable, rad: 10 degrees."""


def restart(b: YawBank, k: Parameters) -> None:
    """Reset all but the counts of the main filter."""
    for i in range(3):
        b.gyro_bias[i] = 0.0
    b.gyro_bias_std = k.gyro_bias_std
    yaw_frame.restart(b)


def take_bias(x: State, std: float) -> None:
    """Adopt the main filter's gyro bias, just measured at rest; one sigma in rad/s."""
    b = address(x.yaw_bank)
    b.gyro_bias_std = std
    for i in range(3):
        b.gyro_bias[i] = x.gyro_bias[i]
        for n in range(YAW_FILTERS):
            yaw_filter.set_state(address(b.filter[n]), 5 + i, 0.0, std * std)


def fuse_velocity(x: State, k: Parameters, u: YawUpdate, std: float) -> None:
    """Fuse a GNSS velocity of now, ``u.vel_n``; one sigma per axis, m/s."""
    b = address(x.yaw_bank)
    dt = b.sums.dt
    std = std if std > LEAST_STD else LEAST_STD
    if b.is_running == 0.0:
        if dt >= LEVEL_TIME:
            start_filters(b, k, u, std * std)
        return
    if dt <= 0.0:
        return
    if dt > LONGEST:
        restart(b, k)
        return
    if update_filters(x, k, u, std * std):
        b.refused = b.refused - 1.0 if b.refused > 1.0 else 0.0
        merge_filters(b)
        check_yaw(b, u, dt)
    else:
        b.good = 0.0
        b.refused += 1.0
    if b.refused >= PATIENCE or not b.vel_var < LARGEST_VAR:
        restart(b, k)


def start_filters(b: YawBank, k: Parameters, u: YawUpdate, variance: float) -> None:
    """Level s by the mean force, and begin the filters at this velocity."""
    yaw_frame.level(b)
    vn = u.vel_n[0]
    ve = u.vel_n[1]
    for n in range(YAW_FILTERS):
        yaw_filter.start(address(b.filter[n]), vn, ve, variance, b.gyro_bias_std, k.delay_std)
    spread_filters(b, 0.0)
    b.vel_mean[0] = vn
    b.vel_mean[1] = ve
    b.vel_var = variance
    b.refused = PATIENCE - FIRST_PATIENCE
    b.is_running = 1.0
    yaw_frame.restart_sums(b)


def spread_filters(b: YawBank, yaw: float) -> None:
    """Spread the filters evenly over the circle, one of them here, with equal weights."""
    for n in range(YAW_FILTERS):
        b.filter[n].weight = 1.0 / YAW_FILTERS
        yaw_filter.set_state(address(b.filter[n]), 2, wrap(yaw + n * YAW_STEP), YAW_STD * YAW_STD)


def update_filters(x: State, k: Parameters, u: YawUpdate, stated: float) -> bool:
    """Predict, weigh and correct all filters; return whether any accepts the fix."""
    b = address(x.yaw_bank)
    best = 0
    least = 1e30
    top = -1e30
    total = 0.0
    variance = b.vel_var
    variance = variance if variance > stated else stated
    yaw_frame.lever_arm_velocity(x, k, u)
    for n in range(YAW_FILTERS):
        f = address(b.filter[n])
        yaw_filter.predict(f, b, k.gyro_bias_walk, u)
        score = yaw_filter.innovate(f, b, u, n, variance)
        score -= 2.0 * log(f.weight)
        if score < least:
            least = score
            best = n
        top = u.log_likelihood[n] if u.log_likelihood[n] > top else top
    yaw_frame.restart_sums(b)
    learn_variance(b, u, best, variance)
    if not least <= LARGEST_SCORE:
        return False
    for n in range(YAW_FILTERS):
        f = address(b.filter[n])
        yaw_filter.apply_update(f, b, u, n)
        score = u.log_likelihood[n] - top
        f.weight *= exp(score if score > -MOST_EVIDENCE else -MOST_EVIDENCE)
        total += f.weight
    for n in range(YAW_FILTERS):
        f = address(b.filter[n])
        f.weight = f.weight / total
        if f.weight < LEAST_WEIGHT:
            f.weight = LEAST_WEIGHT
    return True


def learn_variance(b: YawBank, u: YawUpdate, n: int, variance: float) -> None:
    """Learn the receiver's variance: what the innovation of filter n has beyond its own doubt.

    Quickly upwards, slowly downwards.
    """
    trace = (u.S_inv[n][0] + u.S_inv[n][2]) / (
        u.S_inv[n][0] * u.S_inv[n][2] - u.S_inv[n][1] * u.S_inv[n][1]
    )
    seen = variance + 0.5 * (u.z[n][0] * u.z[n][0] + u.z[n][1] * u.z[n][1] - trace)
    seen = seen if seen < 4.0 * variance else 4.0 * variance
    seen = seen if seen > 0.0 else 0.0
    b.vel_var += (0.1 if seen > b.vel_var else 0.05) * (seen - b.vel_var)


def remove_mean(b: YawBank, i: int) -> float:
    """Return the mixture's mean of state i, and take it off each filter."""
    mean = 0.0
    for n in range(YAW_FILTERS):
        mean += b.filter[n].weight * b.filter[n].x[i]
    for n in range(YAW_FILTERS):
        b.filter[n].x[i] -= mean
    return mean


def variance_about(b: YawBank, i: int, mean: float) -> float:
    """Return the mixture's variance of state i, an angle or a small number, about a mean."""
    total = 0.0
    for n in range(YAW_FILTERS):
        off = wrap(b.filter[n].x[i] - mean)
        total += b.filter[n].weight * (b.filter[n].P[i][i] + off * off)
    return total


def merge_filters(b: YawBank) -> None:
    """Move the mean tilt and bias into the frame itself, and the mean yaw into the bank."""
    s = 0.0
    c = 0.0
    for n in range(YAW_FILTERS):
        s += b.filter[n].weight * sin(b.filter[n].x[2])
        c += b.filter[n].weight * cos(b.filter[n].x[2])
    b.yaw = atan2(s, c)
    b.yaw_std = sqrt(variance_about(b, 2, b.yaw))
    s = remove_mean(b, 3)
    rotate(b.q_sb, s, remove_mean(b, 4), 0.0)
    b.tilt_std = sqrt(0.5 * (variance_about(b, 3, 0.0) + variance_about(b, 4, 0.0)))
    c = 0.0
    for i in range(3):
        b.gyro_bias[i] += remove_mean(b, 5 + i)
        s = variance_about(b, 5 + i, 0.0)
        c = s if s > c else c
    b.gyro_bias_std = sqrt(c)


def check_yaw(b: YawBank, u: YawUpdate, dt: float) -> None:
    """Count fixes with a narrow yaw that was found in a manoeuvre; spread anew what is vague."""
    best = 0
    dn = u.vel_n[0] - b.vel_mean[0]
    de = u.vel_n[1] - b.vel_mean[1]
    b.vel_mean[0] += dt / (dt + MEAN_TIME) * dn
    b.vel_mean[1] += dt / (dt + MEAN_TIME) * de
    if dn * dn + de * de > LEAST_CHANGE * LEAST_CHANGE + 9.0 * b.vel_var:
        b.has_moved = 1.0
    if b.has_moved != 0.0 and b.yaw_std < NARROW_STD:
        b.good += 1.0
    else:
        b.good = 0.0
    for n in range(YAW_FILTERS):
        if b.filter[n].weight > b.filter[best].weight:
            best = n
    if b.filter[best].P[2][2] > VAGUE_VAR:
        spread_filters(b, b.yaw)
        b.has_moved = 0.0
