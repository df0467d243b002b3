"""Range finder: the distance to the ground along the body's down axis.

The ground's height is a slow error: it changes as the vehicle moves over it, and takes in a scale
that is wrong. Before there is a position nothing shows that a steady turn is
none of level flight: by the tilt of then no range can be judged.
"""

from __future__ import annotations

from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.slow_error import copy_error
from cython.cimports.ekf_companion.core.memory.constants import UPRIGHT
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_RANGE_FINDER,
    E_ATT,
    E_POS,
    E_RANGE_FINDER,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import isnan

from ekf_companion.core.memory.aid import SlowError, Value, aid
from ekf_companion.nav.measurements import Kind


@aid(
    Kind.RANGE,
    words="range to the ground",
    sensor="range finder",
    advice="Look at what it points at, raise range_finder.std, or range_finder.use = false.",
)
class RangeFinder:
    """The distance to the ground along the body's down axis."""

    range = Value("m", 0.0, 1e4)
    std = Value("m", 0.0, 1e3, is_optional=True)
    ground = SlowError("m")


def upright(x: State) -> float:
    """Return the cosine of the tilt."""
    return 1.0 - 2.0 * (x.q_nb[1] * x.q_nb[1] + x.q_nb[2] * x.q_nb[2])


def variance(x: State, k: Parameters, row: Vector, c: float) -> float:
    """Return the variance of a range, m^2: white noise, and what the tilt's own error makes of it.

    That is noise, as of a slope of the ground: a range corrects no attitude, which a wrong scale
    would turn over.
    """
    std = k.aid[AID_RANGE_FINDER].std
    if not isnan(row[1]) and row[1] > std:
        std = row[1]
    by_tilt = row[0] * row[0] * (1.0 - c * c) / (c * c)
    return std * std + by_tilt * (x.P[E_ATT][E_ATT] + x.P[E_ATT + 1][E_ATT + 1])


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Find the ground below the estimated height, whose error it has from then on."""
    c = upright(x)
    if c < UPRIGHT or x.mode != MODE_NAVIGATE:
        return False
    x.range_finder_ground = x.pos_n[2] + row[0] * c
    copy_error(x, E_RANGE_FINDER, E_POS + 2, variance(x, k, row, c) * c * c)
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the way to the ground along the body's down axis: one row; not while it is tilted."""
    c = upright(x)
    if c < UPRIGHT or x.mode != MODE_NAVIGATE:
        return False
    clear(o, 1, variance(x, k, row, c))
    o.z[0] = row[0] - (x.range_finder_ground - x.pos_n[2]) / c
    o.H[0][E_POS + 2] = -1.0 / c
    o.H[0][E_RANGE_FINDER] = 1.0 / c
    return True
