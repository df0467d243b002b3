# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The satellite receiver: start with its fixes, correct by them, or make them prove themselves.

A receiver states metres and differs from fix to fix by centimetres: most of its error is slow. So
the stated variance is shared between white noise and three Gauss-Markov states, in a share that is
learnt from the innovations. The position that is estimated is that without the slow error.
"""

from __future__ import annotations

import cython

if cython.compiled:
    from cython.cimports.ekf_companion.core import (
        align,
        correct,
        gate,
        observe,
        proof,
        propagate,
        yaw_bank,
        yaw_reset,
    )
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import isnan, sqrt
else:
    from math import isnan, sqrt

    from ekf_companion.core import (
        align,
        correct,
        gate,
        observe,
        proof,
        propagate,
        yaw_bank,
        yaw_reset,
    )
    from ekf_companion.core import state as at

NEVER = cython.declare(cython.double, -1e18)
PREFERRED_AGE = cython.declare(cython.double, 5e9)
"""How long a receiver keeps the autopilot's own position out after its last word, ns."""
WHITE_MEMORY = cython.declare(cython.double, 100.0)
"""Fixes over which a receiver's white noise is learnt."""
FIRST_MEMORY = cython.declare(cython.double, 10.0)
"""What is assumed at first weighs as so many fixes."""
LEAST_SHARE = cython.declare(cython.double, 0.01)
"""A receiver overstates its white error ten times at the most: what is learnt beyond is luck."""
LARGEST_SHARE = cython.declare(cython.double, 9.0)
"""And it may understate it three times."""
UNKNOWN_HEADING = cython.declare(cython.double, 3.29)
"""Variance of an angle of which nothing is known: pi^2 / 3, rad^2."""
LEAST_DOUBT = cython.declare(cython.double, 2.5e-3)
"""Variance of a heading found in motion, beside what the bank says, rad^2: in a steady turn a bias
of the accelerometer is taken for a part of the turn."""
SMALLEST_LEVEL = cython.declare(cython.double, 1e-6)
"""m^2."""
PATIENCE = cython.declare(cython.double, 3e9)
"""Where no heading comes to find the attitude with, it is left to the filter after so long, ns."""
ANY = cython.declare(cython.double, 1e6)
"""Variance of what is not known at all, m^2."""
LEAN_TIME = cython.declare(cython.double, 3.0)
"""Time over which fixes that lean to one side show, s."""
LEAN_CLIP = cython.declare(cython.double, 4.0)
"""What one wild fix may count, sigmas."""
LARGEST_LEAN = cython.declare(cython.double, 1.5)
"""Mean of the innovations, sigmas, beyond which the receiver is refused;"""
LEAN_SIGMAS = cython.declare(cython.double, 5.5)
"""and at least so many of its own."""
DRAGGED = cython.declare(cython.double, 1e29)
REPEATS = cython.declare(cython.double, 2.0)
"""So many times the same position, and a receiver that moves is frozen."""
JERK = cython.declare(cython.double, 0.25)
"""Variance of our own acceleration while its velocity is refused, m^2/s^4."""
DERIVED = cython.declare(cython.int, 1)
SUSPECT = cython.declare(cython.int, 2)
SAME_CAUSE = cython.declare(cython.double, 2.0)
"""A height refused for so long when the position is begun anew is begun anew with it, s."""


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_fix(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
) -> cython.bint:
    """Take a GNSS fix. False: it was refused for so long that the filter must start over."""
    t: cython.double = x[at.X_T]
    has_vel: cython.bint = k[at.K_USE_VEL] != 0.0 and not isnan(rows[r, at.ROW_V + 3])

    # Which source, and can it be believed
    if not is_used(x, k, cython.cast(cython.int, rows[r, at.ROW_V + 10])):
        return True
    if is_frozen(x, rows, r):
        gate.count(x, at.AID_POS, at.WHY_SUSPECT)
        return True
    learn_place(x, rows, r)
    read(x, k, w, rows, r)
    if x[at.X_T_FIX] > NEVER and t > x[at.X_T_FIX]:
        x[at.X_FIX_DT] = (t - x[at.X_T_FIX]) * 1e-9
    x[at.X_T_FIX] = t

    # The bank hears every velocity; where nothing else knows north, it begins
    if has_vel:
        yaw_bank.correct(x, k, w, w[at.W_FIX + 3], w[at.W_FIX + 4], sqrt(w[at.W_FIX + 11]))
    if x[at.X_MODE] < at.MODE_NAVIGATE and x[at.X_HAS_YAW] == 0.0 and yaw_reset.is_ready(x):
        follow(x, k, w)
        return True

    # Before navigation a fix helps to level, or begins it
    if x[at.X_MODE] == at.MODE_LEVEL:
        if has_vel and align.level_in_motion(
            x, k, w, t, w[at.W_FIX + 3], w[at.W_FIX + 4], w[at.W_FIX + 5], w[at.W_FIX + 8]
        ):
            navigate(x, k, w, has_vel)
        else:
            gate.count(x, at.AID_POS, at.WHY_UNALIGNED)
        return True
    if x[at.X_MODE] == at.MODE_ATTITUDE:
        if x[at.X_HAS_YAW] != 0.0:
            navigate(x, k, w, has_vel)
        else:
            gate.count(x, at.AID_POS, at.WHY_UNALIGNED)
        return True
    if x[at.X_NEEDS_RESET] != 0.0:
        resume(x, k, w, has_vel)
        return True

    # What is slow of their error is no larger than what has been learnt
    bound(x, w, at.E_SLOW, x[at.X_SLOW_POS])
    bound(x, w, at.E_SLOW + 1, x[at.X_SLOW_POS])
    bound(x, w, at.E_SLOW + 2, x[at.X_SLOW_HGT])

    # Velocity first: it is the surer of the two; it also says whether the heading is wrong
    if has_vel:
        if not take_velocity(x, k, w):
            return False
        if yaw_reset.is_needed(x, nis_of(x, k, w), x[at.X_FIX_DT], sqrt(w[at.W_FIX + 11])):
            gate.announce(x, at.RESET_MOTION)
            follow(x, k, w)
            yaw_reset.record(x)
            return True
    take_position(x, k, w)
    take_height(x, k, w)
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def nis_of(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.double:
    """Give the normalised innovation squared of the velocity just judged, per degree."""
    m: cython.Py_ssize_t = 2 if isnan(w[at.W_FIX + 5]) else 3
    return x[at.X_RATIO + at.AID_VEL] * k[at.K_GATE + m - 1] / m


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def follow(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Begin, or begin anew, at a fix with the attitude that explains the motion."""
    i: cython.Py_ssize_t
    yaw: cython.double = x[at.X_BANK + at.B_STD]
    delay: cython.double = x[at.X_DELAY]
    x[at.X_DELTA + 6] += yaw_reset.excess(x)
    yaw_reset.adopt(x)
    if x[at.X_MODE] == at.MODE_LEVEL:
        x[at.X_DELAY] = delay
    else:
        # learnt by a wrong attitude
        for i in range(3):
            x[at.X_BA + i] = 0.0
            x[at.X_IRON + i] = 0.0
    for i in range(3):
        # the bank has its own
        x[at.X_COV + (at.E_BG + i) * (at.N + 1)] = 0.0
    x[at.X_LEVEL + at.L_HAS_REF] = 0.0
    align.begin_filter(x, k, w, x[at.X_T], x[at.X_BANK + at.B_TILT], x[at.X_BANK + at.B_BG_STD])
    x[at.X_HAS_YAW] = 1.0
    x[at.X_T_USED + at.AID_YAW] = x[at.X_T]
    correct.forget(x, at.E_ATT + 2, 1, yaw * yaw + LEAST_DOUBT)
    # what a compass has said until now counts for nothing: its error is to be found
    correct.forget(x, at.E_HEADING, 1, UNKNOWN_HEADING)
    navigate(x, k, w, True)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_used(x: cython.double[::1], k: cython.double[::1], flags: cython.int) -> cython.bint:
    """Say whether a fix is to be used: the receiver's own, unless it says that it is fooled."""
    if flags & DERIVED:
        if k[at.K_USE_DERIVED] == 0.0 or (
            k[at.K_USE_DERIVED] == 1.0 and x[at.X_T] - x[at.X_T_RAW_FIX] < PREFERRED_AGE
        ):
            gate.count(x, at.AID_POS, at.WHY_UNUSED)
            return False
    else:
        x[at.X_T_RAW_FIX] = x[at.X_T]
        if k[at.K_USE_DERIVED] == 2.0:
            gate.count(x, at.AID_POS, at.WHY_UNUSED)
            return False
    if flags & SUSPECT:
        gate.count(x, at.AID_POS, at.WHY_SUSPECT)
        return False
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_frozen(
    x: cython.double[::1], rows: cython.double[:, ::1], r: cython.Py_ssize_t
) -> cython.bint:
    """Say whether the receiver repeats itself to the bit while we move."""
    i: cython.Py_ssize_t
    is_same: cython.bint = True
    speed: cython.double = 0.0
    sigma: cython.double = 0.0
    for i in range(3):
        if x[at.X_LAST_FIX + i] != rows[r, at.ROW_V + i]:
            is_same = False
        x[at.X_LAST_FIX + i] = rows[r, at.ROW_V + i]
        speed += x[at.X_VEL + i] * x[at.X_VEL + i]
        sigma += x[at.X_COV + (at.E_VEL + i) * (at.N + 1)]
    x[at.X_REPEATS] = x[at.X_REPEATS] + 1.0 if is_same else 0.0
    return (
        x[at.X_MODE] == at.MODE_NAVIGATE
        and x[at.X_REPEATS] >= REPEATS
        and speed > 1.0 + 9.0 * sigma
    )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learn_place(
    x: cython.double[::1], rows: cython.double[:, ::1], r: cython.Py_ssize_t
) -> cython.void:
    """Learn the magnetic field of the fix's place."""
    if isnan(rows[r, at.ROW_V + 9]):
        return
    if isnan(x[at.X_DECLINATION]) and x[at.X_T_MAG] > NEVER and x[at.X_MODE] < at.MODE_NAVIGATE:
        # a compass gave magnetic north: take true north from whoever is next
        x[at.X_HAS_YAW] = 0.0
        x[at.X_T_MAG] = NEVER
        x[at.X_LEVEL + at.L_HAS_REF] = 0.0
    x[at.X_DECLINATION] = rows[r, at.ROW_V + 9]
    x[at.X_INCLINATION] = rows[r, at.ROW_V + 11]
    x[at.X_FIELD] = rows[r, at.ROW_V + 12]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def read(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    rows: cython.double[:, ::1],
    r: cython.Py_ssize_t,
) -> cython.void:
    """Write the fix to w[W_FIX]: values, sigmas of the white part, stated variances, by aid."""
    i: cython.Py_ssize_t
    share: cython.double
    slow: cython.double
    floor: cython.double
    for i in range(6):
        w[at.W_FIX + i] = rows[r, at.ROW_V + i]
    for i in range(3):
        w[at.W_FIX + 6 + i] = rows[r, at.ROW_V + 6 + i]
    if isnan(w[at.W_FIX + 8]):
        w[at.W_FIX + 8] = k[at.K_VEL_DEFAULT]
    for i in range(3):
        share = white_share(x, k, i)
        w[at.W_FIX + 9 + i] = w[at.W_FIX + 6 + i] * w[at.W_FIX + 6 + i]
        slow = w[at.W_FIX + 9 + i] * (1.0 - share) if share < 1.0 else 0.0
        if i == at.AID_POS:
            x[at.X_SLOW_POS] = slow
        elif i == at.AID_HGT:
            x[at.X_SLOW_HGT] = slow
        w[at.W_FIX + 6 + i] *= sqrt(share)
        floor = k[at.K_POS_FLOOR + i]
        if w[at.W_FIX + 6 + i] < floor:
            w[at.W_FIX + 6 + i] = floor


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def bound(
    x: cython.double[::1], w: cython.double[::1], e: cython.Py_ssize_t, level: cython.double
) -> cython.void:
    """Bring the variance of the slow error e down to its level, where that has been learnt lower.

    As if the error had been measured to be none, just as well as that takes.
    """
    variance: cython.double = x[at.X_COV + e * (at.N + 1)]
    if level < SMALLEST_LEVEL:
        level = SMALLEST_LEVEL
    if variance <= 1.05 * level:
        return
    observe.blank(w, 1, variance * level / (variance - level))
    w[at.W_H + e] = 1.0
    w[at.W_Z] = -x[at.X_SLOW + e - at.E_SLOW]
    correct.innovate(x, w, 1)
    correct.absorb(x, w, 1)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def white_share(
    x: cython.double[::1], k: cython.double[::1], aid: cython.Py_ssize_t
) -> cython.double:
    """Give the share of a stated variance that is white: the user's, or what was learnt."""
    if aid != at.AID_VEL and not isnan(k[at.K_WHITE_SHARE]):
        return k[at.K_WHITE_SHARE]
    return x[at.X_WHITE + aid] if x[at.X_WHITE + aid] > LEAST_SHARE else LEAST_SHARE


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def fuse(
    x: cython.double[::1],
    k: cython.double[::1],
    w: cython.double[::1],
    aid: cython.Py_ssize_t,
    m: cython.Py_ssize_t,
) -> cython.bint:
    """Absorb the receiver's rows if they pass the gate, and learn how white its error is."""
    nis: cython.double = correct.innovate(x, w, m)
    if aid != at.AID_VEL and is_dragged(x, w, m, aid):
        nis = DRAGGED
    if nis <= k[at.K_GATE + m - 1] or aid == at.AID_VEL:
        learn_white(x, w, aid, m)
    gate.score(x, w, m, nis, k[at.K_GATE + m - 1])
    return gate.weigh(x, k, w, aid, m, nis)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def learn_white(
    x: cython.double[::1], w: cython.double[::1], aid: cython.Py_ssize_t, m: cython.Py_ssize_t
) -> cython.void:
    """Learn what share of the stated variance is white, from rows that have been judged.

    What the innovations have beyond the filter's own doubt is white. Where that doubt is large
    they tell little of it, and weigh less.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    seen: cython.double = 0.0
    own: cython.double = 0.0
    noise: cython.double = 0.0
    weight: cython.double
    memory: cython.double = FIRST_MEMORY + x[at.X_NIS_N + aid]
    for i in range(m):
        seen += w[at.W_Z + i] * w[at.W_Z + i]
        noise += w[at.W_R + 4 * i]
        for j in range(at.N):
            own += w[at.W_H + i * at.N + j] * w[at.W_C + i * at.N + j]
    seen = (seen - own) / (m * w[at.W_FIX + 9 + aid])
    seen = seen if seen < LARGEST_SHARE else LARGEST_SHARE
    seen = seen if seen > -LARGEST_SHARE else -LARGEST_SHARE
    weight = noise / (noise + own)
    if memory > WHITE_MEMORY:
        memory = WHITE_MEMORY
    x[at.X_WHITE + aid] += weight * weight * (seen - x[at.X_WHITE + aid]) / memory


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_dragged(
    x: cython.double[::1], w: cython.double[::1], m: cython.Py_ssize_t, aid: cython.Py_ssize_t
) -> cython.bint:
    """Say whether the fixes lean to one side, each by too little for its gate.

    The mean of the whitened innovations over some seconds is near zero unless fixes and motion
    disagree; a receiver that is dragged off shows so long before any single fix does.
    """
    i: cython.Py_ssize_t
    lean: cython.Py_ssize_t = at.X_LEAN if aid == at.AID_POS else at.X_LEAN + 2
    gain: cython.double = x[at.X_FIX_DT] / (x[at.X_FIX_DT] + LEAN_TIME)
    size: cython.double = 0.0
    y: cython.double
    largest: cython.double = LEAN_SIGMAS * sqrt(gain / (2.0 - gain))
    if largest < LARGEST_LEAN:
        largest = LARGEST_LEAN
    for i in range(m):
        y = w[at.W_Y + i]
        y = y if y < LEAN_CLIP else LEAN_CLIP
        y = y if y > -LEAN_CLIP else -LEAN_CLIP
        x[lean + i] += gain * (y - x[lean + i])
        size += x[lean + i] * x[lean + i]
    return size > largest * largest


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_velocity(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]
) -> cython.bint:
    """Correct by the velocity; False: it went on being refused, so more than velocity is wrong."""
    m: cython.Py_ssize_t = observe.velocity(x, k, w)
    if fuse(x, k, w, at.AID_VEL, m) or not gate.is_timed_out(x, at.AID_VEL, k[at.K_TIMEOUT_VEL]):
        return True
    if proof.is_given(x, at.AID_VEL, m, w[at.W_FIX + 11], JERK):
        gate.announce(x, at.RESET_VELOCITY)
        launch(x, k, w)
        return True
    return x[at.X_T] - x[at.X_T_REFUSED + at.AID_VEL] <= 0.5 * k[at.K_TIMEOUT_VEL] * 1e9


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_position(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]
) -> cython.void:
    """Correct the horizontal position, or begin it anew where the fixes have proved themselves."""
    vel: cython.Py_ssize_t = at.X_COV + at.E_VEL * (at.N + 1)
    drift: cython.double = x[vel] if x[vel] > x[vel + at.N + 1] else x[vel + at.N + 1]
    observe.position(x, k, w)
    if (
        fuse(x, k, w, at.AID_POS, 2)
        or not gate.is_timed_out(x, at.AID_POS, k[at.K_TIMEOUT_POS])
        or not proof.is_given(x, at.AID_POS, 2, w[at.W_FIX + 9], drift)
    ):
        return
    gate.announce(x, at.RESET_POSITION)
    place(x, k, w)
    if gate.is_timed_out(x, at.AID_VEL, k[at.K_TIMEOUT_POS]):
        halt(x, at.E_VEL, 2)
    if gate.is_timed_out(x, at.AID_HGT, SAME_CAUSE):
        lift(x, k, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def take_height(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Correct the height, or begin it anew where the fixes have proved themselves."""
    drift: cython.double = x[at.X_COV + (at.E_VEL + 2) * (at.N + 1)]
    observe.height(x, k, w)
    if (
        fuse(x, k, w, at.AID_HGT, 1)
        or not gate.is_timed_out(x, at.AID_HGT, k[at.K_TIMEOUT_HGT])
        or not proof.is_given(x, at.AID_HGT, 1, w[at.W_FIX + 10], drift)
    ):
        return
    gate.announce(x, at.RESET_HEIGHT)
    lift(x, k, w)
    if isnan(w[at.W_FIX + 5]) or gate.is_timed_out(x, at.AID_VEL, k[at.K_TIMEOUT_HGT]):
        halt(x, at.E_VEL + 2, 1)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def navigate(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], has_vel: cython.bint
) -> cython.void:
    """Begin to navigate at a fix; the first one ever is the origin of the local frame."""
    i: cython.Py_ssize_t
    if x[at.X_HAS_ORIGIN] == 0.0:
        propagate.originate(x, w[at.W_FIX], w[at.W_FIX + 1], w[at.W_FIX + 2])
    x[at.X_MODE] = at.MODE_NAVIGATE
    x[at.X_HAS_BARO] = 0.0
    for i in range(3):
        x[at.X_VEL + i] = 0.0
    correct.forget(x, at.E_VEL, 3, 0.04 if x[at.X_AT_REST] != 0.0 else 100.0)
    restart(x, k, w, has_vel)
    x[at.X_T_USED + at.AID_VEL] = x[at.X_T]
    x[at.X_T_USED + at.AID_BARO] = x[at.X_T]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def resume(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], has_vel: cython.bint
) -> cython.void:
    """Go by the fixes alone after a long gap, until they have shown the attitude.

    Nobody saw the vehicle turn: by an attitude that may be half a radian and more off no fix can
    be judged, and what a linear filter learns from it is wrong and claims to be right.
    """
    if x[at.X_NEEDS_RESET] == at.NEEDS_FIX:
        x[at.X_NEEDS_RESET] = at.NEEDS_TILT
        gate.announce(x, at.RESET_GAP)
    if (
        not has_vel
        or align.level_again(
            x, k, w, x[at.X_T], w[at.W_FIX + 3], w[at.W_FIX + 4], w[at.W_FIX + 5], w[at.W_FIX + 8]
        )
        or x[at.X_T] - x[at.X_LEVEL + at.L_FIX_T] > PATIENCE
    ):
        x[at.X_NEEDS_RESET] = 0.0
        x[at.X_LEVEL + at.L_HAS_FIX] = 0.0
    restart(x, k, w, has_vel)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def restart(
    x: cython.double[::1], k: cython.double[::1], w: cython.double[::1], has_vel: cython.bint
) -> cython.void:
    """Begin velocity, position and height from a fix."""
    if has_vel:
        launch(x, k, w)
        gate.count(x, at.AID_VEL, at.WHY_FUSED)
    place(x, k, w)
    lift(x, k, w)
    gate.count(x, at.AID_POS, at.WHY_FUSED)
    gate.count(x, at.AID_HGT, at.WHY_FUSED)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def place(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the horizontal position from a fix, which has its slow error."""
    i: cython.Py_ssize_t
    for i in range(2):
        x[at.X_SLOW + i] = 0.0
    correct.forget(x, at.E_SLOW, 2, x[at.X_SLOW_POS])
    correct.forget(x, at.E_POS, 2, ANY)
    observe.position(x, k, w)
    for i in range(2):
        x[at.X_POS + i] += w[at.W_Z + i]
        x[at.X_DELTA + i] += w[at.W_Z + i]
        w[at.W_Z + i] = 0.0
    correct.innovate(x, w, 2)
    correct.absorb(x, w, 2)
    x[at.X_LEAN] = 0.0
    x[at.X_LEAN + 1] = 0.0
    gate.settle(x, at.AID_POS)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def lift(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the height from a fix, which has its slow error."""
    x[at.X_SLOW + 2] = 0.0
    correct.forget(x, at.E_SLOW + 2, 1, x[at.X_SLOW_HGT])
    correct.forget(x, at.E_POS + 2, 1, ANY)
    observe.height(x, k, w)
    x[at.X_POS + 2] += w[at.W_Z]
    x[at.X_DELTA + 2] += w[at.W_Z]
    w[at.W_Z] = 0.0
    correct.innovate(x, w, 1)
    correct.absorb(x, w, 1)
    x[at.X_LEAN + 2] = 0.0
    gate.settle(x, at.AID_HGT)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def launch(x: cython.double[::1], k: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Set the velocity from a fix; an unknown vertical one is none, give or take 2 m/s."""
    i: cython.Py_ssize_t
    m: cython.Py_ssize_t
    correct.forget(x, at.E_VEL, 3, ANY)
    m = observe.velocity(x, k, w)
    for i in range(m):
        x[at.X_VEL + i] += w[at.W_Z + i]
        x[at.X_DELTA + 3 + i] += w[at.W_Z + i]
        w[at.W_Z + i] = 0.0
    correct.innovate(x, w, m)
    correct.absorb(x, w, m)
    if m == 2:
        x[at.X_DELTA + 5] -= x[at.X_VEL + 2]
        x[at.X_VEL + 2] = 0.0
        correct.forget(x, at.E_VEL + 2, 1, 0.04 if x[at.X_AT_REST] != 0.0 else 4.0)
    gate.settle(x, at.AID_VEL)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def halt(x: cython.double[::1], first: cython.Py_ssize_t, size: cython.Py_ssize_t) -> cython.void:
    """Begin a velocity anew that carried the position astray: none, give or take 5 m/s."""
    i: cython.Py_ssize_t
    for i in range(first, first + size):
        x[at.X_DELTA + i] -= x[at.X_VEL + i - at.E_VEL]
        x[at.X_VEL + i - at.E_VEL] = 0.0
    correct.forget(x, first, size, 25.0)
