"""An aid that declares itself: whether it counts now, and when its slow errors are found anew."""

from __future__ import annotations

from cython import address
from cython.cimports.ekf_companion.core.filter.slow_error import carry
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    MODE_LEVEL,
    VERDICT_FUSED,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_BARO,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order import dispatch
from cython.cimports.ekf_companion.core.trust import gate, repair, shape, voices


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
    if x.has_aid[aid] != 0.0:
        if not dispatch.observe(x, k, o, aid, row):
            gate.count_verdict(x, aid, VERDICT_SUPERSEDED)
            return
        if k.weighs_faults == WEIGH_ACT:
            shape.take_off(x, o, aid)
        if gate.fuse(x, k, o, aid):
            return
        # where faults are weighed a long refusal is judged by them, and ends by no time-out
        if k.weighs_faults == WEIGH_ACT or not gate.is_timed_out(x, aid, k.timeout_height):
            return
    carry(x, k, aid)
    if not dispatch.begin(x, k, aid, row):
        gate.count_verdict(x, aid, VERDICT_SUPERSEDED)
        return
    x.has_aid[aid] = 1.0
    x.used_t[aid] = x.t
    gate.count_verdict(x, aid, VERDICT_FUSED)
