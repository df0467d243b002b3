"""Rotations: quaternions (w, x, y, z) from b to n, rotation vectors, direction cosines.

Source: Sola 2017, sections 1 to 4.
"""

from __future__ import annotations

from cython.cimports.ekf_companion.core.memory.constants import PI
from cython.cimports.ekf_companion.core.memory.overlay import Dcm, Vector
from cython.cimports.libc.math import cos, floor, sin, sqrt


def rotate(q: Vector, px: float, py: float, pz: float) -> None:
    """Rotate an attitude by a rotation vector in n: q <- exp(p) q, of unit norm."""
    qw = q[0]
    qx = q[1]
    qy = q[2]
    qz = q[3]
    a2 = px * px + py * py + pz * pz
    if a2 > 1e-6:
        half = 0.5 * sqrt(a2)
        c = cos(half)
        s = 0.5 * sin(half) / half
    else:  # the next terms are below 1e-20
        c = 1.0 - a2 * (0.125 - a2 * (1.0 / 384.0))
        s = 0.5 - a2 * (1.0 / 48.0 - a2 * (1.0 / 3840.0))
    px = s * px
    py = s * py
    pz = s * pz
    q[0] = c * qw - px * qx - py * qy - pz * qz
    q[1] = c * qx + px * qw + py * qz - pz * qy
    q[2] = c * qy - px * qz + py * qw + pz * qx
    q[3] = c * qz + px * qy - py * qx + pz * qw
    normalise(q)


def rotate_body(q: Vector, px: float, py: float, pz: float) -> None:
    """Rotate an attitude by a rotation vector in b: q <- q exp(p), of unit norm."""
    # q exp(p) is the conjugate of exp(-p) q*, so one formula serves both
    q[1] = -q[1]
    q[2] = -q[2]
    q[3] = -q[3]
    rotate(q, -px, -py, -pz)
    q[1] = -q[1]
    q[2] = -q[2]
    q[3] = -q[3]


def normalise(q: Vector) -> None:
    """Bring a quaternion to unit norm."""
    norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    q[0] = q[0] / norm
    q[1] = q[1] / norm
    q[2] = q[2] / norm
    q[3] = q[3] / norm


def to_dcm(q: Vector, C: Dcm) -> None:
    """Write the direction cosines of a quaternion to C, shape (3, 3)."""
    qw = q[0]
    qx = q[1]
    qy = q[2]
    qz = q[3]
    C[0][0] = qw * qw + qx * qx - qy * qy - qz * qz
    C[0][1] = 2.0 * (qx * qy - qw * qz)
    C[0][2] = 2.0 * (qx * qz + qw * qy)
    C[1][0] = 2.0 * (qx * qy + qw * qz)
    C[1][1] = qw * qw - qx * qx + qy * qy - qz * qz
    C[1][2] = 2.0 * (qy * qz - qw * qx)
    C[2][0] = 2.0 * (qx * qz - qw * qy)
    C[2][1] = 2.0 * (qy * qz + qw * qx)
    C[2][2] = qw * qw - qx * qx - qy * qy + qz * qz


def wrap(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return angle - 2.0 * PI * floor((angle + PI) / (2.0 * PI))
