"""Errors of an estimate against the truth of the same flight, its lag, and the true motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.sitl.tracks import Track
from ekf_companion.nav.arrays import Array

LAGS = np.arange(-0.15, 0.1501, 0.005)
"""s, looked through for the best."""
QUANTITIES = ("horizontal", "velocity", "vertical", "roll", "pitch", "yaw")
"""RMS errors of a score."""
_MOVING = 0.5
"""m/s RMS; with less motion no lag shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """RMS errors over a part of a flight, in absolute positions; infinite without an estimate."""

    horizontal: float
    """m."""
    horizontal_max: float
    vertical: float
    """m."""
    vertical_max: float
    velocity: float
    """m/s, of the vector."""
    roll: float
    """deg."""
    pitch: float
    yaw: float
    yaw_max: float
    lead: float | None
    """How far the velocity is ahead of the truth, s; None: nothing moved."""


def score(estimate: Track | None, truth: Track, begin: float, end: float) -> Score:
    """Measure an estimate against the truth from begin to end (s of the vehicle's clock)."""
    if estimate is None or not (rows := (estimate.t >= begin) & (estimate.t <= end)).any():
        return _NONE
    t = estimate.t[rows]
    error = estimate.pos_n[rows] - at(t, truth.t, truth.pos_n)
    horizontal = np.hypot(error[:, 0], error[:, 1])
    vel_n = estimate.vel_n[rows]
    moved = at(t, truth.t, truth.vel_n)
    turned = (estimate.att_t >= begin) & (estimate.att_t <= end)
    angles = estimate.euler[turned] - at(estimate.att_t[turned], truth.att_t, truth.euler)
    angles = np.rad2deg((angles + np.pi) % (2.0 * np.pi) - np.pi)
    roll, pitch, yaw = _rms(angles, axis=0)
    return Score(
        horizontal=float(_rms(horizontal)),
        horizontal_max=float(horizontal.max()),
        vertical=float(_rms(error[:, 2])),
        vertical_max=float(abs(error[:, 2]).max()),
        velocity=float(_rms(np.linalg.norm(vel_n - moved, axis=1))),
        roll=float(roll),
        pitch=float(pitch),
        yaw=float(yaw),
        yaw_max=float(abs(angles[:, 2]).max()),
        lead=_lead(t, vel_n, truth),
    )


_NONE = Score(
    **dict.fromkeys((*QUANTITIES, "horizontal_max", "vertical_max", "yaw_max"), float("inf")),
    lead=None,
)


def pooled(scores: Sequence[Score]) -> Score:
    """Return the errors of several flights of the same path as those of one long flight."""

    def over_all(quantity: str) -> float:
        return float(_rms(np.array([getattr(one, quantity) for one in scores])))

    return Score(
        **{quantity: over_all(quantity) for quantity in QUANTITIES},
        **{
            name: max(getattr(one, name) for one in scores)
            for name in ("horizontal_max", "vertical_max", "yaw_max")
        },
        lead=max((one.lead for one in scores if one.lead is not None), key=abs, default=None),
    )


def right_after(
    estimate: Track | None, truth: Track, since: float, end: float, limit: float
) -> float:
    """Return how long after a time an estimate's position is right for good, s; infinite: never.

    Args:
        estimate: The estimate; None: there was none.
        truth: The truth.
        since: The time, s.
        end: Until when it is looked at, s.
        limit: Error in any axis that is right, m.
    """
    if estimate is None:
        return float("inf")
    rows = (estimate.t > since) & (estimate.t <= end)
    t = estimate.t[rows]
    error = abs(estimate.pos_n[rows] - at(t, truth.t, truth.pos_n)).max(axis=1, initial=0.0)
    wrong = t[error > limit]
    if not len(wrong):
        return float(t[0] - since) if len(t) else float("inf")
    return float(wrong[-1] - since) if wrong[-1] < t[-1] else float("inf")


def untold_steps(estimate: Track | None, resets: Array, truth: Track, limit: float) -> int:
    """Count steps of an estimate over a limit (m), in any axis, with an unmoved reset counter.

    A step is a change of the error between two consecutive messages.
    """
    if estimate is None:
        return 0
    error = estimate.pos_n - at(estimate.t, truth.t, truth.pos_n)
    is_step = abs(np.diff(error, axis=0)).max(axis=1, initial=0.0) > limit
    return int((is_step & (np.diff(resets) == 0)).sum())


def moved(truth: Track, t: float, before: float = 2.0, after: float = 10.0) -> float:
    """Return how far a vehicle that hovers goes after a time from where it was before, m, any axis.

    Args:
        truth: Its true motion.
        t: The time, s.
        before: Its place is the median over so long before, s.
        after: For so long it is looked at, s.
    """
    was = truth.pos_n[(truth.t >= t - before) & (truth.t <= t)]
    goes = truth.pos_n[(truth.t > t) & (truth.t <= t + after)]
    if not len(was) or not len(goes):
        return float("inf")
    return float(abs(goes - np.median(was, axis=0)).max())


class Silence(NamedTuple):
    """Duration of pauses."""

    total: float
    """s, of the pauses that are longer than usual."""
    longest: float
    """s."""
    since: float | None
    """When the longest began, s; None: there was no pause."""


def silence(stamps: Array, begin: float, end: float, usual: float = 0.5) -> Silence:
    """Return for how long of a span of time nothing came: pauses longer than ``usual``, s."""
    inside = np.sort(stamps[(stamps >= begin) & (stamps <= end)])
    edges = np.concatenate([[begin], inside, [end]])
    pauses = np.diff(edges)
    longest = int(np.argmax(pauses))
    long = float(pauses[longest])
    total = float(pauses[pauses > usual].sum())
    return Silence(total, long, float(edges[longest]) if long > usual else None)


def _lead(t: Array, vel_n: Array, truth: Track) -> float | None:
    """Return the shift of time at which the horizontal velocity fits best, by a parabola."""
    if _rms(vel_n[:, :2]) < _MOVING:
        return None
    costs = np.array(
        [_rms((vel_n - at(t + lag, truth.t, truth.vel_n))[:, :2]) ** 2 for lag in LAGS]
    )
    least = int(np.argmin(costs))
    if least in (0, len(LAGS) - 1):
        return float(LAGS[least])
    left, middle, right = costs[least - 1 : least + 2]
    return float(LAGS[least] + 0.5 * (left - right) / (left - 2 * middle + right) * 0.005)


def at(t: Array, stamps: Array, values: Array) -> Array:
    """Return columns of values at other times, linearly."""
    return np.stack([np.interp(t, stamps, column) for column in values.T], axis=1)


def _rms(values: Array, axis: int | None = None) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))
