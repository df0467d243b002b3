"""Which receiver is used, of two, and the first fix of one after the autopilot's own position.

The first is used until it is silent, or refused for a while beside a second that agrees with us.
There is no way back but the same: whoever was wrong once has to be needed again.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import gnss, lag
from cython.cimports.ekf_companion.core.filter.slow_error import reset_variance
from cython.cimports.ekf_companion.core.filter.update import innovate
from cython.cimports.ekf_companion.core.memory.constants import FROZEN, NEVER
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_POSITION,
    E_GNSS,
    E_VEL,
    FLAG_DERIVED,
    FLAG_SECOND,
    FLAG_SUSPECT,
    MODE_NAVIGATE,
    RESET_ORIGIN,
    RESET_POSITION,
    RUNS,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_NONE,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import GnssRow, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start.navigation import (
    forget_vel_offset,
    reset_to_fix,
    start_navigation,
)
from cython.cimports.ekf_companion.core.trust import gate
from cython.cimports.ekf_companion.core.trust.gate import (
    begin_reset,
    clear_run,
    is_refused_for,
    is_timed_out,
)

SILENT = cython.declare(cython.double, 0.6e9)
"""Time for which one receiver speaks and the other does not, beside half as much again as its last
interval, ns. At 5 Hz that ends before ODOMETRY would for want of a fix."""
LONGEST = cython.declare(cython.double, 2e9)
"""Longest of these times, and what a receiver is given at first, ns."""
REFUSED = cython.declare(cython.double, 1.0)
"""Time for which a receiver in use is refused, s: a glitch of one fix is over by then."""
UNUSED = cython.declare(cython.double, 3.0)
"""Time for which its position is not used, for whatever reason, s."""
FAR = cython.declare(cython.double, 1000.0)
"""Distance from which on an origin is not worth to be kept, m."""


REPEATS = cython.declare(cython.double, 2.0)
"""Repeats of one position after which a moving receiver counts as frozen."""


def is_used(x: State, k: Parameters, w: Scratch, values: GnssRow) -> bool:
    """Return whether a fix is of the receiver in use, or of the other one where it is needed."""
    flags = cython.declare(cython.int, cython.cast(cython.int, values.flags))
    second = 1.0 if flags & FLAG_SECOND else 0.0
    if second == x.receiver:
        x.alone_t = NEVER
        return True
    if x.alone_t <= NEVER:
        x.alone_t = x.t
    silence = SILENT + 1.5e9 * x.fix_dt
    if x.fix_t <= NEVER or silence > LONGEST:
        silence = LONGEST
    if x.t - x.alone_t <= silence and not is_better(x, k, w, values):
        return False
    x.receiver = second
    forget_receiver(x)
    return True


def is_better(x: State, k: Parameters, w: Scratch, values: GnssRow) -> bool:
    """Return whether a fix agrees with us while the receiver in use is refused."""
    if x.mode != MODE_NAVIGATE or x.needs_reset != 0.0:
        return False
    if not is_refused_for(x, AID_POSITION, REFUSED) and not is_timed_out(x, AID_POSITION, UNUSED):
        return False
    fix = address(w.fix)
    o = address(w.observation)
    fix.lat = values.lat
    fix.lon = values.lon
    fix.lag = 0.0
    fix.lag_var = k.lag_std * k.lag_std
    fix.std[0] = values.std[0]
    for i in range(3):
        fix.vel_n[i] = values.vel_n[i]
    gnss.position(x, k, fix, o)
    return innovate(x, o) <= k.gate[1]


def forget_receiver(x: State) -> None:
    """Forget what fixes have shown of the receiver before: another one has other errors."""
    lag.forget(x)
    x.alone_t = NEVER
    x.split_t = NEVER
    x.slide.t = NEVER
    x.slide.apart_t = NEVER
    x.slide.is_sliding = 0.0
    x.force_t = NEVER
    x.is_force_denied = 0.0
    x.voices.t = NEVER
    x.voices.baro_t = NEVER
    x.voices.apart_t = NEVER
    x.voices.rush = 0.0
    x.voices.is_rushing = 0.0
    x.voices.loser = VOICE_NONE
    x.fix_repeats = 0.0
    for aid in range(RUNS):
        clear_run(x, aid)
        x.last_z_t[aid] = NEVER
        x.refused_t[aid] = x.used_t[aid]
    for i in range(3):
        x.innovation_mean[i] = 0.0
        x.refused_way[i] = 0.0
    for i in range(2):
        x.is_one_sided[i] = 0.0
        x.slide.led[i] = 0.0
        x.slide.smooth[i] = 0.0
    if x.mode != MODE_NAVIGATE:
        return
    for i in range(3):
        x.gnss_offset[i] = 0.0
    reset_variance(x, E_GNSS, 2, x.gnss_offset_var[0])
    reset_variance(x, E_GNSS + 2, 1, x.gnss_offset_var[1])
    forget_vel_offset(x)


def replace_derived(x: State, k: Parameters, w: Scratch, has_vel: bool) -> bool:
    """Begin anew at a receiver's first fix that contradicts the autopilot's own position.

    Return whether it does. Far off, the origin is as wrong as the position, and is set anew.
    """
    fix = address(w.fix)
    o = address(w.observation)
    gnss.position(x, k, fix, o)
    if innovate(x, o) <= k.gate[1]:
        return False
    north = o.z[0]
    east = o.z[1]
    down = x.origin.alt - fix.alt - x.pos_n[2]
    forget_receiver(x)
    if north * north + east * east < FAR * FAR:
        begin_reset(x, RESET_POSITION)
        reset_to_fix(x, k, w, has_vel)
        return True
    begin_reset(x, RESET_ORIGIN)
    x.origin.is_known = 0.0
    x.has_ground = 0.0
    start_navigation(x, k, w, has_vel)
    # the place has moved, whatever the numbers of the new frame are
    x.moved.pos_n[0] = north
    x.moved.pos_n[1] = east
    x.moved.pos_n[2] = down
    return True


def is_allowed(x: State, k: Parameters, flags: int) -> bool:
    """Return whether a fix is used: the receiver's own, unless it reports spoofing or jamming.

    The autopilot's own position is used only for a vehicle that never sent a fix of its receiver:
    while a receiver is silent it is the autopilot's dead reckoning.
    """
    if flags & FLAG_DERIVED:
        if k.use_derived == 0.0 or (k.use_derived == 1.0 and x.raw_fix_t > NEVER):
            gate.count_verdict(x, AID_POSITION, VERDICT_SUPERSEDED)
            return False
    else:
        x.raw_fix_t = x.t
        if k.use_derived == 2.0:
            gate.count_verdict(x, AID_POSITION, VERDICT_SUPERSEDED)
            return False
    if flags & FLAG_SUSPECT:
        gate.count_verdict(x, AID_POSITION, VERDICT_SUSPECT)
        return False
    return True


def is_frozen(x: State, values: GnssRow) -> bool:
    """Return whether the receiver repeats one position to the bit while the vehicle moves.

    It moves by our own velocity, or by the receiver's, which is repeated and not zero, unless we
    rest. Found once, it stays so until the position changes: our velocity is soon not known well.
    """
    is_same = cython.declare(
        cython.bint,
        x.last_fix[0] == values.lat and x.last_fix[1] == values.lon and x.last_fix[2] == values.alt,
    )
    has_same_vel = cython.declare(
        cython.bint,
        x.last_fix_vel[0] == values.vel_n[0] and x.last_fix_vel[1] == values.vel_n[1],
    )
    is_sent_moving = cython.declare(cython.bint, values.vel_n[0] != 0.0 or values.vel_n[1] != 0.0)
    x.last_fix[0] = values.lat
    x.last_fix[1] = values.lon
    x.last_fix[2] = values.alt
    x.last_fix_vel[0] = values.vel_n[0]
    x.last_fix_vel[1] = values.vel_n[1]
    speed = 0.0
    sigma = 0.0
    for i in range(3):
        speed += x.vel_n[i] * x.vel_n[i]
        sigma += x.P[E_VEL + i][E_VEL + i]
    x.fix_repeats = x.fix_repeats + 1.0 if is_same else 0.0
    is_moving = cython.declare(
        cython.bint,
        speed > 1.0 + 9.0 * sigma or (has_same_vel and is_sent_moving and x.at_rest == 0.0),
    )
    if x.mode == MODE_NAVIGATE and x.fix_repeats >= REPEATS and is_moving:
        x.fix_repeats = FROZEN
    return x.fix_repeats >= FROZEN
