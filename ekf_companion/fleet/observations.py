"""What happened in a log, and how its innovations and learnt noise are spread."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby

import numpy as np

from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.engine.health import Aid
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.state import Status
from ekf_companion.replay.watched import PERIOD_NS

EVENTS: Mapping[str, type] = {
    "kind": str,
    "subject": str,
    "begin_s": float,
    "end_s": float,
    "count": int,
    "evidence": str,
}
"""Columns of an event: its kind is ``reset``, ``reboot``, ``refused`` (measurements of an aid),
``status`` (worse than OK) or ``fault`` (what the verdict names); seconds are from the first
estimate, of a fault they are not known."""
HISTOGRAMS: Mapping[str, type] = {
    "quantity": str,
    "low": float,
    "high": float,
    "below": int,
    "counts": list,
    "above": int,
    "mean": float,
    "std": float,
}
"""Columns of a histogram: ``counts`` are of equal bins from low to high. Innovations are over their
sigma; ``nis_*`` are means over a second, over their degrees of freedom, as decimal logarithms, and
so are the learnt noises."""
AXES = ("north", "east", "down")
SIGMAS, BINS = 6.0, 48
"""Range of innovations over their sigma, and bins of every histogram."""
_SHOWN = (Status.DEGRADED, Status.DEAD_RECKONING, Status.INVALID)
_RANGES = {"nis": (-3.0, 3.0), "gyro_noise": (-5.0, 0.0), "accel_noise": (-4.0, 1.0)}
"""Decimal logarithms; noise in rad/s and m/s^2 per square root of Hz."""
Values = dict[str, object]


def events(flight: FlightReview) -> Iterator[Values]:
    """Yield the events of a flight: those with a time in its order, then the faults."""
    begin_ns = int(flight.table.stamp_ns[0])
    found = [*_resets(flight), *_refusals(flight), *_statuses(flight)]
    for first_ns, last_ns, kind, subject, count, evidence in sorted(found):
        yield {
            "kind": kind,
            "subject": subject,
            "begin_s": round((first_ns - begin_ns) * 1e-9, 3),
            "end_s": round((last_ns - begin_ns) * 1e-9, 3),
            "count": count,
            "evidence": evidence,
        }
    for words in flight.judgement.reasons:
        yield {**dict.fromkeys(EVENTS), "kind": "fault", "subject": "verdict", "evidence": words}


_Event = tuple[int, int, str, str, int, str]


def _resets(flight: FlightReview) -> Iterator[_Event]:
    for look in flight.looks:
        if look.reset:
            yield look.t_ns, look.t_ns, "reset", look.reset, 1, ""
    for t_ns in flight.begins_ns:
        yield t_ns, t_ns, "reboot", "autopilot", 1, ""


def _refusals(flight: FlightReview) -> Iterator[_Event]:
    """Yield stretches of whole seconds in which measurements of an aid were refused for one reason.

    The evidence is their mean normalised innovation squared.
    """
    reasons = {each for look in flight.looks for each, n in look.refused.items() if n}
    for aid, why in sorted(reasons):
        looks = [(look, look.refused[aid, why]) for look in flight.looks]
        for is_refused, group in groupby(looks, key=lambda one: one[1] > 0):
            if not is_refused:
                continue
            stretch = list(group)
            nis = np.array([look.nis[aid] for look, _ in stretch])
            known = nis[np.isfinite(nis)]
            evidence = f"{why.name.lower()}"
            if len(known):
                evidence += f", NIS {known.mean():.3g} over its degrees of freedom"
            first, last = stretch[0][0].t_ns - PERIOD_NS, stretch[-1][0].t_ns
            count = sum(number for _, number in stretch)
            yield first, last, "refused", aid.name.lower(), count, evidence


def _statuses(flight: FlightReview) -> Iterator[_Event]:
    for band in flight.bands:
        status, _, why = band.name.partition(": ")
        if band.status in _SHOWN and why:
            for first, last in band.spans_ns:
                yield first, last, "status", status, 1, why


def histograms(flight: FlightReview) -> Iterator[Values]:
    """Yield the histograms of a flight."""
    if (found := flight.innovations) is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = 3.0 * found.values / found.bounds
        names = [f"{what}_{axis}" for what in ("position", "velocity") for axis in AXES]
        for name, column in zip(names, ratios.T, strict=True):
            yield from _histogram(f"innovation_{name}", column, -SIGMAS, SIGMAS)
    nis = np.array([look.nis for look in flight.looks]).reshape(-1, len(Aid))
    quantities = {f"nis_{aid.name.lower()}": nis[:, aid] for aid in Aid}
    for name in ("gyro_noise", "accel_noise"):
        quantities[name] = np.array([getattr(look, name) for look in flight.looks])
    for name, values in quantities.items():
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithms = np.log10(values)
        yield from _histogram(name, logarithms, *_RANGES[name if name in _RANGES else "nis"])


def _histogram(name: str, values: Array, low: float, high: float) -> Iterator[Values]:
    known = values[np.isfinite(values)]
    if not len(known):
        return
    yield {
        "quantity": name,
        "low": low,
        "high": high,
        "below": int(np.count_nonzero(known < low)),
        "counts": np.histogram(known, BINS, (low, high))[0].tolist(),
        "above": int(np.count_nonzero(known > high)),
        "mean": float(known.mean()),
        "std": float(known.std()),
    }
