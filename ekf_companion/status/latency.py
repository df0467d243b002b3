"""Histogram of the time from a read to an estimate sent."""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate

BUCKETS_MS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Bounds of the latency's histogram, ms."""


class Latency:
    """Histogram of the time from the read of a sample until the link has taken the estimate."""

    def __init__(self) -> None:
        self._bounds_ns = [round(bound * 1e6) for bound in BUCKETS_MS]
        self._counts = [0] * (len(BUCKETS_MS) + 1)
        self.sum_ns = 0

    def add(self, took_ns: int, times: int = 1) -> None:
        """Count estimates that were sent so long after their sample was read."""
        self._counts[bisect_left(self._bounds_ns, took_ns)] += times
        self.sum_ns += took_ns * times

    @property
    def count(self) -> int:
        """Return how many were counted."""
        return sum(self._counts)

    def cumulative(self) -> dict[float, int]:
        """Return how many took no longer than each bound, ms."""
        return dict(zip(BUCKETS_MS, accumulate(self._counts), strict=False))
