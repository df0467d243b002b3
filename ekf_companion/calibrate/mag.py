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
from typing import Any, Literal

import numpy as np

from ekf_companion.calibrate import ellipsoid
from ekf_companion.calibrate.ellipsoid import Fit
from ekf_companion.calibrate.result import Result, Setting, rounded, spelled
from ekf_companion.core.settings.settings import FilterSettings
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
AXES = ("forward", "right", "down")
FEW = 0.1
"""Share of directions below which hard iron is a guess."""
DISTURBED = 0.03
"""Remaining error of the strength above which motors, or the place, change the field, gauss."""


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
                f"{name}: the vehicle has hardly turned, so its iron cannot be separated from the "
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


def result(found: Iron) -> Result:
    """Return measured iron as keys of the configuration."""
    fit = found.fit
    is_whole = found.method == "ellipsoid"
    is_sure = bool((np.abs(fit.hard) > 2.0 * fit.hard_std).any())
    is_sure |= is_whole and bool(np.abs(fit.soft - np.eye(3)).max() > 2.0 * fit.soft_std)
    remark = "" if is_sure else "; no more than its uncertainty: leave it as it is"
    if found.method == "hard iron" and found.share < FEW:
        is_sure, remark = False, f"; from {found.share:.0%} of all directions: a guess, to confirm"
    axes = zip(AXES, fit.hard_std, found.determined, strict=True)
    stds = [f"{axis} {f'{std:.3f}' if known else 'not determined'}" for axis, std, known in axes]
    settings = [
        Setting(
            key="heading.hard_iron",
            value=fit.hard.round(4).tolist(),
            comment=f"gauss; one sigma: {', '.join(stds)}{remark}",
            is_sure=is_sure,
        )
    ]
    if is_whole:
        soft_iron = Setting(
            key="heading.soft_iron",
            value=fit.soft.round(4).tolist(),
            comment=f"one sigma of an element up to {fit.soft_std:.3f}",
            is_sure=is_sure,
        )
        settings.append(soft_iron)
    return Result(settings=settings, notes=_notes(found), data=_data(found))


def _notes(found: Iron) -> list[str]:
    """Return what the numbers are based on, as sentences."""
    fit, extremes = found.fit, found.by_extremes
    where = "by the World Magnetic Model there" if found.is_place_known else "as it was measured"
    notes = [
        f"strength of the field: {found.strength:.3f} gauss {where}; the magnetometer's differs by "
        f"{found.rms_before:.3f} RMS as it is, by {fit.rms:.3f} after the {found.method} below",
        f"the field has come from {100.0 * found.share:.0f} % of all directions",
    ]
    if found.method == "hard iron":
        notes.append(
            "too few to find soft iron, so hard iron alone was fitted, and its sigma allows for "
            f"a soft iron of {100.0 * ellipsoid.LIKELY_SOFT:.0f} %; for both, turn the vehicle all "
            "ways round, nose up, nose down, on each side and on its back"
        )
    if found.method == "hard iron" and found.share < FEW:
        notes.append(
            "that is very few: the answer leans on the strength of the field and on the "
            "magnetometer's scale. It is a comment below: use it only if another flight agrees"
        )
    if found.method == "circle":
        axis = AXES[int(np.argmin(found.determined))]
        notes.append(
            f"the vehicle has turned about its {axis} axis only: hard iron {axis} is not "
            "determined and left at 0; tilted, the compass will be off. Turn it all ways round"
        )
    if fit.rms > DISTURBED:
        notes.append(
            "what remains is large: currents of the motors, or iron near by, change the field. "
            "Calibrate in the open, and mount the compass away from wires"
        )
    notes.append(
        "by largest and smallest values (offset half their sum, scale half their difference): "
        f"hard_iron {spelled(extremes.hard.tolist())}, soft_iron diagonal "
        f"{spelled(np.diag(extremes.soft).tolist())}, which leaves {extremes.rms:.3f} RMS"
    )
    return notes


def _data(found: Iron) -> dict[str, Any]:
    fit, extremes = found.fit, found.by_extremes
    return {
        "method": found.method,
        "hard_iron_gauss": rounded(fit.hard),
        "hard_iron_std_gauss": rounded(np.where(found.determined, fit.hard_std, np.nan)),
        "soft_iron": rounded(fit.soft),
        "soft_iron_std": rounded(fit.soft_std) if found.method == "ellipsoid" else None,
        "determined": dict(zip(AXES, found.determined.tolist(), strict=True)),
        "rms_gauss": {
            "before": rounded(found.rms_before),
            "after": rounded(fit.rms),
            "by_extremes": rounded(extremes.rms),
        },
        "by_extremes": {
            "hard_iron_gauss": rounded(extremes.hard),
            "soft_iron": rounded(extremes.soft),
        },
        "strength_gauss": rounded(found.strength),
        "share_of_directions": found.share,
    }
