"""The effect of each fault of a flight, beside the normal errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.document import table
from benchmarks.reliability.soak_flight import Errors
from ekf_companion.nav.arrays import Array
from sim_autopilot.faults.fault import Fault

QUANTILE = 0.999
MARGIN = 1.5
"""Of the undisturbed flight's quantile. One hour holds few independent errors, as those of a
receiver change over minutes: the next hour's quantile differs by a third."""
LEAST = np.array([0.0, 0.0, math.radians(1.0), math.radians(2.0)])
"""Errors that are normal in any flight, as ``normal`` returns them: no controller minds them."""
SETTLED = 60.0
"""The undisturbed flight counts from here on, s: after take-off and first estimates of biases."""
HOLD = 2.0
"""s."""
UNITS = ("position m", "velocity m/s", "tilt deg", "yaw deg")
SCALE = np.array([1.0, 1.0, math.degrees(1.0), math.degrees(1.0)])
"""To those units."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Episode:
    """The effect of one fault."""

    fault: Fault
    seed: int
    largest: Array
    """Position m, velocity m/s, tilt and yaw rad, from its begin until recovery."""
    recovery: float
    """From its end until all errors stay inside the limits, s; inf: they never did."""
    resets: int


def normal(errors: Errors) -> Array:
    """Return the limits of normal errors, from a flight without faults, shape (4,)."""
    found = MARGIN * np.quantile(errors.size[errors.t > SETTLED], QUANTILE, axis=0)
    return np.maximum(found, LEAST)


def episodes(errors: Errors, faults: Sequence[Fault], limits: Array, seed: int) -> list[Episode]:
    """Score each fault, up to the next."""
    starts = [*(fault.start for fault in faults), math.inf][1:]
    return [
        _episode(errors, fault, until, limits, seed)
        for fault, until in zip(faults, starts, strict=True)
    ]


def _episode(errors: Errors, fault: Fault, until: float, limits: Array, seed: int) -> Episode:
    after = (errors.t >= fault.end) & (errors.t < until)
    t = errors.t[after]
    is_right = (errors.size[after] <= limits).all(axis=1)
    wrong = np.append(t[~is_right], math.inf)
    following = wrong[np.searchsorted(wrong, t)]
    good = t[is_right & (following - t >= HOLD)]
    recovery = float(good[0] - fault.end) if len(good) else math.inf
    own = (errors.t >= fault.start) & (errors.t < min(until, fault.end + recovery))
    counts = errors.resets[(errors.t >= fault.start - 1.0) & (errors.t < until)]
    return Episode(
        fault=fault,
        seed=seed,
        largest=errors.size[own].max(axis=0) if own.any() else np.full(4, math.nan),
        recovery=recovery,
        resets=int(counts.max() - counts.min()) if len(counts) else 0,
    )


def label(fault: Fault) -> str:
    """Return a fault's name without its time: variants differ by what is not their default."""
    values = [
        f"{key}={value if isinstance(value, str) else format(value, 'g')}"
        for key, value in fault.values.items()
        if value != getattr(fault.kind.values[key], "default", _first(fault, key))
    ]
    return fault.kind.name + (":" + ",".join(values) if values else "")


def _first(fault: Fault, key: str) -> object:
    return getattr(fault.kind.values[key], "words", (None,))[0]


def unnoticed(found: Sequence[Episode], limits: Array) -> list[str]:
    """Return the kinds of fault during which all errors stayed normal, without a reset."""
    noticed = {label(one.fault) for one in found if one.resets or not (one.largest <= limits).all()}
    return sorted({label(one.fault) for one in found} - noticed)


def rows(found: Sequence[Episode]) -> Iterator[str]:
    """Yield a table by kind of fault."""
    lines = []
    for name in sorted({label(one.fault) for one in found}):
        of_it = [one for one in found if label(one.fault) == name]
        sizes = np.stack([one.largest for one in of_it])
        largest = np.nanmax(sizes, axis=0) * SCALE if not np.isnan(sizes).all() else sizes[0]
        recoveries = [one.recovery for one in of_it]
        cells = [f"`{name}`"]
        cells += [f"{value:.2f}" if value < 10.0 else f"{value:.0f}" for value in largest]
        cells += [f"{np.median(recoveries):.1f}", f"{max(recoveries):.1f}"]
        lines.append(" | ".join([*cells, str(sum(one.resets for one in of_it))]))
    return table(" | ".join(["fault", *UNITS, "recovery median s", "worst s", "resets"]), lines)
