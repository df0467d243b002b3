"""Several filters over one recording, beside each other: how far off, how sure, at what cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.analysis import attitude
from ekf_companion.analysis.closure import closure
from ekf_companion.analysis.consistency import nees
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.filters.solution import Solution
from ekf_companion.logs.estimate import of_table
from ekf_companion.logs.recording import Counted, Recording
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import pair
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Trajectory
from ekf_companion.replay.filters_by_name import parse_name, run_filter

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]

WARM_NS = 5_000_000_000
"""Of the recording that a filter sees before it is timed."""
NEAR_NS = 100_000_000
"""By which the stamps of estimates may be earlier than those of their samples."""


def hold(
    recording: Recording,
    names: Sequence[str],
    settings: FilterSettings,
    progress: Progress | None = None,
) -> list[Entry]:
    """Take each filter through the recording.

    Raises:
        ConfigError: A name is unknown or stands twice, or there is none.
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
        entries.append(_enter(recording, name, settings))
    if all(entry.solution is None for entry in entries):
        raise LogError("; ".join(dict.fromkeys(entry.note for entry in entries)))
    return entries


def _enter(recording: Recording, name: str, settings: FilterSettings) -> Entry:
    _warm(recording, name, settings)
    begin = time.process_time()
    try:
        solution = run_filter(recording, name, settings)
    except (LogError, ConfigError) as error:
        return Entry(name=name, solution=None, trajectory=None, us=np.nan, note=str(error))
    spent = (time.process_time() - begin) * 1e6
    return Entry(
        name=name,
        solution=solution,
        trajectory=of_table(solution.table, name),
        us=spent / max(passed(recording, solution), 1),
        rms=_closure(solution),
    )


def _warm(recording: Recording, name: str, settings: FilterSettings) -> None:
    """Take a filter through the first seconds: what it imports and lays out is not its cost."""
    t_ns = recording.events.t_ns
    if not len(t_ns):
        return
    few = recording.events.take(np.abs(t_ns - t_ns[0]) < WARM_NS)
    with suppress(LogError, ConfigError):
        run_filter(replace(recording, events=few), name, settings)


def passed(recording: Recording, solution: Solution) -> int:
    """Give how many inertial samples a filter went through, those before its start with them."""
    stamps = recording.events.t_ns[recording.events.kind == Kind.IMU]
    if not len(solution.table):
        return len(stamps)
    return int(np.count_nonzero(stamps <= solution.table.stamp_ns[-1] + NEAR_NS))


def _closure(solution: Solution) -> dict[str, float]:
    """Give how far a walk is from closing; nothing of a filter that knows no stance."""
    if solution.is_still is None or not np.isfinite(solution.table.column("pos_n")).any():
        return {}
    found = closure(solution)
    return {
        "closure on the ground": found.horizontal,
        "closure in space": found.distance,
        "way": found.path,
        "stances": float(found.stances),
    }


def judge(
    entries: Sequence[Entry],
    reference: Trajectory,
    skip_s: float,
    until_s: float | None,
    counted: Counted | None = None,
) -> list[Entry]:
    """Hold each against the reference, from one time on at which all of them run.

    Args:
        entries: As :func:`hold` gives them.
        reference: What they should say.
        skip_s: Leave out so many seconds after the last of them has begun.
        until_s: Leave out what is later than so many seconds after that; None: nothing.
        counted: Which times the recording's authors let count: then, and where the reference is of
            attitude alone, all of them do, whatever is skipped.

    Raises:
        LogError: None has any time in common with the reference.
    """
    starts = [
        int(one.trajectory.att_t_ns[0])
        for one in entries
        if one.trajectory is not None and len(one.trajectory.att_t_ns)
    ]
    if counted is not None or not len(reference.pos_t_ns):
        return [_turn(one, reference, counted) for one in entries]
    zero = max(starts, default=0)
    begin = zero + round(skip_s * 1e9)
    end = np.iinfo(np.int64).max if until_s is None else zero + round(until_s * 1e9)
    judged = [_judge(one, reference, begin, end) for one in entries]
    if not any(np.isfinite(value) for one in judged for value in one.rms.values()):
        spans = (one.att_t_ns[[0, -1]] * 1e-9 for one in _known(entries, reference))
        said = ", ".join(f"{first:.1f} to {last:.1f} s" for first, last in spans)
        raise LogError(
            f"no filter has time in common with {reference.name}: they last {said}, of which the "
            "first seconds (--skip) and what comes after --until are left out"
        )
    return judged


def _known(entries: Sequence[Entry], reference: Trajectory) -> Iterator[Trajectory]:
    for one in (*(entry.trajectory for entry in entries), reference):
        if one is not None and len(one.att_t_ns):
            yield one


def _turn(entry: Entry, reference: Trajectory, counted: Counted | None) -> Entry:
    """Judge the attitude alone."""
    if entry.solution is None:
        return entry
    found = attitude.score(entry.solution.table, reference, counted)
    angles = np.rad2deg([found.total, found.heading, found.inclination]).tolist()
    names = ("turn in all", "turn in heading", "turn in inclination")
    return replace(entry, rms=dict(zip(names, angles, strict=True)))


def _judge(entry: Entry, reference: Trajectory, begin: int, end: int) -> Entry:
    if entry.solution is None or entry.trajectory is None:
        return entry
    found = nees(entry.solution, reference, begin, end)
    stamps = entry.trajectory.att_t_ns
    scored = stamps[(stamps >= begin) & (stamps <= end)]
    return replace(
        entry,
        span=(scored[0] * 1e-9, scored[-1] * 1e-9) if len(scored) else None,
        rms={**entry.rms, **_rms(entry.trajectory, reference, begin, end)},
        nees={
            name: np.nan if value is None else value
            for name, value in (
                ("position", found.position),
                ("velocity", found.velocity),
                ("attitude", found.attitude),
            )
        },
    )


def _rms(estimate: Trajectory, reference: Trajectory, begin: int, end: int) -> dict[str, float]:
    rms = {name: float("nan") for name, _ in SECTIONS["RMS error"]}

    def put(names: str, errors: Array) -> None:
        for name, column in zip(names.split(", "), errors.T, strict=True):
            known = column[np.isfinite(column)]
            rms[name] = float(np.sqrt(np.mean(np.square(known)))) if len(known) else np.nan

    if found := pair(estimate.pos_t_ns, reference.pos_t_ns, begin, end):
        alt = float(reference.alt[0])
        frame = LocalFrame(
            float(reference.lat[0]), float(reference.lon[0]), alt if np.isfinite(alt) else 0.0
        )
        mine, theirs = (frame.to_ned(one.lat, one.lon, one.alt) for one in (estimate, reference))
        errors = found.difference(mine, theirs)
        put("north, east, down", errors)
        put("down about mean", errors[:, 2:] - np.nanmean(errors[:, 2:]))
    if found := pair(estimate.vel_t_ns, reference.vel_t_ns, begin, end):
        errors = found.difference(estimate.vel_n, reference.vel_n)
        put("velocity north, velocity east, velocity down", errors)
    if found := pair(estimate.att_t_ns, reference.att_t_ns, begin, end):
        mine, theirs = found.rotations(estimate.q_nb, reference.q_nb)
        angles = so3.wrap(so3.to_euler(mine) - so3.to_euler(theirs))
        put("roll, pitch, yaw", np.rad2deg(angles))
        downs = [so3.to_matrix(q)[:, 2, :] for q in (mine, theirs)]
        tilt = np.arccos(np.clip(np.sum(downs[0] * downs[1], axis=1), -1.0, 1.0))
        put("inclination", np.rad2deg(tilt)[:, None])
    return rms


__all__ = ["SECTIONS", "Entry", "hold", "judge", "table"]


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
