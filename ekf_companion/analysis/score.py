"""Errors of an estimate against a reference, and their statistics.

Two altitudes may differ by a constant because each has its own datum (EGM96, a barometer's zero,
the home position), so the vertical error is reported as it is and less its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.state import EULER, Trajectory
from ekf_companion.review import difference
from ekf_companion.review.difference import ALWAYS, euler_errors, frame_of, tilt_errors

LAG_SPAN = 1.0
"""Largest lag searched for, either way, s."""
LAG_STEP = 0.02
"""Step of the search before the parabola is fitted, s."""
LAG_POINTS = 4000
"""Largest number of stamps that the search for the lag uses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Statistics of an error's size."""

    count: int
    rms: float
    p95: float
    """95 % of the errors are smaller."""
    largest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Errors of an estimate against a reference, SI and radians; None: one of them lacks it."""

    estimate: str
    reference: str
    start_ns: int
    """First stamp compared."""
    end_ns: int
    horizontal: Spread | None
    """m."""
    vertical: Spread | None
    """m, as it is."""
    vertical_about_mean: Spread | None
    """m, without the constant difference."""
    vertical_mean: float | None
    """m, estimate above reference: due to the datum as much as to the estimate."""
    velocity: Spread | None
    """m/s, of the vector; horizontal where the reference has no vertical velocity."""
    velocity_horizontal: Spread | None
    """m/s."""
    tilt: Spread | None
    """rad, between the two directions of down."""
    roll: Spread | None
    """rad."""
    pitch: Spread | None
    """rad."""
    yaw: Spread | None
    """rad."""
    lag: float | None
    """Delay of the estimate at which it fits best, s; None: no motion shows it."""
    horizontal_without_lag: float | None
    """m, RMS at the best lag."""

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON: metres, m/s, degrees and seconds, the unit in the name."""
        flat: dict[str, Any] = {
            "estimate": self.estimate,
            "reference": self.reference,
            "start_s": self.start_ns * 1e-9,
            "end_s": self.end_ns * 1e-9,
            "vertical_mean_m": self.vertical_mean,
            "lag_s": self.lag,
            "horizontal_without_lag_m": self.horizontal_without_lag,
        }
        for name, unit, scale in ROWS:
            spread: Spread | None = getattr(self, name)
            flat[f"{name}_{unit}"] = spread and {
                "count": spread.count,
                "rms": spread.rms * scale,
                "p95": spread.p95 * scale,
                "max": spread.largest * scale,
            }
        return flat


_DEGREES = float(np.rad2deg(1.0))
ROWS = (
    ("horizontal", "m", 1.0),
    ("vertical", "m", 1.0),
    ("vertical_about_mean", "m", 1.0),
    ("velocity", "mps", 1.0),
    ("velocity_horizontal", "mps", 1.0),
    ("tilt", "deg", _DEGREES),
    ("roll", "deg", _DEGREES),
    ("pitch", "deg", _DEGREES),
    ("yaw", "deg", _DEGREES),
)
"""Names of the spreads of a score, units as a key of JSON has them, and what they are in these."""


def score(
    estimate: Trajectory,
    reference: Trajectory,
    skip_s: float = 0.0,
    *,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Score:
    """Measure an estimate against a reference where both exist.

    Args:
        estimate: What is measured.
        reference: What it should be.
        skip_s: Leave out so many seconds from the estimate's first stamp on.
        start_ns: Also leave out what is earlier, for example than the arming; None: nothing.
        end_ns: Leave out what is later; None: nothing.
    """
    starts = [t[0] for t in (estimate.pos_t_ns, estimate.vel_t_ns, estimate.att_t_ns) if len(t)]
    first_ns = int(min(starts, default=0))
    begin = max(first_ns + round(skip_s * 1e9), first_ns if start_ns is None else start_ns)
    span = (begin, ALWAYS[1] if end_ns is None else end_ns)
    seen: list[Stamps] = []
    errors: dict[str, Array] = {}
    mean = None
    if there := difference.in_position(estimate, reference, span):
        stamps, offset = there
        seen.append(stamps)
        errors["horizontal"] = np.hypot(offset[:, 0], offset[:, 1])
        errors["vertical"] = vertical = -offset[np.isfinite(offset[:, 2]), 2]
        if len(vertical):
            mean = float(np.mean(vertical))
            errors["vertical_about_mean"] = vertical - mean
    if there := difference.in_velocity(estimate, reference, span):
        stamps, velocity = there
        seen.append(stamps)
        velocity = velocity[known_rows(velocity[:, :2])]
        errors["velocity"] = np.linalg.norm(np.nan_to_num(velocity), axis=1)
        errors["velocity_horizontal"] = np.hypot(velocity[:, 0], velocity[:, 1])
    if turned := difference.in_attitude(estimate, reference, span):
        stamps, mine, theirs = turned
        seen.append(stamps)
        errors["tilt"] = tilt_errors(mine, theirs)
        errors |= zip(EULER, euler_errors(mine, theirs).T, strict=True)
    lag, best = _find_lag(estimate, reference, *span)
    return Score(
        estimate=estimate.name,
        reference=reference.name,
        start_ns=int(min((t[0] for t in seen), default=begin)),
        end_ns=int(max((t[-1] for t in seen), default=begin)),
        vertical_mean=mean,
        lag=lag,
        horizontal_without_lag=best,
        **{name: _spread(errors.get(name)) for name, _, _ in ROWS},
    )


def _spread(errors: Array | None) -> Spread | None:
    if errors is None or len(errors) == 0:
        return None
    size = np.abs(errors)
    return Spread(
        count=len(size),
        rms=float(np.sqrt(np.mean(np.square(size)))),
        p95=float(np.percentile(size, 95.0)),
        largest=float(size.max()),
    )


def _find_lag(
    estimate: Trajectory, reference: Trajectory, begin: int, end: int
) -> tuple[float | None, float | None]:
    """Return the lag with the least horizontal RMS, by a parabola, and that RMS."""
    # A margin at either end, so that every shift uses the same rows
    margin = round(LAG_SPAN * 1e9)
    if not len(estimate.pos_t_ns) or not len(reference.pos_t_ns):
        return None, None
    low = max(begin, int(estimate.pos_t_ns[0]), int(reference.pos_t_ns[0])) + margin
    high = min(end, int(estimate.pos_t_ns[-1]), int(reference.pos_t_ns[-1])) - margin
    frame = frame_of(reference)
    mine, theirs = (frame.to_ned(one.lat, one.lon, one.alt) for one in (estimate, reference))
    mine_s, theirs_s = ((one.pos_t_ns - low) * 1e-9 for one in (estimate, reference))
    fixed, moved, at, slide, sign = theirs, mine, theirs_s, mine_s, 1.0
    if len(mine) < len(theirs):
        fixed, moved, at, slide, sign = mine, theirs, mine_s, theirs_s, -1.0
    rows = np.flatnonzero((at >= 0.0) & (at <= (high - low) * 1e-9))
    rows = rows[:: max(1, len(rows) // LAG_POINTS)]
    if len(rows) < 3 or np.ptp(fixed[rows, :2], axis=0).max() < 1.0:  # m: nothing moved
        return None, None

    def mean_square(lag: float) -> float:
        shifted = at[rows] + sign * lag
        errors = [np.interp(shifted, slide, moved[:, axis]) - fixed[rows, axis] for axis in (0, 1)]
        return float(np.mean(np.square(errors[0]) + np.square(errors[1])))

    lags = np.arange(-LAG_SPAN, LAG_SPAN + LAG_STEP / 2.0, LAG_STEP)
    costs = np.array([mean_square(lag) for lag in lags])
    least = int(np.argmin(costs))
    if least in (0, len(lags) - 1):
        return None, None
    left, middle, right = costs[least - 1 : least + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
    lag = float(lags[least] + shift * LAG_STEP)
    return lag, float(np.sqrt(min(mean_square(lag), middle)))


def table(scores: Sequence[Score]) -> list[str]:
    """Return scores side by side as lines of text: RMS, 95 % and largest error of each."""
    numbered = list(enumerate(scores, start=1))
    lines = [f"[{number}] {one.estimate} against {one.reference}" for number, one in numbered]
    for number, one in numbered:
        start, end = one.start_ns * 1e-9, one.end_ns * 1e-9
        lines.append(f"[{number}] {start:.1f} to {end:.1f} s ({end - start:.1f} s)")
    head = "".join(f" | {f'[{number}] RMS':>10} {'95 %':>8} {'max':>8}" for number, _ in numbered)
    lines += ["", f"{'':<26}{head}", "-" * (26 + len(head))]
    for name, unit, scale in ROWS:
        cells = ""
        for one in scores:
            spread: Spread | None = getattr(one, name)
            numbers = (spread.rms, spread.p95, spread.largest) if spread else ()
            texts = [f"{number * scale:.3f}" for number in numbers] or ["-", "-", "-"]
            cells += f" | {texts[0]:>10} {texts[1]:>8} {texts[2]:>8}"
        label = f"{name.replace('_', ' ')}, {unit.replace('mps', 'm/s')}"
        lines.append(f"{label:<26}{cells}")
    for label, attribute, scale in (
        ("mean height difference, m", "vertical_mean", 1.0),
        ("best lag, ms", "lag", 1e3),
        ("horizontal at it, m", "horizontal_without_lag", 1.0),
    ):
        values = [getattr(one, attribute) for one in scores]
        cells = "".join(
            f" | {'-' if value is None else f'{value * scale:.3f}':>10} {'':>8} {'':>8}"
            for value in values
        )
        lines.append(f"{label:<26}{cells}".rstrip())
    return lines
