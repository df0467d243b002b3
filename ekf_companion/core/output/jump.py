"""The step from one estimate to a later one which the inertial samples between do not explain.

It knows nothing of the filter but what it states, as whoever is sent the estimates.
"""

from __future__ import annotations

import cython
from cython.cimports.libc.math import atan2, cos, sin, sqrt

GRAVITY = cython.declare(cython.double, 9.81)
"""m/s^2: over a tenth of a second no place on Earth differs by more than 3 mm/s."""


def unexplained_step(
    last: tuple[float, ...],
    now: tuple[float, ...],
    samples: list[tuple[float, ...]],
    dt: float,
    before: tuple[float, ...],
    ahead: float,
) -> tuple[float, ...]:
    """Return position (m) and velocity (m/s) in n, and yaw (rad), less what the motion leads to.

    The mean rate turns the attitude, the mean force in the first and in the last attitude
    accelerates, and the mean of the two velocities moves. Each estimate is ahead of the samples'
    mean by the rate and force of its last sample.

    Args:
        last: Position n (m), quaternion from b to n, velocity n (m/s): ten numbers.
        now: The same, later.
        samples: Those between, at least one: angular rate (rad/s), specific force (m/s^2), b.
        dt: Time between the two, s.
        before: The sample before those: the last of the first estimate.
        ahead: How far ahead an estimate is of the end of its last sample, s.
    """
    rx = ry = rz = fx = fy = fz = 0.0
    sample: tuple[float, ...]
    for sample in samples:
        rx += float(sample[0])
        ry += float(sample[1])
        rz += float(sample[2])
        fx += float(sample[3])
        fy += float(sample[4])
        fz += float(sample[5])
    share = 1.0 / len(samples)
    fx, fy, fz = fx * share, fy * share, fz * share
    share *= dt
    rx, ry, rz = rx * share, ry * share, rz * share
    end: tuple[float, ...] = samples[len(samples) - 1]
    rx += ahead * (float(end[0]) - float(before[0]))
    ry += ahead * (float(end[1]) - float(before[1]))
    rz += ahead * (float(end[2]) - float(before[2]))

    # Turn the attitude by the samples
    half = 0.5 * sqrt(rx * rx + ry * ry + rz * rz)
    scale = 0.5 * sin(half) / half if half > 0.0 else 0.5
    w, x, y, z = float(last[3]), float(last[4]), float(last[5]), float(last[6])
    dw, dx, dy, dz = cos(half), rx * scale, ry * scale, rz * scale
    tw = w * dw - x * dx - y * dy - z * dz
    tx = w * dx + x * dw + y * dz - z * dy
    ty = w * dy - x * dz + y * dw + z * dx
    tz = w * dz + x * dy - y * dx + z * dw

    # Accelerate in the attitude before and in that after it
    ax = 0.5 * (rotate_x(w, x, y, z, fx, fy, fz) + rotate_x(tw, tx, ty, tz, fx, fy, fz))
    ay = 0.5 * (rotate_y(w, x, y, z, fx, fy, fz) + rotate_y(tw, tx, ty, tz, fx, fy, fz))
    az = 0.5 * (rotate_z(w, x, y, z, fx, fy, fz) + rotate_z(tw, tx, ty, tz, fx, fy, fz)) + GRAVITY
    fx, fy, fz = float(before[3]), float(before[4]), float(before[5])
    gx = ahead * rotate_x(w, x, y, z, fx, fy, fz)
    gy = ahead * rotate_y(w, x, y, z, fx, fy, fz)
    gz = ahead * rotate_z(w, x, y, z, fx, fy, fz)
    fx, fy, fz = float(end[3]), float(end[4]), float(end[5])
    gx = ahead * rotate_x(tw, tx, ty, tz, fx, fy, fz) - gx
    gy = ahead * rotate_y(tw, tx, ty, tz, fx, fy, fz) - gy
    gz = ahead * rotate_z(tw, tx, ty, tz, fx, fy, fz) - gz

    # North as the body should see it, and where by the estimate that is
    fx = 1.0 - 2.0 * (ty * ty + tz * tz)
    fy = 2.0 * (tx * ty - tw * tz)
    fz = 2.0 * (tx * tz + tw * ty)
    w, x, y, z = float(now[3]), float(now[4]), float(now[5]), float(now[6])
    yaw = atan2(rotate_y(w, x, y, z, fx, fy, fz), rotate_x(w, x, y, z, fx, fy, fz))

    half = 0.5 * dt
    return (
        now[0] - last[0] - half * (now[7] + last[7]),
        now[1] - last[1] - half * (now[8] + last[8]),
        now[2] - last[2] - half * (now[9] + last[9]),
        now[7] - last[7] - dt * ax - gx,
        now[8] - last[8] - dt * ay - gy,
        now[9] - last[9] - dt * az - gz,
        yaw,
    )


def rotate_x(w: float, x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the first component of a vector that a quaternion rotates."""
    first = w * w + x * x - y * y - z * z
    return first * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c


def rotate_y(w: float, x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the second component of a vector that a quaternion rotates."""
    second = w * w - x * x + y * y - z * z
    return 2.0 * (x * y + w * z) * a + second * b + 2.0 * (y * z - w * x) * c


def rotate_z(w: float, x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the third component of a vector that a quaternion rotates."""
    third = w * w - x * x - y * y + z * z
    return 2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + third * c
