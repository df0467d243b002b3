"""Inertial samples in the order in which they come, each judged by those before and the next one.

What a whole recording shows at once (:func:`ekf_companion.lidar.motion.prepare`) is not known yet.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ekf_companion.lidar.motion import (
    LEAST_FORCE_RANGE,
    LEAST_RATE_RANGE,
    WINDOW,
    Samples,
)
from ekf_companion.nav.arrays import Array

SAME = 1e-4
"""Relative difference of two readings at the end of a range: as the kernel's."""
USUAL = 0.005
"""Step before it is known, s: of 200 Hz."""
STEPS = 40
"""By which the usual step is found: a start has as many of the slowest, 50 Hz."""
LEAST = np.repeat([LEAST_RATE_RANGE, LEAST_FORCE_RANGE], 3)
_VALUES, _CLIPPED, _VIBRATION = slice(1, 7), slice(7, 13), slice(13, 19)


class Heard:
    """The samples of one run of a clock."""

    def __init__(self) -> None:
        self._rows = np.zeros((1024, 19))
        self._count = 0
        self._largest = np.zeros(6)
        self._steps: list[float] = []
        self._step = USUAL
        self._sums: deque[Array] = deque(maxlen=WINDOW + 2)
        """Of the squares of what is not smooth, up to each of the last samples."""

    def __len__(self) -> int:
        """Return the number of samples that are kept."""
        return self._count

    @property
    def judged(self) -> float:
        """Return the time up to which samples will stay as they are, s; -inf: none."""
        return float(self._rows[self._count - 2, 0]) if self._count > 2 else -np.inf

    def add(self, stamp: float, gyro: Array, accel: Array) -> None:
        """Take the next sample: s, rad/s and m/s^2."""
        if self._count == len(self._rows):
            self._rows = np.vstack([self._rows, np.zeros_like(self._rows)])
        rows, k = self._rows, self._count
        rows[k, 0] = stamp
        rows[k, 1:4], rows[k, 4:7] = gyro, accel
        values = rows[k, _VALUES]
        size = np.abs(values)
        if k > 0:
            before = rows[k - 1, _VALUES]
            is_same = (
                (size > LEAST)
                & (size >= self._largest * (1.0 - SAME))
                & (np.abs(values - before) <= SAME * size)
            )
            rows[k, _CLIPPED] = is_same
            rows[k - 1, _CLIPPED] += is_same
            self._judge(k, values, before)
            self._measure_step(stamp - float(rows[k - 1, 0]))
        self._largest = np.maximum(self._largest, size)
        self._count += 1

    def _judge(self, k: int, values: Array, before: Array) -> None:
        """Find the vibration up to the sample before, now that there is one after it."""
        if not self._sums:
            self._sums.append(np.zeros(6))
            return
        # The second difference of white noise has six times its variance
        square = (values - 2.0 * before + self._rows[k - 2, _VALUES]) ** 2 / 6.0
        self._sums.append(self._sums[-1] + square)
        is_full = len(self._sums) == WINDOW + 2
        first = self._sums[0] if is_full else 0.0
        among = len(self._sums) - is_full
        self._rows[k - 1, _VIBRATION] = (self._sums[-1] - first) / among

    def _measure_step(self, step: float) -> None:
        if len(self._steps) < STEPS:
            self._steps.append(step)
            self._step = float(np.median(self._steps)) if len(self._steps) == STEPS else USUAL

    def forget(self, before: float) -> None:
        """Forget the samples before a time, s, but the last three."""
        first = int(np.searchsorted(self._rows[: self._count, 0], before))
        first = min(first, self._count - 3)
        # Not each time: moving costs more than keeping
        if first > len(self._rows) // 2:
            self._rows[: self._count - first] = self._rows[first : self._count].copy()
            self._count -= first

    def samples(self) -> Samples:
        """Return a copy of the samples that are kept."""
        rows = self._rows[: self._count].copy()
        return Samples(
            rows[:, 0],
            rows[:, 1:4],
            rows[:, 4:7],
            rows[:, _CLIPPED] > 0.0,
            self._step,
            rows[:, _VIBRATION] * self._step,
        )
