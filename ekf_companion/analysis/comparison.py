"""Several filters over one recording, side by side: errors, consistency and cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ekf_companion.analysis import attitude
from ekf_companion.analysis.closure import closure
from ekf_companion.analysis.consistency import nees
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import ConfigError, LogError, MissingPackageError
from ekf_companion.filters.solution import Solution
from ekf_companion.logs.estimate import of_table
from ekf_companion.logs.recording import Counted, Recording
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import EULER, Trajectory
from ekf_companion.replay.filters_by_name import parse_name, run_filter
from ekf_companion.review import difference
from ekf_companion.review.difference import euler_errors, rms, tilt_errors

Progress = Callable[[int, int], None]

WARM_NS = 2_000_000_000
"""Length of the recording that a filter processes before it is timed."""
NEAR_NS = 100_000_000
"""Largest time by which an inertial sample may be ahead of its estimate."""
AXES = ("north", "east", "down")
VELOCITIES = tuple(f"velocity {axis}" for axis in AXES)
TURNS = ("turn in all", "turn in heading", "turn in inclination")
SECTIONS: dict[str, dict[str, str]] = {
    "RMS error": {
        **dict.fromkeys((*AXES, "down about mean"), "m"),
        **dict.fromkeys(VELOCITIES, "m/s"),
        **dict.fromkeys((*EULER, "inclination"), "deg"),
    },
    "Attitude alone, RMS error where it counts": dict.fromkeys(TURNS, "deg"),
    "Walk: from its first position to its last": {
        **dict.fromkeys(("closure on the ground", "closure in space", "way"), "m"),
        "stances": "",
    },
    "NEES over its degrees of freedom (1: as sure as it may be; above: too sure)": {
        **dict.fromkeys(("position", "velocity", "attitude"), ""),
    },
}
"""Rows of the table by section, with their units."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Entry:
    """The result of one filter."""

    name: str
    solution: Solution | None
    """None: the recording, or this machine, lacks something that the filter needs."""
    trajectory: Trajectory | None
    us: float
    """Processor time per inertial sample, microseconds."""
    notes: tuple[str, ...] = ()
    """Why there is no solution, or the notes of the solution."""
    span: tuple[float, float] | None = None
    """First and last time scored, s; None: all."""
    rms: Mapping[str, float] = field(default_factory=dict)
    """By row of the table, in its unit; NaN, or no row: not known."""
    nees: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON; null for what is not known."""
        solution = self.solution
        return {
            "filter": self.name,
            "rms": {_key(row): value for row, value in self.rms.items() if np.isfinite(value)},
            "nees": {
                row: value if np.isfinite(value) else None for row, value in self.nees.items()
            },
            "scored_s": self.span,
            "us_per_sample": self.us if np.isfinite(self.us) else None,
            "estimates": 0 if solution is None else len(solution.table),
            "fused": {} if solution is None else dict(solution.counts),
            "notes": list(self.notes),
        }


def run_filters(
    recording: Recording,
    names: Sequence[str],
    settings: FilterSettings,
    progress: Progress | None = None,
) -> list[Entry]:
    """Run each filter over the recording.

    Raises:
        ConfigError: A name is unknown or given twice, or there is none.
        LogError: No filter finds what it needs.
    """
    if not names or len(set(names)) < len(names):
        raise ConfigError(f"--filters: {','.join(names)!r}: name each filter once, at least one")
    for name in names:
        parse_name(name)
    entries = []
    for done, name in enumerate(names):
        if progress is not None:
            progress(done, len(names))
        entries.append(_timed_run(recording, name, settings))
    if all(entry.solution is None for entry in entries):
        raise LogError("; ".join(dict.fromkeys(note for entry in entries for note in entry.notes)))
    return entries


def _timed_run(recording: Recording, name: str, settings: FilterSettings) -> Entry:
    t_ns = recording.events.t_ns
    if len(t_ns):
        # The first seconds alone, so that the filter's imports are not counted as cost
        few = recording.events.take(np.abs(t_ns - t_ns[0]) < WARM_NS)
        with suppress(LogError, ConfigError, MissingPackageError):
            run_filter(replace(recording, events=few), name, settings)
    begin = time.process_time()
    try:
        solution = run_filter(recording, name, settings)
    except (LogError, ConfigError, MissingPackageError) as error:
        return Entry(name=name, solution=None, trajectory=None, us=np.nan, notes=(str(error),))
    spent = (time.process_time() - begin) * 1e6
    return Entry(
        name=name,
        solution=solution,
        trajectory=of_table(solution.table, name),
        us=spent / max(processed(recording, solution), 1),
        notes=solution.notes,
        rms=_closure(solution),
    )


def processed(recording: Recording, solution: Solution) -> int:
    """Return how many inertial samples a filter processed, including those before its start."""
    stamps = recording.events.t_ns[recording.events.kind == Kind.IMU]
    if not len(solution.table):
        return len(stamps)
    return int(np.count_nonzero(stamps <= solution.table.stamp_ns[-1] + NEAR_NS))


def _closure(solution: Solution) -> dict[str, float]:
    """Return the closure of a walk; nothing for a filter that finds no stances."""
    if solution.is_still is None or not np.isfinite(solution.table.column("pos_n")).any():
        return {}
    found = closure(solution)
    return {
        "closure on the ground": found.horizontal,
        "closure in space": found.distance,
        "way": found.path,
        "stances": float(found.stances),
    }


def score_filters(
    entries: Sequence[Entry],
    reference: Trajectory,
    skip_s: float,
    until_s: float | None,
    counted: Counted | None = None,
) -> list[Entry]:
    """Score each filter against the reference, from the time at which all of them run.

    Args:
        entries: From :func:`run_filters`.
        reference: What they should estimate.
        skip_s: Leave out so many seconds after the last of them has begun.
        until_s: Leave out what is later than so many seconds after that; None: nothing.
        counted: The times that count by the recording's authors. With them, or with a reference
            of attitude alone, the other two are ignored.

    Raises:
        LogError: None has any time in common with the reference.
    """
    starts = [
        int(one.trajectory.att_t_ns[0])
        for one in entries
        if one.trajectory is not None and len(one.trajectory.att_t_ns)
    ]
    if counted is not None or not len(reference.pos_t_ns):
        return [_scored_attitude(one, reference, counted) for one in entries]
    zero = max(starts, default=0)
    begin = zero + round(skip_s * 1e9)
    end = difference.ALWAYS[1] if until_s is None else zero + round(until_s * 1e9)
    scored = [_scored(one, reference, (begin, end)) for one in entries]
    if not any(np.isfinite(value) for one in scored for value in one.rms.values()):
        known = (one for one in [*(entry.trajectory for entry in entries), reference] if one)
        spans = (one.att_t_ns[[0, -1]] * 1e-9 for one in known if len(one.att_t_ns))
        said = ", ".join(f"{first:.1f} to {last:.1f} s" for first, last in spans)
        raise LogError(
            f"no filter has time in common with {reference.name}: they last {said}, of which the "
            "first seconds (--skip) and what comes after --until are left out"
        )
    return scored


def _scored_attitude(entry: Entry, reference: Trajectory, counted: Counted | None) -> Entry:
    if entry.solution is None:
        return entry
    found = attitude.score(entry.solution.table, reference, counted)
    angles = np.rad2deg([found.total, found.heading, found.inclination]).tolist()
    return replace(entry, rms=dict(zip(TURNS, angles, strict=True)))


def _scored(entry: Entry, reference: Trajectory, span: difference.Span) -> Entry:
    if entry.solution is None or entry.trajectory is None:
        return entry
    found = nees(entry.solution, reference, *span)
    stamps = entry.trajectory.att_t_ns
    scored = stamps[(stamps >= span[0]) & (stamps <= span[1])]
    return replace(
        entry,
        span=(scored[0] * 1e-9, scored[-1] * 1e-9) if len(scored) else None,
        rms={**entry.rms, **_rms(entry.trajectory, reference, span)},
        nees={name: getattr(found, name) for name in ("position", "velocity", "attitude")},
    )


def _rms(estimate: Trajectory, reference: Trajectory, span: difference.Span) -> dict[str, float]:
    found = dict.fromkeys(SECTIONS["RMS error"], float("nan"))

    def put(names: Sequence[str], errors: Array) -> None:
        found.update(zip(names, map(rms, errors.T), strict=True))

    if there := difference.in_position(estimate, reference, span):
        errors = there[1]
        put(AXES, errors)
        put(["down about mean"], errors[:, 2:] - np.nanmean(errors[:, 2:]))
    if there := difference.in_velocity(estimate, reference, span):
        put(VELOCITIES, there[1])
    if turned := difference.in_attitude(estimate, reference, span):
        _, mine, theirs = turned
        put(EULER, np.rad2deg(euler_errors(mine, theirs)))
        put(["inclination"], np.rad2deg(tilt_errors(mine, theirs))[:, None])
    return found


def _key(row: str) -> str:
    """Return the name of a row for JSON, its unit in the name."""
    unit = next((rows[row] for rows in SECTIONS.values() if row in rows), "")
    return f"{row} {unit.replace('/', 'p')}".strip().replace(" ", "_")


def table(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the entries as lines of text, a column each."""
    width = max(10, *(len(one.name) + 2 for one in entries))

    def line(label: str, cells: Iterator[str]) -> str:
        return f"{label:<26}" + "".join(f"{cell:>{width}}" for cell in cells)

    yield line("", (one.name for one in entries))
    for title, rows in SECTIONS.items():
        values = [one.nees if title.startswith("NEES") else one.rms for one in entries]
        known = {row for each in values for row, value in each.items() if np.isfinite(value)}
        if known & rows.keys():
            yield from ("", title)
        for row, unit in rows.items():
            if row in known:
                digits = 0 if row == "stances" else 3
                cells = (_number(each.get(row, np.nan), digits) for each in values)
                yield line(f"  {row}, {unit}" if unit else f"  {row}", cells)
    if any(one.span is not None for one in entries):
        yield from ("", "Time that was scored")
        for index, label in enumerate(("  from, s", "  to, s")):
            times = (np.nan if one.span is None else one.span[index] for one in entries)
            yield line(label, (_number(time, 1) for time in times))
    yield from ("", "Cost")
    yield line("  us per sample", (_number(one.us, 1) for one in entries))
    for aid in dict.fromkeys(aid for one in entries if one.solution for aid in one.solution.counts):
        counts = [
            one.solution.counts.get(aid, (0, 0)) if one.solution else (0, 0) for one in entries
        ]
        shares = (100.0 * refused / (fused + refused or np.nan) for fused, refused in counts)
        cells = (f"{share:.1f} %" if np.isfinite(share) else "-" for share in shares)
        yield line(f"  {aid} refused", cells)
    for one in entries:
        yield from (f"  note: {one.name}: {note}" for note in one.notes)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"
