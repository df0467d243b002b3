"""Whether the filter's covariance is right: Monte Carlo of the normalised errors, by block.

Source: Bar-Shalom, Li, Kirubarajan 2001, "Estimation with applications to tracking and navigation",
section 5.4 (NEES, NIS and their chi-square bands over independent runs).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.campaign import (
    DELAY_STD,
    HARD_IRON_STD,
    RECEIVERS,
    SCENARIOS,
    Flown,
    band,
    each,
    errors,
    fly,
    nees,
    pieces,
)
from benchmarks.document import table
from benchmarks.matched import matched
from ekf_companion.core.memory.enums import N
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Aid, Health, Verdict
from ekf_companion.nav.arrays import Array

FLIGHTS = 100
DURATION = 180.0
INSTANTS = (60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 179.0)
"""s from the first sample: after convergence, and far enough apart to differ."""
BLOCKS = {
    "position": 3,
    "velocity": 3,
    "attitude": 3,
    "gyro bias": 3,
    "accel bias": 3,
    "baro offset": 1,
    "GNSS delay": 1,
    "heading offset": 1,
    "GNSS slow error": 3,
    "hard iron": 3,
}
"""Blocks of error states and their sizes."""
KINDS = ("matched", "default")
"""Settings: those of the simulator's sensors, and the defaults."""


@dataclass(frozen=True, slots=True, eq=False)
class Account:
    """One flight: normalised errors by block, and the verdicts on the aids."""

    nees: dict[str, Array]
    """Shape (instants,); NaN where the filter did not navigate."""
    ratios: dict[str, Array]
    """Error over sigma by axis, shape (instants, dof)."""
    nis: dict[Aid, tuple[float, float]]
    """Sum of NIS over dof, and their number, from the first instant on."""
    verdicts: dict[Aid, dict[str, int]]
    """From the first instant on."""
    resets: int


def settings_of(kind: str, flown: Flown) -> tuple[FilterSettings, str]:
    """Return settings and the autopilot's family: with the defaults that of PX4."""
    if kind == "matched":
        return matched(flown.nominal, DELAY_STD, HARD_IRON_STD), "unknown"
    return FilterSettings(), "px4"


def account(flown: Flown, kind: str, instants: Sequence[float] = INSTANTS) -> Account:
    """Run the filter over a flight and compare it with the truth at some instants (s)."""
    settings, family = settings_of(kind, flown)
    stops = [flown.flight.first_ns + round(t * 1e9) for t in instants]
    squares = {name: np.full(len(stops), np.nan) for name in BLOCKS}
    ratios = {name: np.full((len(stops), dof), np.nan) for name, dof in BLOCKS.items()}
    first: tuple[Health, State] | None = None
    health, x = None, None
    for i, piece in enumerate(pieces(settings, flown.events, stops, family)):
        health, x = piece.pipeline.health(), piece.snapshot.x
        first = first or (health, x)
        if i == len(stops) or not piece.snapshot.is_navigating:
            continue
        for name, (error, P) in errors(piece.snapshot, flown, settings, family).items():
            squares[name][i] = nees(error, P)
            ratios[name][i] = error / np.sqrt(np.diag(P))
    assert health is not None
    assert first is not None
    assert x is not None
    return Account(squares, ratios, _nis(first[1], x), _verdicts(first[0], health), health.resets)


def _nis(before: State, after: State) -> dict[Aid, tuple[float, float]]:
    """Return the growth of the state's sums of NIS."""
    return {
        aid: (after.nis_sum[aid] - before.nis_sum[aid], after.nis_n[aid] - before.nis_n[aid])
        for aid in Aid
    }


def _verdicts(before: Health, after: Health) -> dict[Aid, dict[str, int]]:
    return {
        aid: {
            why.name.lower(): after.verdicts[aid][why] - before.verdicts[aid][why]
            for why in Verdict
        }
        for aid in Aid
    }


def flight_of(job: tuple[str, int, str]) -> dict[str, Account]:
    """Run one flight (scenario, seed, receiver) with each kind of settings."""
    name, seed, receiver = job
    flown = fly(name, seed, receiver, DURATION)
    return {kind: account(flown, kind) for kind in KINDS}


def campaign(flights: int) -> dict[tuple[str, str], list[dict[str, Account]]]:
    """Run all scenarios with both receivers; accounts by scenario and receiver."""
    cases = [(name, receiver) for receiver in RECEIVERS for name in SCENARIOS]
    # other seeds in each case, so that the cases are independent
    jobs = [
        (name, 1000 * i + seed, receiver)
        for i, (name, receiver) in enumerate(cases)
        for seed in range(1, flights + 1)
    ]
    results = each(flight_of, jobs, "consistency, flights")
    return {case: results[i * flights : (i + 1) * flights] for i, case in enumerate(cases)}


def tables(runs: int | None = None) -> Iterator[str]:
    """Yield NEES by block for each settings and receiver, then NIS and verdicts of the aids."""
    flights = runs or FLIGHTS
    found = campaign(flights)
    yield (
        f"{flights} flights of each scenario and receiver, {DURATION:.0f} s, at "
        f"{len(INSTANTS)} instants from {INSTANTS[0]:.0f} s on, 19 s apart or more. A cell is NEES"
        " over its degrees of freedom, mean of flights and instants; in brackets, with matched"
        " settings, at how many of the instants the mean of the flights lies in the 95 % band, if"
        " not at all of them: "
        f"{_band(3 * flights)} for three degrees of freedom, {_band(flights)} for one."
    )
    if rest := N - sum(BLOCKS.values()):
        yield f"\n{rest} further error states are not compared."
    groups = {}
    for kind in KINDS:
        for receiver in RECEIVERS:
            group = {name: [one[kind] for one in found[name, receiver]] for name in SCENARIOS}
            yield from ("", f"**Settings {kind}, receiver {receiver}**", "")
            yield from _blocks(group, kind == "matched")
            groups[f"{kind}, {receiver}"] = [one for flown in group.values() for one in flown]
    yield from (
        "",
        "NIS of each aid over its degrees of freedom; in brackets the share de-weighted:",
        "",
    )
    yield from _aids(groups)


def _band(dof: int) -> str:
    low, high = band(dof)
    return f"{low:.2f} to {high:.2f}"


def _blocks(group: dict[str, list[Account]], has_counts: bool) -> Iterator[str]:
    rows = []
    for name, dof in BLOCKS.items():
        cells = [
            _cell(np.array([one.nees[name] for one in flown]), dof, has_counts)
            for flown in group.values()
        ]
        if set(cells) == {"-"}:
            continue
        rows.append(" | ".join([name, *cells]))
    return table(" | ".join(["block", *group]), rows)


def _cell(squares: Array, dof: int, has_count: bool) -> str:
    """Format NEES over dof, and if asked how many instants are in the band if not all are.

    The squares have the shape (flights, instants).
    """
    if np.isnan(squares).all():
        return "-"
    counts = np.count_nonzero(np.isfinite(squares), axis=0)
    means = np.nanmean(squares, axis=0) / dof
    bands = [band(max(int(n), 1) * dof) for n in counts]
    inside = sum(low <= mean <= high for mean, (low, high) in zip(means, bands, strict=True))
    notes = [f"{inside}/{len(means)}"] if has_count and inside < len(means) else []
    if (counts < len(squares)).any():
        notes.append(f"{squares.size - counts.sum()} lost")
    return f"{means.mean():.2f}" + (f" ({', '.join(notes)})" if notes else "")


def _aids(groups: dict[str, list[Account]]) -> Iterator[str]:
    """Yield NIS and the share de-weighted, then the largest shares not fused, and resets."""
    largest = dict.fromkeys((Verdict.GATED, Verdict.SUSPECT, Verdict.DISTURBED), 0.0)
    unjudged = (Verdict.BEFORE_ALIGNMENT, Verdict.SUPERSEDED)
    rows = []
    for aid in Aid:
        cells = []
        for flown in groups.values():
            counts = {w: sum(one.verdicts[aid][w.name.lower()] for one in flown) for w in Verdict}
            if not (judged := sum(n for why, n in counts.items() if why not in unjudged)):
                cells.append("-")
                continue
            total, number = np.sum([one.nis[aid] for one in flown], axis=0)
            nis = f"{total / number:.2f}" if number else "-"
            cells.append(f"{nis} ({100.0 * counts[Verdict.DEWEIGHTED] / judged:.3f} %)")
            for why in largest:
                largest[why] = max(largest[why], 100.0 * counts[why] / judged)
        if set(cells) != {"-"}:
            rows.append(" | ".join([aid.name.lower(), *cells]))
    yield from table(" | ".join(["aid", *groups]), rows)
    shares = ", ".join(f"{why.name.lower()} {share:.3f} %" for why, share in largest.items())
    resets = sum(one.resets for flown in groups.values() for one in flown)
    yield from ("", f"Largest share of any aid: {shares}. Resets in all flights: {resets}.")
