"""Rotations as unit quaternions, ``(w, x, y, z)``, Hamilton, over any leading shape.

Source: Sola 2017, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array
from ekf_companion.nav.matrix3 import from_quaternion

_SMALL = 1e-8
"""Angle below which a series replaces sin(x)/x, rad: the next term is 1e-17."""
_SMALL_JACOBIAN = 1e-4
"""Likewise for the coefficient of the Jacobian: the next term is 1e-10 of it."""


def multiply(p: Array, q: Array) -> Array:
    """Return the product p q, shape (..., 4): first q's rotation, then p's."""
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    if p.ndim == q.ndim == 1:
        # The same products and sums; a filter in Python has one quaternion a sample
        w, x, y, z = p.tolist()
        a, b, c, d = q.tolist()
        return np.array(
            [
                w * a - x * b - y * c - z * d,
                w * b + x * a + y * d - z * c,
                w * c - x * d + y * a + z * b,
                w * d + x * c - y * b + z * a,
            ]
        )
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """Return the inverse rotation, shape (..., 4)."""
    return np.asarray(np.asarray(q, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0]))


def normalise(q: Array) -> Array:
    """Return q with unit norm and w >= 0, shape (..., 4)."""
    q = np.asarray(q, dtype=float)
    if q.ndim == 1:
        w, x, y, z = q.tolist()
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        return q / (-norm if w < 0.0 else norm) if norm > 0.0 else q * math.nan
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0.0, -q, q)


def exp(phi: Array) -> Array:
    """Return the quaternion of a rotation vector, rad, shape (..., 3)."""
    phi = np.asarray(phi, dtype=float)
    if phi.ndim == 1:
        x, y, z = phi.tolist()
        turn = math.sqrt(x * x + y * y + z * z)
        s = 0.5 if turn < _SMALL else float(np.sin(0.5 * turn)) / turn
        return np.array([np.cos(0.5 * turn), s * x, s * y, s * z])
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    half = 0.5 * angle
    scale = np.where(angle < _SMALL, 0.5, np.sin(half) / np.where(angle < _SMALL, 1.0, angle))
    return np.concatenate([np.cos(half), scale * phi], axis=-1)


def log(q: Array) -> Array:
    """Return the rotation vector of the shorter way, rad, shape (..., 3)."""
    q = np.asarray(q, dtype=float)
    if q.ndim == 1:
        w, x, y, z = (-q if q[0] < 0.0 else q).tolist()
        s = math.sqrt(x * x + y * y + z * z)
        s = 2.0 if s < _SMALL else 2.0 * float(np.arctan2(s, w)) / s
        return np.array([s * x, s * y, s * z])
    q = np.where(q[..., :1] < 0.0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    scale = np.where(norm < _SMALL, 2.0, angle / np.where(norm < _SMALL, 1.0, norm))
    return np.asarray(scale * q[..., 1:])


def to_matrix(q: Array) -> Array:
    """Return the direction cosine matrix, shape (..., 3, 3)."""
    q = np.asarray(q, dtype=float)
    if q.ndim == 1:
        return np.array(from_quaternion(*q.tolist()))
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(C: Array) -> Array:
    """Return the quaternion of a direction cosine matrix, w >= 0, shape (..., 4).

    Of the four forms the one whose first number is largest, as no digit is lost there.

    Source: Shepperd 1978, "Quaternion from rotation matrix", J. Guidance and Control 1(3).
    """
    C = np.asarray(C, dtype=float)
    if C.ndim == 2:
        (a, b, c), (d, e, f), (g, h, i) = C.tolist()
    else:
        rows = (np.moveaxis(row, -1, 0) for row in np.moveaxis(C, -2, 0))
        (a, b, c), (d, e, f), (g, h, i) = rows
    x, y, z, xy, xz, yz = h - f, c - g, d - b, d + b, c + g, h + f
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    forms = (
        (squares[0], x, y, z),
        (x, squares[1], xy, xz),
        (y, xy, squares[2], yz),
        (z, xz, yz, squares[3]),
    )
    if C.ndim == 2:
        return normalise(np.array(forms[squares.index(max(squares))]))
    largest = np.argmax(np.stack(squares, -1), axis=-1)[..., None, None]
    table = np.stack([np.stack(form, -1) for form in forms], -2)
    return normalise(np.take_along_axis(table, largest, -2)[..., 0, :])


def rotate(q: Array, v: Array) -> Array:
    """Rotate v by q, as ``q_nb`` rotates ``v_b`` into ``v_n``, shape (..., 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", to_matrix(q), np.asarray(v, dtype=float)))


def cross(a: Array, b: Array) -> Array:
    """Return a x b of two vectors of shape (3,), in a tenth of the time of ``numpy.cross``."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew(v: Array) -> Array:
    """Return the matrix of the cross product with v, shape (3, 3)."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def right_jacobian_inverse(phi: Array) -> Array:
    """Return the derivative of log(exp(phi) exp(d)) by d at 0, shape (3, 3); |phi| < 2 pi.

    The inverse of the right Jacobian of SO(3) (section 4.3 of the source).
    """
    angle = math.sqrt(float(phi @ phi))
    if angle < _SMALL_JACOBIAN:
        second = 1.0 / 12.0
    else:
        second = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    X = skew(phi)
    return np.asarray(np.eye(3) + 0.5 * X + second * (X @ X))


def from_euler(roll: npt.ArrayLike, pitch: npt.ArrayLike, yaw: npt.ArrayLike) -> Array:
    """Return q_nb of yaw, then pitch, then roll (z-y-x), rad."""
    if isinstance(roll, float) and isinstance(pitch, float) and isinstance(yaw, float):
        half = np.array([0.5 * roll, 0.5 * pitch, 0.5 * yaw])
        (cr, cp, cy), (sr, sp, sy) = np.cos(half).tolist(), np.sin(half).tolist()
        return np.array(
            [
                cr * cp * cy + sr * sp * sy,
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
            ]
        )
    roll, pitch, yaw = np.broadcast_arrays(
        np.asarray(roll, dtype=float), np.asarray(pitch, dtype=float), np.asarray(yaw, dtype=float)
    )
    cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
    cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def to_euler(q: Array) -> Array:
    """Return roll, pitch, yaw (z-y-x), rad, shape (..., 3); roll and yaw in [-pi, pi]."""
    C = to_matrix(q)
    angles = np.empty(C.shape[:-1])
    angles[..., 0] = np.arctan2(C[..., 2, 1], C[..., 2, 2])
    angles[..., 1] = -np.arcsin(np.clip(C[..., 2, 0], -1.0, 1.0))
    angles[..., 2] = np.arctan2(C[..., 1, 0], C[..., 0, 0])
    return angles


def to_east_north_up(q_nb: Array) -> Array:
    """Return attitudes of a body of forward, left, up in east, north, up, shape (..., 4).

    Given are those of forward, right, down in north, east, down. Viewers expect the former: ROS
    REP 103.
    """
    w, x, y, z = np.moveaxis(q_nb, -1, 0)
    half = np.sqrt(0.5)
    # From north-east-down to east-north-up on the left, by half a turn about x on the right
    return np.stack([half * (w + z), half * (x + y), half * (x - y), half * (w - z)], axis=-1)


def wrap(angle: npt.ArrayLike) -> Array:
    """Bring an angle into [-pi, pi)."""
    return np.asarray(np.mod(np.asarray(angle, dtype=float) + np.pi, 2.0 * np.pi) - np.pi)
