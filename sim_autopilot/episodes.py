"""The effect of a fault on the estimate, and the time of recovery."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.faults.fault import Fault
from sim_autopilot.flight import Flight
from sim_autopilot.score import Witness

Limits = tuple[float, float, float]
"""Largest errors of an estimate that has recovered: position, m, velocity, m/s, attitude, rad."""

USUAL: Limits = (4.0, 1.0, math.radians(6.0))
"""For a single-frequency receiver and a compass: four of its sigmas."""


class ErrorSeries(NamedTuple):
    """Errors over the time of validity of the ODOMETRY."""

    t: Array
    """Since the start of the flight, s, ascending, shape (n,)."""
    size: Array
    """Of position, m, velocity, m/s, and the angle of the attitude's error, rad, shape (n, 3)."""


@dataclass(frozen=True, slots=True)
class Episode:
    """One window of a flight: its largest errors, and the time of recovery after it."""

    count: int
    """ODOMETRY in it."""
    position: float
    """Largest in it, m; NaN: there was none."""
    velocity: float
    """m/s."""
    attitude: float
    """rad."""
    recovery: float
    """From the end until all errors are within the limits and stay so for ``hold``, s; inf: never.
    No ODOMETRY is no recovery."""


def error_series(witness: Witness, flight: Flight) -> ErrorSeries:
    """Return the errors of all ODOMETRY that a witness received.

    Without a published origin the mean offset is subtracted, as in the score.
    """
    estimate = witness.estimate()
    error = witness.error(estimate)
    truth = flight.truth_at(estimate.t_ns)
    turn = so3.log(so3.multiply(so3.conjugate(truth.q_nb), estimate.q_nb))
    sizes = [np.linalg.norm(one, axis=-1) for one in (error.pos_n, error.vel_n, turn)]
    return ErrorSeries(estimate.t, np.stack(sizes, axis=-1))


def episode(
    errors: ErrorSeries,
    start: float,
    end: float,
    limits: Limits,
    *,
    until: float = math.inf,
    hold: float = 2.0,
) -> Episode:
    """Score one window, from ``start`` to before ``end``, s.

    To recover, the errors must stay within the limits for ``hold``, s, or up to ``until``, s, when
    the next fault begins.
    """
    inside = errors.size[(errors.t >= start) & (errors.t < end)]
    position, velocity, attitude = inside.max(axis=0) if len(inside) else [math.nan] * 3
    recovery = _recovery(errors, end, limits, until, hold)
    return Episode(len(inside), float(position), float(velocity), float(attitude), recovery)


def episodes(
    errors: ErrorSeries, faults: list[Fault], limits: Limits
) -> list[tuple[Fault, Episode]]:
    """Score each fault, up to the next one, in order of time."""
    ordered = sorted(faults, key=lambda fault: fault.start)
    ends = [*(fault.start for fault in ordered), math.inf][1:]
    return [
        (fault, episode(errors, fault.start, fault.end, limits, until=until))
        for fault, until in zip(ordered, ends, strict=True)
    ]


def summaries(witness: Witness, flight: Flight, faults: list[Fault]) -> list[dict[str, Any]]:
    """Return the effect of each fault, for JSON; null: no ODOMETRY, or no recovery."""
    return [
        {
            "fault": str(fault),
            "odometry": one.count,
            "position_m": _finite(one.position),
            "velocity_mps": _finite(one.velocity),
            "attitude_deg": _finite(math.degrees(one.attitude)),
            "recovery_s": _finite(one.recovery),
        }
        for fault, one in episodes(error_series(witness, flight), faults, USUAL)
    ]


def sentence(summary: Mapping[str, Any]) -> str:
    """Return a summary as one line."""
    line = f"{summary['fault']}: "
    if summary["odometry"]:
        line += (
            f"errors up to {summary['position_m']:.1f} m, {summary['velocity_mps']:.1f} m/s, "
            f"{summary['attitude_deg']:.0f} deg"
        )
    else:
        line += "no ODOMETRY"
    if summary["recovery_s"] is None:
        return line + "; not right again"
    return line + f"; right again {summary['recovery_s']:.1f} s after it"


def _finite(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None


def _recovery(errors: ErrorSeries, end: float, limits: Limits, until: float, hold: float) -> float:
    after = (errors.t >= end) & (errors.t < until)
    t = errors.t[after]
    is_right = (errors.size[after] <= limits).all(axis=1)
    if not len(t):
        return math.inf
    # From each right one, the next wrong one must be far enough away, or not exist
    wrong = np.append(t[~is_right], math.inf)
    following = wrong[np.searchsorted(wrong, t)]
    good = is_right & ((following - t >= hold) & (t[-1] - t >= min(hold, t[-1] - t[0])))
    return float(t[good][0] - end) if good.any() else math.inf
