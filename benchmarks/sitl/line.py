"""The lines of the table: the result, the limit, and the dangers of every flight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from benchmarks.sitl.flight import Log
from benchmarks.sitl.score import Score, moved, pooled, silence, untold_steps

FLOORS = {
    "horizontal": (0.1, " m"),
    "vertical": (0.1, " m"),
    "velocity": (0.1, " m/s"),
    "roll": (0.25, " deg"),
    "pitch": (0.25, " deg"),
    "yaw": (0.5, " deg"),
}
"""RMS errors below which a ratio says nothing: no controller of such a vehicle shows them."""


class Line(NamedTuple):
    """One line of the table."""

    flight: str
    quantity: str
    found: float
    limit: float
    """The largest that is good."""
    unit: str = ""
    each: tuple[float, ...] = ()
    """The same of each flight, where several were flown."""
    error: float | None = None
    """The error that a ratio is of."""
    floor: tuple[float, str] | None = None
    """The error that is good whatever the ratio is, and its unit."""

    @property
    def is_good(self) -> bool:
        """Whether it is within its limit or below its floor."""
        is_below = self.error is not None and self.floor is not None and self.error <= self.floor[0]
        return self.found <= self.limit or is_below

    def row(self, simulator: str) -> str:
        """Return its cells."""
        verdict = "good" if self.is_good else "**bad**"
        found = f"{self.found:.3g}{self.unit}"
        limit = "none" if math.isinf(self.limit) else f"{self.limit:g}{self.unit}"
        if len(self.each) > 1:
            found += f" ({', '.join(f'{one:.3g}' for one in self.each)})"
        if self.error is not None and self.floor is not None:
            if self.error != self.found:
                found += f", {self.error:.2g}{self.floor[1]}"
            limit += f" or {self.floor[0]:.3g}{self.floor[1]}"
        cells = (found, limit, verdict)
        return " | ".join((simulator, self.flight, self.quantity, *cells))


def motion(flight: str, quantity: str, log: Log, marks: Iterable[str], after: float) -> Line:
    """Return how far the vehicle truly went after each of some marks, the largest.

    Where it hovered before, by :func:`.flight.hover`, as far as it went there in spans of the same
    length is good too: it wanders so far by itself.

    Args:
        flight: Its name.
        quantity: What is looked at.
        log: What was noted.
        marks: From when on.
        after: For how long, s.
    """
    assert log.flown is not None
    truth = log.flown.truth
    found = tuple(moved(truth, log.marks[mark], after=after) for mark in marks)
    calm = [
        moved(truth, t, after=after) for mark, t in log.marks.items() if mark.startswith("calm")
    ]
    floor = (max(calm), " m by itself") if calm else None
    worst = max(found)
    return Line(flight, quantity, worst, 0.5, " m", found, worst if calm else None, floor)


def pace(flight: str, *logs: Log) -> Line:
    """Return how much slower than time the simulator ran: beyond the limit, fly it again."""
    slowest = min(log.pace for log in logs)
    return Line(flight, "simulator slower than time", 100.0 * (1.0 - slowest), 5.0, " %")


def ratios(
    flight: str,
    whose: str,
    scores: list[Score],
    others: list[Score],
    limits: dict[str, float],
) -> Iterator[Line]:
    """Compare the errors of all flights with those of others, and name the ratio of each pair."""
    all_of_it, of_others = pooled(scores), pooled(others)
    for quantity, limit in limits.items():
        each = tuple(_ratio(a, b, quantity) for a, b in zip(scores, others, strict=True))
        found = _ratio(all_of_it, of_others, quantity)
        error = float(getattr(all_of_it, quantity))
        name = whose.format(quantity)
        yield Line(flight, name, found, limit, "", each, error, FLOORS[quantity])


def _ratio(score: Score, other: Score, quantity: str) -> float:
    return float(getattr(score, quantity) / getattr(other, quantity))


def lead(flight: str, quantity: str, scores: list[Score]) -> Iterator[Line]:
    """Return the largest lead or lag of the flights, and that of each."""
    each = tuple(1e3 * one.lead for one in scores if one.lead is not None)
    if each:
        yield Line(flight, quantity, max(map(abs, each)), 10.0, " ms", each)


def dangers(
    flight: str,
    log: Log,
    *,
    begin: str = "begin",
    quiet: float | None = None,
    error: float | None = None,
    allowed: Iterable[str] = (),
) -> Iterator[Line]:
    """Return the lines that every flight has.

    Args:
        flight: Its name.
        log: What was noted.
        begin: Mark from which on it is looked at; to the mark ``end``.
        quiet: Longest good silence of ODOMETRY, s in all; None: it is not judged.
        error: Largest good error of the ODOMETRY that arrived, as the autopilot reads it, in any
            axis, m; None: it is not judged.
        allowed: Words of texts that this flight brings about.
    """
    since, until = log.marks[begin], log.marks["end"]
    alarms = log.alarms(since, until, allowed)
    yield Line(flight, "alarms of the autopilot" + _said(alarms), len(alarms), 0)
    changes = log.unordered_modes(since, until)
    yield Line(flight, "changes of mode that nobody ordered", len(changes), 0)
    flown = log.flown
    if flown is None:
        return
    if quiet is not None:
        total = silence(flown.arrival, since, until).total
        yield Line(flight, "ODOMETRY silent", total, quiet, " s")
    if error is not None:
        found = log.score("taken", begin)
        yield Line(
            flight, "largest horizontal error of ODOMETRY", found.horizontal_max, error, " m"
        )
        # Heights are sent above the autopilot's own datum, which may be metres off; by the origin
        # that the daemon tells beside them they are true
        told = log.score("ours", begin)
        yield Line(flight, "largest vertical error of ODOMETRY", told.vertical_max, error, " m")
    steps = untold_steps(flown.ours, flown.resets, flown.truth, 1.0)
    yield Line(flight, "untold steps of ODOMETRY over 1 m", steps, 0)


def _said(texts: list[str]) -> str:
    """Return the first few texts, for the table."""
    kinds = list(dict.fromkeys(texts))[:3]
    return f" ({'; '.join(kinds).replace('|', '/')})" if kinds else ""
