"""How far the estimate drifts while GNSS is silent, and whether its own sigma covers that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from benchmarks.campaign import (
    PROCESSES,
    SCENARIOS,
    Snapshot,
    each,
    errors,
    fly,
    nees,
    pieces,
    roster,
)
from benchmarks.cases import MISSION, TRUTH, recorded
from benchmarks.consistency import KINDS, settings_of
from ekf_companion.core.enums import E_POS
from ekf_companion.core.settings import FilterSettings
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory

Array = npt.NDArray[np.float64]
Drift = tuple[float, float, bool, bool]
"""Horizontal and vertical error at the end of an outage, m, and whether each is covered."""

FLIGHTS = 50
LENGTHS = (10.0, 30.0, 60.0)
"""s."""
STARTS = (60.0, 100.0)
"""The outages of simulated flights begin anywhere between, s after the first sample."""
COVERED = 0.95
STEP = 5.0
"""Between the outages tried on a recorded flight, s."""
SETTLED = 20.0
"""A recorded flight is left alone for so long after its first fix, s."""
AIRBORNE = 1.0
"""Above where it stood at first, m."""


def cut(events: Events, start_ns: int, length: float) -> Events:
    """Take every fix away whose stamp lies in an outage, the autopilot's own positions too."""
    end_ns = start_ns + round(length * 1e9)
    is_silent = (events.t_ns >= start_ns) & (events.t_ns < end_ns)
    return events.take(~(is_silent & (events.kind == Kind.GNSS)))


def drift(error_n: Array, P: Array) -> Drift:
    """Judge a position error by its covariance: the ellipse, and the interval, of 95 %."""
    return (
        float(np.hypot(error_n[0], error_n[1])),
        abs(float(error_n[2])),
        nees(error_n[:2], P[:2, :2]) <= chi2.ppf(COVERED, 2),
        float(error_n[2] ** 2 / P[2, 2]) <= chi2.ppf(COVERED, 1),
    )


def simulated(job: tuple[str, int]) -> dict[tuple[str, float], Drift]:
    """Fly one scenario and seed with each outage and each kind of settings."""
    name, seed = job
    flown = fly(name, seed)
    start = np.random.default_rng([seed, 99]).uniform(*STARTS)
    start_ns = flown.flight.first_ns + round(start * 1e9)
    found = {}
    for kind in KINDS:
        settings, family = settings_of(kind, flown)
        for length in LENGTHS:
            silent = cut(flown.events, start_ns, length)
            end = next(pieces(settings, silent, [start_ns + round(length * 1e9)], family))
            found[kind, length] = drift(*errors(end.snapshot, flown, settings, family)["position"])
    return found


def in_recorded(job: tuple[Path, float]) -> list[Drift]:
    """Cut outages of one length (s) into a recorded flight, one at a time, wherever it flies."""
    path, length = job
    log = recorded(path)
    reference = log.truth or log.reference
    assert reference is not None, f"{path} holds nothing to compare with"
    found = []
    for start_ns in _starts(log.events, reference, length):
        silent = cut(log.events, start_ns, length)
        end_ns = start_ns + round(length * 1e9)
        parts = pieces(FilterSettings(), silent, [end_ns], log.family, log.gnss_delay)
        snapshot = next(parts).snapshot
        if snapshot.is_navigating:
            error_n = _reference_pos_n(snapshot, reference) - snapshot.x.pos_n
            found.append(drift(error_n, snapshot.covariance(E_POS, 3)))
    return found


def _starts(events: Events, reference: Trajectory, length: float) -> list[int]:
    """Give when outages may begin so that all of each is flown."""
    flown = reference.pos_t_ns[reference.alt > reference.alt[0] + AIRBORNE]
    if not len(flown):
        return []
    first_fix = int(events.t_ns[events.kind == Kind.GNSS].min())
    first = max(int(flown[0]), first_fix + round(SETTLED * 1e9))
    last = int(flown[-1]) - round(length * 1e9)
    return list(range(first, last, round(STEP * 1e9)))


def _reference_pos_n(snapshot: Snapshot, reference: Trajectory) -> Array:
    """Give the reference's position in the filter's frame when its state was true."""
    columns = (reference.lat, reference.lon, reference.alt)
    place = [np.interp(snapshot.t_ns, reference.pos_t_ns, one) for one in columns]
    return snapshot.frame.to_ned(*place)


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give drift and coverage: simulated flights, then recorded ones."""
    flights = runs or FLIGHTS
    yield from _header(f"simulated, {flights} flights each")
    found = each(simulated, roster(flights), "outages, flights")
    for kind in KINDS:
        for i, name in enumerate(SCENARIOS):
            part = found[i * flights : (i + 1) * flights]
            for length in LENGTHS:
                yield _row(f"{name}, {kind}", length, [one[kind, length] for one in part])
        for length in LENGTHS:
            yield _row(f"all, {kind}", length, [one[kind, length] for one in found])
    logs = [case.log for case in TRUTH] + [MISSION]
    logs = [log for log in logs if (data / log).is_file()]
    if not logs:
        return
    yield ""
    yield from _header("recorded")
    tried = [(data / log, length) for log in logs for length in LENGTHS]
    for (path, length), drifts in zip(
        tried, each(in_recorded, tried, "outages, logs and lengths", PROCESSES), strict=True
    ):
        if drifts:
            yield _row(path.parent.name, length, drifts)


def _header(first: str) -> Iterator[str]:
    yield (
        f"| {first} | outage, s | cases | horizontal: median, m | 95 % | covered"
        " | vertical: median, m | 95 % | covered |"
    )
    yield "|---" * 9 + "|"


def _row(title: str, length: float, drifts: Sequence[Drift]) -> str:
    columns = list(zip(*drifts, strict=True))
    cells = []
    for size, is_covered in ((columns[0], columns[2]), (columns[1], columns[3])):
        share = float(np.mean(is_covered))
        cells += [f"{np.median(size):.2f}", f"{np.percentile(size, 95.0):.2f}"]
        cells += [f"{100.0 * share:.0f} %"]
    return f"| {title} | {length:.0f} | {len(drifts)} | {' | '.join(cells)} |"
