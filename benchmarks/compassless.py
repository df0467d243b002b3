"""Flight without a compass, or with one that is wrong: how soon the yaw is found, or mended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import (
    SCENARIOS,
    Flown,
    each,
    fly,
    pieces,
    position_errors,
    roster,
    yaw_errors,
)
from benchmarks.consistency import settings_of
from benchmarks.lies import settled, spread
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status

Array = npt.NDArray[np.float64]

FLIGHTS = 10
DURATION = 180.0
MOVING = 0.5
"""Speed from which on the flight counts, m/s."""
WRONG_FOR = 30.0
"""s from the first sample."""
COARSE, FINE = 10.0, 3.0
"""Yaw errors that count as found, deg."""
NEAR = 5.0
"""Horizontal error that counts as navigating, m."""


def silent(flown: Flown) -> Events:
    """Take magnetometer and headings away."""
    return flown.events.take(~np.isin(flown.events.kind, (Kind.MAG, Kind.HEADING)))


def silent_later(flown: Flown) -> Events:
    """Take them away from a time on."""
    t = (flown.events.t_ns - flown.flight.first_ns) * 1e-9
    gone = np.isin(flown.events.kind, (Kind.MAG, Kind.HEADING)) & (t > WRONG_FOR)
    return flown.events.take(~gone)


def reversed_at_first(flown: Flown) -> Events:
    """Turn the field by half a turn about the vertical, until the disturbance is left behind."""
    return _turned(flown, WRONG_FOR)


def reversed_always(flown: Flown) -> Events:
    """Turn it for the whole flight: a compass that is mounted the wrong way round."""
    return _turned(flown, np.inf)


def _turned(flown: Flown, until: float) -> Events:
    events = flown.events
    t = (events.t_ns - flown.flight.first_ns) * 1e-9
    rows = np.flatnonzero((events.kind == Kind.MAG) & (t < until))
    q_nb = flown.flight.truth_at(events.t_ns[rows]).q_nb
    mag_n = so3.rotate(q_nb, events.values[rows, :3]) * [-1.0, -1.0, 1.0]
    values = events.values.copy()
    values[rows, :3] = so3.rotate(so3.conjugate(q_nb), mag_n)
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


CASES: dict[str, Callable[[Flown], Events]] = {
    "no compass at all": silent,
    "compass silent after 30 s": silent_later,
    "wrong by 180 degrees for 30 s": reversed_at_first,
    "wrong by 180 degrees for good": reversed_always,
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Times since the vehicle began to move, s; inf: never. Each is kept until the end."""

    coarse: float
    fine: float
    position: float
    warned: float
    """Until the status was first not OK while the yaw was wrong; inf too where it never was."""
    yaw: float
    """RMS error over the last 30 s, of what was told, deg; NaN: nothing."""
    resets: int


def outcome(flown: Flown, events: Events) -> Outcome:
    """Run the filter, as nobody has touched its settings."""
    settings, family = settings_of("default", flown)
    *_, last = pieces(settings, events, [], family)
    table = last.table
    truth = flown.flight.truth_at(table.stamp_ns)
    is_moving = np.linalg.norm(truth.vel_n, axis=1) > MOVING
    t = (table.stamp_ns - table.stamp_ns[np.argmax(is_moving)]) * 1e-9
    yaw = np.degrees(np.abs(yaw_errors(table, flown)))
    off = np.hypot(*position_errors(table, flown)[:, :2].T)
    warned = (t >= 0.0) & (table.column("status") != Status.OK) & ~(yaw < COARSE)
    told = yaw[(t > t[-1] - 30.0) & np.isfinite(yaw)]
    return Outcome(
        settled(t, yaw < COARSE),
        settled(t, yaw < FINE),
        settled(t, off < NEAR),
        float(t[np.argmax(warned)]) if warned.any() else np.inf,
        float(np.sqrt(np.mean(np.square(told)))) if len(told) else np.nan,
        last.pipeline.health().resets,
    )


def outcomes(job: tuple[str, int]) -> list[Outcome]:
    """Fly one flight (scenario, seed) with every kind of compass."""
    flown = fly(*job, duration=DURATION)
    return [outcome(flown, change(flown)) for change in CASES.values()]


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give per case and scenario the median of all flights, and in brackets the worst."""
    del data
    flights = runs or FLIGHTS
    found = each(outcomes, roster(flights), "compassless, flights")
    yield (
        f"| compass | flight | yaw to {COARSE:.0f} deg, s | to {FINE:.0f} deg, s"
        f" | position to {NEAR:.0f} m, s | wrong, and not OK, s | yaw at the end, deg | resets |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for i, title in enumerate(CASES):
        for j, name in enumerate(SCENARIOS):
            part = [one[i] for one in found[j * flights : (j + 1) * flights]]
            cells = [
                spread([getattr(one, field) for one in part], 1)
                for field in ("coarse", "fine", "position", "warned")
            ]
            yaws = np.array([one.yaw for one in part])
            told = yaws[np.isfinite(yaws)]
            cells.append(f"{np.median(told):.1f} ({told.max():.1f})" if len(told) else "none told")
            cells.append(spread([one.resets for one in part], 0))
            yield f"| {title} | {name} | {' | '.join(cells)} |"
