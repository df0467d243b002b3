"""Mahony's complementary filter: the gyro, corrected by cross products with gravity and north.

Source: Mahony, Hamel, Pflimlin 2008, "Nonlinear complementary filters on the special orthogonal
group", IEEE Trans. Automatic Control 53(5), section IV.C (explicit, with bias), equations (48).
The gains are those of its section V. There is no model of the field: the known field is the present
one, turned about the vertical to the north. So it corrects roll and pitch too, but only by the
error of their estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.ahrs_sensors import Quaternion, Vector, rotated, to_rows
from ekf_companion.filters.inertial import LONGEST_GAP
from ekf_companion.filters.marg import marg_samples
from ekf_companion.filters.solution import AttitudeEstimates, Solution, attitude_solution
from ekf_companion.nav.measurements import Events


@dataclass(frozen=True, slots=True, kw_only=True)
class MahonySettings:
    """The gains."""

    proportional: float = 1.0
    """Rate per rad of error, 1/s."""
    integral: float = 0.3
    """Growth of the bias per rad of error, 1/s^2."""
    field: float = 1.0
    """Weight of the field relative to that of gravity."""


def run(
    events: Events, settings: MahonySettings = MahonySettings(), gap: float = LONGEST_GAP
) -> Solution:
    """Estimate attitude and gyro bias over a recording, each from the samples until then.

    Beyond a gap in the inertial samples, s, only the longest part counts.

    Raises:
        LogError: There are no inertial samples.
    """
    samples = marg_samples(events, gap)
    w, x, y, z = samples.first_attitude().tolist()
    q: Quaternion = (w, x, y, z)
    bias: Vector = (0.0, 0.0, 0.0)
    attitudes, biases = [], []
    for dt, gyro, accel, mag, missed in samples.rows():
        if missed is not None and missed.gyro is not None:
            p, r, s = (rate - each for rate, each in zip(missed.gyro, bias, strict=True))
            q = rotated(q, p, r, s, missed.span)
        ex, ey, ez = _gravity_error(q, accel)
        if mag is not None:
            mx, my, mz = _field_error(q, mag)
            w = settings.field
            ex, ey, ez = ex + w * mx, ey + w * my, ez + w * mz
        kp, ki = settings.proportional, settings.integral * dt
        bias = (bias[0] - ki * ex, bias[1] - ki * ey, bias[2] - ki * ez)
        q = rotated(
            q,
            gyro[0] - bias[0] + kp * ex,
            gyro[1] - bias[1] + kp * ey,
            gyro[2] - bias[2] + kp * ez,
            dt,
        )
        attitudes.append(q)
        biases.append(bias)
    found = AttitudeEstimates(q_nb=np.array(attitudes), bias=np.array(biases))
    return attitude_solution("mahony", samples, found)


def _gravity_error(q: Quaternion, accel: list[float]) -> Vector:
    """Return measured x estimated up, b."""
    w, x, y, z = q
    ux, uy, uz = -2.0 * (x * z - w * y), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0
    fx, fy, fz = accel
    norm = math.sqrt(fx * fx + fy * fy + fz * fz)
    if norm < 1e-3:
        return 0.0, 0.0, 0.0
    return (
        (fy * uz - fz * uy) / norm,
        (fz * ux - fx * uz) / norm,
        (fx * uy - fy * ux) / norm,
    )


def _field_error(q: Quaternion, mag: list[float]) -> Vector:
    """Return measured x estimated field, b, both of unit length."""
    mx, my, mz = mag
    norm = math.sqrt(mx * mx + my * my + mz * mz)
    if norm < 1e-9:
        return 0.0, 0.0, 0.0
    mx, my, mz = mx / norm, my / norm, mz / norm
    # Rotated into n, then about the vertical to the north
    first, second, third = to_rows(q)
    north = first[0] * mx + first[1] * my + first[2] * mz
    east = second[0] * mx + second[1] * my + second[2] * mz
    down = third[0] * mx + third[1] * my + third[2] * mz
    horizontal = math.hypot(north, east)
    # And back into b
    bx = first[0] * horizontal + third[0] * down
    by = first[1] * horizontal + third[1] * down
    bz = first[2] * horizontal + third[2] * down
    return my * bz - mz * by, mz * bx - mx * bz, mx * by - my * bx
