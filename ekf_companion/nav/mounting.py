"""How the autopilot's board is mounted in its vehicle."""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

LARGEST_TRIM = math.radians(20.0)
"""Beyond it is no trim: ArduPilot allows 10 degrees."""


def trim_matrix(roll: float, pitch: float) -> Array:
    """Return the rotation of vectors from the board to the vehicle, shape (3, 3).

    Args:
        roll: Of the board in the level vehicle, rad: ArduPilot's AHRS_TRIM_X.
        pitch: Likewise, AHRS_TRIM_Y.

    Source: ArduPilot, ``AP_AHRS::update_trim_rotation_matrices``.
    """
    if abs(roll) > LARGEST_TRIM or abs(pitch) > LARGEST_TRIM:
        return np.eye(3)
    return so3.to_matrix(so3.from_euler(roll, pitch, 0.0))
