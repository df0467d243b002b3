"""A receiver that lies: how far it takes the estimate, and how soon that is said and mended."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import Flown, each, fly, pieces, position_errors, roster
from benchmarks.consistency import settings_of
from ekf_companion.engine.health import Aid, Health, Verdict
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, GnssFlag, Kind
from ekf_companion.nav.state import Status

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FLIGHTS = 10
DURATION = 200.0
BEGIN = 80.0
"""The lie begins, s after the first sample."""
WATCH = 0.2
"""Between two looks at the filter, s."""
JUMP = (212.0, -212.0, 0.0)
"""300 m to the north-west."""
DRAG = (0.8, 0.6, 0.0)
"""1 m/s."""
NEAR = 5.0
"""Horizontal error up to which the filter has recovered, m: five sigma of a fix."""
VEL, FLAGS = slice(3, 6), 10
"""Where a GNSS row holds them (nav.measurements.GnssFix.row)."""


@dataclass(frozen=True, slots=True, eq=False)
class Telling:
    """The fixes of a flight, about to be falsified."""

    t: Array
    """Since the lie began, s; of all events."""
    is_fix: Mask
    values: Array
    """All events' values, written in place."""
    frame: LocalFrame
    rng: np.random.Generator

    def shift(self, rows: Mask | npt.NDArray[np.int64], by_n: Array) -> None:
        """Move positions by metres north, east, down."""
        pos_n = self.frame.to_ned(*self.values[rows, :3].T) + by_n
        self.values[rows, :3] = np.stack(self.frame.to_geodetic(pos_n), axis=-1)


def _jump(told: Telling, rows: Mask) -> None:
    told.shift(rows, np.array(JUMP))


def _jump_without_velocity(told: Telling, rows: Mask) -> None:
    told.values[told.is_fix, VEL] = np.nan
    _jump(told, rows)


def _jump_and_flag(told: Telling, rows: Mask) -> None:
    _jump(told, rows)
    told.values[rows, FLAGS] = float(GnssFlag.SUSPECT)


def _flag_then_jump(told: Telling, rows: Mask) -> None:
    """Be flagged and silent for half of the time, then come back in the wrong place, unflagged."""
    is_flagged = rows & (told.t < 20.0)
    told.values[is_flagged, FLAGS] = float(GnssFlag.SUSPECT)
    _jump(told, rows & ~is_flagged)


def _drag(told: Telling, rows: Mask) -> None:
    told.shift(rows, np.outer(told.t[rows], DRAG))


def _drag_with_velocity(told: Telling, rows: Mask) -> None:
    _drag(told, rows)
    told.values[rows, VEL] += DRAG


def _wild(told: Telling, rows: Mask) -> None:
    """Every fifteenth fix is 50 to 500 m off, anywhere, and its velocity by 20 m/s (one sigma)."""
    single = np.flatnonzero(rows)[::15]
    way = told.rng.standard_normal((len(single), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    told.shift(single, way * told.rng.uniform(50.0, 500.0, (len(single), 1)))
    told.values[single, VEL] += 20.0 * told.rng.standard_normal((len(single), 3))


def _freeze(told: Telling, rows: Mask) -> None:
    told.values[rows] = told.values[np.flatnonzero(rows)[0]]


@dataclass(frozen=True, slots=True)
class Lie:
    """What is told, and for how long."""

    title: str
    length: float
    """s; inf: to the end of the flight."""
    tell: Callable[[Telling, Mask], None]
    """Falsifies the fixes of the mask."""


LIES = (
    Lie("jump of 300 m, stays", np.inf, _jump),
    Lie("the same, no velocity at all", np.inf, _jump_without_velocity),
    Lie("jump of 300 m, back after 20 s", 20.0, _jump),
    Lie("the same, no velocity at all", 20.0, _jump_without_velocity),
    Lie("dragged off at 1 m/s for 60 s, velocity true", 60.0, _drag),
    Lie("the same, velocity dragged too", 60.0, _drag_with_velocity),
    Lie("one wild fix every 3 s, 60 s", 60.0, _wild),
    Lie("fixes frozen for 20 s", 20.0, _freeze),
    Lie("jump of 300 m, flagged as spoofed, 20 s", 20.0, _jump_and_flag),
    Lie("flagged for 20 s, then 300 m off for 20 s", 40.0, _flag_then_jump),
)


def told(flown: Flown, lie: Lie) -> Events:
    """Give the events of a flight with the lie in them."""
    events, first_ns = flown.events, flown.flight.first_ns
    t = np.asarray((events.t_ns - first_ns) * 1e-9 - BEGIN, dtype=np.float64)
    is_fix = events.kind == Kind.GNSS
    values = events.values.copy()
    telling = Telling(
        t, is_fix, values, flown.flight.trajectory.frame, np.random.default_rng(flown.flight.seed)
    )
    lie.tell(telling, is_fix & (t >= 0.0) & (t < lie.length))
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a lie did to one flight; times in s, inf: never."""

    largest: float
    """Horizontal error, from the lie's begin on, m."""
    refused: float
    """Until a fix was not used, from the lie's begin."""
    warned: float
    """Until the status was not OK."""
    recovered: float
    """From the lie's end until the error stayed below ``NEAR``."""
    resets: int


def outcome(flown: Flown, lie: Lie) -> Outcome:
    """Tell a lie and watch the filter, as nobody has touched its settings."""
    settings, family = settings_of("default", flown)
    stops = flown.flight.first_ns + np.rint(np.arange(BEGIN, DURATION, WATCH) * 1e9).astype(int)
    before: Health | None = None
    refused = warned = np.inf
    t_all, error_all = [], []
    for piece in pieces(settings, told(flown, lie), stops.tolist(), family):
        health = piece.pipeline.health()
        if before is None:
            before = health
            continue
        t = (piece.table.stamp_ns - flown.flight.first_ns) * 1e-9 - BEGIN
        t_all.append(t)
        error_all.append(np.hypot(*position_errors(piece.table, flown)[:, :2].T))
        if _unused(health) > _unused(before):
            refused = min(refused, float(t[-1]))
        if health.status != Status.OK:
            warned = min(warned, float(t[-1]))
    assert before is not None
    t, error = np.concatenate(t_all), np.concatenate(error_all)
    return Outcome(
        float(np.nanmax(error)),
        refused,
        warned,
        settled(np.asarray(t - lie.length), error < NEAR),
        health.resets - before.resets,
    )


def _unused(health: Health) -> int:
    """Count the fixes' parts that were not taken as they came."""
    taken = (Verdict.FUSED, Verdict.BEFORE_ALIGNMENT)
    return sum(
        count
        for aid in (Aid.POSITION, Aid.VELOCITY)
        for why, count in health.verdicts[aid].items()
        if why not in taken
    )


def settled(t: Array, is_good: Mask) -> float:
    """Give from when on all is good, 0 if from the start; inf: it is not at the end."""
    if not (t >= 0.0).any():
        return np.inf
    bad = np.flatnonzero(~is_good & (t >= 0.0))
    if not len(bad):
        return 0.0
    return float(t[bad[-1] + 1]) if bad[-1] + 1 < len(t) else np.inf


def outcomes(job: tuple[str, int]) -> list[Outcome]:
    """Tell every lie to one flight (scenario, seed)."""
    flown = fly(*job, duration=DURATION)
    return [outcome(flown, lie) for lie in LIES]


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give per lie what it did to all flights: median, and in brackets the worst."""
    del data
    flights = runs or FLIGHTS
    found = each(outcomes, roster(flights), "lies, flights")
    yield (
        "| lie | largest error, m | a fix refused after, s | status not OK after, s"
        " | recovered, s after the end | resets |"
    )
    yield "|---|---|---|---|---|---|"
    for i, lie in enumerate(LIES):
        part = [one[i] for one in found]
        cells = [
            spread([one.largest for one in part], 1),
            spread([one.refused for one in part], 1),
            spread([one.warned for one in part], 1),
            spread([one.recovered for one in part], 1) if np.isfinite(lie.length) else "-",
            spread([one.resets for one in part], 0),
        ]
        yield f"| {lie.title} | {' | '.join(cells)} |"


def spread(values: Sequence[float], digits: int) -> str:
    """Give the median and the worst in brackets; what never came is said, and how often."""
    array = np.asarray(values, dtype=np.float64)
    lost = int(np.count_nonzero(np.isinf(array)))
    middle, worst = np.median(array), array.max()
    if np.isinf(middle):
        return "never" if lost == len(array) else f"never in {lost} of {len(array)}"
    end = f"never in {lost} of {len(array)}" if lost else f"{worst:.{digits}f}"
    return f"{middle:.{digits}f} ({end})"
