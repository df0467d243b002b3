"""Stretches of a log in which the vehicle stands still: inertial samples of noise alone.

A window is quiet by the limits by which the estimator levels (``align.rest_gyro`` and
``align.rest_accel``), if neither the autopilot nor the receiver reports motion. A smooth flight is
quiet too: so the windows of one stretch must also agree in their means, and none may be much
noisier than its neighbours, as when somebody touches the vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ekf_companion.core.settings.settings import AlignSettings
from ekf_companion.filters.inertial import inertial_samples, is_stationary
from ekf_companion.nav.arrays import Array, Mask, Stamps, runs
from ekf_companion.nav.measurements import (
    GNSS_FLAGS,
    GNSS_STD,
    GNSS_VELOCITY,
    Events,
    GnssFlag,
    Kind,
)

SLOW = 20.0
"""Rate of inertial samples below which the motion between them is lost, Hz."""
WINDOW = 1.0
"""Length of a window, s, or of ten samples if that is longer."""
FEWEST = 5
"""Least number of samples of a window that counts."""
SAME_RATE = 0.01
"""Largest difference of a window's mean rate from its stretch's, rad/s: no bias moves so much."""
SAME_FORCE = 0.15
"""Likewise of the specific force, m/s^2."""
BUMP = 2.5
"""Noise of a window over that of its stretch at which it counts as touched."""
STEP = 1.5
"""Step of time over the usual one at which it is a gap."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stretch:
    """Inertial samples at rest, without a gap."""

    t_ns: Stamps
    """Shape (n,)."""
    values: Array
    """Rate, rad/s, and specific force, m/s^2, forward, right, down, shape (n, 6)."""

    @property
    def seconds(self) -> float:
        """Return its length, s."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9


def samples(events: Events) -> tuple[Stamps, Array]:
    """Return stamps and values of all inertial samples in order of time, shapes (n,) and (n, 6)."""
    imu = inertial_samples(events)
    return imu.t_ns, imu.values[:, :6]


def rate(events: Events) -> float:
    """Return the rate of the inertial samples, Hz; 0 if there are none."""
    t_ns, _ = samples(events)
    return 1e9 / float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0


def find(events: Events, limits: AlignSettings, shortest: float) -> list[Stretch]:
    """Return the stretches at rest that last a time, s, at least."""
    t_ns, values = samples(events)
    if len(t_ns) < 2 * FEWEST:
        return []
    usual_ns = float(np.median(np.diff(t_ns)))
    window_ns = max(round(WINDOW * 1e9), round(10.0 * usual_ns))
    index = (t_ns - t_ns[0]) // window_ns
    windows = int(index[-1]) + 1
    count = np.bincount(index, minlength=windows)
    enough = np.maximum(count, 1)[:, None]
    mean = _sums(index, values, windows) / enough
    spread = np.sqrt(_sums(index, (values - mean[index]) ** 2, windows) / enough)
    quiet = is_stationary(mean, spread, limits) & (count >= FEWEST)
    quiet &= ~_moves(events, t_ns[0], window_ns, windows)
    found = []
    for first, last in _alike(mean, spread, quiet):
        inside = (index >= first) & (index < last)
        found += list(_unbroken(t_ns[inside], values[inside], usual_ns))
    return [stretch for stretch in found if stretch.seconds >= shortest]


def _sums(index: Stamps, values: Array, windows: int) -> Array:
    return np.stack([np.bincount(index, column, windows) for column in values.T], axis=1)


def _moves(events: Events, zero_ns: int, window_ns: int, windows: int) -> Mask:
    """Return the windows in which the autopilot reports flight, or the receiver motion."""
    starts = zero_ns + window_ns * np.arange(windows + 1)
    moves = np.zeros(windows, dtype=bool)
    vehicle = events.take(events.kind == Kind.VEHICLE)
    flies = (vehicle.values[:, 0] == 1.0) & (vehicle.values[:, 1] != 1.0)
    if len(vehicle):
        latest = np.searchsorted(vehicle.t_ns, starts[1:]) - 1
        moves |= flies[np.maximum(latest, 0)] & (latest >= 0)
    fixes = events.take(
        (events.kind == Kind.GNSS) & (events.values[:, GNSS_FLAGS] == float(GnssFlag.NONE))
    )
    speed = np.linalg.norm(fixes.values[:, GNSS_VELOCITY][:, :2], axis=1)
    limit = 0.5 + 3.0 * np.nan_to_num(fixes.values[:, GNSS_STD][:, 2], nan=0.3)
    at = (fixes.t_ns[speed > limit] - zero_ns) // window_ns
    moves[at[(at >= 0) & (at < windows)]] = True
    return moves


def _alike(mean: Array, spread: Array, quiet: Mask) -> Iterator[tuple[int, int]]:
    """Return first and last window (exclusive) of each rest."""
    for first, last in runs(quiet):
        middle, usual = np.median(mean[first:last], axis=0), np.median(spread[first:last], axis=0)
        off = np.abs(mean[first:last] - middle)
        limits = np.repeat([SAME_RATE, SAME_FORCE], 3)
        calm = spread[first:last] <= BUMP * usual + 1e-9
        same: Mask = np.asarray(((off < limits) & calm).all(axis=1))
        for start, end in runs(same):
            yield first + start, first + end


def _unbroken(t_ns: Stamps, values: Array, usual_ns: float) -> Iterator[Stretch]:
    """Cut at gaps of more than a few samples; interpolate over smaller ones."""
    if len(t_ns) < 2:
        return
    cuts = np.flatnonzero(np.diff(t_ns) > 4.0 * STEP * usual_ns) + 1
    for part_ns, part in zip(np.split(t_ns, cuts), np.split(values, cuts), strict=True):
        if len(part_ns) < 2:
            continue
        if np.diff(part_ns).max() > STEP * usual_ns:
            even_ns = np.arange(part_ns[0], part_ns[-1] + 1, round(usual_ns))
            columns = [np.interp(even_ns, part_ns, column) for column in part.T]
            yield Stretch(t_ns=even_ns, values=np.stack(columns, axis=1))
        else:
            yield Stretch(t_ns=part_ns, values=part)
