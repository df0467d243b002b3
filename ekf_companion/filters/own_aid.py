"""A measurement of your own for the filters ``euler``, ``iterated`` and ``ukf``.

Say what it measures less what a state predicts, and how large its noise is. The Jacobian is found
by differences unless you give it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ekf_companion.filters.strapdown import N, Nominal
from ekf_companion.nav.arrays import Array

STEP = 1e-6
"""Of the central differences, rad, m/s, m, rad/s and m/s^2."""


class OwnAid(ABC):
    """A measurement, its model and its noise; one to three numbers."""

    aid = "own"
    """Its name among the counts of fused and refused measurements."""

    @abstractmethod
    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, shape (m,).

        For ``ukf``, a state whose arrays have leading axes yields as many, shape (..., m): index
        them from the end, as in ``state.pos_n[..., 2:3]``.
        """

    @abstractmethod
    def covariance(self) -> Array:
        """Return the covariance of the noise, R, shape (m, m)."""

    def jacobian(self, state: Nominal) -> Array:
        """Return the derivative of the prediction by the error state, shape (m, 15).

        The error state is attitude (rotation vector in b), velocity and position in n, gyro bias
        and accelerometer bias, as in :mod:`ekf_companion.filters.strapdown`.
        """
        columns = []
        for axis in range(N):
            step = np.zeros(N)
            step[axis] = STEP
            back, ahead = (np.asarray(self.innovation(state.plus(s * step))) for s in (-1.0, 1.0))
            columns.append((back - ahead) / (2.0 * STEP))
        return np.stack(columns, axis=-1)
