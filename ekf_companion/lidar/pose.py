"""A pose as the loops over points take it: numbers in one array."""

from __future__ import annotations

import numpy as np

from ekf_companion.lidar.state import State
from ekf_companion.nav.arrays import Array

MOUNT_ATT = 0
"""Lidar to body, nine numbers; the others follow likewise."""
MOUNT_POS = 9
"""Lidar in the body, m."""
BIAS = 12
"""Error of the rate less that of the path, rad/s."""
ATT = 15
"""Body to w, nine numbers."""
POS = 24
"""m."""
FASTER = 27
"""Velocity less that of the path, m/s."""
VEL = 30
"""m/s."""
RATE = 33
"""Of the body, rad/s."""
LATER = 36
"""Delay less that of the path, s."""


def pack(x: State, prior: State, rate_b: Array) -> Array:
    """Return a state, and how it differs from that of a path, shape (37,)."""
    return np.concatenate(
        [
            x.C_bl.ravel(),
            x.pos_b,
            x.gyro_bias + x.excess - prior.gyro_bias - prior.excess,
            x.C_wb.ravel(),
            x.pos_w,
            x.vel_w - prior.vel_w,
            x.vel_w,
            rate_b,
            [x.delay - prior.delay],
        ]
    )
