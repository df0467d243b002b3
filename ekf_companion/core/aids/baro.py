"""Barometer: its height less the estimated one is an offset that walks."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import observe
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    E_BARO,
    E_POS,
    MODE_LEVEL,
    VERDICT_FUSED,
    VERDICT_SUPERSEDED,
    VERDICT_SUSPECT,
    VOICE_BARO,
    N,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import gate, voices

GROUND_EFFECT = cython.declare(cython.double, 2.0)
"""Noise that rotors near the ground add to the barometer, m."""
GROUND_EFFECT_HEIGHT = cython.declare(cython.double, 3.0)
"""Height above the last rest up to which they do, m."""


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
        std = k.baro_std
        if x.armed == 1.0 and x.has_ground != 0.0 and x.ground - x.pos_n[2] < GROUND_EFFECT_HEIGHT:
            std = std + GROUND_EFFECT
        observe.pressure_altitude(x, address(w.observation), alt, std)
        if gate.fuse(x, k, address(w.observation), AID_BARO):
            return
        if not gate.is_timed_out(x, AID_BARO, k.timeout_height):
            return
    x.baro_offset = alt - (x.origin.alt - x.pos_n[2])
    for j in range(N):
        x.P[E_BARO][j] = x.P[E_POS + 2][j]
        x.P[j][E_BARO] = x.P[E_POS + 2][j]
    x.P[E_BARO][E_BARO] = x.P[E_POS + 2][E_POS + 2] + k.baro_std * k.baro_std
    x.redrawn[E_BARO] += 1.0
    x.has_baro = 1.0
    x.used_t[AID_BARO] = x.t
    gate.count_verdict(x, AID_BARO, VERDICT_FUSED)
