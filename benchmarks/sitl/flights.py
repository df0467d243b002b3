"""What is flown, and what each flight must show."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.sitl.companion import Companion
from benchmarks.sitl.pilot import Pilot, figure_eight, square
from benchmarks.sitl.score import Score, score
from benchmarks.sitl.simulator import Simulator
from benchmarks.sitl.tracks import Flown
from ekf_companion.errors import CompanionError

SETTLED = 25.0
"""s from the daemon's start to the arming: TIMESYNC's filter in PX4 wants 50 s at 10 Hz."""


@dataclass(slots=True)
class Log:
    """What is noted while a flight goes on."""

    marks: dict[str, float] = field(default_factory=dict)
    """Times of events on the vehicle's clock, s."""
    notes: list[str] = field(default_factory=list)
    texts: list[tuple[float, str]] = field(default_factory=list)
    flown: Flown | None = None

    def score(self, which: str, begin: str = "begin", end: str = "end") -> Score:
        """Score ``autopilot`` or ``ours`` between two marks."""
        assert self.flown is not None
        estimate = getattr(self.flown, which)
        return score(estimate, self.flown.truth, self.marks[begin], self.marks[end])


@contextmanager
def vehicle(
    simulator: Simulator, folder: Path, parameters: dict[str, float], settings: str = ""
) -> Iterator[tuple[Pilot, Companion, Log]]:
    """Run a simulator, a daemon and a ground station; read their logs at the end."""
    folder.mkdir(parents=True, exist_ok=True)
    companion = Companion(folder, simulator.companion, settings)
    log = Log()
    simulator.start(folder, parameters)
    try:
        pilot = Pilot(simulator.pilot)
        try:
            companion.start()
            yield pilot, companion, log
        finally:
            log.texts = pilot.texts
            pilot.close()
    finally:
        companion.stop()
        simulator.stop()
    log.flown = simulator.flown(folder, companion.recordings[-1])


def climb(pilot: Pilot, log: Log) -> None:
    """Wait until all has settled, arm and climb."""
    pilot.wait(SETTLED)
    if not pilot.arm_and_climb():
        last = "; ".join(text for _, text in pilot.texts[-4:])
        raise CompanionError(f"it did not arm and climb: {last}")
    pilot.wait(3.0)
    log.marks["begin"] = pilot.t


def paths(simulator: Simulator, folder: Path, is_flown_on: bool, settings: str = "") -> Log:
    """Hover, squares and a figure of eight, on its own receiver or on ODOMETRY."""
    parameters = dict(simulator.flown_on) if is_flown_on else {}
    with vehicle(simulator, folder, parameters, settings) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["moving"] = pilot.t
        pilot.follow(*square())
        pilot.follow(*figure_eight())
        log.marks["end"] = pilot.t
        pilot.land()
    return log
