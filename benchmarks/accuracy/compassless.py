"""Flight without a compass, or with a wrong one: how soon the yaw is found, or corrected."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.accuracy.consistency import settings_of
from benchmarks.campaign import (
    SCENARIOS,
    Flown,
    each,
    fly,
    median_and_worst,
    pieces,
    position_errors,
    roster,
    settled,
    yaw_errors,
)
from benchmarks.document import table
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status

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
    """Remove magnetometer and headings."""
    return flown.events.take(~np.isin(flown.events.kind, (Kind.MAG, Kind.HEADING)))


def silent_later(flown: Flown) -> Events:
    """Remove them after ``WRONG_FOR``."""
    t = (flown.events.t_ns - flown.flight.first_ns) * 1e-9
    gone = np.isin(flown.events.kind, (Kind.MAG, Kind.HEADING)) & (t > WRONG_FOR)
    return flown.events.take(~gone)


def reversed_at_first(flown: Flown) -> Events:
    """Turn the field by 180 degrees about the vertical until ``WRONG_FOR``: a disturbance."""
    return _turned(flown, WRONG_FOR)


def reversed_always(flown: Flown) -> Events:
    """Turn it for the whole flight: a compass that is mounted backwards."""
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
    """Times since the vehicle began to move, s, of what then held to the end; inf: never."""

    coarse: float
    fine: float
    position: float
    warned: float
    """Until the status was first not OK while the yaw was wrong; inf too if it never was."""
    yaw: float
    """RMS error of the estimates in the last 30 s, deg; NaN: none."""
    resets: int


def outcome(flown: Flown, events: Events) -> Outcome:
    """Run the filter with its default settings."""
    settings, family = settings_of("default", flown)
    *_, last = pieces(settings, events, [], family)
    stamp_ns, status = last.table.stamp_ns, last.table.column("status")
    truth = flown.flight.truth_at(stamp_ns)
    is_moving = np.linalg.norm(truth.vel_n, axis=1) > MOVING
    t = (stamp_ns - stamp_ns[np.argmax(is_moving)]) * 1e-9
    yaw = np.degrees(np.abs(yaw_errors(last.table, flown)))
    off = np.hypot(*position_errors(last.table, flown)[:, :2].T)
    warned = (t >= 0.0) & (status != Status.OK) & ~(yaw < COARSE)
    last_yaw = yaw[(t > t[-1] - 30.0) & np.isfinite(yaw)]
    return Outcome(
        settled(t, yaw < COARSE),
        settled(t, yaw < FINE),
        settled(t, off < NEAR),
        float(t[np.argmax(warned)]) if warned.any() else np.inf,
        float(np.sqrt(np.mean(np.square(last_yaw)))) if len(last_yaw) else np.nan,
        last.pipeline.health().resets,
    )


def outcomes(job: tuple[str, int]) -> list[Outcome]:
    """Fly one flight (scenario, seed) with every kind of compass."""
    flown = fly(*job, duration=DURATION)
    return [outcome(flown, change(flown)) for change in CASES.values()]


def tables(runs: int | None = None) -> Iterator[str]:
    """Yield per case and scenario the median of all flights, and in brackets the worst."""
    flights = runs or FLIGHTS
    found = each(outcomes, roster(flights), "compassless, flights")
    rows = []
    for i, title in enumerate(CASES):
        for j, name in enumerate(SCENARIOS):
            part = [one[i] for one in found[j * flights : (j + 1) * flights]]
            cells = [
                median_and_worst([getattr(one, field) for one in part], 1)
                for field in ("coarse", "position", "warned")
            ]
            yaws = np.array([one.yaw for one in part])
            known = yaws[np.isfinite(yaws)]
            cells.append(
                f"{np.median(known):.1f} ({known.max():.1f})" if len(known) else "no estimate"
            )
            cells.append(median_and_worst([one.resets for one in part], 0))
            rows.append(f"{title} | {name} | {' | '.join(cells)}")
    return table(
        f"compass | flight | yaw to {COARSE:.0f} deg, s | position to {NEAR:.0f} m, s"
        " | wrong, and not OK, s | yaw at the end, deg | resets",
        rows,
    )
