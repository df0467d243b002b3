"""Pressure altitude: which counts, and when its offset is found anew."""

from __future__ import annotations

from cython import address
from cython.cimports.ekf_companion.core.aids import baro
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    MODE_LEVEL,
    VERDICT_FUSED,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_BARO,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import gate, voices


def fuse_baro(x: State, k: Parameters, w: Scratch, alt: float) -> None:
    """Fuse a pressure altitude; the first one gives the offset, with the height's error."""
    if k.use_baro == 0.0 or x.mode == MODE_LEVEL:
        gate.count_verdict(x, AID_BARO, VERDICT_SUPERSEDED)
        return
    voices.add_baro(x, alt)
    if x.voices.loser == VOICE_BARO:
        # it is heard again from where it will be then
        x.has_baro = 0.0
        gate.count_verdict(x, AID_BARO, VERDICT_SUSPECT)
        return
    if x.has_baro != 0.0:
        baro.observe(x, k, address(w.observation), alt)
        if gate.fuse(x, k, address(w.observation), AID_BARO):
            return
        if not gate.is_timed_out(x, AID_BARO, k.timeout_height):
            return
    baro.begin(x, k, alt)
    x.used_t[AID_BARO] = x.t
    gate.count_verdict(x, AID_BARO, VERDICT_FUSED)
