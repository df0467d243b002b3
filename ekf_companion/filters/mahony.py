"""Mahony's complementary filter: the gyro, pulled to gravity and north by their cross products.

Source: Mahony, Hamel, Pflimlin 2008, "Nonlinear complementary filters on the special orthogonal
group", IEEE Trans. Automatic Control 53(5), section IV.C (explicit, with bias), equations (48).
The gains are those of its section V. The known field is the present one, turned about the
vertical to the north, as there is no model of it: so it pulls roll and pitch too, but only by
what the estimate of them is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_companion.filters import readings
from ekf_companion.filters.gyroframe import Quaternion, turned
from ekf_companion.filters.readings import first_attitude, known_rows
from ekf_companion.filters.samples import LONGEST
from ekf_companion.filters.solution import Solution
from ekf_companion.nav.measurements import Events

NAME = "mahony"

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class MahonySettings:
    """The gains."""

    proportional: float = 1.0
    """Rate per rad of error, 1/s."""
    integral: float = 0.3
    """Growth of the bias per rad of error, 1/s^2."""
    field: float = 1.0
    """Weight of the field beside that of gravity."""


def run(
    events: Events, settings: MahonySettings = MahonySettings(), gap: float = LONGEST
) -> Solution:
    """Estimate attitude and gyro bias over a recording, each from what came before.

    Args:
        events: The recording.
        settings: The gains.
        gap: Silence of the inertial sensor beyond which only the longest part counts, s.

    Raises:
        LogError: There are no inertial samples.
    """
    taken = readings.read(events, gap)
    w, x, y, z = first_attitude(taken).tolist()
    q: Quaternion = (w, x, y, z)
    bias: Vector = (0.0, 0.0, 0.0)
    attitudes, biases = [], []
    has_mag = known_rows(taken.mag_b).tolist()
    for dt, gyro, accel, mag, is_seen in zip(
        taken.steps.tolist(),
        taken.gyro_b.tolist(),
        taken.accel_b.tolist(),
        taken.mag_b.tolist(),
        has_mag,
        strict=True,
    ):
        ex, ey, ez = _gravity_error(q, accel)
        if is_seen:
            mx, my, mz = _field_error(q, mag)
            w = settings.field
            ex, ey, ez = ex + w * mx, ey + w * my, ez + w * mz
        kp, ki = settings.proportional, settings.integral * dt
        bias = (bias[0] - ki * ex, bias[1] - ki * ey, bias[2] - ki * ez)
        q = turned(
            q,
            gyro[0] - bias[0] + kp * ex,
            gyro[1] - bias[1] + kp * ey,
            gyro[2] - bias[2] + kp * ez,
            dt,
        )
        attitudes.append(q)
        biases.append(bias)
    return readings.solution(NAME, taken, np.array(attitudes), bias=np.array(biases))


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
    w, x, y, z = q
    mx, my, mz = mag
    norm = math.sqrt(mx * mx + my * my + mz * mz)
    if norm < 1e-9:
        return 0.0, 0.0, 0.0
    mx, my, mz = mx / norm, my / norm, mz / norm
    # Turned into n, then about the vertical to the north
    north = (1.0 - 2.0 * (y * y + z * z)) * mx + 2.0 * (x * y - w * z) * my
    north += 2.0 * (x * z + w * y) * mz
    east = 2.0 * (x * y + w * z) * mx + (1.0 - 2.0 * (x * x + z * z)) * my
    east += 2.0 * (y * z - w * x) * mz
    down = 2.0 * (x * z - w * y) * mx + 2.0 * (y * z + w * x) * my
    down += (1.0 - 2.0 * (x * x + y * y)) * mz
    level = math.hypot(north, east)
    # And back into b
    bx = (1.0 - 2.0 * (y * y + z * z)) * level + 2.0 * (x * z - w * y) * down
    by = 2.0 * (x * y - w * z) * level + 2.0 * (y * z + w * x) * down
    bz = 2.0 * (x * z + w * y) * level + (1.0 - 2.0 * (x * x + y * y)) * down
    return my * bz - mz * by, mz * bx - mx * bz, mx * by - my * bx
