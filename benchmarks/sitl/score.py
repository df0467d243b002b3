"""Errors of an estimate against the truth of the same flight, and its lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    """RMS errors over a part of a flight."""

    horizontal: float
    """m, without the constant offset of the two frames: its median over the part."""
    horizontal_max: float
    vertical: float
    """m, likewise."""
    velocity: float
    """m/s, of the vector."""
    roll: float
    """deg."""
    pitch: float
    yaw: float
    lead: float | None
    """How far the velocity is ahead of the truth, s; None: nothing moved."""


def score(estimate: Track, truth: Track, begin: float, end: float) -> Score:
    """Measure an estimate against the truth from begin to end (s of the vehicle's clock)."""
    rows = (estimate.t >= begin) & (estimate.t <= end)
    t = estimate.t[rows]
    offset = estimate.pos_n[rows] - _at(t, truth.t, truth.pos_n)
    offset -= np.median(offset, axis=0)
    horizontal = np.hypot(offset[:, 0], offset[:, 1])
    vel_n = estimate.vel_n[rows]
    moved = _at(t, truth.t, truth.vel_n)
    turned = (estimate.att_t >= begin) & (estimate.att_t <= end)
    angles = estimate.euler[turned] - _at(estimate.att_t[turned], truth.att_t, truth.euler)
    roll, pitch, yaw = np.rad2deg(_rms((angles + np.pi) % (2.0 * np.pi) - np.pi, axis=0))
    return Score(
        horizontal=float(_rms(horizontal)),
        horizontal_max=float(horizontal.max()),
        vertical=float(_rms(offset[:, 2])),
        velocity=float(_rms(np.linalg.norm(vel_n - moved, axis=1))),
        roll=float(roll),
        pitch=float(pitch),
        yaw=float(yaw),
        lead=_lead(t, vel_n, truth),
    )


def pooled(scores: Sequence[Score]) -> Score:
    """Return the errors of several flights of the same path as those of one long flight."""

    def over_all(quantity: str) -> float:
        return float(_rms(np.array([getattr(one, quantity) for one in scores])))

    return Score(
        **{quantity: over_all(quantity) for quantity in QUANTITIES},
        horizontal_max=max(one.horizontal_max for one in scores),
        lead=max((one.lead for one in scores if one.lead is not None), key=abs, default=None),
    )


def right_after(
    estimate: Track, truth: Track, before: tuple[float, float], since: float, limit: float
) -> float:
    """Return how long after a time an estimate's place is right for good, s; infinite: never.

    Args:
        estimate: The estimate.
        truth: The truth.
        before: A span of time in which it was right, s: by it the two frames are compared.
        since: The time, s.
        limit: Horizontal error that is right, m.
    """
    offset = estimate.pos_n - _at(estimate.t, truth.t, truth.pos_n)
    rows = (estimate.t >= before[0]) & (estimate.t <= before[1])
    offset -= np.median(offset[rows], axis=0)
    wrong = estimate.t[(np.hypot(offset[:, 0], offset[:, 1]) > limit) & (estimate.t > since)]
    if not len(wrong):
        return 0.0
    return float(wrong[-1] - since) if wrong[-1] < estimate.t[-1] else float("inf")


def _lead(t: Array, vel_n: Array, truth: Track) -> float | None:
    """Return the shift of time at which the horizontal velocity fits best, by a parabola."""
    if _rms(vel_n[:, :2]) < _MOVING:
        return None
    costs = np.array(
        [_rms((vel_n - _at(t + lag, truth.t, truth.vel_n))[:, :2]) ** 2 for lag in LAGS]
    )
    least = int(np.argmin(costs))
    if least in (0, len(LAGS) - 1):
        return float(LAGS[least])
    left, middle, right = costs[least - 1 : least + 2]
    return float(LAGS[least] + 0.5 * (left - right) / (left - 2 * middle + right) * 0.005)


def _at(t: Array, stamps: Array, values: Array) -> Array:
    return np.stack([np.interp(t, stamps, column) for column in values.T], axis=1)


def _rms(values: Array, axis: int | None = None) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))
