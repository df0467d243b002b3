"""Linear error-state step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.course import Setup
from ekf_companion.filters.observation import Observation
from ekf_companion.filters.strapdown import Interval, Nominal, in_n, move, transition

Array = npt.NDArray[np.float64]


class Iterated:
    """Error-state filter."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.state: Nominal = setup.start.state
        self.P = setup.start.P.copy()

    def predict(self, over: Interval) -> None:
        """Carry over an interval."""
        Phi = transition(self.state, over, self._setup.earth)
        self.state = move(self.state, over, self._setup.earth)
        self.P = Phi @ self.P @ Phi.T + self._setup.noise.covariance(over.dt)

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse."""
        for aid in aids:
            z, H, R = aid.innovation(self.state), aid.jacobian(self.state), aid.covariance()
            S = H @ self.P @ H.T + R
            if not self._setup.gate.admits(aid.aid, t_ns, z, S):
                continue
            K = np.linalg.solve(S, H @ self.P).T
            L = np.eye(15) - K @ H
            self.P = L @ self.P @ L.T + K @ R @ K.T
            self.state = self.state.plus(K @ z)

    def covariance(self) -> Array:
        """Give the nine."""
        return in_n(self.P, self.state.q_nb)
