"""The order, the number and the delay of arrivals: what must not matter, and what may a little."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import Flown, Snapshot, each, errors, fly, pieces, roster
from benchmarks.consistency import settings_of
from ekf_companion.engine.health import Arrival
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind

Array = npt.NDArray[np.float64]

FLIGHTS = 10
DURATION = 60.0
LATEST = 0.5
"""s."""
TAIL = 2.0
"""Until so long before the end arrivals are disturbed, s: the last ones must come in time."""
LOST = 0.05
"""Share of the messages that is dropped."""


def shuffled(events: Events, rng: np.random.Generator) -> Events:
    """Let every message arrive anywhere within the half second after its stamp."""
    return _arriving(events, rng.uniform(0.0, LATEST, len(events)))


def duplicated(events: Events, rng: np.random.Generator) -> Events:
    """Let every third message arrive again, up to half a second later."""
    again = np.flatnonzero(rng.random(len(events)) < 1.0 / 3.0)
    rows = np.concatenate([np.arange(len(events)), again])
    late = np.concatenate([np.zeros(len(events)), rng.uniform(0.0, LATEST, len(again))])
    return _arriving(events.take(rows), late)


def aids_delayed(events: Events, rng: np.random.Generator) -> Events:
    """Delay every message but the inertial ones by up to half a second."""
    late = rng.uniform(0.0, LATEST, len(events))
    return _arriving(events, np.where(events.kind == Kind.IMU, 0.0, late))


def samples_delayed(events: Events, rng: np.random.Generator) -> Events:
    """Delay every inertial sample."""
    late = rng.uniform(0.0, LATEST, len(events))
    return _arriving(events, np.where(events.kind == Kind.IMU, late, 0.0))


def aids_dropped(events: Events, rng: np.random.Generator) -> Events:
    """Drop a part of all messages but the inertial ones."""
    return _dropped(events, rng, events.kind != Kind.IMU)


def all_dropped(events: Events, rng: np.random.Generator) -> Events:
    """Drop a part of all messages."""
    return _dropped(events, rng, np.full(len(events), True))


def _arriving(events: Events, late: Array) -> Events:
    """Put events in the order of arrival: so late after their stamps (s), but the last ones."""
    end_ns = events.t_ns.max() - round(TAIL * 1e9)
    arrival_ns = events.t_ns + np.where(events.t_ns < end_ns, late * 1e9, 0.0)
    return events.take(np.argsort(arrival_ns, kind="stable"))


def _dropped(events: Events, rng: np.random.Generator, candidates: npt.NDArray[np.bool_]) -> Events:
    return events.take(~(candidates & (rng.random(len(events)) < LOST)))


CASES: dict[str, Callable[[Events, np.random.Generator], Events]] = {
    "shuffled within 0.5 s": shuffled,
    "a third duplicated": duplicated,
    "aids delayed by 0 to 0.5 s": aids_delayed,
    "inertial samples delayed by 0 to 0.5 s": samples_delayed,
    "5 % of the aids dropped": aids_dropped,
    "5 % of all dropped": all_dropped,
}


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The posterior at the end of a flight beside that of the undisturbed one."""

    is_same: bool
    """To the last bit."""
    refused: int
    """Messages that came too late, or were malformed."""
    moved: Array
    """Difference of position, velocity and attitude over its sigma by axis, shape (9,)."""
    ratios: Array
    """Error over sigma, shape (9,)."""


def end_of(flown: Flown, events: Events) -> tuple[Snapshot, Pipeline]:
    """Run all events; settings are matched to the simulator."""
    settings, family = settings_of("matched", flown)
    *_, last = pieces(settings, events, [], family)
    return last.snapshot, last.pipeline


def outcomes(job: tuple[str, int]) -> list[Outcome]:
    """Disturb one flight (scenario, seed) in every way."""
    flown = fly(*job, duration=DURATION)
    settings, family = settings_of("matched", flown)
    before, _ = end_of(flown, flown.events)
    held = errors(before, flown, settings, family)
    found = []
    for i, disturb in enumerate(CASES.values()):
        rng = np.random.default_rng([job[1], i])
        after, pipeline = end_of(flown, disturb(flown.events, rng))
        arrivals = pipeline.health().arrivals
        moved, ratios = [], []
        for name, (error, P) in errors(after, flown, settings, family).items():
            if name in ("position", "velocity", "attitude"):
                sigma = np.sqrt(np.diag(P))
                # both from the truth at one time: their difference is that of the estimates
                moved.append((error - held[name][0]) / sigma)
                ratios.append(error / sigma)
        bad = (Arrival.STALE, Arrival.MALFORMED)
        found.append(
            Outcome(
                before.x.tobytes() == after.x.tobytes(),
                sum(row[why] for row in arrivals.values() for why in bad),
                np.concatenate(moved),
                np.concatenate(ratios),
            )
        )
    return found


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give per disturbance in how many flights the posterior is the same, and how far it moved."""
    del data
    flights = runs or FLIGHTS
    found = each(outcomes, roster(flights), "arrival, flights")
    yield ("| arrivals | same bits | too late | moved, sigma: RMS | largest | RMS(error / sigma) |")
    yield "|---|---|---|---|---|---|"
    for i, title in enumerate(CASES):
        part = [one[i] for one in found]
        moved = np.concatenate([one.moved for one in part])
        ratios = np.concatenate([one.ratios for one in part])
        same = sum(one.is_same for one in part)
        yield (
            f"| {title} | {same} of {len(part)} | {sum(one.refused for one in part)}"
            f" | {_rms(moved):.3f} | {np.abs(moved).max():.3f} | {_rms(ratios):.2f} |"
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
