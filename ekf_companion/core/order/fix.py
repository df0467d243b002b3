"""A fix: start navigation by it, correct by it, or test refused ones for consistency.

A receiver states metres and differs from fix to fix by centimetres: most of its error is slow. So
the stated variance is shared between white noise and three Gauss-Markov states, in a share that is
learnt from the innovations. The position that is estimated is that without the slow error.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import delay, gnss, lag, rest
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import (
    EVEN,
    NAN,
    NEVER,
    SAME_CAUSE,
    THREE_SIGMA2,
)
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    E_GNSS,
    E_POS,
    E_VEL,
    FLAG_DERIVED,
    MODE_LEVEL,
    MODE_NAVIGATE,
    RESET_HEIGHT,
    RESET_MOTION,
    RESET_POSITION,
    RESET_VELOCITY,
    VERDICT_BEFORE_ALIGNMENT,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_HEIGHT,
    VOICE_VELOCITY,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, GnssRow, Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order import receiver
from cython.cimports.ekf_companion.core.order.aid import yield_to_receiver
from cython.cimports.ekf_companion.core.start import align, yaw_bank, yaw_reset
from cython.cimports.ekf_companion.core.start.navigation import (
    forget_vel_offset,
    join_fixes,
    reset_height,
    reset_position,
    reset_unknown_velocity,
    reset_velocity,
    resume_after_gap,
    start_from_yaw_bank,
    start_navigation,
)
from cython.cimports.ekf_companion.core.trust import (
    delay_search,
    doubt,
    force,
    gate,
    hypotheses,
    repair,
    shape,
    slide,
    voices,
)
from cython.cimports.ekf_companion.core.trust.innovation import (
    is_denied_by_position,
    is_dragged,
    learn_white_share,
    white_share,
)
from cython.cimports.libc.math import isnan, sqrt

SILENT_COMPASS = cython.declare(cython.double, 4e9)
"""Silence that a compass is given at the first fix, ns: a second less than what lets another
estimate's heading be used."""
LEAST_LEVEL = cython.declare(cython.double, 1e-6)
"""Least variance of a slow error, m^2."""
GOOD_VELOCITY = cython.declare(cython.double, 0.1)
"""White noise of a velocity above which its slow error is larger in proportion, m/s."""
JERK = cython.declare(cython.double, 0.25)
"""Variance of the error of our acceleration while velocity is refused, m^2/s^4."""
DOUBTED_NIS = cython.declare(cython.double, 0.02)
"""NIS that a doubt of one is worth where the heading is judged."""
FAR_WORSE = cython.declare(cython.double, 18.0)
"""Square of a velocity's innovation over the variance that the yaw bank meets."""
FEW_SIGMAS = cython.declare(cython.double, 10.0)
"""A position off by less than so many sigmas of ours may have become so by itself."""
OWN_DRIFT = cython.declare(cython.double, 0.5)
"""Drift of our position that is possible while the velocity is fused and agrees, m/s."""
LARGEST_DRIFT = cython.declare(cython.double, (OWN_DRIFT / 3.0) ** 2)
"""Variance of which that is three sigma, m^2/s^2."""
LONGEST_PATIENCE = cython.declare(cython.double, 30.0)
"""Longest time for which a position that drift cannot explain is refused, s."""
SHORTEST_RUN = cython.declare(cython.double, 3.0)
"""Least duration of a run of refused fixes that proves them, s."""


def fuse_fix(x: State, k: Parameters, w: Scratch, values: GnssRow) -> bool:
    """Fuse a fix. Return False if it was refused for so long that the filter must start over."""
    fix = address(w.fix)
    flags = cython.declare(cython.int, cython.cast(cython.int, values.flags))
    has_vel = cython.declare(cython.bint, k.use_velocity != 0.0 and not isnan(values.vel_n[0]))
    is_first = cython.declare(cython.bint, not flags & FLAG_DERIVED and x.raw_fix_t <= NEVER)

    # Which source, and is it usable
    if not receiver.is_allowed(x, k, flags):
        return True
    if not flags & FLAG_DERIVED and not receiver.is_used(x, k, w, values):
        gate.count_verdict(x, AID_POSITION, VERDICT_SUPERSEDED)
        return True
    if receiver.is_frozen(x, values):
        gate.count_verdict(x, AID_POSITION, VERDICT_SUSPECT)
        return True
    learn_field(x, values)
    read_fix(x, k, fix, values)
    if not flags & FLAG_DERIVED:
        delay.follow_lag(x, k, lag.take(x, k, fix))
    if x.origin.is_known != 0.0 and k.weighs_faults != WEIGH_ACT:
        force.compare(x, fix)
        slide.compare_fixes(x, fix)
    if k.weighs_faults != WEIGH_ACT:
        voices.compare_climbs(x, fix)
    if x.voices.loser == VOICE_VELOCITY:
        fix.vel_n[2] = NAN
    if x.fix_t > NEVER and x.t > x.fix_t:
        x.fix_dt = (x.t - x.fix_t) * 1e-9
    x.fix_t = x.t

    rest.add_velocity(x, fix)

    # The yaw bank uses every velocity; without another heading it starts the filter
    if has_vel:
        w.yaw.vel_n[0] = fix.vel_n[0]
        w.yaw.vel_n[1] = fix.vel_n[1]
        yaw_bank.fuse_velocity(x, k, address(w.yaw), sqrt(fix.stated_var[2]))
    if x.mode < MODE_NAVIGATE and x.has_yaw == 0.0 and yaw_reset.is_ready(x):
        start_from_yaw_bank(x, k, w)
        return True

    # Before navigation a fix helps to level, or starts it
    if x.mode < MODE_NAVIGATE:
        if has_vel and align.level_in_motion(x, k, w) if x.mode == MODE_LEVEL else x.has_yaw != 0.0:
            start_navigation(x, k, w, has_vel)
        else:
            gate.count_verdict(x, AID_POSITION, VERDICT_BEFORE_ALIGNMENT)
        return True
    if x.origin.is_known == 0.0:
        if not join_fixes(x, k, w, has_vel):
            gate.count_verdict(x, AID_POSITION, VERDICT_BEFORE_ALIGNMENT)
        return True
    if k.weighs_faults == WEIGH_ACT:
        repair.drive(x, address(w.observation.bank[0]), 0, 2)
        widen_offsets(x, address(w.observation.bank[0]))
    if x.needs_reset != 0.0:
        resume_after_gap(x, k, w, has_vel)
        return True
    if is_first and receiver.replace_derived(x, k, w, has_vel):
        return True
    return correct_by_fix(x, k, w, has_vel)


def correct_by_fix(x: State, k: Parameters, w: Scratch, has_vel: bool) -> bool:
    """Correct velocity, position and height. Return False if the filter must start over."""
    fix = address(w.fix)
    o = address(w.observation)
    # What is slow of their error is no larger than what has been learnt
    bound_offset(x, o, 0, x.gnss_offset_var[0])
    bound_offset(x, o, 1, x.gnss_offset_var[0])
    bound_offset(x, o, 2, x.gnss_offset_var[1])

    # Velocity first: it is more precise, and shows whether the heading is wrong
    if has_vel:
        delay.keep_fix(x, k, fix, o)
        if not fuse_velocity(x, k, w):
            return False
        rows = 2 if isnan(fix.vel_n[2]) else 3
        nis = x.ratio[AID_VELOCITY] * k.gate[rows - 1] / rows
        z = o.z[0] * o.z[0] + o.z[1] * o.z[1]
        if nis < DOUBTED_NIS * x.doubt and z > FAR_WORSE * x.yaw_bank.vel_var:
            # much doubt is a contradiction, however small its NIS, where the bank has none
            nis = DOUBTED_NIS * x.doubt
        if x.is_denied[AID_VELOCITY] != 0.0:
            nis = NAN
        if k.weighs_faults == WEIGH_ACT:
            if o.bank[0].astray > EVEN:
                nis = NAN  # our yaw is off, however well another one explains this velocity
                yaw_reset.take_angle(x, address(o.bank[0]))
            elif hypotheses.explains(address(o.bank[0])) or delay_search.may_have_leapt(x):
                nis = 0.0  # it is a fault, or may be one, and not our attitude
        if yaw_reset.is_needed(x, nis, x.fix_dt, sqrt(fix.stated_var[2])):
            gate.begin_reset(x, RESET_MOTION)
            start_from_yaw_bank(x, k, w)
            yaw_reset.note_repair(x)
            doubt.restart(x)
            return True
    fuse_position(x, k, w)
    fuse_height(x, k, w)
    if o.has_bank:
        if k.weighs_faults == WEIGH_ACT:
            repair.hold_found(x, address(o.bank[0]))
        repair.decide(x, k, o)
    return True


def widen_offsets(x: State, b: Bank) -> None:
    """Leave an offset as uncertain as a declared fault has made it, as long as that is held."""
    for level in range(2):
        x.gnss_offset_var[level] += b.let_go[level]
    b.natural[0] = x.gnss_offset_var[0]
    b.natural[1] = x.gnss_offset_var[1]
    for i in range(3):
        level = 0 if i < 2 else 1
        b.before[i] = x.gnss_offset[i]
        if b.held[i] != 0.0 and x.P[E_GNSS + i][E_GNSS + i] > x.gnss_offset_var[level]:
            x.gnss_offset_var[level] = x.P[E_GNSS + i][E_GNSS + i]
        square = x.gnss_vel_offset[i] * x.gnss_vel_offset[i]
        if square > THREE_SIGMA2 * x.gnss_vel_offset_var[level]:
            x.gnss_vel_offset_var[level] = square


def learn_field(x: State, values: GnssRow) -> None:
    """Learn the magnetic field of the fix's place."""
    if isnan(values.declination):
        return
    if isnan(x.field.declination) and x.mag_t > NEVER and x.mode < MODE_NAVIGATE:
        # a compass gave magnetic north: the next field gives true north, or if none comes soon
        # another estimate, whose heading may be magnetic still
        x.has_yaw = 0.0
        if x.mag_t > x.t - SILENT_COMPASS:
            x.mag_t = x.t - SILENT_COMPASS
        x.alignment.reference.is_known = 0.0
    x.field.declination = values.declination
    x.field.inclination = values.inclination
    x.field.strength = values.strength


def read_fix(x: State, k: Parameters, fix: Fix, values: GnssRow) -> None:
    """Read a fix: its values, one sigma of the white part of each, its stated variances."""
    fix.lat = values.lat
    fix.lon = values.lon
    fix.alt = values.alt
    fix.lag = 0.0
    fix.lag_var = 0.0
    for i in range(3):
        fix.vel_n[i] = values.vel_n[i]
        fix.std[i] = values.std[i]
    if isnan(fix.std[2]):
        fix.std[2] = k.vel_std_default
    for aid in range(3):
        share = white_share(x, k, aid)
        fix.stated_var[aid] = fix.std[aid] * fix.std[aid]
        if aid < 2:
            x.gnss_offset_var[aid] = fix.stated_var[aid] * (1.0 - share) if share < 1.0 else 0.0
        fix.std[aid] *= sqrt(share)
        if aid == AID_VELOCITY:
            slow = k.gnss_vel_slow_std
            slow *= doubt.receiver_share(x) if k.learn_noise != 0.0 else 1.0
            white = sqrt(share * fix.stated_var[aid])
            slow *= white / GOOD_VELOCITY if white > GOOD_VELOCITY else 1.0
            x.gnss_vel_offset_var[0] = slow * slow
            x.gnss_vel_offset_var[1] = slow * slow
        least = k.gnss_floor[aid]
        if aid == AID_VELOCITY and k.learn_noise != 0.0:
            least = least * doubt.receiver_share(x)
        if fix.std[aid] < least:
            fix.std[aid] = least


def bound_offset(x: State, o: Observation, axis: int, level: float) -> None:
    """Bring the variance of a slow error down to its level, where that has been learnt lower.

    As if the error had been measured to be none, just as well as that takes.
    """
    variance = x.P[E_GNSS + axis][E_GNSS + axis]
    if level < LEAST_LEVEL:
        level = LEAST_LEVEL
    if variance <= 1.05 * level:
        return
    clear(o, 1, variance * level / (variance - level))
    o.H[0][E_GNSS + axis] = 1.0
    o.z[0] = -x.gnss_offset[axis]
    innovate(x, o)
    apply_update(x, o)


def fuse(x: State, k: Parameters, w: Scratch, aid: int) -> bool:
    """Fuse the receiver's observation if it passes the gate, and learn how white its error is."""
    o = address(w.observation)
    fix = address(w.fix)
    if k.weighs_faults == WEIGH_ACT:
        shape.take_off(x, o, aid)
        nis = innovate(x, o)
        if aid == AID_VELOCITY:
            nis = yield_to_receiver(x, k, o, nis)
        if nis <= k.gate[o.rows - 1]:
            learn_white_share(x, o, aid, fix.stated_var[aid])
        gate.score(x, o, nis, k.gate[o.rows - 1])
        gate.fuse_judged(x, k, o, aid, nis, False)
        return True
    nis = innovate(x, o)
    hard = k.gate[o.rows - 1]
    is_denied = cython.declare(cython.bint, x.is_force_denied != 0.0)
    if aid == AID_VELOCITY and gate.is_running(x, aid) and is_denied_by_position(x, fix, o):
        is_denied = True
    if aid != AID_VELOCITY and is_dragged(x, o, fix, aid):
        is_denied = True
        if x.refused_t[aid] <= x.used_t[aid]:
            forget_vel_offset(x)
    if aid == AID_VELOCITY or (nis <= hard and not is_denied):
        learn_white_share(x, o, aid, fix.stated_var[aid])
    if aid == AID_VELOCITY:
        doubt.learn_doubt(x, k, fix, o, nis, is_denied)
    gate.score(x, o, hard if is_denied and nis < hard else nis, hard)
    return gate.fuse_judged(x, k, o, aid, nis, is_denied)


def fuse_velocity(x: State, k: Parameters, w: Scratch) -> bool:
    """Fuse the velocity. Return False if its time-out shows that more than velocity is wrong."""
    fix = address(w.fix)
    o = address(w.observation)
    gnss.velocity(x, k, fix, o)
    if fuse(x, k, w, AID_VELOCITY):
        return True
    if doubt.is_receivers_own(x, fix):
        if not gate.is_timed_out(x, AID_POSITION, k.timeout_vel):
            return True
    else:
        doubt.doubt_refusal(x, k, fix, o)
    if not gate.is_timed_out(x, AID_VELOCITY, k.timeout_vel) or is_denied_by_position(x, fix, o):
        return True
    if gate.is_proven(x, AID_VELOCITY, o.rows, fix.stated_var[2], JERK, SHORTEST_RUN):
        gate.begin_reset(x, RESET_VELOCITY)
        reset_velocity(x, k, w)
        return True
    return x.t - x.refused_t[AID_VELOCITY] <= 0.5 * k.timeout_vel * 1e9


def fuse_position(x: State, k: Parameters, w: Scratch) -> None:
    """Fuse the horizontal position, or reset it if refused fixes are consistent."""
    fix = address(w.fix)
    north = x.P[E_VEL][E_VEL]
    east = x.P[E_VEL + 1][E_VEL + 1]
    drift = north if north > east else east
    if not gate.is_timed_out(x, AID_VELOCITY, SAME_CAUSE) and drift > LARGEST_DRIFT:
        # more would be the receiver's position against its own velocity
        drift = LARGEST_DRIFT
    gnss.position(x, k, fix, address(w.observation))
    if fuse(x, k, w, AID_POSITION):
        slide.follow(x, fix, False)
        x.refused_way[0] = 0.0
        x.refused_way[1] = 0.0
        return
    if is_settling(x, AID_POSITION):
        gate.begin_reset(x, RESET_POSITION)
        reset_position(x, k, w)
        return
    if x.refused_t[AID_POSITION] == x.t:
        slide.refuse(x)
    patience = position_patience(x, k, w)
    shortest = 0.5 * patience if 0.5 * patience > SHORTEST_RUN else SHORTEST_RUN
    if not gate.is_refused_for(x, AID_POSITION, patience) or not gate.is_proven(
        x, AID_POSITION, 2, fix.stated_var[0], drift, shortest
    ):
        return
    gate.begin_reset(x, RESET_POSITION)
    reset_position(x, k, w)
    if gate.is_timed_out(x, AID_VELOCITY, k.timeout_pos):
        reset_unknown_velocity(x, 0, 2)
    if gate.has_run_for(x, AID_HEIGHT, SAME_CAUSE):
        reset_height(x, k, w)


def is_settling(x: State, aid: int) -> bool:
    """Return whether a receiver is refused while the vehicle stands on the ground, not armed.

    It is the receiver that moves, as every one does after a cold start, and its newest place is the
    best one. Nothing is flown by ours yet, so that a reset harms nobody.
    """
    return (
        x.at_rest != 0.0 and rest.is_reported_still(x) and gate.is_timed_out(x, aid, SHORTEST_RUN)
    )


def position_patience(x: State, k: Parameters, w: Scratch) -> float:
    """Return how long this position is refused before it may reset ours, s.

    While the velocity is fused, our position can have drifted only slowly: a distance that would
    have taken longer is the receiver's jump.
    """
    is_led = cython.declare(cython.bint, gate.is_shown(x, k, SAME_CAUSE))
    if gate.is_timed_out(x, AID_VELOCITY, SAME_CAUSE) and not is_led:
        return k.timeout_pos
    z = w.observation.z
    north = z[0] - x.refused_way[0]
    east = z[1] - x.refused_way[1]
    off = z[0] * z[0] + z[1] * z[1]
    sigma = x.P[E_POS][E_POS] + x.P[E_POS + 1][E_POS + 1]
    if north * north + east * east < 0.1 * off:
        # it is where the velocity led that was refused: that was right
        return SAME_CAUSE
    if off < FEW_SIGMAS * FEW_SIGMAS * sigma:
        return k.timeout_pos
    needed = sqrt(off) / OWN_DRIFT
    if needed > LONGEST_PATIENCE and not is_led:
        needed = LONGEST_PATIENCE
    return needed if needed > k.timeout_pos else k.timeout_pos


def fuse_height(x: State, k: Parameters, w: Scratch) -> None:
    """Fuse the height, or reset it if refused fixes are consistent."""
    fix = address(w.fix)
    drift = x.P[E_VEL + 2][E_VEL + 2]
    if x.voices.loser == VOICE_HEIGHT and not is_settling(x, AID_HEIGHT):
        gate.count_verdict(x, AID_HEIGHT, VERDICT_SUSPECT)
        gate.clear_run(x, AID_HEIGHT)
        return
    gnss.height(x, k, fix, address(w.observation))
    if fuse(x, k, w, AID_HEIGHT):
        return
    if is_settling(x, AID_HEIGHT):
        gate.begin_reset(x, RESET_HEIGHT)
        reset_height(x, k, w)
        voices.take_height(x)
        x.has_aid[AID_BARO] = 0.0
        return
    if not gate.is_timed_out(x, AID_HEIGHT, k.timeout_height) or not gate.is_proven(
        x, AID_HEIGHT, 1, fix.stated_var[1], drift, SHORTEST_RUN
    ):
        return
    gate.begin_reset(x, RESET_HEIGHT)
    reset_height(x, k, w)
    if isnan(fix.vel_n[2]) or gate.is_timed_out(x, AID_VELOCITY, k.timeout_height):
        reset_unknown_velocity(x, 2, 1)
