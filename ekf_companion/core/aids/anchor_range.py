"""Ranges to anchors, as of ultra-wideband radios: between a tag on the vehicle and known places.

All ranges share a slow error, the delay of the tag's electronics, and those of an anchor another:
its own delay, and how far it is from where it is taken to be among the others. Where all of them
are on the Earth is known no better than they were surveyed: the place of their frame, and its yaw
about where the ranges began, are slow errors too, and so is how late all ranges are. What comes a
detour is too long, for as long as something stands between: so a range counts the less the further
off it is.

Source: Groves 2013, section 9.4; the weight is that of a Cauchy distribution (Huber 1981).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import reset_variance
from cython.cimports.ekf_companion.core.filter.update import innovate
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_ANCHOR_RANGE,
    E_ANCHOR_RANGE,
    E_ATT,
    E_POS,
    E_VEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector, errors
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import cos, isnan, sin, sqrt

from ekf_companion.core.memory.aid import Kept, SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

BIAS_STD = cython.declare(cython.int, 0)
SPREAD_STD = cython.declare(cython.int, 1)
FRAME_STD = cython.declare(cython.int, 2)
FRAME_YAW_STD = cython.declare(cython.int, 3)
DELAY_STD = cython.declare(cython.int, 4)
LEVER_ARM = cython.declare(cython.int, 5)
"""Places of the settings."""
NEAR = cython.declare(cython.double, 0.1)
"""Least distance at which the direction to an anchor is one, m."""

FAR = cython.declare(cython.double, 100.0)
"""Square of how far off a range may be, in its sigmas, for its noise to be taken to be as large as
that: a wall makes it longer by some metres. Beyond, it is the gate's. With 9 the ranges of four
anchors of eight that were 2 m too long led away by as much, with 100 by a fifth of that."""
KNOWN = cython.declare(cython.double, 3.0)
"""One sigma of the horizontal position, m, up to which it is known beside a range: beyond, the
first ones would be believed whatever they say."""
ANCHORS = cython.declare(cython.int, 8)
"""Anchors, from 0 on, that have a slow error of their own."""
E_FRAME = cython.declare(cython.int, E_ANCHOR_RANGE + 9)
E_YAW = cython.declare(cython.int, E_ANCHOR_RANGE + 12)
E_LATE = cython.declare(cython.int, E_ANCHOR_RANGE + 13)


@aid(
    Kind.ANCHOR,
    words="range to an anchor",
    sensor="anchors",
    advice="Measure where the anchors are anew (anchor_range.anchors), raise anchor_range.std, or "
    "anchor_range.use = false.",
    stuck_after=0.1,
    is_tried=True,
    shows_velocity=True,
)
class AnchorRange:
    """The distance between the tag and an anchor."""

    range = Value("m", 0.0, 1e5)
    anchor = Value("1", -1.0, 1e6, is_optional=True)
    north = Value("m; where it is geodetic the latitude, rad", -1e6, 1e6, is_optional=True)
    east = Value("m; where it is geodetic the longitude, rad", -1e6, 1e6, is_optional=True)
    down = Value("m; where it is geodetic the altitude", -1e5, 1e5, is_optional=True)
    is_geodetic = Value("1", -1.0, 2.0, is_optional=True)
    std = Value("m", 0.0, 1e3, is_optional=True)
    bias = SlowError("m", speed_walk=None)
    bias_0 = SlowError("m", speed_walk=None)
    bias_1 = SlowError("m", speed_walk=None)
    bias_2 = SlowError("m", speed_walk=None)
    bias_3 = SlowError("m", speed_walk=None)
    bias_4 = SlowError("m", speed_walk=None)
    bias_5 = SlowError("m", speed_walk=None)
    bias_6 = SlowError("m", speed_walk=None)
    bias_7 = SlowError("m", speed_walk=None)
    frame_north = SlowError("m", walk=None, speed_walk=None)
    frame_east = SlowError("m", walk=None, speed_walk=None)
    frame_down = SlowError("m", walk=None, speed_walk=None)
    frame_yaw = SlowError("rad", walk=None, speed_walk=None)
    delay = SlowError("s", walk=None, speed_walk=None)
    pivot = Kept("m", 2)


def stated(x: State, row: Vector, axis: int) -> float:
    """Return where the anchor is said to be along an axis of n, m."""
    if row[5] != 1.0:
        return row[2 + axis]
    if axis == 0:
        return (row[2] - x.origin.lat) * x.origin.scale_n
    if axis == 1:
        return (row[3] - x.origin.lon) * x.origin.scale_e
    return x.origin.alt - row[4]


def place(x: State, row: Vector, anchor: Vector) -> None:
    """Write where the anchor is in n, m: as is said, in a frame that is off and turned."""
    c = cos(x.anchor_range_frame_yaw)
    n = sin(x.anchor_range_frame_yaw)
    north = stated(x, row, 0) - x.anchor_range_pivot[0]
    east = stated(x, row, 1) - x.anchor_range_pivot[1]
    anchor[0] = x.anchor_range_pivot[0] + x.anchor_range_frame_north + c * north - n * east
    anchor[1] = x.anchor_range_pivot[1] + x.anchor_range_frame_east + n * north + c * east
    anchor[2] = stated(x, row, 2) + x.anchor_range_frame_down


def weigh(x: State, o: Observation) -> None:
    """Take the noise to be as large as its part of the innovation, R / S of it, says."""
    noise = o.R[0][0]
    if isnan(innovate(x, o)):
        return
    off = o.z[0] * noise / (o.L[0][0] * o.L[0][0])
    if off * off < FAR * noise:
        o.R[0][0] += off * off


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Take the slow errors for what is known of such radios, while the position is known."""
    variance = x.P[E_POS][E_POS] + x.P[E_POS + 1][E_POS + 1]
    if x.mode != MODE_NAVIGATE or variance > KNOWN * KNOWN or isnan(row[2] + row[3] + row[4]):
        return False
    s = address(k.aid[AID_ANCHOR_RANGE])
    value = errors(x)
    for e in range(E_ANCHOR_RANGE, E_LATE + 1):
        value[e - E_VEL] = 0.0
    reset_variance(x, E_ANCHOR_RANGE, 1, s.own[BIAS_STD] * s.own[BIAS_STD])
    reset_variance(x, E_ANCHOR_RANGE + 1, ANCHORS, s.own[SPREAD_STD] * s.own[SPREAD_STD])
    reset_variance(x, E_FRAME, 3, s.own[FRAME_STD] * s.own[FRAME_STD])
    reset_variance(x, E_YAW, 1, s.own[FRAME_YAW_STD] * s.own[FRAME_YAW_STD])
    reset_variance(x, E_LATE, 1, s.own[DELAY_STD] * s.own[DELAY_STD])
    for i in range(2):
        x.anchor_range_pivot[i] = x.pos_n[i]
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the distance from the anchor to the tag: one row."""
    if x.mode != MODE_NAVIGATE:
        return False
    s = address(k.aid[AID_ANCHOR_RANGE])
    std = s.std
    if not isnan(row[6]) and row[6] > std:
        std = row[6]
    to_dcm(x.q_nb, o.C_nb)
    square = 0.0
    place(x, row, o.gain)
    for i in range(3):
        o.arm_n[i] = 0.0
        for j in range(3):
            o.arm_n[i] += o.C_nb[i][j] * s.own[LEVER_ARM + j]
        o.y[i] = x.pos_n[i] - x.anchor_range_delay * x.vel_n[i] + o.arm_n[i] - o.gain[i]
        square += o.y[i] * o.y[i]
    far = sqrt(square)
    if not far > NEAR:  # nor where its place is not known
        return False
    clear(o, 1, std * std)
    o.z[0] = row[0] - (far + x.anchor_range_bias)
    which = cython.cast(cython.int, -1 if isnan(row[1]) else row[1])
    if 0 <= which < ANCHORS:
        o.z[0] -= errors(x)[E_ANCHOR_RANGE - E_VEL + 1 + which]
        o.H[0][E_ANCHOR_RANGE + 1 + which] = 1.0
    else:
        o.R[0][0] += s.own[SPREAD_STD] * s.own[SPREAD_STD]
    for i in range(3):
        o.y[i] /= far
        o.H[0][E_POS + i] = o.y[i]
        o.H[0][E_FRAME + i] = -o.y[i]
        o.H[0][E_VEL + i] = -x.anchor_range_delay * o.y[i]
        o.H[0][E_LATE] -= o.y[i] * x.vel_n[i]
    north = o.gain[0] - x.anchor_range_pivot[0] - x.anchor_range_frame_north
    east = o.gain[1] - x.anchor_range_pivot[1] - x.anchor_range_frame_east
    o.H[0][E_YAW] = o.y[0] * east - o.y[1] * north
    o.H[0][E_ATT] = o.arm_n[1] * o.y[2] - o.arm_n[2] * o.y[1]
    o.H[0][E_ATT + 1] = o.arm_n[2] * o.y[0] - o.arm_n[0] * o.y[2]
    o.H[0][E_ATT + 2] = o.arm_n[0] * o.y[1] - o.arm_n[1] * o.y[0]
    o.H[0][E_ANCHOR_RANGE] = 1.0
    weigh(x, o)
    return True
