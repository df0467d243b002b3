"""Where in a log the vehicle stands still: stretches of samples that hold nothing but noise.

A window is quiet by the same limits by which the estimator levels (``align.rest_gyro`` and
``align.rest_accel``), if neither the autopilot nor the receiver says that the vehicle moves. A
smooth flight is quiet too: so the windows of one stretch must also agree in their means, and none
may be noisier than its neighbours by much, as one is in which somebody touches the vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import AlignSettings
from ekf_companion.filters.samples import inertial
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, GnssFlag, Kind

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SLOW = 20.0
"""Inertial samples per second below which they are telemetry: what is between them is lost, Hz."""
WINDOW = 1.0
"""s, or as long as ten samples take."""
FEWEST = 5
"""Samples of a window that says something."""
SAME_RATE = 0.01
"""Largest difference of a window's mean rate from its stretch's, rad/s: no bias moves so much."""
SAME_FORCE = 0.15
"""Likewise of the specific force, m/s^2."""
BUMP = 2.5
"""A window so many times as noisy as its stretch is somebody's touch."""
LARGEST_BIAS = 0.1
"""rad/s; no gyro of today has it."""
LEVEL, SPEED, VELOCITY_STD, FLAGS = 0.1, slice(3, 5), 8, 10
"""Share by which the specific force may differ from gravity; where a GNSS row holds the others."""
STEP = 1.5
"""A step of time so many times the usual one is a gap."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stretch:
    """Inertial samples at rest, without a gap."""

    t_ns: Stamps
    """Shape (n,)."""
    values: Array
    """Rate, rad/s, and specific force, m/s^2, forward, right, down, shape (n, 6)."""

    @property
    def seconds(self) -> float:
        """Give its length, s."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9


def samples(events: Events) -> tuple[Stamps, Array]:
    """Give stamps and values of all inertial samples in order of time, shapes (n,) and (n, 6)."""
    imu = inertial(events)
    return imu.t_ns, imu.values[:, :6]


def rate(events: Events) -> float:
    """Give how often inertial samples come, Hz; 0: there are none."""
    t_ns, _ = samples(events)
    return 1e9 / float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0


def find(events: Events, limits: AlignSettings, shortest: float) -> list[Stretch]:
    """Give the stretches at rest that are not shorter than some time, s."""
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
    quiet = _is_quiet(mean, spread, limits) & (count >= FEWEST)
    quiet &= ~_moves(events, t_ns[0], window_ns, windows)
    found = []
    for first, last in _alike(mean, spread, quiet):
        inside = (index >= first) & (index < last)
        found += list(_unbroken(t_ns[inside], values[inside], usual_ns))
    return [stretch for stretch in found if stretch.seconds >= shortest]


def _sums(index: Stamps, values: Array, windows: int) -> Array:
    sums = [np.bincount(index, weights=column, minlength=windows) for column in values.T]
    return np.stack(sums, axis=1)


def _is_quiet(mean: Array, spread: Array, limits: AlignSettings) -> Mask:
    force = np.linalg.norm(mean[:, 3:], axis=1) / STANDARD_GRAVITY
    return np.asarray(
        (np.linalg.norm(spread[:, :3], axis=1) < limits.rest_gyro)
        & (np.linalg.norm(spread[:, 3:], axis=1) < limits.rest_accel)
        & (np.linalg.norm(mean[:, :3], axis=1) < LARGEST_BIAS)
        & (np.abs(force - 1.0) < LEVEL)
    )


def _moves(events: Events, zero_ns: int, window_ns: int, windows: int) -> Mask:
    """Say in which windows the autopilot says that it flies, or the receiver that it moves."""
    starts = zero_ns + window_ns * np.arange(windows + 1)
    moves = np.zeros(windows, dtype=bool)
    vehicle = events.take(events.kind == Kind.VEHICLE)
    flies = (vehicle.values[:, 0] == 1.0) & (vehicle.values[:, 1] != 1.0)
    if len(vehicle):
        latest = np.searchsorted(vehicle.t_ns, starts[1:]) - 1
        moves |= flies[np.maximum(latest, 0)] & (latest >= 0)
    fixes = events.take(
        (events.kind == Kind.GNSS) & (events.values[:, FLAGS] == float(GnssFlag.NONE))
    )
    speed = np.linalg.norm(fixes.values[:, SPEED], axis=1)
    limit = 0.5 + 3.0 * np.nan_to_num(fixes.values[:, VELOCITY_STD], nan=0.3)
    at = (fixes.t_ns[speed > limit] - zero_ns) // window_ns
    moves[at[(at >= 0) & (at < windows)]] = True
    return moves


def _alike(mean: Array, spread: Array, quiet: Mask) -> Iterator[tuple[int, int]]:
    """Give first and last window (exclusive) of each run that is one rest."""
    for first, last in _runs(quiet):
        middle, usual = np.median(mean[first:last], axis=0), np.median(spread[first:last], axis=0)
        off = np.abs(mean[first:last] - middle)
        limits = np.repeat([SAME_RATE, SAME_FORCE], 3)
        calm = spread[first:last] <= BUMP * usual + 1e-9
        same: Mask = np.asarray(((off < limits) & calm).all(axis=1))
        for start, end in _runs(same):
            yield first + start, first + end


def _runs(mask: Mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _unbroken(t_ns: Stamps, values: Array, usual_ns: float) -> Iterator[Stretch]:
    """Cut at gaps of more than a few samples; fill the small ones along a straight line."""
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
