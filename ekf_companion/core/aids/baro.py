"""Barometer: its height less the estimated one is an offset that walks."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.slow_error import copy_error
from cython.cimports.ekf_companion.core.memory.enums import AID_BARO, E_BARO, E_POS
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State

from ekf_companion.core.memory.aid import SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

GROUND_EFFECT = cython.declare(cython.double, 2.0)
"""Noise that rotors near the ground add to the barometer, m."""
GROUND_EFFECT_HEIGHT = cython.declare(cython.double, 3.0)
"""Height above the last rest up to which they do, m."""


@aid(
    Kind.BARO,
    words="pressure height",
    sensor="barometer",
    advice="Raise baro.std, cover the barometer with foam, or baro.use = false.",
)
class Baro:
    """The altitude of the standard atmosphere, less the estimated one."""

    alt = Value("m", -5_000.0, 11_000.0)  # nav.earth.TROPOSPHERE
    offset = SlowError("m")


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Find the offset by the estimated height, whose error it has from then on."""
    x.baro_offset = row[0] - (x.origin.alt - x.pos_n[2])
    copy_error(x, E_BARO, E_POS + 2, k.aid[AID_BARO].std * k.aid[AID_BARO].std)
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the altitude of the standard atmosphere, which has a slow offset: one row."""
    std = k.aid[AID_BARO].std
    if x.armed == 1.0 and x.has_ground != 0.0 and x.ground - x.pos_n[2] < GROUND_EFFECT_HEIGHT:
        std = std + GROUND_EFFECT
    clear(o, 1, std * std)
    o.z[0] = row[0] - (x.origin.alt - x.pos_n[2] + x.baro_offset)
    o.H[0][E_POS + 2] = -1.0
    o.H[0][E_BARO] = 1.0
    return True
