"""How far the estimate drifts without GNSS, and whether its own sigma covers that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.accuracy.consistency import KINDS, settings_of
from benchmarks.campaign import SCENARIOS, Snapshot, each, errors, fly, nees, pieces, roster
from benchmarks.document import table
from benchmarks.recorded import MISSION, TRUTH, recorded
from ekf_companion.core.memory.enums import E_POS
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory

Drift = tuple[float, float, bool, bool]
"""Horizontal and vertical error at the end of an outage, m, and whether each is covered."""

FLIGHTS = 50
LENGTHS = (10.0, 30.0, 60.0)
"""s."""
STARTS = (60.0, 100.0)
"""The outages of simulated flights begin anywhere between, s after the first sample."""
COVERED = 0.95
HEAD = "outage, s | cases | horizontal: median, m | 95 % | covered | vertical: 95 %, m | covered"
STEP = 5.0
"""Between the outages tried on a recorded flight, s."""
SETTLED = 20.0
"""No outage begins so soon after the first fix of a recorded flight, s."""
AIRBORNE = 1.0
"""Above the height at the start, m."""


def cut(events: Events, start_ns: int, length: float) -> Events:
    """Remove every fix whose stamp lies in an outage, the autopilot's own positions too."""
    end_ns = start_ns + round(length * 1e9)
    is_silent = (events.t_ns >= start_ns) & (events.t_ns < end_ns)
    return events.take(~(is_silent & (events.kind == Kind.GNSS)))


def drift(error_n: Array, P: Array) -> Drift:
    """Compare a position error with its covariance: the ellipse, and the interval, of 95 %."""
    return (
        float(np.hypot(error_n[0], error_n[1])),
        abs(float(error_n[2])),
        nees(error_n[:2], P[:2, :2]) <= chi2.ppf(COVERED, 2),
        float(error_n[2] ** 2 / P[2, 2]) <= chi2.ppf(COVERED, 1),
    )


def simulated(job: tuple[str, int]) -> dict[tuple[str, float], Drift]:
    """Run one flight (scenario, seed) with an outage and each kind of settings."""
    name, seed = job
    flown = fly(name, seed)
    start = np.random.default_rng([seed, 99]).uniform(*STARTS)
    start_ns = flown.flight.first_ns + round(start * 1e9)
    silent = cut(flown.events, start_ns, max(LENGTHS))
    ends = [start_ns + round(length * 1e9) for length in LENGTHS]
    found = {}
    for kind in KINDS:
        settings, family = settings_of(kind, flown)
        # a shorter outage is the beginning of the longest
        for length, piece in zip(LENGTHS, pieces(settings, silent, ends, family), strict=False):
            position = errors(piece.snapshot, flown, settings, family)["position"]
            found[kind, length] = drift(*position)
    return found


def in_recorded(path: Path) -> dict[float, list[Drift]]:
    """Cut outages into a recorded flight, one at a time, wherever it flies; drifts by length."""
    log = recorded(path)
    reference = log.truth or log.reference
    assert reference is not None, f"{path} holds nothing to compare with"
    found: dict[float, list[Drift]] = {length: [] for length in LENGTHS}
    first_ns, last_ns = _airborne(log.events, reference)
    for start_ns in range(first_ns, last_ns - round(min(LENGTHS) * 1e9), round(STEP * 1e9)):
        lengths = [length for length in LENGTHS if start_ns + round(length * 1e9) < last_ns]
        silent = cut(log.events, start_ns, max(lengths))
        ends = [start_ns + round(length * 1e9) for length in lengths]
        parts = pieces(FilterSettings(), silent, ends, log.family, log.gnss_delay)
        for length, piece in zip(lengths, parts, strict=False):
            at_end = piece.snapshot
            if at_end.is_navigating:
                error_n = _reference_pos_n(at_end, reference) - at_end.x.pos_n
                found[length].append(drift(error_n, at_end.covariance(E_POS, 3)))
    return found


def _airborne(events: Events, reference: Trajectory) -> tuple[int, int]:
    """Return the first time for an outage and the end of the flight; 0, 0: no flight."""
    flown = reference.pos_t_ns[reference.alt > reference.alt[0] + AIRBORNE]
    if not len(flown):
        return 0, 0
    first_fix = int(events.t_ns[events.kind == Kind.GNSS].min())
    return max(int(flown[0]), first_fix + round(SETTLED * 1e9)), int(flown[-1])


def _reference_pos_n(snapshot: Snapshot, reference: Trajectory) -> Array:
    """Return the reference's position in the filter's frame at the time of its state."""
    columns = (reference.lat, reference.lon, reference.alt)
    place = [np.interp(snapshot.t_ns, reference.pos_t_ns, one) for one in columns]
    return snapshot.frame.to_ned(*place)


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Yield drift and coverage: all simulated flights, the worst scenario, then recorded ones."""
    flights = runs or FLIGHTS
    found = each(simulated, roster(flights), "outages, flights")
    rows = []
    for kind in KINDS:
        for length in LENGTHS:
            drifts = [one[kind, length] for one in found]
            rows.append(_row(f"{kind}: all", length, drifts))
            parts = {
                name: drifts[i * flights : (i + 1) * flights] for i, name in enumerate(SCENARIOS)
            }
            worst = max(parts, key=lambda name: _reach(parts[name]))
            rows.append(_row(f"{kind}: {worst}, the worst", length, parts[worst]))
    yield from table(f"simulated, settings | {HEAD}", rows)
    paths = [data / case.log for case in (*TRUTH, MISSION) if (data / case.log).is_file()]
    if paths:
        yield ""
        rows = [
            _row(path.parent.name, length, drifts)
            for path, by_length in zip(
                paths, each(in_recorded, paths, "outages, logs"), strict=True
            )
            for length, drifts in by_length.items()
            if drifts
        ]
        yield from table(f"recorded | {HEAD}", rows)


def _reach(drifts: Sequence[Drift]) -> float:
    """Return the horizontal error that 95 % of the drifts do not pass."""
    return float(np.percentile([one[0] for one in drifts], 95.0))


def _row(title: str, length: float, drifts: Sequence[Drift]) -> str:
    horizontal, vertical, *covered = zip(*drifts, strict=True)
    shares = [f"{100.0 * float(np.mean(is_covered)):.0f} %" for is_covered in covered]
    reach = f"{_reach(drifts):.2f}"
    cells = [title, f"{length:.0f}", str(len(drifts)), f"{np.median(horizontal):.2f}", reach]
    return " | ".join([*cells, shares[0], f"{np.percentile(vertical, 95.0):.2f}", shares[1]])
