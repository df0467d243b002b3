"""Chi-square gate on the innovations, with a time-out after which an aid resets the estimate."""

from __future__ import annotations

from enum import Enum

import numpy as np

from ekf_companion.core.settings.from_settings import chi_square_quantile
from ekf_companion.core.settings.settings import GateSettings
from ekf_companion.filters.observation import Observation, reset
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav.arrays import Array


class Decision(Enum):
    """What to do with a measurement."""

    REFUSED = 0
    """Do not use it."""
    FUSED = 1
    """Fuse it with the estimate."""
    RESET = 2
    """Set what it measures to the measurement: this aid has been refused for too long."""


class Gate:
    """Tests innovations by aid, and counts the results."""

    def __init__(self, settings: GateSettings) -> None:
        self._limits = [chi_square_quantile(settings.probability, dof) for dof in (1, 2, 3)]
        self.patience = {
            "position": settings.timeout_position,
            "velocity": settings.timeout_velocity,
            "heading": settings.timeout_heading,
        }
        """By aid, the time after which it resets the estimate, s; others never do."""
        self.counts: dict[str, tuple[int, int]] = {}
        """By aid, how many measurements were accepted, and how many refused."""
        self.resets: dict[str, int] = {}
        """By aid, how many measurements reset the estimate after a time-out."""
        self._accepted_ns: dict[str, int] = {}

    def test(self, aid: str, t_ns: int, z: Array, S: Array) -> Decision:
        """Test an innovation of 1 to 3 rows; the first that fails after a time-out resets."""
        return self.decide(aid, t_ns, float(z @ np.linalg.solve(S, z)), len(z))

    def reset(self, aid: Observation, state: Nominal, t_ns: int) -> tuple[Array, Array]:
        """Return gain and inflation of a reset, as :func:`~.observation.reset` does."""
        has_velocity = self.counts.get("velocity", (0, 0))[0] > 0
        if has_velocity:
            silent_ns = t_ns - self._accepted_ns["velocity"]
            has_velocity = silent_ns * 1e-9 < self.patience["velocity"]
        return reset(aid, state, self.patience[aid.aid], has_velocity=has_velocity)

    def is_within(self, nis: float, dof: int) -> bool:
        """Return whether a normalised innovation squared is within the gate."""
        return nis <= self._limits[dof - 1]

    def decide(self, aid: str, t_ns: int, nis: float, dof: int) -> Decision:
        """Test an innovation by its normalised square, as :meth:`test` does."""
        accepted, refused = self.counts.get(aid, (0, 0))
        # The time-out counts from the first measurement
        since_ns = self._accepted_ns.setdefault(aid, t_ns)
        decision = Decision.FUSED
        if not self.is_within(nis, dof):
            is_over = (t_ns - since_ns) * 1e-9 > self.patience.get(aid, np.inf)
            decision = Decision.RESET if is_over else Decision.REFUSED
        if decision is Decision.RESET:
            self.resets[aid] = self.resets.get(aid, 0) + 1
        if decision is Decision.REFUSED:
            self.counts[aid] = (accepted, refused + 1)
        else:
            self.counts[aid] = (accepted + 1, refused)
            self._accepted_ns[aid] = t_ns
        return decision
