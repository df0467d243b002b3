"""An aid that declares itself: whether it counts now, and when its slow errors are found anew."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance, carry
from cython.cimports.ekf_companion.core.filter.update import innovate
from cython.cimports.ekf_companion.core.memory.constants import EVEN, FADES, WITHOUT_FIX
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_POSITION,
    AID_VELOCITY,
    AIDS,
    E_POS,
    E_VEL,
    MODE_ATTITUDE,
    MODE_LEVEL,
    SHOWS_ALL,
    SOURCE_ACCEL,
    SOURCE_DRAG,
    SOURCE_GYRO,
    SOURCE_STATE,
    SOURCE_VELOCITY,
    VERDICT_DENIED,
    VERDICT_FUSED,
    VERDICT_GATED,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_BARO,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order import dispatch
from cython.cimports.ekf_companion.core.start.navigation import start_without_fix
from cython.cimports.ekf_companion.core.trust import gate, repair, shape, voices

DOUBTED = cython.declare(cython.double, 30.0)
"""Doubt in the samples beyond which it is an aid's speed that is wrong, not they: with wheels that
turn as they should it was up to 17."""
MEMORY = cython.declare(cython.double, 20.0)
"""Measurements over which the share of the refused ones is formed."""
HALF = cython.declare(cython.double, 0.5)
"""Share beyond which those that pass do so by chance."""
STARTS = cython.declare(cython.double, 2.0)
"""Of what an aid shows: a position to start from."""
WAIT_FOR_FIX = cython.declare(cython.double, 5e9)
"""Time after which navigation starts by an aid, ns: fixes and a heading that are there have begun
it within that."""
ON_TRIAL = cython.declare(cython.double, 2.0)
"""Of ``has_aid``: its readings are judged, and do not count yet."""


def try_out(x: State, k: Parameters, o: Observation, aid: int) -> None:
    """Judge a reading of an aid that has to agree, without fusing it.

    So many in a row make it count that the share of the refused ones would fall below half.
    """
    if innovate(x, o) <= k.gate[o.rows - 1]:
        gate.count_verdict(x, aid, VERDICT_SUPERSEDED)
        x.refusal[aid] -= x.refusal[aid] / MEMORY
        if x.refusal[aid] < HALF:
            x.has_aid[aid] = 1.0
        return
    gate.count_verdict(x, aid, VERDICT_GATED)
    if x.refused_t[aid] <= x.used_t[aid]:
        x.refused_t[aid] = x.t
    x.has_aid[aid] = 0.0


def widen(x: State, k: Parameters, o: Observation, aid: int) -> None:
    """Make velocity and position as uncertain as an aid that has led them proved to be wrong.

    Beside a receiver they are its. Else they owe to what is now contradicted by itself: their
    variances grow by the last normalised innovation squared (the ratio of Birge 1932).
    """
    if not gate.is_timed_out(x, AID_POSITION, WITHOUT_FIX):
        return
    share = x.ratio[aid] * k.gate[o.rows - 1] / o.rows - 1.0
    if share > 0.0:
        for e in range(E_VEL, E_POS + 3):
            add_variance(x, e, share * x.P[e][e])


def fuse_aid(x: State, k: Parameters, w: Scratch, aid: int, row: Vector) -> None:
    """Fuse a measurement; the first one gives the slow errors, with what the estimate lacks."""
    o = address(w.observation)
    if k.aid[aid].use == 0.0 or x.mode == MODE_LEVEL:
        gate.count_verdict(x, aid, VERDICT_SUPERSEDED)
        return
    if aid == AID_BARO and k.weighs_faults == WEIGH_ACT:
        repair.drive(x, address(o.bank[0]), 3, 3)
    elif aid == AID_BARO:
        voices.add_baro(x, row[0])
        if x.voices.loser == VOICE_BARO:
            # it is heard again from where it will be then
            x.has_aid[aid] = 0.0
            gate.count_verdict(x, aid, VERDICT_SUSPECT)
            return
    note_reading(x, aid, row)
    waited = x.t - x.alignment.start_t
    if x.mode == MODE_ATTITUDE and k.aid[aid].shows == STARTS and waited > WAIT_FOR_FIX:
        std = dispatch.place(x, k, aid, row)
        if std > 0.0:
            start_without_fix(x, std)
    if x.has_aid[aid] != 0.0:
        if fuse_parts(x, k, w, aid, row):
            return
        # it has ended what began before, or is refused for long: by a long refusal that the faults
        # are weighed by, no time-out is reached
        if x.has_aid[aid] != 0.0 and (
            k.weighs_faults == WEIGH_ACT or not gate.is_timed_out(x, aid, k.timeout_height)
        ):
            return
    begin(x, k, w, aid, row)


def begin(x: State, k: Parameters, w: Scratch, aid: int, row: Vector) -> None:
    """Find the slow errors of an aid by a measurement, or what is known of such sensors."""
    o = address(w.observation)
    x.refusal[aid] = 0.0
    is_anew = cython.declare(cython.bint, x.has_aid[aid] != 0.0)
    x.has_aid[aid] = 0.0
    if is_stuck(x, k, aid) or is_outvoted(x, k, aid) or not dispatch.begin(x, k, aid, row):
        if not is_anew:  # else it has just been refused
            is_refused = cython.declare(cython.bint, has_yielded(x, k, aid))
            gate.count_verdict(x, aid, VERDICT_GATED if is_refused else VERDICT_SUPERSEDED)
        return
    carry(x, k, aid)
    if k.aid[aid].is_tried != 0.0:
        x.refusal[aid] = 1.0
        if dispatch.observe(x, k, o, aid, row):
            x.has_aid[aid] = ON_TRIAL
            if not is_anew:
                try_out(x, k, o, aid)
        return
    x.has_aid[aid] = 1.0
    x.used_t[aid] = x.t
    gate.count_verdict(x, aid, VERDICT_FUSED)


def fuse_parts(x: State, k: Parameters, w: Scratch, aid: int, row: Vector) -> bool:
    """Fuse what a measurement observes, part by part; return whether that was all it can do.

    The next part counts where the one before was fused.
    """
    o = address(w.observation)
    for part in range(cython.cast(cython.Py_ssize_t, k.aid[aid].parts)):
        o.part = part
        if not dispatch.observe(x, k, o, aid, row):
            if part == 0 and x.has_aid[aid] != 0.0:
                gate.count_verdict(x, aid, VERDICT_SUPERSEDED)
            return x.has_aid[aid] != 0.0
        if part == 0 and (is_stuck(x, k, aid) or is_outvoted(x, k, aid)):
            # one that is tried for long goes on with what it has shown as soon as it counts again
            if not is_stuck(x, k, aid) and k.aid[aid].is_tried == 0.0:
                x.has_aid[aid] = 0.0
            gate.count_verdict(x, aid, VERDICT_DENIED)
            return True
        if k.weighs_faults == WEIGH_ACT:
            shape.take_off(x, o, aid)
        if x.has_aid[aid] == ON_TRIAL:
            try_out(x, k, o, aid)
            return True
        nis = innovate(x, o)
        is_denied = cython.declare(cython.bint, is_persistent(x, k, o, aid, nis))
        is_fused = cython.declare(cython.bint, gate.fuse_judged(x, k, o, aid, nis, is_denied))
        if part == 0:
            x.refusal[aid] += ((0.0 if is_fused else 1.0) - x.refusal[aid]) / MEMORY
        if k.aid[aid].is_tried != 0.0 and x.refusal[aid] > HALF:
            x.has_aid[aid] = 0.0
            widen(x, k, o, aid)
            return True
        if not is_fused:
            return part > 0
    return True


def note_reading(x: State, aid: int, row: Vector) -> None:
    """Note when the reading of an aid has changed last."""
    if row[0] != x.reading[aid]:
        x.reading[aid] = row[0]
        x.changed_t[aid] = x.t


def is_persistent(x: State, k: Parameters, o: Observation, aid: int, nis: float) -> bool:
    """Return whether readings go on being beyond the soft gate: they are no outliers, but wrong.

    A sensor that does not yield to the receiver's velocity is believed again only beside it:
    without one the gate widens until anything fits.
    """
    patience = k.aid[aid].patience
    is_wrong = cython.declare(cython.bint, patience > 0.0 and x.doubtful[aid] > patience)
    is_alone = cython.declare(cython.bint, gate.is_timed_out(x, AID_VELOCITY, WITHOUT_FIX))
    if nis > k.soft_gate[o.rows - 1]:
        x.doubtful[aid] += 1.0
    elif not (is_wrong and is_alone and k.aid[aid].yields == 0.0):
        x.doubtful[aid] = 0.0
    return patience > 0.0 and x.doubtful[aid] > patience


def has_yielded(x: State, k: Parameters, aid: int) -> bool:
    """Return whether an aid has yielded to the receiver just now: what fails does so again."""
    is_left = cython.declare(cython.bint, k.aid[aid].yields != 0.0 and x.has_aid[aid] == 0.0)
    return k.weighs_faults == WEIGH_ACT and is_left and x.t - x.refused_t[aid] < FADES * 1e9


def is_outvoted(x: State, k: Parameters, aid: int) -> bool:
    """Return whether the receiver's velocity, which comes, contradicts an aid's."""
    if k.aid[aid].yields == 0.0 or x.t - x.fix_t > WITHOUT_FIX * 1e9:
        return False
    if has_yielded(x, k, aid):
        return True
    return x.refused_t[AID_VELOCITY] > x.used_t[AID_VELOCITY] or x.doubt > DOUBTED


def yield_to_receiver(x: State, k: Parameters, o: Observation, nis: float) -> float:
    """Leave the aids that yield where the receiver's velocity contradicts what they have led to.

    That is where it, or what ours is integrated from, is more likely wrong than right: such an aid
    has no hypothesis of its own, and what it does looks like theirs. So who was blamed is
    forgotten, and ours is as uncertain as the velocity differs, and that over the time since.

    Returns:
        The NIS of the velocity then.
    """
    b = address(o.bank[0])
    is_led = cython.declare(cython.bint, False)
    for aid in range(AIDS):
        is_led = is_led or (k.aid[aid].yields != 0.0 and x.has_aid[aid] != 0.0)
    if not is_led:
        return nis
    p = 0.0
    best = -1
    for i in range(b.n):
        source = k.fault[b.instance[i].kind].source
        is_motion = cython.declare(
            cython.bint,
            source == SOURCE_VELOCITY
            or source == SOURCE_DRAG
            or source == SOURCE_ACCEL
            or source == SOURCE_GYRO
            or source == SOURCE_STATE,
        )
        if is_motion:
            p += b.instance[i].p
            if best < 0 or b.instance[i].p > b.instance[best].p:
                best = i
    if p <= EVEN:
        return nis
    since = (x.t - b.instance[best].t0) * 1e-9
    for r in range(o.rows):
        add_variance(x, E_VEL + r, o.z[r] * o.z[r])
        add_variance(x, E_POS + r, o.z[r] * o.z[r] * since * since)
    for aid in range(AIDS):
        if k.aid[aid].yields != 0.0 and x.has_aid[aid] != 0.0:
            x.has_aid[aid] = 0.0
            x.refused_t[aid] = x.t
    repair.drop_others(k, b, SHOWS_ALL, -1)
    return innovate(x, o)


def is_stuck(x: State, k: Parameters, aid: int) -> bool:
    """Return whether an aid repeats its reading to the bit for longer than its sensor can."""
    after = k.aid[aid].stuck_after
    return after > 0.0 and x.t - x.changed_t[aid] > after * 1e9
