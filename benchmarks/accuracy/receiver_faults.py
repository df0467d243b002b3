"""A receiver that is wrong: its effect on the estimate, the times of detection and recovery."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.consistency import settings_of
from benchmarks.campaign import (
    Flown,
    each,
    fly,
    median_and_worst,
    pieces,
    position_errors,
    roster,
    settled,
)
from benchmarks.document import table
from ekf_companion.engine.health import Aid, Health, Verdict
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, GnssFlag, Kind
from ekf_companion.nav.state import Status

Mask = npt.NDArray[np.bool_]

FLIGHTS = 10
DURATION = 200.0
BEGIN = 80.0
"""The fault begins, s after the first sample."""
WATCH = 0.2
"""Between two checks of the filter's health, s."""
JUMP = (212.0, -212.0, 0.0)
"""300 m to the north-west."""
DRAG = (0.8, 0.6, 0.0)
"""1 m/s."""
NEAR = 5.0
"""Horizontal error up to which the filter has recovered, m: five sigma of a fix."""
VEL, FLAGS = slice(3, 6), 10
"""Columns of a GNSS row (nav.measurements.GnssFix.row)."""


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """The events of a flight, whose fixes are falsified in place."""

    t: Array
    """Since the fault began, s; of all events."""
    is_fix: Mask
    values: Array
    """Of all events."""
    frame: LocalFrame
    rng: np.random.Generator

    def shift(self, rows: Mask | npt.NDArray[np.int64], by_n: Array) -> None:
        """Move positions by metres north, east, down."""
        pos_n = self.frame.to_ned(*self.values[rows, :3].T) + by_n
        self.values[rows, :3] = np.stack(self.frame.to_geodetic(pos_n), axis=-1)


def _jump(fixes: Fixes, rows: Mask) -> None:
    fixes.shift(rows, np.array(JUMP))


def _jump_without_velocity(fixes: Fixes, rows: Mask) -> None:
    fixes.values[fixes.is_fix, VEL] = np.nan
    _jump(fixes, rows)


def _jump_and_flag(fixes: Fixes, rows: Mask) -> None:
    _jump(fixes, rows)
    fixes.values[rows, FLAGS] = float(GnssFlag.SUSPECT)


def _flag_then_jump(fixes: Fixes, rows: Mask) -> None:
    """Flag the fixes for half of the time; then shift them, without a flag."""
    is_flagged = rows & (fixes.t < 20.0)
    fixes.values[is_flagged, FLAGS] = float(GnssFlag.SUSPECT)
    _jump(fixes, rows & ~is_flagged)


def _drag(fixes: Fixes, rows: Mask) -> None:
    fixes.shift(rows, np.outer(fixes.t[rows], DRAG))


def _drag_with_velocity(fixes: Fixes, rows: Mask) -> None:
    _drag(fixes, rows)
    fixes.values[rows, VEL] += DRAG


def _wild(fixes: Fixes, rows: Mask) -> None:
    """Shift every 15th fix by 50 to 500 m anywhere, its velocity by 20 m/s (one sigma)."""
    single = np.flatnonzero(rows)[::15]
    way = fixes.rng.standard_normal((len(single), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    fixes.shift(single, way * fixes.rng.uniform(50.0, 500.0, (len(single), 1)))
    fixes.values[single, VEL] += 20.0 * fixes.rng.standard_normal((len(single), 3))


def _freeze(fixes: Fixes, rows: Mask) -> None:
    fixes.values[rows] = fixes.values[np.flatnonzero(rows)[0]]


@dataclass(frozen=True, slots=True)
class ReceiverFault:
    """A fault of the receiver, and its duration."""

    title: str
    length: float
    """s; inf: to the end of the flight."""
    falsify: Callable[[Fixes, Mask], None]
    """Changes the fixes of the mask."""


FAULTS = (
    ReceiverFault("jump of 300 m, stays", np.inf, _jump),
    ReceiverFault("the same, no velocity at all", np.inf, _jump_without_velocity),
    ReceiverFault("jump of 300 m, back after 20 s", 20.0, _jump),
    ReceiverFault("the same, no velocity at all", 20.0, _jump_without_velocity),
    ReceiverFault("dragged off at 1 m/s for 60 s, velocity true", 60.0, _drag),
    ReceiverFault("the same, velocity dragged too", 60.0, _drag_with_velocity),
    ReceiverFault("one wild fix every 3 s, 60 s", 60.0, _wild),
    ReceiverFault("fixes frozen for 20 s", 20.0, _freeze),
    ReceiverFault("jump of 300 m, flagged as spoofed, 20 s", 20.0, _jump_and_flag),
    ReceiverFault("flagged for 20 s, then 300 m off for 20 s", 40.0, _flag_then_jump),
)


def falsified(flown: Flown, fault: ReceiverFault) -> Events:
    """Return the events of a flight with a fault in them."""
    events, first_ns = flown.events, flown.flight.first_ns
    t = np.asarray((events.t_ns - first_ns) * 1e-9 - BEGIN, dtype=np.float64)
    is_fix = events.kind == Kind.GNSS
    values = events.values.copy()
    rng = np.random.default_rng(flown.flight.seed)
    fixes = Fixes(t, is_fix, values, flown.flight.trajectory.frame, rng)
    fault.falsify(fixes, is_fix & (t >= 0.0) & (t < fault.length))
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The effect of a fault on one flight; times in s, inf: never."""

    largest: float
    """Horizontal error, from the fault's begin on, m."""
    refused: float
    """Until a fix was not used, from the fault's begin."""
    warned: float
    """Until the status was not OK."""
    recovered: float
    """From the fault's end until the error stayed below ``NEAR``."""
    resets: int


def outcome(flown: Flown, fault: ReceiverFault) -> Outcome:
    """Run the filter with its default settings over a flight with a fault."""
    settings, family = settings_of("default", flown)
    stops = flown.flight.first_ns + np.rint(np.arange(BEGIN, DURATION, WATCH) * 1e9).astype(int)
    before: Health | None = None
    refused = warned = np.inf
    t_all, error_all = [], []
    for piece in pieces(settings, falsified(flown, fault), stops.tolist(), family):
        health = piece.pipeline.health()
        if before is None:
            before = health
            continue
        t = (piece.table.stamp_ns - flown.flight.first_ns) * 1e-9 - BEGIN
        t_all.append(t)
        error_all.append(np.hypot(*position_errors(piece.table, flown)[:, :2].T))
        if _not_fused(health) > _not_fused(before):
            refused = min(refused, float(t[-1]))
        if health.status != Status.OK:
            warned = min(warned, float(t[-1]))
    assert before is not None
    t, error = np.concatenate(t_all), np.concatenate(error_all)
    return Outcome(
        float(np.nanmax(error)),
        refused,
        warned,
        settled(np.asarray(t - fault.length), error < NEAR),
        health.resets - before.resets,
    )


def _not_fused(health: Health) -> int:
    """Count the parts of fixes that were not fused as they came."""
    fused = (Verdict.FUSED, Verdict.BEFORE_ALIGNMENT)
    return sum(
        count
        for aid in (Aid.POSITION, Aid.VELOCITY)
        for why, count in health.verdicts[aid].items()
        if why not in fused
    )


def outcomes(job: tuple[str, int]) -> list[Outcome]:
    """Put every fault into one flight (scenario, seed)."""
    flown = fly(*job, duration=DURATION)
    return [outcome(flown, fault) for fault in FAULTS]


def tables(runs: int | None = None) -> Iterator[str]:
    """Yield per fault its effect on all flights: median, and in brackets the worst."""
    found = each(outcomes, roster(runs or FLIGHTS), "receiver faults, flights")
    rows = []
    for i, fault in enumerate(FAULTS):
        part = [one[i] for one in found]
        cells = [
            median_and_worst([getattr(one, name) for one in part], 1)
            for name in ("largest", "refused", "warned", "recovered")
        ]
        if not np.isfinite(fault.length):
            cells[-1] = "-"
        cells.append(median_and_worst([one.resets for one in part], 0))
        rows.append(f"{fault.title} | {' | '.join(cells)}")
    return table(
        "fault | largest error, m | a fix refused after, s | status not OK after, s"
        " | recovered, s after the end | resets",
        rows,
    )
