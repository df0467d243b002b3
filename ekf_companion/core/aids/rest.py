"""Rest: detect that the vehicle stands still, and fuse zero velocity and zero rate."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm, wrap
from cython.cimports.ekf_companion.core.memory.constants import EARTH_RATE
from cython.cimports.ekf_companion.core.memory.enums import (
    E_BG,
    E_VEL,
    MODE_LEVEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import atan2, cos, isnan, sin, sqrt

FEWEST = cython.declare(cython.double, 5.0)
"""Samples to judge rest by."""
LEAST_SPEED = cython.declare(cython.double, 0.2)
"""Estimated speed that excludes rest, beside its sigmas, m/s."""
SLOW_VELOCITY = cython.declare(cython.double, 0.04)
"""Error of the receiver's mean velocity over a window at rest beside noise, one sigma, m/s."""
REST_SIGMAS = cython.declare(cython.double, 3.0)
CHANGE_OF_RATE = cython.declare(cython.double, 5e-3)
"""Largest steady change of the rate over a window at rest beside noise, rad/s."""
CHANGE_OF_FORCE = cython.declare(cython.double, 0.1)
"""Likewise of the specific force, m/s^2."""
REST_RATE = cython.declare(cython.double, 1e-4)
"""One sigma of the rate at rest beside noise, rad/s: soft ground, wind."""
HIDDEN_TURN = cython.declare(cython.double, 0.02)
"""One sigma of a steady turn about the vertical that a window of rest cannot tell from the gyro's
bias, rad/s; there is none only where the autopilot reports that it stands."""
HIDDEN_LATER = cython.declare(cython.double, 1.0)
"""The same for the windows after the first, rad/s: a turn that it has hidden is hidden in all."""
FIELD_TURN = cython.declare(cython.double, 0.01)
"""One sigma of a turn of the magnetic field itself between two windows, rad."""
LONGEST_STILL = cython.declare(cython.double, 60.0)
"""Time after which the field is compared with that of a newer window, s."""


def begin_window(x: State, t: float) -> None:
    """Begin a window of rest statistics at t."""
    rest = address(x.alignment.rest)
    rest.t0 = t
    rest.n = 0.0
    rest.mag_n = 0.0
    for i in range(3):
        rest.mag_b[i] = 0.0
        rest.gyro[i] = 0.0
        rest.accel[i] = 0.0
        rest.gyro2[i] = 0.0
        rest.accel2[i] = 0.0
        rest.gyro_t[i] = 0.0
        rest.accel_t[i] = 0.0
        rest.vel_n[i] = 0.0
    rest.t1 = 0.0
    rest.t2 = 0.0
    rest.vel_var = 0.0
    rest.vel_count = 0.0


def add_to_window(x: State) -> None:
    """Add the newest sample to the rest statistics."""
    rest = address(x.alignment.rest)
    rest.n += 1.0
    tau = (x.t - rest.t0) * 1e-9
    rest.t1 += tau
    rest.t2 += tau * tau
    for i in range(3):
        rest.gyro_t[i] += tau * x.gyro[i]
        rest.accel_t[i] += tau * x.accel[i]
        rest.gyro[i] += x.gyro[i]
        rest.accel[i] += x.accel[i]
        rest.gyro2[i] += x.gyro[i] * x.gyro[i]
        rest.accel2[i] += x.accel[i] * x.accel[i]


def is_full(x: State, k: Parameters) -> bool:
    """Return whether the window is long enough to judge rest by."""
    rest = address(x.alignment.rest)
    return x.t - rest.t0 >= k.align_time * 1e9 and rest.n >= FEWEST


def add_field(x: State, mag_b: Vector) -> None:
    """Add a magnetic field (gauss) to the rest statistics."""
    rest = address(x.alignment.rest)
    rest.mag_n += 1.0
    for i in range(3):
        rest.mag_b[i] += mag_b[i]


def forget_field(x: State) -> None:
    """Take the field of the window, and of the one to compare it with, for no compass."""
    x.alignment.rest.mag_n = 0.0
    x.alignment.still.t0 = 0.0
    for i in range(3):
        x.alignment.rest.mag_b[i] = 0.0


def add_velocity(x: State, fix: Fix) -> None:
    """Add a velocity of the receiver to the rest statistics."""
    rest = address(x.alignment.rest)
    if isnan(fix.vel_n[0]):
        return
    rest.vel_count += 1.0
    rest.vel_var += fix.std[2] * fix.std[2]
    for i in range(3):
        rest.vel_n[i] += 0.0 if isnan(fix.vel_n[i]) else fix.vel_n[i]


def is_receiver_moving(x: State) -> bool:
    """Return whether the receiver's mean velocity over the window excludes rest."""
    rest = address(x.alignment.rest)
    speed = 0.0
    if rest.vel_count == 0.0:
        return False
    for i in range(3):
        speed += rest.vel_n[i] * rest.vel_n[i]
    level = rest.vel_var + SLOW_VELOCITY * SLOW_VELOCITY * rest.vel_count * rest.vel_count
    return speed > REST_SIGMAS * REST_SIGMAS * level


def is_changing(x: State) -> bool:
    """Return whether rate or force change steadily over the window, as on a rocking deck."""
    rest = address(x.alignment.rest)
    n = rest.n
    turn = 0.0
    push = 0.0
    noise = 0.0
    shaking = 0.0
    spread = rest.t2 - rest.t1 * rest.t1 / n
    span = (x.t - rest.t0) * 1e-9
    if not spread > 0.0:
        return False
    for i in range(3):
        slope = (rest.gyro_t[i] - rest.t1 * rest.gyro[i] / n) / spread * span
        turn += slope * slope
        noise += rest.gyro2[i] - rest.gyro[i] * rest.gyro[i] / n
        slope = (rest.accel_t[i] - rest.t1 * rest.accel[i] / n) / spread * span
        push += slope * slope
        shaking += rest.accel2[i] - rest.accel[i] * rest.accel[i] / n
    # the noise of a slope times the span, from what is scattered about the mean
    scale = 9.0 * span * span / (spread * n)
    return (
        turn > CHANGE_OF_RATE * CHANGE_OF_RATE + scale * noise
        or push > CHANGE_OF_FORCE * CHANGE_OF_FORCE + scale * shaking
    )


def largest_at_rest(learnt: float, largest: float) -> float:
    """Return the largest variance at rest: twice the sigma learnt, but no more than the limit."""
    if learnt > 0.0 and 4.0 * learnt < largest * largest:
        return 4.0 * learnt
    return largest * largest


def was_at_rest(x: State, k: Parameters) -> bool:
    """Return whether the window saw the vehicle stand still: quiet, not turning, one g."""
    rest = address(x.alignment.rest)
    n = rest.n
    size = 0.0
    var_gyro = 0.0
    var_accel = 0.0
    rate = 0.0
    for i in range(3):
        mean = rest.gyro[i] / n
        rate += mean * mean
        var_gyro += rest.gyro2[i] / n - mean * mean
        mean = rest.accel[i] / n
        size += mean * mean
        var_accel += rest.accel2[i] / n - mean * mean
    size = sqrt(size)
    if var_gyro > largest_at_rest(x.rest_gyro, k.rest_gyro):
        return False
    if var_accel > largest_at_rest(x.rest_accel, k.rest_accel):
        return False
    if is_changing(x) or is_receiver_moving(x):
        return False
    if rate > 0.01:  # 0.1 rad/s: no gyro of today has such a bias
        return False
    if size < 0.9 * k.gravity or size > 1.1 * k.gravity:
        return False
    if x.mode == MODE_LEVEL and x.alignment.motion.has_fix != 0.0:
        # a receiver that reports motion excludes rest
        mean = 0.5 + 3.0 * x.alignment.motion.fix_std
        rate = 0.0
        for i in range(2):
            rate += x.alignment.motion.fix_vel[i] * x.alignment.motion.fix_vel[i]
        return rate < mean * mean
    return True


def is_moving(x: State) -> bool:
    """Return whether the estimated velocity excludes rest: a wing flies as quietly as it stands."""
    speed = 0.0
    sigma = 0.0
    if x.mode != MODE_NAVIGATE or x.landed == 1.0:
        return False
    for i in range(3):
        speed += x.vel_n[i] * x.vel_n[i]
        sigma += x.P[E_VEL + i][E_VEL + i]
    # a velocity that is not known speaks against it as well
    if sigma > 1.0:
        return True
    return speed > LEAST_SPEED * LEAST_SPEED + 9.0 * sigma


def is_reported_still(x: State) -> bool:
    """Return whether the autopilot reports that it stands: landed, or not armed."""
    return x.landed == 1.0 or x.armed == 0.0


def gyro_bias_std(x: State) -> float:
    """Return the largest sigma of the gyro bias about an axis of the body, rad/s."""
    largest = 0.0
    for i in range(E_BG, E_BG + 3):
        largest = x.P[i][i] if x.P[i][i] > largest else largest
    return sqrt(largest)


def observe_rate(x: State, k: Parameters, w: Scratch, is_first: bool) -> None:
    """Observe the mean rate of a window of rest as the gyro's bias.

    Unless the autopilot reports that it stands, the vehicle may turn steadily. About a level axis
    that shows in the specific force: a tilt that changes over the window makes a twelfth of its
    change squared. About the vertical it shows in the magnetic field, if there is one; else it has
    one sigma of its own, and what the first window has hidden is hidden in all.
    """
    rest = address(x.alignment.rest)
    o = address(w.observation)
    noise = 0.0
    for i in range(3):
        w.mean_rate[i] = rest.gyro[i] / rest.n
        noise += rest.gyro2[i] / rest.n - w.mean_rate[i] * w.mean_rate[i]
    noise = sqrt(noise / rest.n) + REST_RATE if noise > 0.0 else REST_RATE
    if is_reported_still(x):
        zero_rate(x, o, w.mean_rate, noise, noise)
        return
    tilting = sqrt(12.0 * force_variance(x)) / (k.gravity * (x.t - rest.t0) * 1e-9)
    if tilting > HIDDEN_TURN:
        tilting = HIDDEN_TURN
    hidden_turn = compare_with_field(x, k, w, HIDDEN_TURN if is_first else HIDDEN_LATER)
    zero_rate(x, o, w.mean_rate, noise + tilting, noise + hidden_turn)


def compare_with_field(x: State, k: Parameters, w: Scratch, hidden_turn: float) -> float:
    """Put the bias about the vertical that gyro and field show together into ``w.mean_rate``.

    Return one sigma of it, rad/s, such that all windows together leave the field's own error.
    """
    rest = address(x.alignment.rest)
    still = address(x.alignment.still)
    C_nb = w.observation.C_nb
    rate = 0.0
    variance = 0.0
    north = 0.0
    east = 0.0
    north_now = 0.0
    east_now = 0.0
    to_dcm(x.q_nb, C_nb)
    for i in range(3):
        rate += C_nb[2][i] * w.mean_rate[i]
        for j in range(3):
            variance += C_nb[2][i] * x.P[E_BG + i][E_BG + j] * C_nb[2][j]
    span = (0.5 * (rest.t0 + x.t) - still.t0) * 1e-9
    half = 0.5 * rate * (x.t - rest.t0) * 1e-9
    if still.t0 != 0.0 and rest.mag_n >= FEWEST:
        for i in range(3):
            north += C_nb[0][i] * still.mag_b[i]
            east += C_nb[1][i] * still.mag_b[i]
            north_now += C_nb[0][i] * rest.mag_b[i] / rest.mag_n
            east_now += C_nb[1][i] * rest.mag_b[i] / rest.mag_n
        cross = north * east_now - east * north_now
        dot = north * north_now + east * east_now
        # the field turns in the body against the body's turn
        bias = wrap(still.turn + half + atan2(cross, dot)) / span
        strength = sqrt(north * north + east * east)
        std = (FIELD_TURN + k.mag_noise / (strength * sqrt(rest.mag_n) + 1e-9)) / span
        if std * std < variance:
            for i in range(3):
                w.mean_rate[i] += (bias - rate) * C_nb[2][i]
            hidden_turn = std * sqrt(variance / (variance - std * std))
    if still.t0 != 0.0:
        still.turn += 2.0 * half
    elif rest.mag_n >= FEWEST:
        still.t0 = 0.5 * (rest.t0 + x.t)
        still.turn = half
        for i in range(3):
            still.mag_b[i] = rest.mag_b[i] / rest.mag_n
    if span > LONGEST_STILL:
        still.t0 = 0.0
    return hidden_turn


def zero_velocity(x: State, o: Observation, std: float) -> None:
    """Observe zero velocity with one sigma std, m/s: three rows."""
    clear(o, 3, std * std)
    for i in range(3):
        o.z[i] = -x.vel_n[i]
        o.H[i][E_VEL + i] = 1.0


def zero_rate(x: State, o: Observation, rate: Vector, level: float, vertical: float) -> None:
    """Observe that the gyro's rate at rest is its bias and the turning Earth: three rows.

    One sigma of the vehicle's own rate, and of noise, differs about level axes and the vertical.
    """
    north = 0.0
    down = 0.0
    clear(o, 3, level * level)
    to_dcm(x.q_nb, o.C_nb)
    for i in range(3):
        for j in range(3):
            o.R[i][j] += (vertical * vertical - level * level) * o.C_nb[2][i] * o.C_nb[2][j]
    if x.origin.is_known != 0.0:
        lat = x.origin.lat + x.pos_n[0] / x.origin.scale_n
        north = EARTH_RATE * cos(lat)
        down = -EARTH_RATE * sin(lat)
    for i in range(3):
        o.z[i] = rate[i] - (x.gyro_bias[i] + o.C_nb[0][i] * north + o.C_nb[2][i] * down)
        o.H[i][E_BG + i] = 1.0


def force_variance(x: State) -> float:
    """Return the variance of the specific force over the window, all axes together, m^2/s^4."""
    rest = address(x.alignment.rest)
    variance = 0.0
    if rest.n < 2.0:
        return 0.0
    for i in range(3):
        mean = rest.accel[i] / rest.n
        variance += rest.accel2[i] / rest.n - mean * mean
    return variance if variance > 0.0 else 0.0
