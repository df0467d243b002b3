"""Rest: detect that the vehicle stands still, and fuse zero velocity and zero rate."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import observe
from cython.cimports.ekf_companion.core.filter.propagate import propagate_covariance
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm, wrap
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate, reset_variance
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_POSITION,
    AID_REST,
    E_BG,
    E_POS,
    E_VEL,
    MODE_ATTITUDE,
    MODE_LEVEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start import align, yaw_bank
from cython.cimports.ekf_companion.core.trust import gate
from cython.cimports.libc.math import atan2, isnan, sqrt

FEWEST = cython.declare(cython.double, 5.0)
"""Samples to judge rest by."""
ROUGH_AFTER = cython.declare(cython.double, 6e9)
"""Time without rest and velocity of GNSS after which a rough attitude is used, ns."""
FAKE_INTERVAL = cython.declare(cython.double, 2e8)
"""Interval between pseudo-measurements of zero velocity without GNSS, ns."""
LOST = cython.declare(cython.double, 100.0)
"""Position variance over its limit beyond which the position is dropped."""
LONGEST_OUTAGE = cython.declare(cython.double, 60.0)
"""Time without GNSS after which it is dropped, s."""
LEAST_SPEED = cython.declare(cython.double, 0.2)
"""Estimated speed that excludes rest, beside its sigmas, m/s."""
REST_SPEED = cython.declare(cython.double, 0.05)
"""One sigma of the velocity at rest, m/s."""
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


def check_rest(x: State, k: Parameters, w: Scratch) -> None:
    """Level, or fuse rest, when a window of it is full; keep an attitude without GNSS."""
    rest = address(x.alignment.rest)
    add_to_window(x)
    if x.t - rest.t0 >= k.align_time * 1e9 and rest.n >= FEWEST:
        propagate_covariance(x, k, address(w.motion))
        use_rest_window(x, k, w)
        begin_window(x, x.t)
    if x.mode == MODE_ATTITUDE and x.t - x.fake_t >= FAKE_INTERVAL:
        propagate_covariance(x, k, address(w.motion))
        fuse_no_travel(x, w)
    elif (
        x.mode == MODE_NAVIGATE
        and gate.is_timed_out(x, AID_POSITION, LONGEST_OUTAGE)
        and x.P[E_POS][E_POS] > LOST * k.limit_pos * k.limit_pos
    ):
        # so long without GNSS that only the attitude is left to keep
        propagate_covariance(x, k, address(w.motion))
        x.mode = MODE_ATTITUDE
        reset_variance(x, E_VEL, 3, 100.0)
        for i in range(3):
            x.vel_n[i] = 0.0


def use_rest_window(x: State, k: Parameters, w: Scratch) -> None:
    """Find out whether the window saw rest; level by it, or fuse it."""
    # an autopilot that reports flight excludes rest: a smooth flight looks like it
    was_still = x.at_rest
    x.at_rest = 0.0
    if (x.armed != 1.0 or x.landed == 1.0) and was_at_rest(x, k) and not is_moving(x):
        x.at_rest = 1.0
    if was_still == 0.0 or x.at_rest == 0.0:
        x.alignment.still.t0 = 0.0
    if x.mode == MODE_LEVEL:
        if x.at_rest != 0.0:
            align.level_at_rest(x, k, w)
            observe_rate(x, k, w, HIDDEN_TURN)
            innovate(x, address(w.observation))
            apply_update(x, address(w.observation))
            yaw_bank.take_bias(x, gyro_bias_std(x))
        elif x.t - x.alignment.start_t > ROUGH_AFTER and not is_levelling_by_fixes(x):
            align.level_roughly(x, k, w)
    elif x.at_rest != 0.0 and k.use_rest != 0.0 and x.needs_reset == 0.0:
        fuse_zero_velocity(x, k, w)


def is_levelling_by_fixes(x: State) -> bool:
    """Return whether fixes come that level in motion: with a velocity."""
    return x.t - x.fix_t <= ROUGH_AFTER and x.alignment.motion.has_fix != 0.0


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


def fuse_zero_velocity(x: State, k: Parameters, w: Scratch) -> None:
    """Fuse zero velocity, and the mean rate over the window as the gyro bias.

    A turn that the first window has hidden is hidden in all others too: unless the autopilot
    reports that it stands, they show nothing of the bias about the vertical.

    Only where a rest has been seen before, or the autopilot says that it has landed: so a first
    hover is not taken for one.
    """
    o = address(w.observation)
    if not x.rest_gyro > 0.0 and x.landed != 1.0:
        return
    if x.mode == MODE_NAVIGATE:
        observe.zero_velocity(x, o, REST_SPEED)
        if not gate.fuse(x, k, o, AID_REST):
            return
        x.ground = x.pos_n[2]
        x.has_ground = 1.0
    observe_rate(x, k, w, HIDDEN_LATER)
    if is_reported_still(x):
        admit_new_bias(x, k, o)
    if gate.fuse(x, k, o, AID_REST) and x.yaw_bank.has_moved == 0.0:
        std = gyro_bias_std(x)
        if std < x.yaw_bank.gyro_bias_std:
            yaw_bank.take_bias(x, std)


def is_reported_still(x: State) -> bool:
    """Return whether the autopilot reports that it stands: landed, or not armed."""
    return x.landed == 1.0 or x.armed == 0.0


def admit_new_bias(x: State, k: Parameters, o: Observation) -> None:
    """Raise the variance of a gyro bias that a window of rest denies: the bias has moved.

    PX4 takes its own filter's bias off what it sends, and in its first minute, or with a wrong
    heading, that bias runs away faster than any sensor's. A rate beyond one sigma of a bias at the
    start is a turn after all.
    """
    if innovate(x, o) <= k.soft_gate[2]:
        return
    for i in range(3):
        if o.z[i] * o.z[i] > k.gyro_bias_std * k.gyro_bias_std:
            return
    for i in range(3):
        x.P[E_BG + i][E_BG + i] += o.z[i] * o.z[i]


def gyro_bias_std(x: State) -> float:
    """Return the largest sigma of the gyro bias about an axis of the body, rad/s."""
    largest = 0.0
    for i in range(E_BG, E_BG + 3):
        largest = x.P[i][i] if x.P[i][i] > largest else largest
    return sqrt(largest)


def observe_rate(x: State, k: Parameters, w: Scratch, hidden_turn: float) -> None:
    """Observe the mean rate of a window of rest as the gyro's bias.

    Unless the autopilot reports that it stands, the vehicle may turn steadily. About a level axis
    that shows in the specific force: a tilt that changes over the window makes a twelfth of its
    change squared. About the vertical it shows in the magnetic field, if there is one; else it has
    one sigma of ``hidden_turn`` (rad/s).
    """
    rest = address(x.alignment.rest)
    o = address(w.observation)
    noise = 0.0
    for i in range(3):
        w.mean_rate[i] = rest.gyro[i] / rest.n
        noise += rest.gyro2[i] / rest.n - w.mean_rate[i] * w.mean_rate[i]
    noise = sqrt(noise / rest.n) + REST_RATE if noise > 0.0 else REST_RATE
    if is_reported_still(x):
        observe.zero_rate(x, o, w.mean_rate, noise, noise)
        return
    tilting = sqrt(12.0 * align.force_variance(x)) / (k.gravity * (x.t - rest.t0) * 1e-9)
    if tilting > HIDDEN_TURN:
        tilting = HIDDEN_TURN
    hidden_turn = compare_with_field(x, k, w, hidden_turn)
    observe.zero_rate(x, o, w.mean_rate, noise + tilting, noise + hidden_turn)


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


def fuse_no_travel(x: State, w: Scratch) -> None:
    """Fuse zero velocity with a large sigma, which bounds tilt by gravity."""
    o = address(w.observation)
    x.fake_t = x.t
    observe.zero_velocity(x, o, 0.1 if x.at_rest != 0.0 else 30.0)
    innovate(x, o)
    apply_update(x, o)
    reset_variance(x, E_POS, 2, 1.0)
    for i in range(2):
        x.pos_n[i] = 0.0
