"""Allan deviation, and the white noise, bias instability and random walk that it shows.

For white noise of density N the Allan variance falls as ``N^2 / tau``; a random walk of the bias
makes it rise as ``K^2 tau / 3``; between them flicker keeps it at ``(0.664 B)^2``. An autopilot's
low-pass removes white noise at short times: it is read off at longer ones.

Source: IEEE Std 952-1997, annex C; W. J. Riley 2008, NIST SP 1065, sections 5.2.4 (overlapping
estimator) and 5.4 (degrees of freedom).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.errors import part_of
from ekf_companion.nav.arrays import Array

with part_of("calibrate", "calibrate"):
    from scipy.optimize import nnls
    from scipy.signal import welch

FLICKER = 2.0 * np.log(2.0) / np.pi
"""Allan variance of flicker noise of B = 1, where it is flat."""
LONGEST = 0.25
"""Longest time used, as a share of a stretch."""
BEYOND = 3.0
"""Periods of the low-pass's corner beyond which white noise is read off."""
UNFILTERED = 0.35
"""Share of the sampling rate above which a corner counts as none."""
NOTHING = 1e-24
"""Least variance, for a sensor that always reads the same."""
SHOWS = 2.0
"""Sigmas above zero at which a term counts as present; below, its bound is reported."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Curve:
    """Allan deviation of one axis."""

    tau: Array
    """Averaging times, ascending, s."""
    deviation: Array
    """In the unit of the samples."""
    freedom: Array
    """Degrees of freedom of each variance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """One number of a fit."""

    value: float
    """Best value; 0 if it is not significantly above zero."""
    bound: float
    """Upper bound (two sigmas)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """The noise terms of one axis."""

    white: float
    """N: density, unit per square root of Hz."""
    white_std: float
    """One sigma, as a share of it."""
    instability: Level
    """B: in the unit of the samples."""
    walk: Level
    """K: unit per square root of s."""
    corner: float | None
    """Frequency at which a low-pass halves the power, Hz; None: there is none."""
    white_from: float
    """Averaging time from which on the white noise was read off, s."""


def curve(stretches: Sequence[Array], period: float, taus: Array | None = None) -> Curve:
    """Return the overlapping Allan deviation over all stretches, each shape (n,).

    Their samples at rest are evenly spaced by the period, s. The averaging times, s, are by default
    octaves from one sample to a quarter of the longest stretch.
    """
    longest = max(map(len, stretches))
    if taus is None:
        octaves = int(np.log2(max(LONGEST * longest, 1.0)))
        taus = np.asarray(period * 2.0 ** np.arange(octaves + 1), dtype=np.float64)
    sizes = np.unique(np.maximum(np.rint(taus / period).astype(np.int64), 1))
    tau, variance, freedom = [], [], []
    for m in sizes[sizes <= LONGEST * longest].tolist():
        total = count = dof = 0.0
        for part in stretches:
            if m > LONGEST * len(part):
                continue
            phase = np.concatenate([[0.0], np.cumsum(part - part.mean())])
            second = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
            total += float(second @ second) / (2.0 * m * m)
            count += len(second)
            # For white noise (table 5)
            n = len(phase)
            ratio = 1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n
            dof += max(ratio * 4.0 * m * m / (4.0 * m * m + 5.0), 1.0)
        tau.append(m * period)
        variance.append(total / count)
        freedom.append(dof)
    return Curve(tau=np.array(tau), deviation=np.sqrt(variance), freedom=np.array(freedom))


def corner(stretches: Sequence[Array], period: float) -> float | None:
    """Return the frequency where the power falls to half of that below, Hz, or None."""
    size = min(512, min(map(len, stretches)))
    powers = [welch(part, 1.0 / period, nperseg=size)[1] * len(part) for part in stretches]
    frequency = np.fft.rfftfreq(size, period)
    power = np.sum(powers, axis=0)
    # Median over a fifth of an octave either way, against single lines of hum
    smooth = np.array(
        [np.median(power[(frequency > 0.87 * f) & (frequency < 1.15 * f)]) for f in frequency[2:]]
    )
    frequency = frequency[2:]
    halved = smooth < 0.5 * np.array([np.median(smooth[: max(i, 3)]) for i in range(len(smooth))])
    stays = np.flip(np.logical_and.accumulate(np.flip(halved)))
    first = int(np.argmax(stays)) if stays.any() else len(stays)
    if first == len(stays) or frequency[first] > UNFILTERED / period:
        return None
    return float(frequency[first])


def fit(stretches: Sequence[Array], period: float) -> tuple[Curve, Noise]:
    """Fit white noise, flicker and random walk to one axis at rest.

    The stretches, each of shape (n,), are evenly spaced by the period, s.
    """
    found = curve(stretches, period)
    cut = corner(stretches, period)
    begin = 0.0 if cut is None else BEYOND / cut
    used = found.tau >= min(begin, float(found.tau[-3:][0]))
    tau, freedom = found.tau[used], found.freedom[used]
    variance = np.maximum(found.deviation[used] ** 2, NOTHING)
    terms = np.stack([1.0 / tau, np.full(len(tau), FLICKER), tau / 3.0], axis=1)
    scale = variance[0] * np.array([tau[0], 1.0, 1.0 / tau[-1]])
    # Weighted by the fit: weighted by itself, a variance small by chance would look sure
    modelled = variance
    for _ in range(6):
        rows = terms * (np.sqrt(0.5 * freedom) / modelled)[:, None] * scale
        values = nnls(rows, variance * np.sqrt(0.5 * freedom) / modelled)[0]
        modelled = np.maximum((terms * scale) @ values, 1e-3 * variance)
    sigma = np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows))) * scale
    squares = values * scale
    levels = [_level(square, std) for square, std in zip(squares[1:], sigma[1:], strict=True)]
    return found, Noise(
        white=float(np.sqrt(squares[0])),
        white_std=float(0.5 * sigma[0] / squares[0]) if squares[0] > 0.0 else 1.0,
        instability=levels[0],
        walk=levels[1],
        corner=cut,
        white_from=float(tau[0]),
    )


def _level(square: float, sigma: float) -> Level:
    shows = square > SHOWS * sigma
    return Level(
        value=float(np.sqrt(square)) if shows else 0.0,
        bound=float(np.sqrt(square + SHOWS * sigma)),
    )
