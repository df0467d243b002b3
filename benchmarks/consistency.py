"""Is the filter as wrong as it says? Monte Carlo of the normalised errors, block by block.

Source: Bar-Shalom, Li, Kirubarajan 2001, "Estimation with applications to tracking and
navigation", section 5.4 (NEES, NIS and their chi-square bands over independent runs).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import (
    DELAY_STD,
    HARD_IRON_STD,
    PROCESSES,
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
from benchmarks.matched import matched
from ekf_companion.core import state as at
from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.health import Aid, Health, Verdict

Array = npt.NDArray[np.float64]

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
"""Settings: those of the simulator's sensors, and those that nobody has touched."""


@dataclass(frozen=True, slots=True, eq=False)
class Account:
    """One flight: normalised errors by block, and what became of the aids."""

    nees: dict[str, Array]
    """Shape (instants,); NaN where the filter did not navigate."""
    ratios: dict[str, Array]
    """Error over sigma by axis, shape (instants, dof)."""
    nis: dict[Aid, tuple[float, float]]
    """Sum of NIS over dof, and their number, from the first instant on; empty: not kept."""
    verdicts: dict[Aid, dict[str, int]]
    """From the first instant on."""
    resets: int


def settings_of(kind: str, flown: Flown) -> tuple[FilterSettings, str]:
    """Give settings and the autopilot's family; the simulator passes itself off as a PX4."""
    if kind == "matched":
        return matched(flown.nominal, DELAY_STD, HARD_IRON_STD), "unknown"
    return FilterSettings(), "px4"


def account(flown: Flown, kind: str, instants: Sequence[float] = INSTANTS) -> Account:
    """Run the filter over a flight and hold it against the truth at some instants (s)."""
    settings, family = settings_of(kind, flown)
    stops = [flown.flight.first_ns + round(t * 1e9) for t in instants]
    squares = {name: np.full(len(stops), np.nan) for name in BLOCKS}
    ratios = {name: np.full((len(stops), dof), np.nan) for name, dof in BLOCKS.items()}
    first: tuple[Health, Array] | None = None
    health, x = None, np.empty(0)
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
    return Account(squares, ratios, _nis(first[1], x), _verdicts(first[0], health), health.resets)


def _nis(before: Array, after: Array) -> dict[Aid, tuple[float, float]]:
    """Give what the block has summed up in between, if it does."""
    gained = after - before
    return {
        aid: (float(gained[at.X_NIS_SUM + aid]), float(gained[at.X_NIS_N + aid])) for aid in Aid
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
    """Fly one job (scenario, seed, receiver) with each kind of settings."""
    name, seed, receiver = job
    flown = fly(name, seed, receiver, DURATION)
    return {kind: account(flown, kind) for kind in KINDS}


def campaign(
    flights: int, processes: int = PROCESSES
) -> dict[tuple[str, str], list[dict[str, Account]]]:
    """Fly all scenarios with both receivers; accounts by scenario and receiver."""
    cases = [(name, receiver) for receiver in RECEIVERS for name in SCENARIOS]
    # other seeds in each case, so that the cases are independent
    jobs = [
        (name, 1000 * i + seed, receiver)
        for i, (name, receiver) in enumerate(cases)
        for seed in range(1, flights + 1)
    ]
    results = each(flight_of, jobs, "consistency, flights", processes)
    return {case: results[i * flights : (i + 1) * flights] for i, case in enumerate(cases)}


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give NEES and error over sigma by block, then what became of the aids."""
    del data
    flights = runs or FLIGHTS
    found = campaign(flights)
    yield (
        f"{flights} flights of each scenario and receiver, {DURATION:.0f} s, at "
        f"{len(INSTANTS)} instants from {INSTANTS[0]:.0f} s on, 19 s apart or more. A cell is NEES"
        " over its degrees of freedom, mean of flights and instants; in brackets at how many of"
        " the instants the mean of the flights lies in the 95 % band: "
        f"{_band(3 * flights)} for three degrees of freedom, {_band(flights)} for one."
    )
    if rest := at.N - sum(BLOCKS.values()):
        yield f"\n{rest} further error states are held against nothing."
    for kind in KINDS:
        for receiver in RECEIVERS:
            group = {name: [one[kind] for one in found[name, receiver]] for name in SCENARIOS}
            yield from ("", f"**Settings {kind}, receiver {receiver}**", "")
            yield from _blocks(group)
            yield ""
            yield from _aids(group)


def _band(dof: int) -> str:
    low, high = band(dof)
    return f"{low:.2f} to {high:.2f}"


def _blocks(group: dict[str, list[Account]]) -> Iterator[str]:
    yield f"| block | {' | '.join(group)} | RMS(error / sigma) by axis |"
    yield "|---" * (len(group) + 2) + "|"
    for name, dof in BLOCKS.items():
        cells = [
            _cell(np.array([one.nees[name] for one in flown]), dof) for flown in group.values()
        ]
        pooled = np.concatenate([one.ratios[name] for flown in group.values() for one in flown])
        axes = np.sqrt(np.nanmean(np.square(pooled), axis=0))
        yield f"| {name} | {' | '.join(cells)} | {', '.join(f'{axis:.2f}' for axis in axes)} |"


def _cell(squares: Array, dof: int) -> str:
    """Give NEES over dof and how many instants are in the band; squares: (flights, instants)."""
    if np.isnan(squares).all():
        return "-"
    counts = np.count_nonzero(np.isfinite(squares), axis=0)
    means = np.nanmean(squares, axis=0) / dof
    bands = [band(max(int(n), 1) * dof) for n in counts]
    inside = sum(low <= mean <= high for mean, (low, high) in zip(means, bands, strict=True))
    lost = f", {squares.size - counts.sum()} lost" if (counts < len(squares)).any() else ""
    return f"{means.mean():.2f} ({inside}/{len(means)}{lost})"


def _aids(group: dict[str, list[Account]]) -> Iterator[str]:
    """Give NIS (if the filter sums it), the shares refused or weakened, and resets."""
    everyone = [one for flown in group.values() for one in flown]
    has_nis = bool(everyone[0].nis)
    names = [
        why.name.lower()
        for why in Verdict
        if why not in (Verdict.BEFORE_ALIGNMENT, Verdict.SUPERSEDED)
    ]
    yield f"| aid | {'NIS / dof | ' if has_nis else ''}judged | {' | '.join(names[1:])} |"
    yield "|---" * (len(names) + 1 + has_nis) + "|"
    for aid in Aid:
        counts = {name: sum(one.verdicts[aid][name] for one in everyone) for name in names}
        judged = sum(counts.values())
        if not judged:
            continue
        cells = [f"{100.0 * counts[name] / judged:.3f} %" for name in names[1:]]
        nis = ""
        if has_nis:
            sums = np.sum([one.nis[aid] for one in everyone], axis=0)
            nis = f"{sums[0] / sums[1]:.2f} | " if sums[1] else "- | "
        yield f"| {aid.name.lower()} | {nis}{judged} | {' | '.join(cells)} |"
    yield from ("", f"Resets in all flights: {sum(one.resets for one in everyone)}.")
