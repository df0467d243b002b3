"""Loops over the points of one scan: where each is, its row, its weight, and sums of rows.

Compiled; the same file runs as plain Python. What is done once for a scan is in
:mod:`ekf_companion.lidar.deskew` and :mod:`ekf_companion.lidar.rows`, with the equations.
"""

from __future__ import annotations

import numpy as np
from cython.cimports.libc.math import sin, sqrt

from ekf_companion.lidar.pose import (
    ATT,
    BIAS,
    FASTER,
    LATER,
    MOUNT_ATT,
    MOUNT_POS,
    POS,
    RATE,
    VEL,
)
from ekf_companion.nav.arrays import Column, Const, Table

_OWN = 12
"""Columns of a row without mounting and delay."""
_LEVER = 6
"""Last columns of a row: shift and rotation of the whole scan about the body, in w."""
_SMALL = 1e-4
"""rad."""
_EDGE = 9.0
"""Square of the sigmas by which a ray must meet a plane from one of its sides."""
_TOUCHING = 1e-3
"""Least range, m: the direction of a beam is that of its point."""


def carry(
    stamp: Const[Column[np.float64]],
    step: Const[Column[np.int64]],
    start: Const[Column[np.float64]],
    states: Const[Table[np.float64]],
    back: Const[Table[np.float64]],
    turn: Table[np.float64],
    moved: Table[np.float64],
) -> None:
    """Write where the body was at times within a path.

    Args:
        stamp: s, shape (n,).
        step: Of the path that each time is in, shape (n,).
        start: Of each of k steps, s, shape (k,).
        states: At its beginning: attitude, nine numbers, position, velocity; during it: rate and
            acceleration; shape (k, 21).
        back: What the attitudes are multiplied by from the left, shape (3, 3).
        turn: Receives them, shape (n, 9).
        moved: Receives the positions, shape (n, 3).
    """
    for n in range(stamp.shape[0]):
        k = step[n]
        dt = stamp[n] - start[k]
        x, y, z = states[k, 15] * dt, states[k, 16] * dt, states[k, 17] * dt
        angle = sqrt(x * x + y * y + z * z)
        # sin a / a and (1 - cos a) / a^2, by their series where the next term is 1e-18
        s = sin(angle) / angle if angle > _SMALL else 1.0 - angle * angle / 6.0
        half = sin(0.5 * angle)
        c = 2.0 * half * half / (angle * angle) if angle > _SMALL else 0.5 - angle * angle / 24.0
        R = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
        S = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
        T = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
        for i in range(3):
            a = back[i, 0] * states[k, 0] + back[i, 1] * states[k, 3] + back[i, 2] * states[k, 6]
            b = back[i, 0] * states[k, 1] + back[i, 1] * states[k, 4] + back[i, 2] * states[k, 7]
            d = back[i, 0] * states[k, 2] + back[i, 1] * states[k, 5] + back[i, 2] * states[k, 8]
            turn[n, 3 * i] = a * R[0] + b * S[0] + d * T[0]
            turn[n, 3 * i + 1] = a * R[1] + b * S[1] + d * T[1]
            turn[n, 3 * i + 2] = a * R[2] + b * S[2] + d * T[2]
            along = states[k, 12 + i] + 0.5 * dt * states[k, 18 + i]
            moved[n, i] = states[k, 9 + i] + dt * along


def place(
    points: Const[Table[np.float64]],
    before: Const[Column[np.float64]],
    turn: Const[Table[np.float64]],
    moved: Const[Table[np.float64]],
    pose: Const[Column[np.float64]],
    y: Table[np.float64],
    q: Table[np.float64],
) -> None:
    """Write where points are: from the body at the end, rotated only, and in w.

    Args:
        points: In the lidar's frame, m, shape (n, 3).
        before: Time from each to the end, s, shape (n,).
        turn: Body at the point's time to body at the end, shape (n, 9).
        moved: Position at the point's time less that at the end, in w, m, shape (n, 3).
        pose: As :mod:`ekf_companion.lidar.pose` packs it.
        y: Receives the lever, in b, m, shape (n, 3).
        q: Receives the place in w, m, shape (n, 3).
    """
    late = pose[LATER]
    for n in range(points.shape[0]):
        bx = _dot(pose, MOUNT_ATT, points, n) + pose[MOUNT_POS]
        by = _dot(pose, MOUNT_ATT + 3, points, n) + pose[MOUNT_POS + 1]
        bz = _dot(pose, MOUNT_ATT + 6, points, n) + pose[MOUNT_POS + 2]
        dt = before[n]
        tx = bx + dt * (pose[BIAS + 1] * bz - pose[BIAS + 2] * by)
        ty = by + dt * (pose[BIAS + 2] * bx - pose[BIAS] * bz)
        tz = bz + dt * (pose[BIAS] * by - pose[BIAS + 1] * bx)
        for i in range(3):
            y[n, i] = turn[n, 3 * i] * tx + turn[n, 3 * i + 1] * ty + turn[n, 3 * i + 2] * tz
        # By a delay the body has gone on, and turned
        sx = y[n, 0] + late * (pose[RATE + 1] * y[n, 2] - pose[RATE + 2] * y[n, 1])
        sy = y[n, 1] + late * (pose[RATE + 2] * y[n, 0] - pose[RATE] * y[n, 2])
        sz = y[n, 2] + late * (pose[RATE] * y[n, 1] - pose[RATE + 1] * y[n, 0])
        for i in range(3):
            along = ATT + 3 * i
            seen = pose[along] * sx + pose[along + 1] * sy + pose[along + 2] * sz
            shift = pose[POS + i] - dt * pose[FASTER + i] + late * pose[VEL + i]
            q[n, i] = seen + moved[n, i] + shift


def differentiate(
    points: Const[Table[np.float64]],
    before: Const[Column[np.float64]],
    turn: Const[Table[np.float64]],
    y: Const[Table[np.float64]],
    q: Const[Table[np.float64]],
    normal: Const[Table[np.float64]],
    pose: Const[Column[np.float64]],
    rows: Table[np.float64],
) -> None:
    """Write the derivative of normal' q by what a row depends on.

    Args:
        points: As :func:`place` takes it, and so on.
        before: s.
        turn: Shape (n, 9).
        y: Levers, m.
        q: Places in w, m.
        normal: In w, shape (n, 3).
        pose: As :mod:`ekf_companion.lidar.pose` packs it.
        rows: Receives attitude, position, velocity and gyro bias, then, where there is room for
            seven more, mounting and delay, and at the end shift and rotation of the scan as a
            whole about the body, shape (n, 18 or 25).
    """
    width = rows.shape[1]
    for n in range(points.shape[0]):
        x0, x1, x2 = normal[n, 0], normal[n, 1], normal[n, 2]
        # The normal in the body at the end, and at the point's time
        b0 = pose[ATT] * x0 + pose[ATT + 3] * x1 + pose[ATT + 6] * x2
        b1 = pose[ATT + 1] * x0 + pose[ATT + 4] * x1 + pose[ATT + 7] * x2
        b2 = pose[ATT + 2] * x0 + pose[ATT + 5] * x1 + pose[ATT + 8] * x2
        t0 = turn[n, 0] * b0 + turn[n, 3] * b1 + turn[n, 6] * b2
        t1 = turn[n, 1] * b0 + turn[n, 4] * b1 + turn[n, 7] * b2
        t2 = turn[n, 2] * b0 + turn[n, 5] * b1 + turn[n, 8] * b2
        dt = before[n]
        l0 = _dot(pose, MOUNT_ATT, points, n) + pose[MOUNT_POS]
        l1 = _dot(pose, MOUNT_ATT + 3, points, n) + pose[MOUNT_POS + 1]
        l2 = _dot(pose, MOUNT_ATT + 6, points, n) + pose[MOUNT_POS + 2]
        rows[n, 0] = y[n, 1] * b2 - y[n, 2] * b1
        rows[n, 1] = y[n, 2] * b0 - y[n, 0] * b2
        rows[n, 2] = y[n, 0] * b1 - y[n, 1] * b0
        rows[n, 3], rows[n, 4], rows[n, 5] = x0, x1, x2
        rows[n, 6], rows[n, 7], rows[n, 8] = -dt * x0, -dt * x1, -dt * x2
        rows[n, 9] = dt * (l1 * t2 - l2 * t1)
        rows[n, 10] = dt * (l2 * t0 - l0 * t2)
        rows[n, 11] = dt * (l0 * t1 - l1 * t0)
        if width > _OWN + _LEVER:
            m0 = pose[MOUNT_ATT] * t0 + pose[MOUNT_ATT + 3] * t1 + pose[MOUNT_ATT + 6] * t2
            m1 = pose[MOUNT_ATT + 1] * t0 + pose[MOUNT_ATT + 4] * t1 + pose[MOUNT_ATT + 7] * t2
            m2 = pose[MOUNT_ATT + 2] * t0 + pose[MOUNT_ATT + 5] * t1 + pose[MOUNT_ATT + 8] * t2
            rows[n, 12] = points[n, 1] * m2 - points[n, 2] * m1
            rows[n, 13] = points[n, 2] * m0 - points[n, 0] * m2
            rows[n, 14] = points[n, 0] * m1 - points[n, 1] * m0
            rows[n, 15], rows[n, 16], rows[n, 17] = t0, t1, t2
            # n . (v + C (rate x y)) = n . v + rate . (y x C'n)
            speed: float = pose[VEL] * x0 + pose[VEL + 1] * x1 + pose[VEL + 2] * x2
            for i in range(3):
                speed += pose[RATE + i] * rows[n, i]
            rows[n, 18] = speed
        p0, p1, p2 = q[n, 0] - pose[POS], q[n, 1] - pose[POS + 1], q[n, 2] - pose[POS + 2]
        rows[n, width - 6], rows[n, width - 5], rows[n, width - 4] = x0, x1, x2
        rows[n, width - 3] = p1 * x2 - p2 * x1
        rows[n, width - 2] = p2 * x0 - p0 * x2
        rows[n, width - 1] = p0 * x1 - p1 * x0


def weigh(
    points: Const[Table[np.float64]],
    turn: Const[Table[np.float64]],
    pose: Const[Column[np.float64]],
    q: Const[Table[np.float64]],
    normal: Const[Table[np.float64]],
    centre: Const[Table[np.float64]],
    along: Const[Table[np.float64]],
    spread: Const[Table[np.float64]],
    together: Const[Column[np.int64]],
    group: Const[Column[np.int64]],
    apart: Const[Table[np.float64]],
    rows: Const[Table[np.float64]],
    P: Const[Table[np.float64]],
    noise: Const[Column[np.float64]],
    out: Table[np.float64],
) -> None:
    """Write innovation, variance and weight of each row.

    Args:
        points: As :func:`place` takes it, and so on.
        turn: Shape (n, 9).
        pose: As :mod:`ekf_companion.lidar.pose` packs it.
        q: Places in w, m.
        normal: Of the plane of each, in w, shape (n, 3).
        centre: Of the plane, m, shape (n, 3).
        along: Two axes in the plane times the sigma of its slope along each, shape (n, 6).
        spread: Variance of the plane's offset, and of its points, m^2, shape (n, 2).
        together: Number of rows on the same plane, shape (n,).
        group: Which anchor's the plane is, shape (n,).
        apart: Covariance of the position relative to each anchor, m^2, shape (g, 9).
        rows: Derivatives, whose first six are attitude and position.
        P: Their covariance, shape (6, 6).
        noise: Sigma of a range, m, of a beam's direction, rad, of a laser's bias, m; then sigmas at
            which a row is left out, and at which it has half its weight.
        out: Receives innovation, m, variance, m^2, and weight, 1/m^2, shape (n, 3).
    """
    range_var, angle_var, bias_var = noise[0] * noise[0], noise[1] * noise[1], noise[2] * noise[2]
    gate, tail = noise[3] * noise[3], noise[4] * noise[4]
    for n in range(points.shape[0]):
        x0, x1, x2 = normal[n, 0], normal[n, 1], normal[n, 2]
        g0, g1, g2 = centre[n, 0] - q[n, 0], centre[n, 1] - q[n, 1], centre[n, 2] - q[n, 2]
        z = x0 * g0 + x1 * g1 + x2 * g2
        # Angle of incidence
        square: float = points[n, 0] * points[n, 0] + points[n, 1] * points[n, 1]
        square += points[n, 2] * points[n, 2]
        c0 = _dot(pose, MOUNT_ATT, points, n)
        c1 = _dot(pose, MOUNT_ATT + 3, points, n)
        c2 = _dot(pose, MOUNT_ATT + 6, points, n)
        d0 = turn[n, 0] * c0 + turn[n, 1] * c1 + turn[n, 2] * c2
        d1 = turn[n, 3] * c0 + turn[n, 4] * c1 + turn[n, 5] * c2
        d2 = turn[n, 6] * c0 + turn[n, 7] * c1 + turn[n, 8] * c2
        e0 = pose[ATT] * d0 + pose[ATT + 1] * d1 + pose[ATT + 2] * d2
        e1 = pose[ATT + 3] * d0 + pose[ATT + 4] * d1 + pose[ATT + 5] * d2
        e2 = pose[ATT + 6] * d0 + pose[ATT + 7] * d1 + pose[ATT + 8] * d2
        cosine = e0 * x0 + e1 * x1 + e2 * x2
        cosine2: float = min(cosine * cosine / max(square, _TOUCHING * _TOUCHING), 1.0)
        point = range_var * cosine2 + angle_var * square * (1.0 - cosine2)
        # What the rows on one plane share
        shared: float = spread[n, 0] + bias_var * cosine2
        unsure: float = 0.0
        m = group[n]
        for k in range(2):
            a0, a1, a2 = along[n, 3 * k], along[n, 3 * k + 1], along[n, 3 * k + 2]
            slope = a0 * g0 + a1 * g1 + a2 * g2
            shared += slope * slope
            along_ray = a0 * e0 + a1 * e1 + a2 * e2
            unsure += along_ray * along_ray
            # What an unknown shift along a plane becomes by its slope (a term of second order)
            shared += a0 * (apart[m, 0] * a0 + apart[m, 1] * a1 + apart[m, 2] * a2)
            shared += a1 * (apart[m, 3] * a0 + apart[m, 4] * a1 + apart[m, 5] * a2)
            shared += a2 * (apart[m, 6] * a0 + apart[m, 7] * a1 + apart[m, 8] * a2)
        # Together they know no more than the plane
        R: float = max(point, spread[n, 1]) + together[n] * shared
        prior: float = 0.0
        for i in range(6):
            part: float = 0.0
            for j in range(6):
                part += P[i, j] * rows[n, j]
            prior += rows[n, i] * part
        distance = z * z / (R + prior)
        out[n, 0], out[n, 1] = z, R
        # No surface is seen edge on: such a plane is that of rays from one place
        is_seen = cosine * cosine > _EDGE * unsure
        is_row = is_seen and distance < gate
        out[n, 2] = 1.0 / (R * (1.0 + distance / tail)) if is_row else 0.0


def sum_normals(
    normal: Const[Table[np.float64]],
    along: Const[Table[np.float64]],
    weight: Const[Column[np.float64]],
    group: Const[Column[np.int64]],
    A: Table[np.float64],
    B: Table[np.float64],
) -> None:
    """Add to the sums of n n' and of the covariances of normals for each group, shape (g, 9)."""
    for n in range(normal.shape[0]):
        g = group[n]
        for i in range(3):
            for j in range(3):
                A[g, 3 * i + j] += weight[n] * (normal[n, i] * normal[n, j])
                seen = along[n, i] * along[n, j] + along[n, 3 + i] * along[n, 3 + j]
                B[g, 3 * i + j] += weight[n] * seen


def sum_planes(
    normal: Const[Table[np.float64]],
    along: Const[Table[np.float64]],
    weight: Const[Column[np.float64]],
    group: Const[Column[np.int64]],
    white: Const[Table[np.float64]],
    sums: Table[np.float64],
) -> None:
    """Add up what each plane holds of three directions, and the noise of it.

    Args:
        normal: Of each plane, shape (p, 3).
        along: As :func:`weigh` takes it, shape (p, 6).
        weight: Of all its rows.
        group: Of each.
        white: Directions in columns for each group, scaled to unit information, shape (g, 9).
        sums: Receives for each direction the information, the sum of its squares, and that of the
            squares of the noise, shape (g, 9).
    """
    for n in range(normal.shape[0]):
        g = group[n]
        for j in range(3):
            held: float = 0.0
            noise: float = 0.0
            for k in range(3):
                seen: float = 0.0
                for i in range(3):
                    axis = normal[n, i] if k == 0 else along[n, 3 * (k - 1) + i]
                    seen += axis * white[g, 3 * i + j]
                if k == 0:
                    held = weight[n] * seen * seen
                else:
                    noise += weight[n] * seen * seen
            sums[g, j] += held
            sums[g, 3 + j] += held * held
            sums[g, 6 + j] += noise * noise


def sum_rows(
    rows: Const[Table[np.float64]],
    z: Const[Column[np.float64]],
    weight: Const[Column[np.float64]],
    group: Const[Column[np.int64]],
    A: Table[np.float64],
    b: Table[np.float64],
) -> None:
    """Add the squares of rows of width w to A, shape (g w, w), and their products with z to b."""
    width = rows.shape[1]
    for n in range(rows.shape[0]):
        if weight[n] == 0.0:
            continue
        first = group[n] * width
        for i in range(width):
            scaled = weight[n] * rows[n, i]
            b[group[n], i] += scaled * z[n]
            for j in range(i + 1):
                A[first + i, j] += scaled * rows[n, j]
    for first in range(0, A.shape[0], width):
        for i in range(width):
            for j in range(i):
                A[first + j, i] = A[first + i, j]


def _dot(
    pose: Const[Column[np.float64]], first: int, points: Const[Table[np.float64]], n: int
) -> float:
    """Return the product of three numbers of a pose with a point."""
    dot: float = pose[first] * points[n, 0] + pose[first + 1] * points[n, 1]
    return dot + pose[first + 2] * points[n, 2]
