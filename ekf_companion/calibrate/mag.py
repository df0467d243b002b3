"""Hard and soft iron of the vehicle: the correction of its magnetometer.

There are two answers. The ellipsoid (:mod:`ekf_companion.calibrate.ellipsoid`) is the one to paste.
The other is by the largest and smallest value of each axis, as it is done by hand: the offset is
half their sum, the scale half their difference.

What can be determined depends on the directions of the field relative to the body. From all round
it is the whole ellipsoid; else hard iron alone; and if the vehicle has only turned about one axis,
the circle in the plane of the other two.

Source: T. Ozyagcilar 2015, NXP AN4246 (hard and soft iron).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ekf_companion.calibrate import ellipsoid
from ekf_companion.calibrate.ellipsoid import Fit
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array, Indices, Mask, known_rows
from ekf_companion.nav.magnetic import magnetic_field
from ekf_companion.nav.measurements import Kind

Method = Literal["ellipsoid", "hard iron", "circle"]

FEWEST = 50
"""Samples."""
MOST = 4000
"""Largest number of samples used: more add nothing."""
SHARE = 0.3
"""Share of all directions needed to separate soft iron from hard."""
SURE_HARD = 0.06
"""Largest sigma of the hard iron of a determined axis, gauss."""
SURE_SOFT = 0.02
"""Likewise of an element of the soft iron."""
EARTH = (0.2, 0.7)
"""Range of the strength of the Earth's field, gauss."""
BEARINGS = 36
TURNED = 0.75
"""Share of all bearings needed for a circle."""
FLATTEST = 0.1
"""Least radius of a circle above noise, gauss; a compass is of no use with less."""
OVAL = 0.15
"""Largest error of points on a circle as a share of its radius: tilting causes more."""
PIECES = 8
"""Pieces of the log that the jackknife leaves out one by one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Iron:
    """The measured iron about a magnetometer."""

    method: Method
    fit: Fit
    determined: Mask
    """Whether each axis is determined, shape (3,)."""
    by_extremes: Fit
    """The fit by largest and smallest values."""
    rms_before: float
    """RMS error of the strength without any correction, gauss."""
    share: float
    """Share of all directions that the field has come from."""
    strength: float
    """Of the Earth's field, gauss."""
    is_place_known: bool
    """The strength is the World Magnetic Model's; else the radius of the sphere."""
    mag_b: Array
    """The samples, shape (n, 3), gauss."""


def measure(recording: Recording, settings: FilterSettings, name: str = "the log") -> Iron:
    """Measure the iron about a log's magnetometer; of the settings it uses ``heading.year``.

    Raises:
        LogError: The log has no magnetometer, or the vehicle has turned too little.
    """
    events = recording.events
    mag_b = events.values[events.kind == Kind.MAG, :3]
    mag_b = mag_b[known_rows(mag_b) & (np.abs(mag_b) < 10.0).all(axis=1)]
    if len(mag_b) < FEWEST:
        raise LogError(
            f"{name}: holds {len(mag_b) or 'no'} samples of a magnetometer, and {FEWEST} are "
            "needed; ask the autopilot to log or stream it (HIGHRES_IMU, RAW_IMU, SCALED_IMU, MAG)"
        )
    fixes = events.values[events.kind == Kind.GNSS]
    strength = None
    if len(fixes):
        lat, lon = np.median(fixes[:, :2], axis=0)
        strength = magnetic_field(float(lat), float(lon), settings.heading.year)[2]
    return measure_field(mag_b, strength, name)


def measure_field(mag_b: Array, strength: float | None, name: str = "the log") -> Iron:
    """Measure the iron from samples, shape (n, 3), gauss, in a field of a strength (None: unknown).

    Raises:
        LogError: The vehicle has turned too little.
    """
    mag_b = mag_b[:: -(-len(mag_b) // MOST)]
    is_place_known = strength is not None
    if strength is None:
        centre, strength = ellipsoid.sphere(mag_b)
        is_all_round = _share(mag_b - centre) >= SHARE and EARTH[0] < strength < EARTH[1]
    first = ellipsoid.fit(mag_b, strength, is_soft=False, start=np.zeros(3))
    share = _share(mag_b - first.hard)
    method, fit = _choose(mag_b, strength, first, share)
    sure = fit.hard_std <= SURE_HARD
    if not sure.all() or not (is_place_known or is_all_round):
        left_out = int(np.argmin(mag_b.std(axis=0)))
        sure = np.arange(3) != left_out
        method, fit = "circle", _with_jackknife(mag_b, lambda some: _circle(some, sure))
        arms = mag_b[:, sure] - fit.hard[sure]
        radius = float(np.median(np.linalg.norm(arms, axis=1)))
        turned = len(np.unique(_bearing(arms))) / BEARINGS
        is_circle = radius > FLATTEST and fit.rms < OVAL * radius and turned >= TURNED
        if not is_circle or fit.hard_std.max() > SURE_HARD:
            raise LogError(
                f"{name}: the vehicle has hardly turned, so its iron cannot be told from the "
                "Earth's field; turn it all ways round, or at least full circles on level ground"
            )
    return Iron(
        method=method,
        fit=fit,
        determined=sure,
        by_extremes=_by_extremes(mag_b, strength),
        rms_before=ellipsoid.spread(mag_b, strength),
        share=share,
        strength=strength,
        is_place_known=is_place_known,
        mag_b=mag_b,
    )


def _share(arms: Array) -> float:
    """Return the share of all directions that occur."""
    return len(np.unique(ellipsoid.directions(arms))) / ellipsoid.CELLS


def _choose(mag_b: Array, strength: float, first: Fit, share: float) -> tuple[Method, Fit]:
    """Return the whole ellipsoid where the directions show it, else hard iron alone."""
    if share >= SHARE:
        whole = _with_jackknife(
            mag_b, lambda some: ellipsoid.fit(some, strength, is_soft=True, start=first.hard)
        )
        if whole.hard_std.max() <= SURE_HARD and whole.soft_std <= SURE_SOFT:
            return "ellipsoid", whole
    return "hard iron", _with_jackknife(
        mag_b, lambda some: ellipsoid.fit(some, strength, is_soft=False, start=first.hard)
    )


def _with_jackknife(mag_b: Array, solve: Callable[[Array], Fit]) -> Fit:
    """Solve, with sigmas from the solutions without one piece of the log after another.

    The field near ground, cars and houses differs by place, so neighbouring errors are correlated.

    Source: Efron 1982, The jackknife, the bootstrap and other resampling plans.
    """
    whole = solve(mag_b)
    piece = np.arange(len(mag_b)) * PIECES // len(mag_b)
    others = [solve(mag_b[piece != left_out]) for left_out in range(PIECES)]
    factor = (PIECES - 1) / np.sqrt(PIECES)
    hard = np.std([other.hard for other in others], axis=0) * factor
    soft = np.std([other.soft for other in others], axis=0).max() * factor
    return replace(
        whole,
        hard_std=np.maximum(whole.hard_std, hard),
        soft_std=max(whole.soft_std, float(soft)) if whole.soft_std else 0.0,
    )


def _circle(mag_b: Array, plane: Mask) -> Fit:
    """Fit a circle of any radius in the plane of two axes; the third has no iron."""
    flat = mag_b[:, plane]
    hard = np.zeros(3)
    hard[plane] = flat.mean(axis=0)
    for _ in range(2):
        bearing = _bearing(flat - hard[plane])
        weight = 1.0 / np.bincount(bearing)[bearing]
        hard[plane] = ellipsoid.sphere(flat, weight)[0]
    size = np.linalg.norm(flat - hard[plane], axis=1)
    off = size - np.average(size, weights=weight)
    rms = float(np.sqrt(np.average(off**2, weights=weight)))
    # Of n independent bearings each coordinate of the centre has the variance 2 / n
    std = np.where(plane, np.sqrt(2.0 / weight.sum()) * rms, 0.0)
    return Fit(hard=hard, soft=np.eye(3), hard_std=std, soft_std=0.0, rms=rms)


def _bearing(flat: Array) -> Indices:
    """Return for each vector, shape (n, 2), which of ``BEARINGS`` sectors it points to."""
    turns = np.arctan2(flat[:, 1], flat[:, 0]) / (2.0 * np.pi) + 0.5
    return np.asarray(turns * BEARINGS, dtype=np.int64) % BEARINGS


def _by_extremes(mag_b: Array, strength: float) -> Fit:
    """Return offsets and scales by the largest and the smallest value of each axis."""
    high, low = mag_b.max(axis=0), mag_b.min(axis=0)
    hard = 0.5 * (high + low)
    soft = np.diag(strength / np.maximum(0.5 * (high - low), 1e-6))
    return Fit(
        hard=hard,
        soft=soft,
        hard_std=np.full(3, np.nan),
        soft_std=np.nan,
        rms=ellipsoid.spread((mag_b - hard) @ soft, strength),
    )
