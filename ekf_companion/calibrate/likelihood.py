"""Likelihood of a log's fixes by delay."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array

JUDGED = (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY)


class Likelihood:
    """Log-likelihood by delay, each computed once."""

    def __init__(self, recording: Recording, settings: FilterSettings) -> None:
        self._recording = recording
        self._settings = settings
        self._cuts: list[int] = []
        self._known: dict[int, tuple[Array, int]] = {}
        self.rows = 0
        """Largest number of rows that were judged under one delay."""

    def cut(self, seconds: Array) -> None:
        """Count from the first of some stamps (s) on, in blocks that end at the other stamps."""
        newest = np.maximum.accumulate(self._recording.events.t_ns)
        stamps = np.rint(seconds * 1e9).astype(np.int64)
        self._cuts = [0, *np.searchsorted(newest, stamps, side="right").tolist()]
        self._known.clear()

    def blocks(self, delay: float) -> Array:
        """Return the sum of each block."""
        key = round(delay * 1e6)
        if key not in self._known:
            self._known[key] = self._run(key * 1e-6)
            self.rows = max(self.rows, self._known[key][1])
        return self._known[key][0]

    def total(self, delay: float) -> float:
        """Return the sum; a fix that was not judged counts as the mean of the rest.

        That is one or two at the ends, or many where the filter had to restart.
        """
        total = float(self.blocks(delay).sum())
        count = self._known[round(delay * 1e6)][1]
        return total * self.rows / count if count else -math.inf

    def scaled(self, delay: float) -> Array:
        """Return the sum of each block, scaled so that all delays count the same number of rows."""
        blocks = self.blocks(delay)
        return blocks * (self.rows / max(self._known[round(delay * 1e6)][1], 1))

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
        recording = self._recording
        gnss = replace(self._settings.gnss, delay=delay, delay_std=0.0)
        pipeline = Pipeline(replace(self._settings, gnss=gnss), recording.family)
        sums, counts = [], []
        for first, last in zip(self._cuts, self._cuts[1:], strict=False):
            pipeline.run(recording.events.take(np.arange(first, last)))
            sums.append(pipeline.log_likelihood)
            counts.append(judged(pipeline))
        return np.diff(sums), counts[-1] - counts[0]


def judged(pipeline: Pipeline) -> int:
    """Return how many GNSS positions, heights and velocities were fused or refused so far."""
    verdicts = pipeline.health().verdicts
    return sum(verdicts[aid][Verdict.FUSED] + verdicts[aid][Verdict.GATED] for aid in JUDGED)
