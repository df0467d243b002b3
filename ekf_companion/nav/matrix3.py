"""Vectors and matrices of three in plain floats.

NumPy takes ten times as long for a single vector, and its BLAS rounds differently on other boards.
"""

from __future__ import annotations

from collections.abc import Sequence

Vector3 = Sequence[float]
Matrix3 = Sequence[Vector3]
"""Row by row."""


def from_quaternion(w: float, x: float, y: float, z: float) -> Matrix3:
    """Return the direction cosine matrix of a unit quaternion."""
    return (
        (w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def apply(A: Matrix3, v: Vector3) -> Vector3:
    """Return A v."""
    (a, b, c), (d, e, f), (g, h, i) = A
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def multiply_transposed(A: Matrix3, B: Matrix3) -> Matrix3:
    """Return A B^T."""
    a, b, c = A
    return apply(B, a), apply(B, b), apply(B, c)
