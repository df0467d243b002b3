"""Whether the times of the fixes and those of the inertial samples are of one clock.

In windows of 6 s in which the specific force varies, the velocity of the fixes shows the same
forces as in :mod:`ekf_companion.review.axes`, if it is read at the right time. So the
statistic of that comparison is tried at shifts of up to half a minute of the fixes: GPS time is
ahead of UTC by the leap seconds, 18 s since 2017 (IERS Bulletin C), and a message that is stamped
on arrival may be seconds late.

The statistic at the best shift is that of the receiver's noise. Of samples that are declared right
none leaves more than 1.3 times that at the delays of receivers, 0 to 0.3 s, in 20 recordings and 18
simulated flights; so where the best shift leaves less than half, the times are wrong. A shift
below 0.6 s is mostly not found: the filter estimates such a delay. A hover, a straight flight or a
steady turn does not show the time, and nothing is said.
"""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np

from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events
from ekf_companion.review.axes import (
    CHANGE,
    DELAYS,
    FEWEST,
    GAP,
    MOST,
    SECONDS,
    integrated_force,
    rest_of_rotation,
)
from ekf_companion.review.turns import (
    ALIKE,
    RATE,
    at,
    averaged,
    fits_better,
    variation,
    velocities,
)
from ekf_companion.review.turns import spread as evenly

FARTHEST, STEP, FINE = 30.0, 0.5, 0.1
"""Largest shift, and steps of the search far from and near to the delays of receivers, s."""
NEAR = 2.0
"""Up to which the steps are fine, s."""
NORMAL = 0.3
"""How far from the delays of receivers a shift must be, s: theirs differ by as much."""
MEANS = 5
"""Samples of ``RATE`` that are averaged: 10 Hz show when a vehicle moved."""
COMPARABLE = 1.0 / 3.0
"""Share of the windows that a shift must leave within the time of the fixes."""


def clock_disagreement(imu: Events, fixes: Events, delay: float | Literal["auto"] = "auto") -> str:
    """Return a sentence if the times of the fixes cannot be meant; empty: they can.

    Args:
        imu: Of ``Kind.IMU``, in the order of their stamps.
        fixes: Of ``Kind.GNSS``, likewise.
        delay: By how much they are declared to be late, s.
    """
    if delay != "auto":
        t_ns = fixes.t_ns - round(delay * 1e9)
        fixes = Events(t_ns=t_ns, kind=fixes.kind, values=fixes.values)
    shift = fix_shift(imu, fixes)
    if shift is None:
        return ""
    side = "late" if shift > 0.0 else "early"
    return (
        f"gnss: its velocities show the motion of gyro and accel {abs(shift):.1f} s too {side}: "
        "the times of both must be of one clock (GPS time is 18 s ahead of UTC: leap seconds), and "
        "those at which the measurements were true, not at which they arrived; where the motion "
        "repeats itself, the shift may be longer by its period. Of a receiver that is known to be "
        "late, set gnss.delay"
    )


def fix_shift(imu: Events, fixes: Events) -> float | None:
    """Return how much too late the stamps of fixes are, s; None: nothing contradicts them."""
    windows = _Windows(imu, fixes)
    if windows.count < FEWEST:
        return None
    declared = windows.left(np.array(DELAYS))
    if not np.isfinite(usual := windows.medians(declared)).any():
        return None
    fine = np.arange(-NEAR, NEAR + FINE / 2, FINE)
    far = np.arange(NEAR + STEP, FARTHEST + STEP / 2, STEP)
    shifts = np.concatenate([fine, far, -far])
    shifts = shifts[np.argsort(np.abs(shifts), kind="stable")]
    coarse = windows.medians(windows.left(shifts))
    best = _around(shifts[np.argsort(coarse, kind="stable")[:3]])
    lowest = min(float(coarse.min()), float(windows.medians(windows.left(best)).min()))
    # Who goes round and round fits at each round: the nearest that fits as well is meant
    if not (alike := np.flatnonzero(coarse < ALIKE * lowest)).size:
        alike = np.array([int(np.argmin(coarse))])
    near = _around(shifts[alike[:1]])
    left = windows.left(near)
    k = int(np.argmin(windows.medians(left)))
    first = int(np.argmin(usual))
    shift, both = float(near[k]), np.isfinite(left[k]) & np.isfinite(declared[first])
    if -NORMAL < shift < DELAYS[-1] + NORMAL or np.count_nonzero(both) < FEWEST:
        return None
    is_better = fits_better(np.stack([declared[first][both], left[k][both]])) is not None
    return shift if is_better else None


def _around(shifts: Array) -> Array:
    """Return shifts within a coarse step of those given, in fine steps."""
    return np.unique(np.round(shifts[:, None] + np.arange(-STEP, STEP + FINE / 2, FINE), 6))


class _Windows:
    """The windows of a flight in which the specific force varies."""

    def __init__(self, imu: Events, fixes: Events) -> None:
        t, gyro, accel, is_full = averaged(imu)
        self._t_fix, self._vel_n = velocities(fixes)
        self._is_gap: Mask = np.concatenate([[True], np.diff(self._t_fix) > GAP, [True]])
        self.count = 0
        length = SECONDS * int(RATE)
        starts = np.arange(0, len(t) - length, length)
        starts = starts[[bool(is_full[one : one + length].mean() > 0.9) for one in starts]]
        if len(self._t_fix) < 2 or not len(starts):
            return
        rows = starts + np.arange(length)[:, None]
        nothing = np.eye(3)[None]
        rates, forces = (
            part[rows].reshape(-1, MEANS, len(starts), 3).mean(axis=1) for part in (gyro, accel)
        )
        force = integrated_force(rates, forces, nothing, nothing, RATE / MEANS)[0]
        chosen = evenly(np.flatnonzero(variation(force) > CHANGE), MOST)
        self.count = len(chosen)
        self._force = force[chosen]
        self._edges = t[starts[chosen], None] - 0.5 / RATE + np.arange(SECONDS + 1)

    def left(self, shifts: Array) -> Array:
        """Return what the best rotation leaves at each shift of the fixes and in each window.

        m/s RMS, shape (shifts, windows); NaN: there are no fixes at that time.
        """
        edges = self._edges + shifts[:, None, None]
        after = np.searchsorted(self._t_fix, edges)
        change = np.diff(at(self._t_fix, self._vel_n, edges), axis=2)
        left = rest_of_rotation(change - [0.0, 0.0, STANDARD_GRAVITY], self._force)
        left[self._is_gap[after].any(axis=2)] = np.nan
        return left

    def medians(self, left: Array) -> Array:
        """Return the medians over the windows, shape (shifts,); infinite: too few are known."""
        known = np.count_nonzero(np.isfinite(left), axis=1)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="All-NaN slice")
            median = np.nanmedian(left, axis=1)
        return np.where(known >= max(FEWEST, COMPARABLE * self.count), median, np.inf)
