"""One flight: its processes, and the record of what happens."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sitl.companion import Companion
from benchmarks.sitl.lock import alone
from benchmarks.sitl.pilot import Pilot
from benchmarks.sitl.score import Score, at, score
from benchmarks.sitl.simulator import Simulator
from benchmarks.sitl.throttle import Line as Wire
from benchmarks.sitl.throttle import Throttle
from benchmarks.sitl.tracks import Flown
from ekf_companion.errors import CompanionError

SETTLED = 25.0
"""s from the daemon's start to the arming: TIMESYNC's filter in PX4 wants 50 s at 10 Hz."""

ALARMS = (
    "failsafe",
    "lane switch",
    "ekf variance",
    "stopped aiding",
    "blind land",
    "glitch",
    "position lost",
    "no position",
    "navigation failure",
    "no valid position",
    "crash",
    "emergency",
)
"""Words of an autopilot's texts that a flight must not bring about."""


@dataclass(slots=True)
class Log:
    """Record of a flight."""

    marks: dict[str, float] = field(default_factory=dict)
    """Times of events on the vehicle's clock, s."""
    texts: list[tuple[float, str]] = field(default_factory=list)
    """The autopilot's, each with the time at which it came."""
    said: list[tuple[float, str]] = field(default_factory=list)
    """The daemon's texts, likewise: those that reached the ground station."""
    modes: list[tuple[float, int]] = field(default_factory=list)
    """Changes of the mode."""
    ordered: list[int] = field(default_factory=list)
    """Modes that the pilot asked for."""
    flown: Flown | None = None
    pace: float = 1.0
    """How fast the simulator ran: 1 is real time."""
    has_global: bool = False
    """Whether the autopilot sent a global position at the end."""

    def alarms(self, begin: float, end: float, allowed: Iterable[str] = ()) -> list[str]:
        """Return the autopilot's alarms between two times, s, without those that are allowed."""
        inside = [text.strip() for t, text in self.texts if begin < t <= end]
        return [
            text
            for text in inside
            if any(word in text.lower() for word in ALARMS)
            and "cleared" not in text.lower()
            and not any(word in text.lower() for word in allowed)
        ]

    def unordered_modes(self, begin: float, end: float) -> list[int]:
        """Return the modes between two times, s, that the pilot had not asked for."""
        return [mode for t, mode in self.modes if begin < t <= end and mode not in self.ordered]

    def told_after(self, words: str, since: float) -> float:
        """Return how long after a time the daemon first sent one of some texts, s."""
        pattern = re.compile(words, re.IGNORECASE)
        times = [t for t, text in self.said if t >= since and pattern.search(text)]
        return times[0] - since if times else float("inf")

    @property
    def largest_bias(self) -> float:
        """The autopilot's largest accelerometer bias, m/s^2; 0 if it is not logged."""
        if self.flown is None or not len(self.flown.accel_bias):
            return 0.0
        return float(abs(self.flown.accel_bias).max())

    def score(self, which: str, begin: str = "begin", end: str = "end") -> Score:
        """Score ``autopilot``, ``ours`` or ``taken`` between two marks."""
        assert self.flown is not None
        estimate = getattr(self.flown, which)
        return score(estimate, self.flown.truth, self.marks[begin], self.marks[end])

    def truth_at(self, mark: str) -> Any:
        """Return the true place at a mark, m of home, shape (3,)."""
        assert self.flown is not None
        truth = self.flown.truth
        return at(np.array([self.marks[mark]]), truth.t, truth.pos_n)[0]


@contextmanager
def vehicle(
    simulator: Simulator,
    folder: Path,
    parameters: dict[str, float],
    settings: str = "",
    *,
    starts: bool = True,
    wire: Wire | None = None,
) -> Iterator[tuple[Pilot, Companion, Log]]:
    """Run a simulator, a daemon and a ground station; read their logs at the end.

    Args:
        simulator: The simulator.
        folder: For all logs.
        parameters: The autopilot's, beside those of every flight.
        settings: YAML of the daemon.
        starts: Whether the daemon is started at once: else by the flight.
        wire: What lies between the autopilot and the daemon; None: nothing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log = Log()
    with alone(), Throttle(simulator.companion, wire, folder) if wire else nullcontext() as between:
        simulator.start(folder, parameters)
        companion = None
        try:
            if between is not None:
                between.start()
            link = simulator.companion if between is None else between.link
            companion = Companion(folder, link, settings)
            if starts:
                companion.start()
            pilot = Pilot(simulator.pilot)
            try:
                yield pilot, companion, log
            finally:
                log.texts, log.said, log.pace = pilot.texts, pilot.said, pilot.pace
                log.modes, log.ordered = pilot.modes, pilot.ordered
                pilot.close()
                _note(folder, log)
        finally:
            if companion is not None:
                companion.stop()
            simulator.stop()
    if companion is not None:
        try:
            log.flown = simulator.flown(folder, companion.recordings)
        except (KeyError, IndexError) as error:
            raise CompanionError(f"{folder}: the autopilot's log lacks {error}") from None


def _note(folder: Path, log: Log) -> None:
    """Write marks and texts beside the logs."""
    rows = [(t, f"MARK {name}") for name, t in log.marks.items()]
    rows += [(t, f"1: {text}") for t, text in log.texts]
    rows += [(t, f"194: {text}") for t, text in log.said]
    rows += [(t, f"MODE {mode}") for t, mode in log.modes]
    lines = [f"{t:8.2f} {text}" for t, text in sorted(rows)]
    (folder / "events.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def climb(pilot: Pilot, log: Log, settled: float = SETTLED) -> None:
    """Wait until all has settled, arm and climb."""
    pilot.wait(settled)
    log.marks["arming"] = pilot.t
    if not pilot.arm_and_climb():
        last = "; ".join(text for _, text in pilot.texts[-4:])
        raise CompanionError(f"it did not arm and climb: {last}")
    pilot.wait(3.0)
    log.marks["begin"] = pilot.t


def hover(simulator: Simulator, pilot: Pilot, log: Log, each: float = 10.0) -> None:
    """Hover for as many spans as show how far it wanders by itself; note when each began."""
    for number in range(simulator.calm):
        log.marks[f"calm {number}"] = pilot.t
        pilot.wait(each)


def to_ground(pilot: Pilot, log: Log) -> None:
    """Return to home, land, and note when it lay there."""
    pilot.return_home()
    log.marks["landed"] = pilot.t
