"""Whom to believe: a chi-square gate on the innovations, and for how long not to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import GateSettings, chi_square_quantile

Array = npt.NDArray[np.float64]


class Gate:
    """Judges innovations by aid, and keeps count."""

    def __init__(self, settings: GateSettings) -> None:
        self._limits = [chi_square_quantile(settings.probability, dof) for dof in (1, 2, 3)]
        self._patience = {
            "position": settings.timeout_position,
            "velocity": settings.timeout_velocity,
            "heading": settings.timeout_heading,
        }
        self._refused_ns: dict[str, int] = {}
        self._counts: dict[str, list[int]] = {}

    @property
    def counts(self) -> Mapping[str, tuple[int, int]]:
        """Give how many of each aid were fused, and how many refused."""
        return {aid: (fused, refused) for aid, (fused, refused) in self._counts.items()}

    def admits(self, aid: str, t_ns: int, z: Array, S: Array) -> bool:
        """Judge an innovation; after a time-out all are believed, until one is good.

        Args:
            aid: Whose it is.
            t_ns: When.
            z: Innovation, shape (m,), m 1 to 3.
            S: Its covariance, shape (m, m).
        """
        return self.judges(aid, t_ns, float(z @ np.linalg.solve(S, z)), len(z))

    def allows(self, nis: float, dof: int) -> bool:
        """Say whether a normalised innovation squared is one that a good measurement has."""
        return nis <= self._limits[dof - 1]

    def judges(self, aid: str, t_ns: int, nis: float, dof: int) -> bool:
        """Judge an innovation by its normalised square, as :meth:`admits` does."""
        counts = self._counts.setdefault(aid, [0, 0])
        since_ns = self._refused_ns.setdefault(aid, t_ns)
        is_good = self.allows(nis, dof)
        if is_good:
            del self._refused_ns[aid]
        is_believed = is_good or (t_ns - since_ns) * 1e-9 > self._patience[aid]
        counts[0 if is_believed else 1] += 1
        return is_believed
