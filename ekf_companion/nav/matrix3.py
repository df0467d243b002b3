"""A rotation's matrix in plain floats: of one, NumPy takes ten times as long."""

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
