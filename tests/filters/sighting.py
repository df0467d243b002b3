"""A vector that is known in n and measured in b: an observation that is not linear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.strapdown import ATT, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sighting:
    """The Earth's field, or the direction of a beacon.

    Unlike an azimuth it is not linear in the heading: an error of psi shows as sin(psi).
    """

    seen_b: Array
    """As measured, shape (3,)."""
    known_n: Array
    """As known, in the same unit, shape (3,)."""
    std: float
    """One sigma per axis, in that unit."""
    aid: str = "heading"

    def covariance(self) -> Array:
        """Return the covariance of its noise, shape (3, 3)."""
        return self.std * self.std * np.eye(3)

    def innovation(self, state: Nominal) -> Array:
        """Return measured minus predicted, shape (3,)."""
        return np.asarray(
            self.seen_b - np.swapaxes(so3.to_matrix(state.q_nb), -1, -2) @ self.known_n
        )

    def jacobian(self, state: Nominal) -> Array:
        """Return the Jacobian, shape (3, 15)."""
        H = np.zeros((3, N))
        H[:, ATT] = so3.skew(so3.to_matrix(state.q_nb).T @ self.known_n)
        return H
