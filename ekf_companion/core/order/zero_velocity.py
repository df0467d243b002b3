"""Rest: level by a window of it, or fuse zero velocity and zero rate."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import rest
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance, reset_variance
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate
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
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order.interval import carry_on
from cython.cimports.ekf_companion.core.start import align, yaw_bank
from cython.cimports.ekf_companion.core.trust import gate

ROUGH_AFTER = cython.declare(cython.double, 6e9)
"""Time without rest and velocity of GNSS after which a rough attitude is used, ns."""
FAKE_INTERVAL = cython.declare(cython.double, 2e8)
"""Interval between pseudo-measurements of zero velocity without GNSS, ns."""
LOST = cython.declare(cython.double, 100.0)
"""Position variance over its limit beyond which the position is dropped."""
LONGEST_OUTAGE = cython.declare(cython.double, 60.0)
"""Time without GNSS after which it is dropped, s."""
REST_SPEED = cython.declare(cython.double, 0.05)
"""One sigma of the velocity at rest, m/s."""


def check_rest(x: State, k: Parameters, w: Scratch) -> None:
    """Level, or fuse rest, when a window of it is full; keep an attitude without GNSS."""
    rest.add_to_window(x)
    if rest.is_full(x, k):
        carry_on(x, k, w)
        use_rest_window(x, k, w)
        rest.begin_window(x, x.t)
    if x.mode == MODE_ATTITUDE and x.t - x.fake_t >= FAKE_INTERVAL:
        carry_on(x, k, w)
        fuse_no_travel(x, w)
    elif (
        x.mode == MODE_NAVIGATE
        and gate.is_timed_out(x, AID_POSITION, LONGEST_OUTAGE)
        and x.P[E_POS][E_POS] > LOST * k.limit_pos * k.limit_pos
    ):
        # so long without GNSS that only the attitude is left to keep
        carry_on(x, k, w)
        x.mode = MODE_ATTITUDE
        reset_variance(x, E_VEL, 3, 100.0)
        for i in range(3):
            x.vel_n[i] = 0.0


def use_rest_window(x: State, k: Parameters, w: Scratch) -> None:
    """Find out whether the window saw rest; level by it, or fuse it."""
    # an autopilot that reports flight excludes rest: a smooth flight looks like it
    was_still = x.at_rest
    x.at_rest = 0.0
    if (x.armed != 1.0 or x.landed == 1.0) and rest.was_at_rest(x, k) and not rest.is_moving(x):
        x.at_rest = 1.0
    if was_still == 0.0 or x.at_rest == 0.0:
        x.alignment.still.t0 = 0.0
    if x.mode == MODE_LEVEL:
        if x.at_rest != 0.0:
            align.level_at_rest(x, k, w)
            rest.observe_rate(x, k, w, True)
            innovate(x, address(w.observation))
            apply_update(x, address(w.observation))
            yaw_bank.take_bias(x, rest.gyro_bias_std(x))
        elif x.t - x.alignment.start_t > ROUGH_AFTER and not is_levelling_by_fixes(x):
            align.level_roughly(x, k, w)
    elif x.at_rest != 0.0 and k.use_rest != 0.0 and x.needs_reset == 0.0:
        fuse_zero_velocity(x, k, w)


def is_levelling_by_fixes(x: State) -> bool:
    """Return whether fixes come that level in motion: with a velocity."""
    return x.t - x.fix_t <= ROUGH_AFTER and x.alignment.motion.has_fix != 0.0


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
        rest.zero_velocity(x, o, REST_SPEED)
        if not gate.fuse(x, k, o, AID_REST):
            return
        x.ground = x.pos_n[2]
        x.has_ground = 1.0
    rest.observe_rate(x, k, w, False)
    if rest.is_reported_still(x):
        admit_new_bias(x, k, o)
    if gate.fuse(x, k, o, AID_REST) and x.yaw_bank.has_moved == 0.0:
        std = rest.gyro_bias_std(x)
        if std < x.yaw_bank.gyro_bias_std:
            yaw_bank.take_bias(x, std)


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
        add_variance(x, E_BG + i, o.z[i] * o.z[i])


def fuse_no_travel(x: State, w: Scratch) -> None:
    """Fuse zero velocity with a large sigma, which bounds tilt by gravity."""
    o = address(w.observation)
    x.fake_t = x.t
    rest.zero_velocity(x, o, 0.1 if x.at_rest != 0.0 else 30.0)
    innovate(x, o)
    apply_update(x, o)
    reset_variance(x, E_POS, 2, 1.0)
    for i in range(2):
        x.pos_n[i] = 0.0
