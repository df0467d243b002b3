"""Time from a read to the estimate sent, counted."""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate

BUCKETS_MS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Bounds of the latency's histogram, ms."""


class Latency:
    """Time from a read to the estimate sent, as a histogram."""

    def __init__(self) -> None:
        self._bounds_ns = [round(bound * 1e6) for bound in BUCKETS_MS]
        self._counts = [0] * (len(BUCKETS_MS) + 1)
        self.sum_ns = 0

    def take(self, took_ns: int, times: int = 1) -> None:
        """Count estimates that left so long after what they are of was read."""
        self._counts[bisect_left(self._bounds_ns, took_ns)] += times
        self.sum_ns += took_ns * times

    @property
    def count(self) -> int:
        """Give how many were counted."""
        return sum(self._counts)

    def cumulative(self) -> dict[float, int]:
        """Give how many took no longer than each bound, ms."""
        return dict(zip(BUCKETS_MS, accumulate(self._counts), strict=False))
