"""What the comparisons of a gyro with other sensors share: its turns, and the usual mistakes."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np

from ekf_companion.nav.arrays import Array, Indices, Mask
from ekf_companion.nav.measurements import GNSS_VELOCITY, Events

RATE = 50.0
"""Hz to which the samples are averaged: enough for turns, and few."""
LARGEST = 1e4
"""A number beyond is damaged: no vehicle turns, accelerates or moves so."""
BETTER = 2.0
"""Factor between the statistics as declared, and as something else."""
OFTEN = 0.8
"""Share of the windows in which the something else fits better."""
ALIKE = 1.2
"""Factor within which two choices fit alike."""
MOST_NAMED = 3
"""Likely mistakes in a sentence."""

DEGREES = float(np.rad2deg(1.0))
EXCHANGED = np.eye(3)[[1, 0, 2]]
"""x and y."""
SIGNED = [
    np.diag(signs)[list(axes)]
    for axes in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
"""All 48 ways to exchange and reverse axes; first: none."""
IN_DEGREES = "gyro looks like deg/s: say units={'gyro': 'deg/s'}, in a table gyro_x_dps"
IN_RADIANS = "gyro looks like rad/s that is called deg/s: leave its unit out, in a table gyro_x_rps"


def averaged(imu: Events) -> tuple[Array, Array, Array, Mask]:
    """Return times, s, and means of the samples in each interval of ``RATE``, and if it has any."""
    known = usable(imu.values[:, :6])
    t, values = np.asarray(imu.t_ns[known] * 1e-9), imu.values[known, :6]
    # Hours of time without a sample would be many empty intervals
    if len(t) < 2 or t[-1] - t[0] > 3600.0 + len(t):
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_)
    place: Indices = np.floor((t - t[0]) * RATE).astype(np.int64)
    size = int(place[-1]) + 1
    count = np.bincount(place, minlength=size)
    sums = np.stack([np.bincount(place, column, size) for column in values.T], axis=1)
    means: Array = sums / np.maximum(count, 1)[:, None]
    return t[0] + (np.arange(size) + 0.5) / RATE, means[:, :3], means[:, 3:], np.asarray(count > 0)


def velocities(fixes: Events) -> tuple[Array, Array]:
    """Return times, s, and velocities north, east, down of fixes that have one, m/s.

    A vertical velocity that is not known is 0: then all axes leave a little more.
    """
    known = usable(fixes.values[:, GNSS_VELOCITY][:, :2])
    vel_n = fixes.values[known, GNSS_VELOCITY]
    return np.asarray(fixes.t_ns[known] * 1e-9), np.where(np.abs(vel_n) < LARGEST, vel_n, 0.0)


def variation(vectors: Array) -> Array:
    """Return how much vectors of a window vary about their mean, RMS, shape (windows,).

    Args:
        vectors: Shape (windows, n, axes).
    """
    varies = vectors - vectors.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.square(varies).sum(axis=2).mean(axis=1)))


def usable(values: Array) -> Mask:
    """Return which rows hold numbers that a sensor can measure."""
    return np.asarray((np.abs(values) < LARGEST).all(axis=1))


def at(t: Array, values: Array, times: Array) -> Array:
    """Return columns of values, shape (n, d), between their times, shape (*times, d)."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def spread(chosen: Indices, most: int) -> Indices:
    """Return so many of the windows chosen, evenly over all of them."""
    if len(chosen) <= most:
        return chosen
    return np.asarray(chosen[np.linspace(0, len(chosen) - 1, most).astype(np.int64)])


def fits_better(left: Array) -> Array | None:
    """Return the medians of what each choice leaves if one is far better than the first.

    Args:
        left: By choice and window, shape (choices, windows); the first is what was declared.
    """
    median = np.median(left, axis=1)
    best = int(np.argmin(median))
    is_often = np.mean(left[best] < left[0]) >= OFTEN
    return median if is_often and median[0] >= BETTER * median[best] else None


def named(mistakes: Iterable[tuple[str, float]], best: float) -> str:
    """Return the first mistakes, of words and what they leave, that leave hardly more than best."""
    likely = [words for words, left in mistakes if left < ALIKE * best]
    return ", or ".join(likely[:MOST_NAMED])


def spelled(turn: Array) -> str:
    """Return ``(y, x, z)`` for x and y exchanged."""
    axes = []
    for row in turn:
        axis = int(np.argmax(np.abs(row)))
        axes.append(f"{'-' if row[axis] < 0.0 else ''}{'xyz'[axis]}")
    return f"({', '.join(axes)})"
