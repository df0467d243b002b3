"""Repair: what follows from the posterior of the fault hypotheses, and from nothing else.

As long as nothing is beyond doubt, what is shown is the mixture: its mean, and its covariance by
moments. A source that has been beyond doubt for some fixes is declared: the state becomes
``x + U b``, its covariance ``P + U M U'``, as if the fault had been a state since its onset; and
the fault lives on in the slow error of its source, or is taken off the readings.

Source: Friedland 1969; Blackman and Popoli 1999, chapter 6 (moments of a mixture).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.filter.columns import turn
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance, reset_variance
from cython.cimports.ekf_companion.core.filter.update import add_columns, inject
from cython.cimports.ekf_companion.core.memory.bank import FOUND, Bank, Instance
from cython.cimports.ekf_companion.core.memory.constants import (
    FADES,
    NEVER,
    SETTLING,
    THREE_SIGMA2,
    UNKNOWN_ANGLE,
)
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    E_ATT,
    E_BARO,
    E_DELAY,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_IRON,
    FAULT_ACCEL_NOISE,
    FAULT_ALIGNMENT,
    FAULT_BARO_RAMP,
    FAULT_BARO_SCALE,
    FAULT_BARO_SPEED,
    FAULT_BARO_STEP,
    FAULT_BODY_FIELD,
    FAULT_CLIMB_STEP,
    FAULT_DELAY,
    FAULT_FALL,
    FAULT_FALL_RAMP,
    FAULT_FIELD,
    FAULT_HEADING_STEP,
    FAULT_HEIGHT_RAMP,
    FAULT_HEIGHT_STEP,
    FAULT_LEVER,
    FAULT_POSITION_RAMP,
    FAULT_POSITION_STEP,
    FAULT_RECOVERY_HEADING,
    FAULT_SETTLE,
    FAULT_SETTLE_HEIGHT,
    FAULT_STATE_WILD,
    FAULT_VELOCITY_LAG,
    FAULT_VELOCITY_SCALE,
    FAULT_VELOCITY_STEP,
    FAULT_VELOCITY_TURN,
    SHOWS_ALL,
    SOURCE_ACCEL,
    SOURCE_DRAG,
    SOURCE_FALL,
    SOURCE_GYRO,
    SOURCE_HEADING,
    SOURCE_HEIGHT,
    SOURCE_NOISE,
    SOURCE_POSITION,
    SOURCE_SETTLING,
    SOURCE_SETTLING_HEIGHT,
    SOURCE_STATE,
    SOURCE_VELOCITY,
    SOURCES,
    WEIGH_ACT,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import delay_search, gate, lost, score, shape
from cython.cimports.ekf_companion.core.trust.onsets import begin_instance, drop
from cython.cimports.libc.math import atan2, exp, log

SURE = cython.declare(cython.double, 0.99)
"""Probability of a source beyond which it is beyond doubt."""
SUREST = cython.declare(cython.double, 0.9999)
"""The model itself may be wrong so often."""
PATIENCE = cython.declare(cython.double, 3.0)
"""Fixes for which it must be so."""
SHORTEST = cython.declare(cython.double, 0.6e9)
"""And for at least so long, ns: as three fixes of the usual receiver take."""
SAME_FAULT = cython.declare(cython.double, 5e9)
"""Time, ns, after which a fault of the same kind is told as another one."""
SETTLED = cython.declare(cython.double, 2.0)
"""Time constants after which it has: an eighth of the error is left."""
UNEXPLAINED = cython.declare(cython.double, 3.0)
"""Mean NIS a row of the last readings beyond which a fault does not explain them, and waits."""
UNLIKELY = cython.declare(cython.double, 1e-3)
"""Probability below which an instance does not count in what is shown."""


def decide(x: State, k: Parameters, o: Observation) -> None:
    """Declare what has been beyond doubt for long enough."""
    b = address(o.bank[0])
    patience = PATIENCE * 1e9 * x.fix_dt
    patience = patience if patience > SHORTEST else SHORTEST
    for source in range(SOURCES):
        p = 0.0
        best = -1
        for i in range(b.n):
            h = address(b.instance[i])
            if k.fault[h.kind].source == source:
                p += h.p
                if best < 0 or h.p > b.instance[best].p:
                    best = i
        if source == SOURCE_SETTLING or source == SOURCE_SETTLING_HEIGHT:
            p = settled_share(x, b, best)
        if p < SURE or source == SOURCE_NOISE or is_beyond_doubting(x, k, b, source, best):
            b.since[source] = NEVER
            continue
        h = address(b.instance[best])
        if shape.is_wild(h.kind) and h.is_wide != 0.0:
            tell(x, b, h)
            b.since[source] = NEVER
        elif b.since[source] <= NEVER or x.t < b.hold_t:
            b.since[source] = x.t
        elif h.recent > THREE_SIGMA2 or not (is_of_its_size(k, h) or is_own(k, source)):
            b.since[source] = x.t
        elif x.t - b.since[source] >= (patience if h.recent < UNEXPLAINED else 2.0 * patience):
            is_told = cython.declare(
                cython.bint, p - find_rival(k, b, best) >= SURE and not is_learnt(x, h)
            )
            if k.weighs_faults != WEIGH_ACT:
                if is_told:
                    tell(x, b, h)
                continue
            b.since[source] = NEVER
            if is_told and (h.kind == FAULT_STATE_WILD or is_of_its_size(k, h)):
                tell(x, b, h)
            if is_lost(k, h):
                lose(x, k, o)
            elif shape.is_wild(h.kind):
                take_back(x, k, o, best, p)
            else:
                repair(x, k, o, best, p)
            return


def is_learnt(x: State, h: Instance) -> cython.bint:
    """Return whether a delay is off by no more than it is not known by anyway: that is no fault."""
    square = h.b[0] * h.b[0]
    return h.kind == FAULT_DELAY and square <= THREE_SIGMA2 * x.P[E_DELAY][E_DELAY]


def take_back(x: State, k: Parameters, o: Observation, i: int, p: float) -> None:
    """Take back what a source that is wrong in no shape has corrected since its onset.

    That is as uncertain as it was large. It goes on to be as probable, until readings say that they
    are right again; or begins anew, where there is nothing else to go on by.
    """
    b = address(o.bank[0])
    kind = b.instance[i].kind
    onset = b.instance[i].t0
    columns.follow(x, b)
    b.declared[kind] += 1.0
    b.failed_t[k.fault[kind].source] = x.t
    find_effect(x, b, i, 0.0, o.dx)
    add_columns(x, b, i, o.dx, 1.0)
    inject(x, o)
    p = p if p < SUREST else SUREST
    odds = 1.0 if score.is_noisy(x) else p / (1.0 - p)
    go_on(b, i, odds)
    drop_others(k, b, k.fault[kind].shows, -1)
    if score.is_noisy(x):
        return
    h = address(b.instance[begin_instance(x, k, b, kind, 0.0)])
    h.t0 = onset
    h.log_prior = log(odds)
    h.is_wide = 1.0
    h.p = p


def is_heading_found(b: Bank) -> cython.bint:
    """Return whether it was found that the compass, or another heading, is wrong."""
    compass = b.declared[FAULT_FIELD] + b.declared[FAULT_BODY_FIELD]
    return compass + b.declared[FAULT_HEADING_STEP] > 0.0


def is_lost(k: Parameters, h: Instance) -> cython.bint:
    """Return whether our own state is lost by a fault: one of our own, larger than of any kind."""
    is_ours = cython.declare(cython.bint, is_own(k, k.fault[h.kind].source))
    return is_ours and (h.kind == FAULT_STATE_WILD or not is_of_its_size(k, h))


def lose(x: State, k: Parameters, o: Observation) -> None:
    """Go by the fixes alone until they have shown the attitude: our own state is lost.

    So it is by an error of the inertial sensors, or of what was integrated of them, that is larger
    than those of any kind.
    """
    b = address(o.bank[0])
    b.declared[FAULT_STATE_WILD] += 1.0
    b.failed_t[SOURCE_STATE] = x.t
    let_go(x, k, b, o)
    reset_variance(x, E_ATT, 3, UNKNOWN_ANGLE)
    gate.go_by_fixes(x)


def go_on(b: Bank, i: int, odds: float) -> None:
    """Let that our own state is lost go on beside an instance that is declared.

    It has no size that the repair would change. The instance has these odds to nothing from now on.
    """
    shift = log(odds) - b.instance[i].evidence - b.instance[i].log_prior
    for j in range(b.n):
        if b.instance[j].kind == FAULT_STATE_WILD:
            b.instance[j].evidence += shift


def is_own(k: Parameters, source: int) -> cython.bint:
    """Return whether our own state is off by a source, so that nothing is left to go on by."""
    is_ours = cython.declare(
        cython.bint, source == SOURCE_ACCEL or source == SOURCE_GYRO or source == SOURCE_STATE
    )
    return k.weighs_faults == WEIGH_ACT and is_ours


def is_of_its_size(k: Parameters, h: Instance) -> bool:
    """Return whether a fault is as large as those of its kind: three sigma of the larger ones.

    What is larger is of another kind, that no hypothesis has. An end, and a delay, begin where they
    are found.
    """
    if shape.is_end(h.kind) or h.kind == FAULT_DELAY:
        return True
    square = 0.0
    for c in range(h.rows):
        square += h.b[c] * h.b[c]
    std = k.fault[h.kind].tail
    return square <= THREE_SIGMA2 * h.rows * std * std


def is_beyond_doubting(x: State, k: Parameters, b: Bank, source: int, i: int) -> bool:
    """Return whether no other source could ever contradict that a fault was declared.

    So it is of a position that is led away with its velocity, at once or one after the other: the
    estimate would go its way beside both, and nothing would show it.
    """
    if source == SOURCE_POSITION:
        square = x.gnss_vel_offset[0] * x.gnss_vel_offset[0]
        square += x.gnss_vel_offset[1] * x.gnss_vel_offset[1]
        usual = THREE_SIGMA2 * k.gnss_vel_slow_std * k.gnss_vel_slow_std
        return b.instance[i].kind == FAULT_POSITION_RAMP and square > usual
    if shape.is_wild(b.instance[i].kind):
        return False
    if b.instance[i].kind == FAULT_ALIGNMENT:  # the yaw bank resets it, once that knows north
        return True
    if source == SOURCE_VELOCITY:
        return b.drift[0] != 0.0 or b.drift[1] != 0.0
    return source == SOURCE_DRAG


def settled_share(x: State, b: Bank, i: int) -> float:
    """Return how probable it is that a receiver settles in one time, once most of that is over.

    Sooner the times cannot be told apart, and a wrong one would leave what is left of the error.
    """
    if i < 0:
        return 0.0
    h = address(b.instance[i])
    return h.p if (x.t - h.t0) * 1e-9 > SETTLED * h.tau else 0.0


def tell(x: State, b: Bank, h: Instance) -> None:
    """Keep what was found; the same fault, found again, has gone on."""
    last = cython.declare(cython.Py_ssize_t, -1)
    for i in range(b.finds):
        if b.found[i].kind == h.kind and x.t - b.found[i].until < SAME_FAULT:
            last = i
    if last < 0:
        last = b.finds if b.finds < FOUND else FOUND - 1
        b.finds = last + 1
        b.found[last].kind = h.kind
        b.found[last].onset = h.t0
    b.found[last].until = x.t
    b.found[last].evidence = h.evidence
    for c in range(3):
        b.found[last].b[c] = h.b[c] if h.M[c][c] > 0.0 else 0.0
        b.found[last].var[c] = h.M[c][c]


def repair(x: State, k: Parameters, o: Observation, i: int, p: float) -> None:
    """Move the state to where it would be if the fault had been known since its onset."""
    b = address(o.bank[0])
    h = address(b.instance[i])
    kind = h.kind
    shows = k.fault[kind].shows
    columns.follow(x, b)
    b.declared[kind] += 1.0
    carry(x, b, h)
    note_restless(x, b, b.failed_t[k.fault[kind].source])
    if not shape.is_end(kind):
        b.failed_t[k.fault[kind].source] = x.t
    find_effect(x, b, i, 0.0, o.dx)
    other = find_rival(k, b, i)
    if b.rival >= 0 and (other == 0.0 or b.instance[b.rival].b[0] == 0.0):
        b.rival = -1
    if b.rival >= 0:
        condition(b, b.rival, o.dx, other / (p - other))
    spread(x, k, o, i, p - other)
    inject(x, o)
    go_on(b, i, 1.0)
    doubt_it(k, b, i, o, p)
    if kind == FAULT_RECOVERY_HEADING:
        b.heading_off = 0.0
    # of what was held nothing is left that an end could be the opposite of
    drop_others(k, b, shows, -1 if shape.is_end(kind) else i)


def find_rival(k: Parameters, b: Bank, i: int) -> float:
    """Find what a fault of the heading shares its source with: that one begins, or has ended.

    A heading that leaps is wrong from now on, or was so before; which of them motion shows. Note
    the most probable one of the other sort, and return how probable that is.
    """
    b.rival = -1
    total = 0.0
    if k.fault[b.instance[i].kind].source != SOURCE_HEADING:
        return 0.0
    for j in range(b.n):
        h = address(b.instance[j])
        if k.fault[h.kind].source == SOURCE_HEADING and is_other_sort(b, i, j):
            total += h.p
            if b.rival < 0 or h.p > b.instance[b.rival].p:
                b.rival = j
    return total


def is_other_sort(b: Bank, i: int, j: int) -> bool:
    """Return whether just one of two is the end of a heading's fault."""
    is_end = cython.declare(cython.bint, b.instance[i].kind == FAULT_RECOVERY_HEADING)
    return is_end != (b.instance[j].kind == FAULT_RECOVERY_HEADING)


def condition(b: Bank, i: int, dx: Vector, odds: float) -> None:
    """Let an instance go on beside a repair that moves the state by dx, at odds to it.

    Under it the state is off by what it was, less dx: as a share of its mean size.
    """
    h = address(b.instance[i])
    h.evidence = log(odds) - h.log_prior
    for e in range(N):
        b.U[0][e][i] -= dx[e] / h.b[0]
    for c in range(h.rows):
        turn(b, c, i, dx)


def drop_others(k: Parameters, b: Bank, shows: int, kept: int) -> None:
    """Drop what was about another state than the one that is repaired.

    What may fail apart is left, and the noise is what it was.
    """
    b.kept = kept
    j = b.n - 1
    while j >= 0:
        other = k.fault[b.instance[j].kind].shows
        is_apart = cython.declare(
            cython.bint, shows != SHOWS_ALL and other != SHOWS_ALL and other != shows
        )
        is_noise = cython.declare(cython.bint, b.instance[j].kind >= FAULT_ACCEL_NOISE)
        stays = cython.declare(cython.bint, is_noise or b.instance[j].kind == FAULT_STATE_WILD)
        if j != b.kept and j != b.rival and not is_apart and not stays:
            drop(b, j)
        j -= 1
    b.kept = -1
    b.rival = -1
    # what goes on otherwise does so from now on, not from the next second on
    b.begun_t[AID_BARO] = NEVER
    for aid in range(AID_VELOCITY + 1):
        b.begun_t[aid] = NEVER


def spread(x: State, k: Parameters, o: Observation, i: int, p: float) -> None:
    """Add to P what is not known of the fault: its size, and which of its source's it is, and when.

    The state goes by the most probable one; how far the others are from it is uncertainty.
    """
    b = address(o.bank[0])
    source = k.fault[b.instance[i].kind].source
    find_effect(x, b, i, 1.0, o.gain)
    for j in range(b.n):
        h = address(b.instance[j])
        if k.fault[h.kind].source == source and h.p > UNLIKELY and not is_other_sort(b, i, j):
            find_effect(x, b, j, 1.0, b.work)
            for e in range(N):
                b.work[e] -= o.gain[e]
            extend(x, b, j, 1.0)
            open_offset(x, b, j, 1.0)
            add_columns(x, b, j, b.work, h.p / p)
            open_offset(x, b, j, -1.0)
            extend(x, b, j, -1.0)


def find_effect(x: State, b: Bank, i: int, held: float, out: Vector) -> None:
    """Write what a fault of its mean does to each error state, with those that will hold it.

    An offset that is held beside the state counts as such a state where ``held`` is 1.
    """
    h = address(b.instance[i])
    extend(x, b, i, 1.0)
    open_offset(x, b, i, held)
    for e in range(N):
        out[e] = 0.0
        for c in range(h.rows):
            out[e] += b.U[c][e][i] * h.b[c]
    open_offset(x, b, i, -held)
    extend(x, b, i, -1.0)


def doubt_it(k: Parameters, b: Bank, i: int, o: Observation, p: float) -> None:
    """Keep the instance that was declared as its own opposite: that it never was, by what is left.

    Under that the state, and what is taken off the readings, are off by -b from the same onset on.
    """
    h = address(b.instance[i])
    odds = (1.0 - p) / p if p < SUREST else (1.0 - SUREST)
    h.evidence = log(odds) - h.log_prior
    h.p = 1.0 - p
    for c in range(h.rows):
        h.b[c] = -h.b[c]
        turn(b, c, i, o.dx)
    if h.kind == FAULT_DELAY:  # of which the last component is one, whatever it is
        h.b[1] = 1.0
        h.tau = -h.tau
        for e in range(N):
            b.U[1][e][i] = -b.U[1][e][i]
        delay_search.forget(b)


def carry(x: State, b: Bank, h: Instance) -> None:
    """Hold what is off by the fault from now on, or let it go on; or take it off the readings."""
    kind = h.kind
    since = (x.t - h.t0) * 1e-9
    for axis in range(4):
        b.before[axis] = b.drift[axis]
        b.was_held[axis] = b.held[axis]
    if kind == FAULT_POSITION_STEP:
        for c in range(2):
            hold(b, c, h.b[c])
    elif kind == FAULT_POSITION_RAMP:
        for c in range(2):
            hold(b, c, h.b[c] * since)
            drive_on(x, b, c, h.b[c], h.M[c][c])
    elif kind == FAULT_HEIGHT_STEP:
        hold(b, 2, h.b[0])
    elif kind == FAULT_HEIGHT_RAMP or kind == FAULT_FALL:
        hold(b, 2, h.b[0] * since)
        drive_on(x, b, 2, h.b[0], h.M[0][0])
    elif kind == FAULT_FALL_RAMP:
        hold(b, 2, 0.5 * h.b[0] * since * since)
        drive_on(x, b, 2, h.b[0] * since, h.M[0][0] * since * since)
    elif kind == FAULT_BARO_STEP:
        hold(b, 3, h.b[0])
    elif kind == FAULT_BARO_RAMP:
        hold(b, 3, h.b[0] * since)
        drive_on(x, b, 3, h.b[0], h.M[0][0])
    elif kind == FAULT_HEADING_STEP:
        b.heading_off += h.b[0]
        b.heading_off_var = h.M[0][0]
    elif shape.is_end(kind) and kind != FAULT_RECOVERY_HEADING:
        for axis in range(shape.first_axis(kind), shape.last_axis(kind) + 1):
            if shape.is_halt(kind):
                hold(b, axis, -b.drift[axis] * since)
            elif shape.is_fading(kind):
                fade_on(x, b, axis, h)
            else:
                hold(b, axis, -b.held[axis])
    elif is_taken(kind):
        b.taken_t[kind] = h.t0
        b.taken_tau[kind] = h.tau
        b.taken_reference[kind] = h.reference
        for c in range(h.rows):
            b.taken[kind][c] += h.b[c]
            b.taken_var[kind][c] = h.M[c][c]


def note_restless(x: State, b: Bank, failed_t: float) -> None:
    """Note what was added to the offset of a source that had just failed.

    No constant describes it then, and the next fault will not be the last; what only takes back
    another one is none.
    """
    for axis in range(3):
        if failed_t > 0.0 and b.held[axis] * b.held[axis] > b.was_held[axis] * b.was_held[axis]:
            added = b.held[axis] - b.was_held[axis]
            b.restless[axis] += added * added * exp(1e-9 * (failed_t - x.t) / FADES)


def is_taken(kind: int) -> bool:
    """Return whether a fault is taken off the readings: no error state holds it."""
    return (
        kind == FAULT_VELOCITY_SCALE
        or kind == FAULT_VELOCITY_LAG
        or kind == FAULT_VELOCITY_TURN
        or kind == FAULT_BARO_SPEED
        or kind == FAULT_BARO_SCALE
        or kind == FAULT_SETTLE
        or kind == FAULT_SETTLE_HEIGHT
        or kind == FAULT_LEVER
    )


def extend(x: State, b: Bank, i: int, sign: float) -> None:
    """Extend the columns to the error state that holds the fault from now on; -1: take it back."""
    h = address(b.instance[i])
    kind = h.kind
    if kind == FAULT_RECOVERY_HEADING and h.tau != 0.0:  # of what was never held nothing is
        shape.find_end(b, (x.t - h.t0) * 1e-9, b.trial.D)
        for c in range(2):
            b.U[c][E_HEADING][i] += sign * b.trial.D[0][c]
    elif kind == FAULT_VELOCITY_STEP:
        for c in range(2):
            b.U[c][E_GNSS_VEL + c][i] += sign
    elif kind == FAULT_CLIMB_STEP or kind == FAULT_FALL:
        b.U[0][E_GNSS_VEL + 2][i] += sign
    elif kind == FAULT_FALL_RAMP:
        b.U[0][E_GNSS_VEL + 2][i] += sign * (x.t - h.t0) * 1e-9
    elif kind == FAULT_BODY_FIELD:
        for c in range(3):
            b.U[c][E_IRON + c][i] += sign
    elif kind == FAULT_HEADING_STEP:
        b.U[0][E_HEADING][i] += sign
    elif kind == FAULT_FIELD:
        for c in range(2):
            b.U[c][E_HEADING][i] += sign * b.field_slope[c]
    elif kind == FAULT_DELAY:
        b.U[0][E_DELAY][i] += sign


def open_offset(x: State, b: Bank, i: int, sign: float) -> None:
    """Let what is not known of an offset that is held be a part of the slow error of its source."""
    h = address(b.instance[i])
    kind = h.kind
    since = (x.t - h.t0) * 1e-9 * sign
    if kind == FAULT_POSITION_STEP or kind == FAULT_POSITION_RAMP:
        for c in range(2):
            b.U[c][E_GNSS + c][i] += sign if kind == FAULT_POSITION_STEP else since
    elif kind == FAULT_HEIGHT_STEP:
        b.U[0][E_GNSS + 2][i] += sign
    elif kind == FAULT_HEIGHT_RAMP or kind == FAULT_FALL:
        b.U[0][E_GNSS + 2][i] += since
    elif kind == FAULT_FALL_RAMP:
        b.U[0][E_GNSS + 2][i] += 0.5 * since * (x.t - h.t0) * 1e-9
    elif kind == FAULT_BARO_STEP:
        b.U[0][E_BARO][i] += sign
    elif kind == FAULT_BARO_RAMP:
        b.U[0][E_BARO][i] += since


def hold(b: Bank, axis: int, offset: float) -> None:
    """Hold an offset that was found; what jumps has ended to slide."""
    b.held[axis] += offset
    b.drift[axis] = 0.0
    b.fade[axis] = 0.0


def let_go(x: State, k: Parameters, b: Bank, o: Observation) -> None:
    """Hold no offset of a position that is drawn anew beside an attitude that was wrong.

    Whether there ever was that fault nothing shows any more: what was known of it is forgotten with
    the hypotheses, and so is what was only suspected. So the whole of it may be there, or none,
    until such a fault is over.
    """
    for axis in range(3):
        square = suspected_square(x, k, b, o, axis) + b.held[axis] * b.held[axis]
        b.let_go[0 if axis < 2 else 1] += square
        x.gnss_offset_var[0 if axis < 2 else 1] += square
        b.held[axis] = 0.0
        b.drift[axis] = 0.0
        b.fade[axis] = 0.0


def suspected_square(x: State, k: Parameters, b: Bank, o: Observation, axis: int) -> float:
    """Return the mean square of what a receiver is off by on one axis, n e d, beside what is held.

    As the hypotheses have it, m^2.
    """
    square = 0.0
    o.rows = 2 if axis < 2 else 1
    r = axis if axis < 2 else 0
    for i in range(b.n):
        h = address(b.instance[i])
        source = k.fault[h.kind].source
        is_its = cython.declare(cython.bint, source == SOURCE_HEIGHT or source == SOURCE_FALL)
        if axis < 2:
            is_its = source == SOURCE_POSITION or source == SOURCE_DRAG
        if is_its and not shape.is_end(h.kind):
            shape.find_direct(x, b, h, o, AID_POSITION if axis < 2 else AID_HEIGHT)
            off = 0.0
            for c in range(h.rows):
                off += b.trial.D[r][c] * h.b[c]
            square += h.p * off * off
    return square


def drive_on(x: State, b: Bank, axis: int, rate: float, var: float) -> None:
    """Let a slide go on by a rate that was found; one that ends has the same against it."""
    b.drift[axis] = b.before[axis] + rate
    b.drift_var[axis] = var
    if b.drift[axis] * b.drift[axis] < THREE_SIGMA2 * var:
        b.drift[axis] = 0.0
    b.drift_t[axis] = x.t
    b.driven_t[axis] = x.t


def fade_on(x: State, b: Bank, axis: int, h: Instance) -> None:
    """Let what is held fade by a rate that was found, from its onset on."""
    rate = SETTLING * exp(h.b[1])
    left = exp(-rate * (x.t - h.t0) * 1e-9)
    hold(b, axis, -b.held[axis] * (1.0 - left))
    b.fade[axis] = rate
    b.fade_var[axis] = h.M[1][1]
    b.faded_from[axis] = b.held[axis]
    b.driven_t[axis] = x.t


def hold_found(x: State, b: Bank) -> None:
    """Hold what a fix has found of a held offset, as far as no usual slow error can be so large.

    That is a constant and one that passes, known only by their sum; the constant's share of what is
    found is that of its variance.
    """
    for i in range(3):
        level = 0 if i < 2 else 1
        if b.held[i] != 0.0 and x.gnss_offset_var[level] > b.natural[level]:
            share = 1.0 - b.natural[level] / x.gnss_offset_var[level]
            found = share * (x.gnss_offset[i] - b.before[i])
            x.gnss_offset[i] -= found
            b.held[i] += found


def drive(x: State, b: Bank, first: int, last: int) -> None:
    """Move the offsets of declared slides on to now, and let those walk that are restless."""
    if first == 0:
        for level in range(2):
            b.let_go[level] *= exp(-x.fix_dt / FADES)
    for axis in range(first, last + 1):
        if axis < 3 and b.restless[axis] > 0.0:
            kept = exp(-x.fix_dt / FADES)
            if b.held[axis] != 0.0:
                add_variance(x, E_GNSS + axis, b.restless[axis] * (1.0 - kept))
            b.restless[axis] *= kept
        if b.drift[axis] != 0.0:
            dt = (x.t - b.driven_t[axis]) * 1e-9
            before = (b.driven_t[axis] - b.drift_t[axis]) * 1e-9
            now = (x.t - b.drift_t[axis]) * 1e-9
            var = b.drift_var[axis] * (now * now - before * before)
            b.driven_t[axis] = x.t
            b.held[axis] += b.drift[axis] * dt
            add_variance(x, E_GNSS + axis if axis < 3 else E_BARO, var)
        elif b.fade[axis] != 0.0:
            before = b.faded_from[axis] - b.held[axis]
            b.held[axis] *= exp(-b.fade[axis] * (x.t - b.driven_t[axis]) * 1e-9)
            now = b.faded_from[axis] - b.held[axis]
            b.driven_t[axis] = x.t
            if now * now > before * before:
                add_variance(x, E_GNSS + axis, b.fade_var[axis] * (now * now - before * before))


def mix(x: State, k: Parameters, b: Bank) -> None:
    """Write what the mixture adds to attitude, velocity and position, mean and covariance.

    What no other source can ever contradict, what is over within a minute, and what is larger than
    it can be, widens and does not move: a position and velocity that are led away, a receiver that
    settles.
    """
    for i in range(9):
        b.mean[i] = 0.0
        for g in range(3):
            b.means[g][i] = 0.0
        for j in range(9):
            b.spread[i][j] = 0.0
    if b.nothing > 1.0 - UNLIKELY:
        return
    for n in range(b.n):
        h = address(b.instance[n])
        if h.p < UNLIKELY:
            continue
        if is_lost(k, h):
            lost.widen(b, h.p)
            continue
        for i in range(9):
            b.work[i] = 0.0
        for c in range(h.rows):
            columns.look_ahead(b, n, c, b.ahead[c])
            for i in range(9):
                b.work[i] += b.ahead[c][i] * h.b[c]
        if h.kind == FAULT_ALIGNMENT:
            b.work[2] += atan2(h.b[1], 1.0 + h.b[0]) - h.b[1]
        source = k.fault[h.kind].source
        moves = cython.declare(
            cython.bint,
            (
                source != SOURCE_DRAG
                and source < SOURCE_SETTLING
                and h.kind != FAULT_ALIGNMENT
                and is_of_its_size(k, h)
            )
            or shape.is_wild(h.kind),
        )
        for i in range(9):
            if moves:
                b.means[k.fault[h.kind].shows][i] += h.p * b.work[i]
            for j in range(9):
                s = b.work[i] * b.work[j]
                for c in range(h.rows):
                    for d in range(h.rows):
                        s += b.ahead[c][i] * h.M[c][d] * b.ahead[d][j]
                b.spread[i][j] += h.p * s
    # a level and a vertical fault may be there at once, and are independent
    for g in range(3):
        for i in range(9):
            b.mean[i] += b.means[g][i]
            for j in range(9):
                b.spread[i][j] -= b.means[g][i] * b.means[g][j]
