"""Heading: which source is used, and how it corrects yaw.

The magnetic field of a vehicle is that of the Earth, turned, and its own: three hard-iron states
in the body tell the two apart as soon as the vehicle turns. Its strength and its dip are only
judged by: they say whether this is the Earth's field at all.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm, wrap
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_HEADING,
    E_IRON,
)
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import Reference, State
from cython.cimports.libc.math import atan2, cos, fabs, sin, sqrt

STEEPEST_DIP = cython.declare(cython.double, 1.5)
"""Dip beyond which the horizontal field of the model is as uncertain as it is small, rad."""


def azimuth(x: State, o: Observation, r: Reference) -> bool:
    """Observe that a direction of the body points to an azimuth: one row.

    The forward axis gives a heading; the magnetic field less the vehicle's own gives a compass,
    levelled by the filter's own tilt. Its slow error is a state; ``r.std`` is the white rest, and
    ``r.noise`` that of the direction itself, which counts the more the steeper it is. Return False
    if the direction is too near the vertical.
    """
    clear(o, 1, 0.0)
    to_dcm(x.q_nb, o.C_nb)
    bx = r.direction_b[0]
    by = r.direction_b[1]
    bz = r.direction_b[2]
    if r.has_iron != 0.0:
        bx = bx - x.hard_iron[0]
        by = by - x.hard_iron[1]
        bz = bz - x.hard_iron[2]
    n = o.C_nb[0][0] * bx + o.C_nb[0][1] * by + o.C_nb[0][2] * bz
    e = o.C_nb[1][0] * bx + o.C_nb[1][1] * by + o.C_nb[1][2] * bz
    d = o.C_nb[2][0] * bx + o.C_nb[2][1] * by + o.C_nb[2][2] * bz
    h2 = n * n + e * e
    if h2 <= 0.01 * (h2 + d * d):
        return False
    o.z[0] = wrap(r.azimuth - atan2(e, n) - x.heading_offset)

    # The slopes of the field that should be, not of the one that its noise has made: yaw, tilt and
    # hard iron are each known far worse than their sum, and a slope that shakes tears them apart
    h = sqrt(h2)
    if r.has_iron != 0.0 and x.field.strength > 0.0 and fabs(x.field.inclination) < STEEPEST_DIP:
        h = x.field.strength * cos(x.field.inclination)
        d = x.field.strength * sin(x.field.inclination)
    n = cos(r.azimuth - x.heading_offset)
    e = sin(r.azimuth - x.heading_offset)
    o.H[0][E_ATT] = -n * d / h
    o.H[0][E_ATT + 1] = -e * d / h
    o.H[0][E_ATT + 2] = 1.0
    o.H[0][E_HEADING] = 1.0
    if r.has_iron != 0.0:
        for i in range(3):
            o.H[0][E_IRON + i] = (e * o.C_nb[0][i] - n * o.C_nb[1][i]) / h
    o.R[0][0] = r.std * r.std + r.noise * r.noise / (h * h)
    return True
