"""What became of several filters over one recording, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ekf_companion.filters.solution import Solution
from ekf_companion.nav.state import Trajectory

SECTIONS = {
    "RMS error": (
        *(("north", "m"), ("east", "m"), ("down", "m"), ("down about mean", "m")),
        *(("velocity north", "m/s"), ("velocity east", "m/s"), ("velocity down", "m/s")),
        *(("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("inclination", "deg")),
    ),
    "Attitude alone, RMS error where it counts": (
        *(("turn in all", "deg"), ("turn in heading", "deg"), ("turn in inclination", "deg")),
    ),
    "Walk: from its first position to its last": (
        *(("closure on the ground", "m"), ("closure in space", "m"), ("way", "m")),
        ("stances", ""),
    ),
    "NEES over its degrees of freedom (1: as sure as it may be; above: too sure)": (
        *(("position", ""), ("velocity", ""), ("attitude", "")),
    ),
}
"""Rows of the table, with their units."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Entry:
    """What became of one filter."""

    name: str
    solution: Solution | None
    """None: the recording, or this machine, lacks what it needs."""
    trajectory: Trajectory | None
    us: float
    """Processor time per inertial sample, microseconds."""
    note: str = ""
    """Why there is no solution."""
    span: tuple[float, float] | None = None
    """First and last time that was scored, s; None: all that counts."""
    rms: Mapping[str, float] = field(default_factory=dict)
    """By row of the table, in its unit; NaN, or no row: one of the two lacks it."""
    nees: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Give everything for JSON; what is not known is null."""
        known = {name: value if np.isfinite(value) else None for name, value in self.rms.items()}
        sure = {name: value if np.isfinite(value) else None for name, value in self.nees.items()}
        return {
            "filter": self.name,
            "rms": {_key(name): value for name, value in known.items() if value is not None},
            "nees": sure,
            "scored_s": self.span,
            "us_per_sample": self.us if np.isfinite(self.us) else None,
            "estimates": 0 if self.solution is None else len(self.solution.table),
            "fused": {} if self.solution is None else dict(self.solution.counts),
            "notes": [*([self.note] if self.note else []), *self.remarks()],
        }

    def remarks(self) -> tuple[str, ...]:
        """Give what the filter itself says of its solution."""
        return () if self.solution is None else self.solution.notes


def _key(name: str) -> str:
    unit = dict(row for rows in SECTIONS.values() for row in rows).get(name, "")
    return f"{name} {unit.replace('/', 'p')}".strip().replace(" ", "_")


def table(entries: Sequence[Entry]) -> Iterator[str]:
    """Give the entries as lines of text, a column each."""
    width = max(10, *(len(one.name) + 2 for one in entries))
    yield f"{'':<26}" + "".join(f"{one.name:>{width}}" for one in entries)
    for title, rows in SECTIONS.items():
        values = [one.nees if title.startswith("NEES") else one.rms for one in entries]
        shown = [
            (name, unit)
            for name, unit in rows
            if any(np.isfinite(each.get(name, np.nan)) for each in values)
        ]
        if shown:
            yield from ("", title)
        for name, unit in shown:
            label = f"  {name}, {unit}" if unit else f"  {name}"
            yield f"{label:<26}" + "".join(
                f"{_number(each.get(name, np.nan), 0 if name == 'stances' else 3):>{width}}"
                for each in values
            )
    if any(one.span is not None for one in entries):
        yield from ("", "Time that was scored")
        for index, name in enumerate(("from", "to")):
            times = [np.nan if one.span is None else one.span[index] for one in entries]
            label = f"  {name}, s"
            yield f"{label:<26}" + "".join(f"{_number(t, 1):>{width}}" for t in times)
    yield from ("", "Cost")
    yield f"{'  us per sample':<26}" + "".join(f"{_number(one.us, 1):>{width}}" for one in entries)
    aids = dict.fromkeys(aid for one in entries if one.solution for aid in one.solution.counts)
    for aid in aids:
        cells = [one.solution.counts.get(aid) if one.solution else None for one in entries]
        shares = [
            "-" if cell is None or not sum(cell) else f"{100.0 * cell[1] / sum(cell):.1f} %"
            for cell in cells
        ]
        yield f"{f'  {aid} refused':<26}" + "".join(f"{share:>{width}}" for share in shares)
    for one in entries:
        for note in (*([one.note] if one.note else []), *one.remarks()):
            yield f"  note: {one.name}: {note}"


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"
