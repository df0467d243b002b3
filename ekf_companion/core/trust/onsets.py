"""Onsets: which faults may have begun when, kept in an exponential histogram.

An onset is tried at each reading that may be the first to show the fault. There are three instances
of a kind for each power of two of onsets; the two oldest of a full level become one of the next:
the older stays, unless the younger explains more once it has paid for what it leaves open.

Source: detection over all onsets, Willsky and Jones 1976; the histogram, Datar et al. 2002.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.memory.bank import COMPONENTS, INSTANCES, Bank, Instance
from cython.cimports.ekf_companion.core.memory.constants import NEVER, THREE_SIGMA2, WITHOUT_FIX
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEADING,
    AID_HEIGHT,
    AID_POSITION,
    AID_RANGE_FINDER,
    AID_REST,
    AID_VELOCITY,
    AIDS,
    AZIMUTH_MAGNETIC,
    E_ATT,
    FAULT_ACCEL_LOUD,
    FAULT_ACCEL_NOISE,
    FAULT_ACCEL_STEP,
    FAULT_ALIGNMENT,
    FAULT_BARO_STEP,
    FAULT_BARO_WILD,
    FAULT_BODY_FIELD,
    FAULT_DELAY,
    FAULT_DRAG_RAMP,
    FAULT_FALL_RAMP,
    FAULT_FALL_WILD,
    FAULT_FIELD,
    FAULT_GYRO_LOUD,
    FAULT_GYRO_NOISE,
    FAULT_HEADING_STEP,
    FAULT_LED,
    FAULT_LED_ON,
    FAULT_POSITION_STEP,
    FAULT_RECOVERY_HEADING,
    FAULT_SETTLE,
    FAULT_SETTLE_HEIGHT,
    FAULT_STATE_WILD,
    SOURCE_NOISE,
    SOURCE_STATE,
    N,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import delay_search, loud, score, shape
from cython.cimports.libc.math import exp, log

KEPT = cython.declare(cython.int, 3)
"""Onsets of a level that are told apart: with two the one that explains most soon is gone before it
does."""
LEAST = cython.declare(cython.double, 1e-300)
"""Prior of what is no fault, and has no rate."""
LEAST_VAR = cython.declare(cython.double, 1e-20)
"""Variance below any size that is known: rounding leaves none, which has no logarithm."""
EXCLUDED = cython.declare(cython.double, -6.0)
"""Evidence below which a fault has not begun then: its size is known to be none."""
SETTLED = cython.declare(cython.double, 1e10)
"""Age before which none is excluded, ns."""
OLDEST = cython.declare(cython.double, 2e11)
"""Age beyond which an instance that says nothing goes, ns."""
FASTEST = cython.declare(cython.double, 2e10)
"""Age at which a receiver has ceased to be led away ever faster, ns: at 1 m/s2 by 20 m/s then."""
OFTEN = cython.declare(cython.double, 0.95e9)
"""Time between two onsets of those that are tried once a second, ns: stamps jitter. The inertial
noise is learnt over as long: over ten seconds a slow wave is none."""
SHORTEST_SETTLING = cython.declare(cython.double, 5.0)
"""Shortest time constant with which a receiver settles, s."""
LONGER = cython.declare(cython.double, 3.5)
"""How much longer each of the others is: 5, 17, 61 s."""
EVER = cython.declare(cython.double, 0.004)
"""Odds that a heading is off from the first one on."""
ANY_ANGLE = cython.declare(cython.double, 0.001)
"""Odds that it is off by any angle, and our yaw with it."""
FROM_FIRST = cython.declare(cython.int, 1000)
"""Level of that instance, beyond any: it is told apart from all onsets, and goes when it is
excluded. Not below zero, which would be no number in a checkpoint."""
ALIGNED = cython.declare(cython.int, 1001)
"""The same of our own yaw."""


def begin_instances(x: State, k: Parameters, b: Bank, o: Observation, aid: int) -> None:
    """Begin an instance of each kind that this reading may be the first to show.

    What shows in a fix begins with its first row; what another aid alone would show, with that. Of
    a receiver or a compass none begins before the start is proven: it may be our own.
    """
    if b.proven_t <= NEVER:
        b.proven_t = x.proven_t
    if aid == AID_BARO:
        begin_kinds(x, k, b, aid, FAULT_BARO_STEP, FAULT_BARO_WILD)
    elif aid == AID_HEADING:
        if x.azimuth != b.azimuth:
            b.azimuth = x.azimuth
            b.heading_off = 0.0
        if x.t < b.proven_t:
            return
        first = FAULT_FIELD if x.azimuth >= AZIMUTH_MAGNETIC else FAULT_HEADING_STEP
        last = FAULT_BODY_FIELD if x.azimuth >= AZIMUTH_MAGNETIC else FAULT_HEADING_STEP
        if b.begun_t[aid] <= NEVER:
            for kind in range(first, last + 1):
                begin_heading(x, k, b, o, kind)
            begin_heading(x, k, b, o, FAULT_ALIGNMENT)
        begin_kinds(x, k, b, aid, first, last)
        if last == FAULT_HEADING_STEP:
            begin_heading_end(x, k, b)
    elif aid <= AID_VELOCITY and b.fix_t != x.fix_t:
        b.fix_t = x.fix_t
        loud.walk(k, b, x.fix_dt)
        if not x.t - b.window_t < OFTEN:
            score.end_window(x, k, b)
            begin_loud(x, k, b, FAULT_ACCEL_LOUD)
            begin_loud(x, k, b, FAULT_GYRO_LOUD)
            begin_instance(x, k, b, FAULT_ACCEL_NOISE, 0.0)
            begin_instance(x, k, b, FAULT_GYRO_NOISE, 0.0)
        if b.has_begun == 0.0:
            b.has_begun = 1.0
            begin_settling(x, k, b)
        begin_kinds(x, k, b, AID_HEIGHT, FAULT_ACCEL_STEP, FAULT_STATE_WILD)
        if x.t < b.proven_t:
            return
        if x.fix_dt > WITHOUT_FIX and was_led(x):
            for kind in range(FAULT_LED, FAULT_LED_ON + 1):
                forget_kind(b, kind)
                begin_instance(x, k, b, kind, x.fix_dt)
        begin_kinds(x, k, b, AID_POSITION, FAULT_POSITION_STEP, FAULT_FALL_RAMP)
        if delay_search.best(b) != 0.0 and x.t - b.begun_t[AID_VELOCITY] < OFTEN:
            begin_instance(x, k, b, FAULT_DELAY, x.fix_dt)
        begin_kinds(x, k, b, AID_VELOCITY, FAULT_DELAY, FAULT_FALL_WILD)


def begin_loud(x: State, k: Parameters, b: Bank, kind: int) -> None:
    """Begin a window of a noise that may have leapt in this one, or in one before.

    Its onset is where that explains most (Page 1954).
    """
    evidence = 0.0
    for i in range(b.n):
        if b.instance[i].kind == kind and b.instance[i].evidence > 0.0:
            evidence = b.instance[i].evidence
            loud.write_until_now(b, i)
    loud.go_on(b, address(b.instance[begin_instance(x, k, b, kind, 0.0)]), evidence)


def was_led(x: State) -> bool:
    """Return whether an aid has led the position since the fix before.

    A range finder does not; inertial samples alone have hypotheses of their own.
    """
    for aid in range(AID_REST + 1, AIDS):
        if aid != AID_RANGE_FINDER and x.has_aid[aid] != 0.0:
            if x.t - x.used_t[aid] < x.fix_dt * 1e9:
                return True
    return False


def begin_kinds(x: State, k: Parameters, b: Bank, clock: int, first: int, last: int) -> None:
    """Begin an instance of each of some kinds, of those that are rarer once in a while."""
    is_due = cython.declare(cython.bint, x.t - b.begun_t[clock] >= OFTEN)
    if is_due:
        b.begun_t[clock] = x.t
    for kind in range(first, last + 1):
        if (is_due or k.fault[kind].every == 0.0) and shape.can_begin(x, b, kind):
            begin_instance(x, k, b, kind, x.fix_dt if clock == AID_POSITION else 0.1)


def begin_instance(x: State, k: Parameters, b: Bank, kind: int, dt: float) -> int:
    """Begin one of a kind, and return its place.

    What its onset stands for is the time since the onset before.
    """
    if k.fault[kind].source == SOURCE_NOISE:
        forget_kind(b, kind)
    fold(x, b, kind)
    if b.n == INSTANCES:
        drop_least(k, b)
    i = make_room(b, k.fault[kind].rows)
    h = address(b.instance[i])
    h.kind = kind
    h.rows = k.fault[kind].rows
    h.reference = x.pos_n[2]
    h.level = 0
    h.t0 = x.t
    span = (k.fault[kind].every if k.fault[kind].every > 0.0 else dt) / 3600.0
    h.log_prior = log(k.fault[kind].rate * span + LEAST)
    h.evidence = 0.0
    h.earlier = 0.0
    h.p = 0.0
    h.is_wide = 0.0
    h.recent = 0.0
    h.readings = 0.0
    for c in range(COMPONENTS):
        h.b[c] = 0.0
        for j in range(COMPONENTS):
            h.M[c][j] = 0.0
        h.M[c][c] = k.fault[kind].std * k.fault[kind].std
    for c in range(h.rows):
        for e in range(N):
            b.U[c][e][i] = 0.0
        for r in range(3):
            b.T[c][r][i] = 0.0
    shape.begin(x, k, b, i)
    return i


def make_room(b: Bank, rows: int) -> int:
    """Return a place for one of so many components: a first one of fewer moves to their end."""
    i = b.n
    if rows > 1:
        move(b, b.pairs, i)
        i = b.pairs
        if rows > 2:
            move(b, b.triples, i)
            i = b.triples
            if rows > 3:
                move(b, b.fours, i)
                i = b.fours
                b.fours += 1
            b.triples += 1
        b.pairs += 1
    b.n += 1
    return i


def move(b: Bank, source: int, to: int) -> None:
    """Move an instance to another place."""
    if source == to:
        return
    b.instance[to] = b.instance[source]
    if b.kept == source:
        b.kept = to
    if b.rival == source:
        b.rival = to
    for c in range(b.instance[to].rows):
        for e in range(N):
            b.U[c][e][to] = b.U[c][e][source]
        for r in range(3):
            b.T[c][r][to] = b.T[c][r][source]


def begin_heading(x: State, k: Parameters, b: Bank, o: Observation, kind: int) -> None:
    """Begin what may be ever since: that a heading is off, by which our yaw was found."""
    i = begin_instance(x, k, b, kind, 0.0)
    h = address(b.instance[i])
    if kind == FAULT_HEADING_STEP:
        h.level = FROM_FIRST
    elif kind == FAULT_ALIGNMENT:
        h.level = ALIGNED
    h.log_prior = log(ANY_ANGLE if kind == FAULT_ALIGNMENT else EVER)
    shape.find_direct(x, b, h, o, AID_HEADING)
    for c in range(h.rows):
        b.U[c][E_ATT + 2][i] = -b.trial.D[0][c]
    shape.find_copies(x, b, i)


def begin_heading_end(x: State, k: Parameters, b: Bank) -> None:
    """Begin that a heading is right: one that was off from the first on, or a declared one.

    The first has led our yaw, and goes on from all that is known of it. The second comes back to
    within its slow error, as far as that is less than what is held. What has gone by itself, down
    to that error, is held no more.
    """
    left = x.heading_offset if b.heading_off > 0.0 else -x.heading_offset
    if left < x.heading_std:
        b.heading_off = 0.0
    var = x.heading_std * x.heading_std + b.heading_off_var
    is_held = cython.declare(cython.bint, b.heading_off * b.heading_off > THREE_SIGMA2 * var)
    if not is_held and from_first(b) < 0:
        return
    i = begin_instance(x, k, b, FAULT_RECOVERY_HEADING, 0.1)
    of = from_first(b)
    h = address(b.instance[i])
    h.tau = 1.0 if of < 0 else 0.0
    if of < 0:
        h.b[0] = -b.heading_off
        h.M[0][0] = var
        return
    first = address(b.instance[of])
    h.log_prior += first.log_prior
    h.evidence = first.evidence
    h.is_wide = first.is_wide
    h.b[0] = first.b[0]
    h.M[0][0] = first.M[0][0]
    h.M[1][1] = 0.0
    for e in range(N):
        b.U[0][e][i] = b.U[0][e][of]


def from_first(b: Bank) -> int:
    """Return the place of the instance that a heading is off from the first one on; -1: none."""
    for i in range(b.n):
        if b.instance[i].level == FROM_FIRST:
            return i
    return -1


def begin_settling(x: State, k: Parameters, b: Bank) -> None:
    """Begin what may be since the first fix: that the receiver settles, in one of some times.

    Each has a level of its own: they are no onsets of one fault, and do not become one.
    """
    tau = SHORTEST_SETTLING
    for time in range(3):
        for kind in range(FAULT_SETTLE, FAULT_SETTLE_HEIGHT + 1):
            i = begin_instance(x, k, b, kind, 0.0)
            shape.find_copies(x, b, i)
            h = address(b.instance[i])
            h.level = 1 + time
            h.tau = tau
            h.t0 = x.t - x.fix_dt * 1e9
        tau *= LONGER


def fold(x: State, b: Bank, kind: int) -> None:
    """Make room for one more onset of a kind: of a full level the two oldest become one.

    Those of which nothing has been seen in all the time are not told apart at all.
    """
    level = 0
    while True:
        count = 0
        first = -1
        second = -1
        for i in range(b.n):
            h = address(b.instance[i])
            if h.kind == kind and h.level == level:
                count += 1
                if first < 0 or h.t0 < b.instance[first].t0:
                    second = first
                    first = i
                elif second < 0 or h.t0 < b.instance[second].t0:
                    second = i
        # of the first level one is to come; of the others it has
        is_full = cython.declare(cython.bint, count >= (KEPT if level == 0 else KEPT + 1))
        if count < 2 or not (is_full or (is_quiet(x, b, first) and is_quiet(x, b, second))):
            return
        stays = first
        goes = second
        if is_better(address(b.instance[second]), address(b.instance[first])):
            stays = second
            goes = first
        h = address(b.instance[stays])
        of = address(b.instance[goes])
        h.log_prior += log(1.0 + exp(of.log_prior + of.evidence - h.log_prior - h.evidence))
        level += 1
        h.level = level
        drop(b, goes)


def is_quiet(x: State, b: Bank, i: int) -> bool:
    """Return whether nothing speaks for an onset of long ago."""
    return x.t - b.instance[i].t0 > SETTLED and b.instance[i].evidence < 0.0


def is_better(younger: Instance, older: Instance) -> bool:
    """Return whether the younger of two explains more, once it knows as much of its size.

    As long as it knows less it has not paid for what it leaves open: half the logarithm of the
    ratio of the determinants, as in Occam's factor of an evidence.
    """
    owed = 0.5 * (log_determinant(younger) - log_determinant(older))
    return younger.evidence - (owed if owed > 0.0 else 0.0) > older.evidence


def log_determinant(h: Instance) -> float:
    """Return the logarithm of the determinant of M, of three components at most."""
    a = h.M[0][0]
    det = a if a > LEAST_VAR else LEAST_VAR
    total = log(det)
    if h.rows > 1:
        f = h.M[1][0] / det
        s = h.M[1][1] - f * h.M[0][1]
        s = s if s > LEAST_VAR else LEAST_VAR
        total += log(s)
        if h.rows > 2:
            g = h.M[2][0] / det
            cross = h.M[2][1] - g * h.M[0][1]
            last = h.M[2][2] - g * h.M[0][2] - cross * cross / s
            total += log(last if last > LEAST_VAR else LEAST_VAR)
    return total


def drop(b: Bank, i: int) -> None:
    """Drop an instance; the last one of as many components takes its place, and so on."""
    rows = b.instance[i].rows
    if rows > 3:
        b.fours -= 1
        move(b, b.fours, i)
        i = b.fours
    if rows > 2:
        b.triples -= 1
        move(b, b.triples, i)
        i = b.triples
    if rows > 1:
        b.pairs -= 1
        move(b, b.pairs, i)
        i = b.pairs
    b.n -= 1
    move(b, b.n, i)


def forget_kind(b: Bank, kind: int) -> None:
    """Drop all instances of a kind."""
    i = b.n - 1
    while i >= 0:
        if b.instance[i].kind == kind:
            drop(b, i)
        i -= 1


def drop_least(k: Parameters, b: Bank) -> None:
    """Drop the least probable instance of a fault."""
    least = -1
    for i in range(b.n):
        h = address(b.instance[i])
        is_fault = cython.declare(cython.bint, k.fault[h.kind].source != SOURCE_NOISE)
        if is_fault and (least < 0 or h.p < b.instance[least].p):
            least = i
    drop(b, least)


def thin(x: State, k: Parameters, b: Bank) -> None:
    """Drop what cannot have begun then, what is old and says nothing, and what is gone again."""
    i = b.n - 1
    while i >= 0:
        h = address(b.instance[i])
        age = x.t - h.t0
        is_over = cython.declare(
            cython.bint, age > FASTEST and (h.kind == FAULT_DRAG_RAMP or h.kind == FAULT_FALL_RAMP)
        )
        is_absorbed = cython.declare(
            cython.bint,
            age > SETTLED and k.fault[h.kind].source == SOURCE_STATE and shape.is_absorbed(x, b, i),
        )
        if (
            is_over
            or is_absorbed
            or (age > SETTLED and h.evidence < EXCLUDED)
            or (age > OLDEST and h.evidence < 0.0 and h.level < FROM_FIRST)
        ):
            drop(b, i)
        i -= 1
