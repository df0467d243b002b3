"""Zero-velocity detectors on windows of inertial samples, and the rest with which a walk begins.

Each detector computes a mean over a centred window, in units of the motion of a planted foot. Below
one the sensor is still, for every detector, at every rate.

Source: Skog, Haendel, Nilsson, Rantakokko 2010, "Zero-velocity detection - an algorithm
evaluation", IEEE Trans. Biomedical Engineering 57(11), equations 11 to 16; there the unit is the
sensor's noise and the threshold is large, here the unit contains the threshold.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.filters.inertial import LARGEST_BIAS, level
from ekf_companion.nav.arrays import Array, runs
from ekf_companion.nav.measurements import Events

WINDOW = 0.5
"""Window in which the samples must agree, s."""
SHORTEST = 0.5
"""Least length of a rest, s."""
LATEST = 10.0
"""Latest begin of the rest after the first sample, s."""
GYRO = 0.03
"""Largest deviation at rest, root mean square, rad/s: a standing person sways by a third."""
ACCEL = 0.2
"""Largest deviation at rest, root mean square, m/s^2: five times a small sensor's noise."""
LIGHTEST, HEAVIEST = 5.0, 15.0
"""m/s^2; the scale of an accelerometer is not wrong by half."""
SLOWEST = 50.0
"""Least rate of samples for a stride, Hz."""


class Detector(Enum):
    """The criterion of a detector."""

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
    """Root mean squares over a window below which a sensor is still."""

    gyro: float
    """rad/s, > 0."""
    accel: float
    """m/s^2, > 0."""


def statistic(
    detector: Detector, gyro: Array, accel: Array, gravity: float, limits: Limits, half: int
) -> Array:
    """Return a detector's statistic at each sample, shape (n,); below one the sensor is still.

    Rates are in rad/s, specific forces in m/s^2, shape (n, 3), and gravity as this accelerometer
    measures it at rest. The window has ``half`` samples on either side, at the ends fewer.
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
    # |f - g u|^2, u along the window's mean, the direction of best fit
    along = np.linalg.norm(mean, axis=1)
    misfit = np.maximum(length2 - 2.0 * gravity * along + gravity * gravity, 0.0)
    return np.asarray(misfit / accel2 + _mean(np.square(gyro).sum(axis=1), half) / gyro2)


def moving_variance(values: Array, half: int) -> Array:
    """Return the variance over a centred window, summed over axes; values (n, m), result (n,)."""
    # About the overall mean, so that mean square and squared mean do not cancel badly
    values = values - values.mean(axis=0)
    mean2 = sum(np.square(_mean(column, half)) for column in values.T)
    return np.asarray(np.maximum(_mean(np.square(values).sum(axis=1), half) - mean2, 0.0))


def _mean(values: Array, half: int) -> Array:
    """Return the mean over a centred window, cut short at the ends, by one cumulative sum."""
    n = len(values)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(n)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, n)
    return np.asarray((sums[last] - sums[first]) / (last - first))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rest:
    """The rest at the start, and what the sensors measured in it."""

    first: int
    """Index of its first sample."""
    period: float
    """Step between samples, s."""
    gravity: float
    """Length of the mean specific force, m/s^2: gravity by this accelerometer."""
    gyro: Array
    """Mean rate, rad/s, b: the bias."""
    q_nb: Array
    """Level by the mean specific force, yaw 0."""
    gyro_noise: float
    """Root mean square of all axes about their means, rad/s."""
    accel_noise: float
    """m/s^2."""
    notes: tuple[str, ...]
    """What the user should know."""


def first_rest(imu: Events) -> Rest:
    """Find the first rest of inertial samples with ascending stamps.

    Raises:
        LogError: There are too few samples, no rest, or no gravity.
    """
    if len(imu) < 2:
        raise LogError(
            f"{len(imu)} inertial samples: too few to navigate by; record gyro and accelerometer "
            f"at {SLOWEST:g} Hz or more"
        )
    period = float(np.median(np.diff(imu.t_ns))) * 1e-9
    if period * SLOWEST > 1.0:
        raise LogError(
            f"{1.0 / period:.1f} inertial samples per second: too few to follow a stride; record "
            f"at {SLOWEST:g} Hz or more"
        )
    gyro, accel = imu.values[:, 0:3], imu.values[:, 3:6]
    half = round(0.5 * WINDOW / period)
    is_still = moving_variance(gyro, half) < GYRO**2
    is_still &= moving_variance(accel, half) < ACCEL**2
    # As quiet as a rest is a steady turn; no gyro has such a bias
    rate = np.stack([_mean(axis, half) for axis in gyro.T], axis=1)
    is_still &= np.linalg.norm(rate, axis=1) < LARGEST_BIAS
    stamps = (imu.t_ns - imu.t_ns[0]) * 1e-9
    dead = None
    for first, last in runs(is_still):
        # Half a window next to a motion contains some of it, and would bias the gyro's mean
        first, last = first + half * (first > 0), last - half * (last < len(imu))
        is_long = first < last and stamps[last - 1] - stamps[first] >= SHORTEST
        if is_long and stamps[first] <= LATEST:
            try:
                return _rest(
                    gyro[first:last], accel[first:last], first, period, float(stamps[first])
                )
            except LogError as error:
                dead = error
    if dead is not None:
        raise dead
    raise LogError(
        f"no rest of {SHORTEST:g} s in the first {LATEST:g} s of {stamps[-1]:.1f} s: down and the "
        "bias of the gyro cannot be found; stand still for two seconds before walking"
    )


def _rest(gyro: Array, accel: Array, first: int, period: float, start: float) -> Rest:
    mean = accel.mean(axis=0)
    gravity = float(np.linalg.norm(mean))
    if not LIGHTEST < gravity < HEAVIEST:
        raise LogError(
            f"the accelerometer reads {gravity:.2f} m/s^2 at rest, where gravity is 9.8: it is "
            "dead, or the log has another unit"
        )
    late = f"the first {start:.1f} s, before the sensor came to rest, were left out"
    return Rest(
        first=first,
        period=period,
        gravity=gravity,
        gyro=gyro.mean(axis=0),
        q_nb=level(mean),
        gyro_noise=float(np.sqrt(gyro.var(axis=0).sum())),
        accel_noise=float(np.sqrt(accel.var(axis=0).sum())),
        notes=(late,) if first else (),
    )
