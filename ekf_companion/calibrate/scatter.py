"""Scatter of a receiver's fixes: white from fix to fix, and slow over minutes.

The structure function of an error e is ``D(tau) = E[(e(t + tau) - e(t))^2] / 2``. White noise
adds its variance at any lag, a slow error of correlation time T adds ``s^2 (1 - exp(-tau / T))``.
At rest the fixes themselves are the error. In flight the motion is subtracted: from positions the
integral of the receiver's own velocity, with the estimator's between fixes; from velocities the
integral of the specific force. The error of such a reference is smooth from one fix to the next, so
the white level is taken from second differences, whose variance is six times that of white noise.

Source: IEEE Std 952-1997, annex C (structure function); Kolmogorov 1941; J. von Neumann 1941,
Annals of Mathematical Statistics 12, 4 (successive differences).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array

MEDIAN = 1.4826
"""Standard deviation over median of the size, of normal numbers."""
FEWEST = 30
"""Least number of second differences for a white level."""
LONGEST = 0.5
"""Longest lag used, as a share of the longest series."""
TINY = 1e-12
"""Least variance, square units."""
BETTER = 10.0
"""Least gain in twice the log-likelihood of a slow error over white noise alone."""
LEAST_SLOW = 0.5
"""Share of the white noise below which a slow error does not matter."""
SEEN = 6.0
"""Least length of a series that shows a correlation time, over that time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scatter:
    """White and slow part of an error, per axis."""

    white: float
    """One sigma."""
    white_std: float
    """One sigma of the white level, as a share of it."""
    slow: float
    """One sigma, of what the log is long enough to show."""
    time: float | None
    """Correlation time of the slow part, s; None: not significant, or the log is too short."""
    lag: Array
    """s."""
    structure: Array
    """Structure function, less the random walk of the reference."""
    seconds: float
    """Length of the longest series."""

    def model(self, time: float) -> Array:
        """Return the structure function at the lags for a correlation time, s."""
        return np.asarray(self.white**2 + self.slow**2 * (1.0 - np.exp(-self.lag / time)))


def measure(series: Sequence[Array], period: float, wander: float = 0.0) -> Scatter | None:
    """Split errors of fixes into a white and a slow part; return None if there are too few.

    Args:
        series: Errors up to a constant, each of shape (n, axes).
        period: From fix to fix, s.
        wander: Random walk of the reference, units^2 per s.
    """
    second = [np.diff(errors, 2, axis=0).ravel() for errors in series]
    jumps = np.concatenate([np.zeros(0), *second])
    if len(jumps) < FEWEST:
        return None
    white = _sigma(jumps) / math.sqrt(6.0)
    seconds = max(map(len, series)) * period
    lag, structure, freedom = _structure(series, period)
    structure = np.maximum(structure - 0.5 * wander * lag, 0.0)
    slow, time = _slow_part(lag, structure, freedom, white, seconds, wander)
    return Scatter(
        white=white,
        # A median is as sure as a mean of a third of them; neighbours share two fixes of three
        white_std=1.6 / math.sqrt(len(jumps)),
        slow=slow,
        time=time,
        lag=lag,
        structure=structure,
        seconds=seconds,
    )


def _sigma(values: Array) -> float:
    """Return the standard deviation by the median, or if that is 0 by the mean square."""
    robust = MEDIAN * float(np.median(np.abs(values)))
    return robust if robust > 0.0 else float(np.sqrt(np.mean(values**2)))


def _structure(series: Sequence[Array], period: float) -> tuple[Array, Array, Array]:
    """Return lags, the structure function there, and the numbers of independent differences."""
    most = max(int(LONGEST * max(map(len, series))), 1)
    steps = np.unique(np.rint(np.geomspace(1, most, 40)).astype(np.int64))
    structure, freedom = [], []
    for step in steps.tolist():
        differences = np.concatenate([(one[step:] - one[:-step]).ravel() for one in series])
        structure.append(0.5 * _sigma(differences) ** 2)
        freedom.append(max(len(differences) / step, 1.0))
    lag = np.asarray(steps * period, dtype=np.float64)
    return lag, np.array(structure), np.array(freedom)


def _slow_part(
    lag: Array, structure: Array, freedom: Array, white: float, seconds: float, wander: float
) -> tuple[float, float | None]:
    """Return level and correlation time of the slow part.

    The time is None if the white noise fits nearly as well, if the series is too short for it, and
    if the reference wanders as much.
    """

    def misfit(modelled: Array) -> float:
        return float(np.sum(freedom * (np.log(modelled) + structure / modelled)))

    alone = np.full(len(lag), white**2 + TINY)
    best, level, time = misfit(alone), 0.0, seconds
    for each in np.geomspace(5.0 * lag[0], 2.0 * seconds, 60):
        rise = 1.0 - np.exp(-lag / each)
        modelled = np.maximum(structure, alone)
        for _ in range(4):
            weight = freedom * rise / modelled**2
            height = max(float(weight @ (structure - white**2) / (weight @ rise)), 0.0)
            modelled = alone + height * rise
        if misfit(modelled) < best - BETTER:
            best, level, time = misfit(modelled), height, float(each)
    if time * SEEN <= seconds and level > max(1.5 * wander * time, (LEAST_SLOW * white) ** 2):
        return float(np.sqrt(level)), time
    return float(np.sqrt(max(structure[-1] - white**2, 0.0))), None
