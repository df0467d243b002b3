"""Derivatives by central differences, and states to take them at."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

STEP = 1e-5


def central(function: Callable[[Array], Array], size: int) -> Array:
    """Return the derivative of a function of an error state at zero."""
    columns = [
        (function(STEP * axis) - function(-STEP * axis)) / (2.0 * STEP) for axis in np.eye(size)
    ]
    return np.stack(columns, axis=-1)


def some_state(seed: int = 1) -> Nominal:
    """Return a state away from zero in everything."""
    rng = np.random.default_rng(seed)
    return Nominal(
        q_nb=so3.exp(rng.uniform(-1.2, 1.2, 3)),
        vel_n=rng.uniform(-5.0, 5.0, 3),
        pos_n=rng.uniform(-20.0, 20.0, 3),
        gyro_bias=rng.uniform(-0.02, 0.02, 3),
        accel_bias=rng.uniform(-0.2, 0.2, 3),
    )
