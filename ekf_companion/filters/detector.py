"""When does a foot or a wheel stand still: four detectors on windows of inertial samples.

Each gives a mean over a centred window, measured in one unit: what a sensor on a planted foot
may do. Below one it stands still, for every detector, at every rate.

Source: Skog, Haendel, Nilsson, Rantakokko 2010, "Zero-velocity detection - an algorithm
evaluation", IEEE Trans. Biomedical Engineering 57(11), equations 11 to 16; there the unit is the
sensor's noise and the threshold is large, here the threshold stands in the unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Detector(Enum):
    """What the windows are asked."""

    SHOE = "shoe"
    """Stance hypothesis optimal detection: is the specific force gravity alone, the rate none?"""
    VARIANCE = "mv"
    """Acceleration moving variance: does the specific force stay the same?"""
    MAGNITUDE = "mag"
    """Acceleration magnitude: is the specific force as large as gravity?"""
    RATE = "are"
    """Angular rate energy: does it not turn?"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What counts as still: root mean squares over a window."""

    gyro: float
    """rad/s, > 0."""
    accel: float
    """m/s^2, > 0."""


def statistic(
    detector: Detector, gyro: Array, accel: Array, gravity: float, limits: Limits, half: int
) -> Array:
    """Return a detector's statistic about each sample; below one the sensor stands still.

    Args:
        detector: Which.
        gyro: Angular rate, rad/s, shape (n, 3).
        accel: Specific force, m/s^2, shape (n, 3).
        gravity: As this accelerometer measures it at rest, m/s^2.
        limits: What counts as still.
        half: Samples on either side of the one asked about; at the ends there are fewer.

    Returns:
        Shape (n,).
    """
    gyro2, accel2 = limits.gyro * limits.gyro, limits.accel * limits.accel
    if detector is Detector.RATE:
        return _mean(np.square(gyro).sum(axis=1), half) / gyro2
    norm = np.linalg.norm(accel, axis=1)
    if detector is Detector.MAGNITUDE:
        return _mean(np.square(norm - gravity), half) / accel2
    if detector is Detector.VARIANCE:
        return moving_variance(accel, half) / accel2
    mean = np.stack([_mean(accel[:, axis], half) for axis in range(3)], axis=1)
    length2 = _mean(norm * norm, half)
    # |f - g u|^2, u along the window's mean: the direction that fits best
    along = np.linalg.norm(mean, axis=1)
    misfit = np.maximum(length2 - 2.0 * gravity * along + gravity * gravity, 0.0)
    return np.asarray(misfit / accel2 + _mean(np.square(gyro).sum(axis=1), half) / gyro2)


def moving_variance(values: Array, half: int) -> Array:
    """Return the variance over a centred window, all axes added; values (n, m), result (n,)."""
    # About the mean of all: what the window's mean square and squared mean share cancels badly
    values = values - values.mean(axis=0)
    mean2 = sum(np.square(_mean(column, half)) for column in values.T)
    return np.asarray(np.maximum(_mean(np.square(values).sum(axis=1), half) - mean2, 0.0))


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first index and the one past the last of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def _mean(values: Array, half: int) -> Array:
    """Return the mean over a centred window, cut short at the ends, by one cumulative sum."""
    n = len(values)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(n)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, n)
    return np.asarray((sums[last] - sums[first]) / (last - first))
