"""A pipeline that is looked at once a second while it runs over a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import REFUSALS, Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import Table, join

PERIOD_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What the filter did in one second."""

    t_ns: int
    """At its end, the newest sample's stamp."""
    fused: Mapping[Aid, int]
    """With full or with less weight."""
    refused: Mapping[tuple[Aid, Verdict], int]
    """By why it was: one of ``REFUSALS``."""
    nis: Array
    """Mean normalised innovation squared over its degrees of freedom, by aid; NaN: none."""
    reset: str
    """Reason of the last reset in it; empty: none."""
    gyro_noise: float
    """White noise learnt by then, rad/s per square root of Hz."""
    accel_noise: float
    """Likewise, m/s^2 per square root of Hz."""


class WatchedPipeline(Pipeline):
    """Runs over a block in pieces of a second, and notes what the filter did in each."""

    def __init__(
        self, settings: FilterSettings, family: str = "unknown", gnss_delay: float | None = None
    ) -> None:
        super().__init__(settings, family, gnss_delay)
        self.looks: list[Look] = []
        self._before = self._counters()

    def run(self, events: Events) -> Table:
        """Process events by the same steps as any pipeline: where they are cut changes no bit."""
        if not len(events):
            return super().run(events)
        slots = np.maximum.accumulate(events.t_ns) // PERIOD_NS
        tables = []
        for rows in np.split(np.arange(len(events)), np.flatnonzero(np.diff(slots)) + 1):
            tables.append(super().run(events.take(rows)))
            self._look()
        return join(tables)

    def _counters(self) -> tuple[Array, Array, Array, int]:
        self._health = health = self.health()
        counts = np.array([[health.verdicts[aid][why] for why in Verdict] for aid in Aid])
        return counts, *self.nis_sums(), health.resets

    def _look(self) -> None:
        counts, nis, number, resets = self._counters()
        counts_0, nis_0, number_0, resets_0 = self._before
        self._before = counts, nis, number, resets
        new = np.maximum(counts - counts_0, 0)
        fused = new[:, Verdict.FUSED] + new[:, Verdict.DEWEIGHTED]
        more = number - number_0
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(more > 0, (nis - nis_0) / more, np.nan)
        self.looks.append(
            Look(
                t_ns=self.stamp_ns,
                fused={aid: int(fused[aid]) for aid in Aid},
                refused={(aid, why): int(new[aid, why]) for aid in Aid for why in REFUSALS},
                nis=mean,
                reset=self._health.reset_reason if resets > resets_0 else "",
                gyro_noise=self._health.gyro_noise,
                accel_noise=self._health.accel_noise,
            )
        )
