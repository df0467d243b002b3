"""The mean wind of an estimate, as one speaks of it: its speed, and where it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.state import WIND, Table


@dataclass(slots=True)
class MeanWind:
    """The mean of the wind over all estimates that know it."""

    count: int = 0
    north: float = 0.0
    """Sum over them of where the air moves to, m/s."""
    east: float = 0.0

    def add(self, table: Table) -> None:
        """Add estimates."""
        wind = table.columns(WIND)
        wind = wind[np.isfinite(wind).all(axis=1)]
        self.count += len(wind)
        self.north += float(wind[:, 0].sum())
        self.east += float(wind[:, 1].sum())

    @property
    def speed(self) -> float:
        """Of the mean, m/s; NaN: it is not known."""
        return math.hypot(self.north, self.east) / self.count if self.count else math.nan

    @property
    def words(self) -> str:
        """Speed and direction: ``5.0 m/s from 250 deg``; empty: it is not known."""
        if not self.count:
            return ""
        origin = math.degrees(math.atan2(-self.east, -self.north)) % 360.0
        return f"{self.speed:.1f} m/s from {origin:.0f} deg"
