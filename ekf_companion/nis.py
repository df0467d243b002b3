"""How well the innovations of the last seconds agree with what the filter expected of them.

The filter's own account is a mean over all of its life, in which a receiver that has just gone bad
does not show for minutes. From its sums now and a while ago follows the mean since then.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.pipeline import Aid, Array, Pipeline

SPAN = 20
"""Seconds that the mean is over: a hundred fixes at 5 Hz, of which it has a sigma of 0.1."""
_STEP = 2


class _Sums(NamedTuple):
    now_ns: int
    nis: Array
    counts: Array


class RecentNis:
    """Mean normalised innovation squared of each aid over the last seconds."""

    def __init__(self) -> None:
        self._pipeline: Pipeline | None = None
        self._looks: deque[_Sums] = deque(maxlen=SPAN // _STEP)

    def look(self, pipeline: Pipeline, now_ns: int) -> None:
        """Keep the sums of this moment; to be called every second or two."""
        if pipeline is not self._pipeline:
            self._pipeline = pipeline
            self._looks.clear()
        if self._looks and now_ns - self._looks[-1].now_ns < _STEP * SECOND_NS:
            return
        sums = _Sums(now_ns, *pipeline.nis_sums())
        if self._looks and (sums.counts < self._looks[-1].counts).any():
            self._looks.clear()  # the filter began anew
        self._looks.append(sums)

    def mean(self) -> dict[Aid, float]:
        """Give it over its degrees of freedom: 1 if all is well; NaN: none in that time."""
        if self._pipeline is None or not self._looks:
            return dict.fromkeys(Aid, math.nan)
        nis, counts = self._pipeline.nis_sums()
        first = self._looks[0]
        new = counts - first.counts
        return {
            aid: float((nis[aid] - first.nis[aid]) / new[aid]) if new[aid] > 0.0 else math.nan
            for aid in Aid
        }
