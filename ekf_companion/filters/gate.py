"""Whom to believe: a chi-square gate on the innovations, and for how long not to."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import GateSettings, chi_square_quantile

Array = npt.NDArray[np.float64]


class Trust(Enum):
    """What is to be done with a measurement."""

    REFUSED = 0
    """Leave it out."""
    FUSED = 1
    """Weigh it against the estimate."""
    RESET = 2
    """Take what it shows from it alone: for too long the estimate has agreed with none."""


class Gate:
    """Judges innovations by aid, and keeps count."""

    def __init__(self, settings: GateSettings) -> None:
        self._limits = [chi_square_quantile(settings.probability, dof) for dof in (1, 2, 3)]
        self._patience = {
            "position": settings.timeout_position,
            "velocity": settings.timeout_velocity,
            "heading": settings.timeout_heading,
        }
        self._accepted_ns: dict[str, int] = {}
        self._counts: dict[str, list[int]] = {}
        self._resets: dict[str, int] = {}

    @property
    def counts(self) -> Mapping[str, tuple[int, int]]:
        """Return how many of each aid were taken, and how many refused."""
        return {aid: (taken, refused) for aid, (taken, refused) in self._counts.items()}

    @property
    def resets(self) -> Mapping[str, int]:
        """Return how many measurements of each aid reset the estimate after a time-out."""
        return dict(self._resets)

    def admits(self, aid: str, t_ns: int, z: Array, S: Array) -> Trust:
        """Judge an innovation; the first that fails after a time-out resets what it shows.

        Args:
            aid: Whose it is.
            t_ns: When.
            z: Innovation, shape (m,), m 1 to 3.
            S: Its covariance, shape (m, m).
        """
        return self.judges(aid, t_ns, float(z @ np.linalg.solve(S, z)), len(z))

    def patience(self, aid: str) -> float:
        """Return how long an aid may be refused, s."""
        return self._patience[aid]

    def allows(self, nis: float, dof: int) -> bool:
        """Return whether a normalised innovation squared is one that a good measurement has."""
        return nis <= self._limits[dof - 1]

    def judges(self, aid: str, t_ns: int, nis: float, dof: int) -> Trust:
        """Judge an innovation by its normalised square, as :meth:`admits` does."""
        counts = self._counts.setdefault(aid, [0, 0])
        # The first is waited for as if the one before had been good
        since_ns = self._accepted_ns.setdefault(aid, t_ns)
        trust = Trust.FUSED
        if not self.allows(nis, dof):
            is_over = (t_ns - since_ns) * 1e-9 > self._patience[aid]
            trust = Trust.RESET if is_over else Trust.REFUSED
        if trust is Trust.RESET:
            self._resets[aid] = self._resets.get(aid, 0) + 1
        if trust is not Trust.REFUSED:
            self._accepted_ns[aid] = t_ns
        counts[1 if trust is Trust.REFUSED else 0] += 1
        return trust
