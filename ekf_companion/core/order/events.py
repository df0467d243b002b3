"""Events: their order, and the bounds of their values."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.enums import (
    FLAG_DERIVED,
    KIND_GNSS,
    KIND_HEADING,
    KIND_IMU,
    KIND_MAG,
    KIND_VEHICLE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Numbers, Structs
from cython.cimports.ekf_companion.core.memory.scratch import VALUES, Event
from cython.cimports.ekf_companion.core.order import dispatch
from cython.cimports.libc.math import fabs, isfinite, isnan

from ekf_companion.nav.measurements import NULL_ISLAND

LARGEST_RATE = cython.declare(cython.double, 200.0)
"""rad/s; no gyro of a vehicle reaches it."""
LARGEST_FORCE = cython.declare(cython.double, 2000.0)
"""m/s^2."""


def compare(row: Event, t: float, kind: int, values: Numbers) -> int:
    """Return -1, 0, 1 as a row is before, the same as, or after an event: by time, kind, values."""
    if row.t != t:
        return -1 if row.t < t else 1
    if row.kind != kind:
        return -1 if row.kind < kind else 1
    for j in range(VALUES):
        a = row.values.all[j]
        b = values[j]
        if isnan(a) or isnan(b):
            if isnan(a) and isnan(b):
                continue
            return -1 if isnan(a) else 1
        if a != b:
            return -1 if a < b else 1
    return 0


def is_late(values: Numbers) -> bool:
    """Return whether it is known of an inertial sample that it is late: ``ImuRow.is_late``."""
    return values[10] != 0.0


def last_sample(rows: Structs, size: int, t: float) -> int:
    """Return the last inertial one of some rows in order of time that is not later; -1: none."""
    i = size - 1
    while i >= 0 and (rows[i].kind != KIND_IMU or rows[i].t > t):
        i -= 1
    return i


def next_sample(rows: Structs, size: int, i: int) -> int:
    """Return the first inertial row after the i-th; ``size``: none."""
    i += 1
    while i < size and rows[i].kind != KIND_IMU:
        i += 1
    return i


def is_sane(kind: int, values: Numbers) -> bool:
    """Return whether a sensor can say this: finite where it must be, and within all bounds."""
    if kind == KIND_IMU:
        for j in range(3):
            if not isfinite(values[j]) or fabs(values[j]) > LARGEST_RATE:
                return False
            if not isfinite(values[3 + j]) or fabs(values[3 + j]) > LARGEST_FORCE:
                return False
        return values[6] >= 0.0 and values[7] >= 0.0 and 0.0 <= values[8] < 7.0 and values[9] >= 0.0
    if kind == KIND_GNSS:
        for j in range(3, 9):
            if not (isfinite(values[j]) or isnan(values[j])) or fabs(values[j]) > 1e5:
                return False
        if isnan(values[3]) != isnan(values[4]) or isnan(values[6]) or isnan(values[7]):
            return False
        if not (values[6] > 0.0 and values[7] > 0.0) or values[8] <= 0.0:
            return False
        if not (isnan(values[9]) or fabs(values[9]) <= 3.2) or not 0.0 <= values[10] < 256.0:
            return False
        if not (isnan(values[11]) or fabs(values[11]) <= 1.6):
            return False
        if not (isnan(values[12]) or 0.0 <= values[12] < 10.0):
            return False
        if is_nowhere(values[0], values[1], cython.cast(cython.int, values[10])):
            return False
        return fabs(values[0]) < 1.57 and fabs(values[1]) < 3.15 and fabs(values[2]) < 1e5
    if kind == KIND_HEADING:
        return fabs(values[0]) < 7.0 and 0.0 < values[1] < 10.0 and values[2] in (0.0, 1.0, 2.0)
    if kind == KIND_MAG:
        return (
            fabs(values[0]) < 10.0
            and fabs(values[1]) < 10.0
            and fabs(values[2]) < 10.0
            and values[0] * values[0] + values[1] * values[1] + values[2] * values[2] > 1e-6
            and 0.0 <= values[3] < 16.0
        )
    if kind == KIND_VEHICLE:
        return not isnan(values[0]) and fabs(values[3]) <= 1.0 and 0.0 <= values[4] <= 4.0
    return dispatch.is_possible(kind, values)


def is_nowhere(lat: float, lon: float, flags: int) -> bool:
    """Return whether a place (rad) is what stands for none: 0, 0, or a derived one near it."""
    if flags & FLAG_DERIVED:
        return fabs(lat) < NULL_ISLAND and fabs(lon) < NULL_ISLAND
    return lat == 0.0 and lon == 0.0
