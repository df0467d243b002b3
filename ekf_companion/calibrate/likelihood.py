"""Likelihood of a log's fixes under some settings, and by delay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array

JUDGED = (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY)
_SCORED = (Verdict.FUSED, Verdict.DEWEIGHTED, Verdict.GATED, Verdict.DENIED)


class Likelihood:
    """Log-likelihood by delay, each computed once."""

    def __init__(self, recording: Recording, settings: FilterSettings, edges: Array) -> None:
        """Count from the first of some stamps (s) on, in blocks that end at the other stamps."""
        self._recording = recording
        self._settings = settings
        self._cuts = cuts_at(recording, edges)
        self._known: dict[int, tuple[Array, int]] = {}
        self.rows = 0
        """Largest number of rows that were judged under one delay."""

    def blocks(self, delay: float) -> tuple[Array, int]:
        """Return the sum of each block, and the number of rows judged."""
        key = round(delay * 1e6)
        if key not in self._known:
            self._known[key] = self._run(key * 1e-6)
            self.rows = max(self.rows, self._known[key][1])
        return self._known[key]

    def total(self, delay: float) -> float:
        """Return the sum; a fix that was not judged counts as the mean of the rest.

        That is one or two at the ends, or many where the filter had to restart.
        """
        sums, count = self.blocks(delay)
        return float(sums.sum()) * self.rows / count if count else -math.inf

    def scaled(self, delay: float) -> Array:
        """Return the sum of each block, scaled so that all delays count the same number of rows."""
        sums, count = self.blocks(delay)
        return sums * (self.rows / max(count, 1))

    def curve(self) -> tuple[Array, Array]:
        """Return all delays tried, ascending, and their sums over that of the best."""
        delays = np.array(sorted(self._known)) * 1e-6
        totals = np.array([self.total(float(delay)) for delay in delays])
        return delays, totals - totals.max()

    def best(self) -> float:
        """Return the likeliest of the delays tried."""
        delays, gain = self.curve()
        return float(delays[np.argmax(gain)])

    def _run(self, delay: float) -> tuple[Array, int]:
        gnss = replace(self._settings.gnss, delay=delay, delay_std=0.0)
        return likelihood(self._recording, replace(self._settings, gnss=gnss), self._cuts)


def cuts_at(recording: Recording, edges: Array) -> list[int]:
    """Return the number of events until each of some stamps, s, after a first cut at the begin."""
    newest = np.maximum.accumulate(recording.events.t_ns)
    stamps = np.rint(edges * 1e9).astype(np.int64)
    return [0, *np.searchsorted(newest, stamps, side="right").tolist()]


def likelihood(
    recording: Recording, settings: FilterSettings, cuts: Sequence[int]
) -> tuple[Array, int]:
    """Return the log-likelihood of the fixes between cuts, and how many rows were judged.

    What is before the second cut is run and not counted.
    """
    pipeline = Pipeline(settings, recording.family, recording.gnss_delay)
    sums, counts = [], []
    for first, last in pairwise(cuts):
        pipeline.run(recording.events.take(np.arange(first, last)))
        sums.append(pipeline.log_likelihood)
        verdicts = [pipeline.health().verdicts[aid] for aid in JUDGED]
        counts.append(sum(one[why] for one in verdicts for why in _SCORED))
    return np.diff(sums), counts[-1] - counts[0]
