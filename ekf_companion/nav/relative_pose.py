"""How the covariance of a pose is written: files and messages have it as an upper triangle.

The error of a relative one is that of the position (m) in the earlier body and a rotation vector
(rad) of the later one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ekf_companion.nav.arrays import Array

UPPER = np.triu_indices(6)
FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])
"""From axes forward, left, up to forward, right, down; and back."""
_AXES = ("x", "y", "z", "rx", "ry", "rz")
COVARIANCE = tuple(
    f"rel_{_AXES[i]}_{_AXES[j]}" for i, j in zip(*(one.tolist() for one in UPPER), strict=True)
)
"""Names of its elements, in m and rad, row by row."""
SINCE = "rel_since_s"
"""Name of the time of the earlier pose."""
LEVEL = "sigma_level_rad"
"""Name of one sigma of how the world of the poses is tilted."""
LASTS = 60.0
"""Time over which a tilt of the source's world adds up, s: as long as outages usually are."""


def square(rows: Array) -> Array:
    """Return covariances, shape (..., 6, 6), of their upper triangles, shape (..., 21)."""
    P = np.empty((*rows.shape[:-1], 6, 6))
    P[..., UPPER[0], UPPER[1]] = P[..., UPPER[1], UPPER[0]] = rows
    return P


def drift_by_tilt(tilt: float, way: Any, seconds: Any) -> Array:
    """Return the variance of height, m^2, that a tilt of the world adds on a level way.

    It rises all the time: as a walk over :data:`LASTS`.

    Args:
        tilt: One sigma, rad.
        way: What is travelled, m: a number, or an array of them.
        seconds: The time that it took, s.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.where(seconds > 0.0, way / seconds, 0.0)
    return np.asarray(tilt * tilt * speed * speed * LASTS * seconds)
