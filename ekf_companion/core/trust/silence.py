"""Axes of the inertial sensor that do not measure: at the end of their range, or stuck.

A sensor's noise makes its readings differ: a run of equal ones that is too long for chance means
that the axis no longer measures. How likely two are equal is counted for each axis; beside coarse
digits of a vehicle at rest it is what the other axes show in the same run. What such an axis would
have read is not known: as much as the vehicle moves.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.constants import EVEN, NAN
from cython.cimports.ekf_companion.core.memory.scratch import ImuRow
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import fabs, log

CLIPPED_RATE_VAR = cython.declare(cython.double, 0.05)
"""Variance that a gyro at the end of its range adds about its axis, rad^2/s."""
CLIPPED_FORCE_VAR = cython.declare(cython.double, 2.0)
"""Likewise of an accelerometer, m^2/s^3."""
LEAST_RANGE = cython.declare(cython.double, 0.5)
"""rad/s; no gyro has a smaller range."""
LEAST_FORCE_RANGE = cython.declare(cython.double, 11.5)
"""m/s^2."""
SAME = cython.declare(cython.double, 1e-4)
"""Relative difference of two readings at the end of a range."""
CHANCE = cython.declare(cython.double, -27.6)
"""Logarithm of the probability below which a run is not chance, as in ``nav.repetition``: 1e-12."""
KNOWN = cython.declare(cython.double, 2048.0)
"""Pairs of readings after which the counts of equal ones are halved, likewise."""
MOTION = cython.declare(cython.double, 1.0)
"""Variance by the second of a motion that no reading shows, of its square, s: twice the time over
which rate and force are correlated (``interval.MOTION_TIME``, 0.4 s, measured), rounded up: all of
the motion that is felt may be about that axis."""


def find_unmeasured(x: State, imu: ImuRow) -> None:
    """Find the axes that do not measure, and the variance by the second that they add.

    To be called before the sample is kept.
    """
    equal = 0.0
    for j in range(3):
        equal += count(x, j, imu.gyro[j], x.gyro[j])
        equal += count(x, j + 3, imu.accel[j], x.accel[j])
    rate2 = 0.0
    accel2 = 0.0
    if equal > 0.0:
        for j in range(3):
            rate = imu.gyro[j] - x.gyro_bias[j]
            rate2 += rate * rate
            accel2 += x.accel_n[j] * x.accel_n[j]
    for j in range(3):
        a = j + 3
        x.unmeasured[j] = MOTION * rate2 if is_stuck(x, j, equal) else 0.0
        if is_at_end(x, j, imu.gyro[j], LEAST_RANGE, imu.gyro[j] - x.gyro[j]):
            x.unmeasured[j] = CLIPPED_RATE_VAR
        x.unmeasured[a] = MOTION * accel2 if is_stuck(x, a, equal) else 0.0
        if is_at_end(x, a, imu.accel[j], LEAST_FORCE_RANGE, imu.accel[j] - x.accel[j]):
            x.unmeasured[a] = CLIPPED_FORCE_VAR
        if x.unmeasured[j] != 0.0 or x.unmeasured[a] != 0.0:
            x.force_sum[j] = NAN


def count(x: State, axis: int, value: float, last: float) -> float:
    """Count whether an axis repeats its last reading; return 1 if it does.

    A run that is no chance says nothing of the others.
    """
    if value == last:
        x.equal_run[axis] += 1.0
        return 1.0
    if x.equal_run[axis] > 0.0 and not is_long(x, axis):
        x.equal[axis] += x.equal_run[axis]
    x.unequal[axis] += 1.0
    x.equal_run[axis] = 0.0
    x.equal_beside[axis] = 0.0
    if x.equal[axis] + x.unequal[axis] > KNOWN:
        x.equal[axis] *= 0.5
        x.unequal[axis] *= 0.5
    return 0.0


def is_stuck(x: State, axis: int, equal: float) -> cython.bint:
    """Return whether an axis repeats its reading for longer than chance explains.

    Args:
        x: The state.
        axis: 0 to 2 of the gyro, 3 to 5 of the accelerometer.
        equal: Axes that repeat theirs now, with this one.
    """
    if x.equal_run[axis] == 0.0:
        return False
    x.equal_beside[axis] += equal - 1.0
    return is_long(x, axis)


def is_long(x: State, axis: int) -> cython.bint:
    """Return whether the run of an axis is longer than chance explains.

    Of readings that are more often equal than not none is: their digits are too coarse, or the
    vehicle a simulated one in a plane.
    """
    run = x.equal_run[axis]
    usual = (x.equal[axis] + 1.0) / (x.equal[axis] + x.unequal[axis] + 1.0)
    beside = (x.equal_beside[axis] + 1.0) / (5.0 * run + 2.0)
    return usual < EVEN and run * log(usual if usual > beside else beside) < CHANCE


def is_measured(x: State) -> cython.bint:
    """Return whether all axes measured the last sample."""
    for j in range(6):
        if x.unmeasured[j] != 0.0:
            return False
    return True


def is_at_end(x: State, axis: int, reading: float, least: float, change: float) -> cython.bint:
    """Return whether a large reading repeats the largest one of its axis; keep the largest."""
    size = fabs(reading)
    if size <= least:
        return False
    is_same = cython.declare(
        cython.bint,
        size >= x.largest_reading[axis] * (1.0 - SAME) and fabs(change) <= SAME * size,
    )
    if size > x.largest_reading[axis]:
        x.largest_reading[axis] = size
    return is_same
