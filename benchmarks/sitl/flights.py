"""What is flown, and what each flight must show."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.sitl.companion import Companion
from benchmarks.sitl.pilot import Pilot, figure_eight, square
from benchmarks.sitl.score import Score, score
from benchmarks.sitl.simulator import Simulator
from benchmarks.sitl.tracks import Flown, resumed_after
from ekf_companion.errors import CompanionError

SETTLED = 25.0
"""s from the daemon's start to the arming: TIMESYNC's filter in PX4 wants 50 s at 10 Hz."""

RESTART = 0.3
"""s from a kill to the next start: RestartSec of systemd/ekf-companion.service."""


@dataclass(slots=True)
class Log:
    """What is noted while a flight goes on."""

    marks: dict[str, float] = field(default_factory=dict)
    """Times of events on the vehicle's clock, s."""
    notes: list[str] = field(default_factory=list)
    texts: list[tuple[float, str]] = field(default_factory=list)
    flown: Flown | None = None
    pace: float = 1.0
    """How fast the simulator ran: 1 is real time."""
    has_global: bool = False
    """Whether the autopilot sent a global position at the end."""

    @property
    def failsafes(self) -> list[str]:
        """The autopilot's texts that tell of a failsafe or a lane switch."""
        return self.failsafes_after(-1.0)

    def failsafes_after(self, begin: float) -> list[str]:
        """Return those of the texts that came after a time, s."""
        words = ("failsafe", "lane switch", "ekf variance")
        later = [text.strip() for t, text in self.texts if t > begin]
        found = [text for text in later if any(word in text.lower() for word in words)]
        return [text for text in found if "cleared" not in text.lower()]

    @property
    def largest_bias(self) -> float:
        """The autopilot's largest accelerometer bias, m/s^2; 0 where it tells none."""
        if self.flown is None or not len(self.flown.accel_bias):
            return 0.0
        return float(abs(self.flown.accel_bias).max())

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
            log.texts, log.pace = pilot.texts, pilot.pace
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
    """Hover, a square and a figure of eight, on its own receiver or on ODOMETRY."""
    parameters = dict(simulator.flown_on) if is_flown_on else {}
    with vehicle(simulator, folder, parameters, settings) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["moving"] = pilot.t
        pilot.follow(*square())
        pilot.follow(*figure_eight())
        log.marks["end"] = pilot.t
        log.has_global = pilot.global_t is not None and pilot.t - pilot.global_t < 2.0
        pilot.land()
    return log


def outage(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Hover without the receiver for twenty seconds, and with it again."""
    parameters = dict(simulator.flown_on) if is_flown_on else {}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["off"] = pilot.t
        pilot.set(simulator.receiver, simulator.receiver_off)
        pilot.wait(20.0)
        pilot.has_fix = False
        log.marks["on"] = pilot.t
        pilot.set(simulator.receiver, simulator.receiver_on)
        pilot.wait_for(lambda: pilot.has_fix, 10.0)
        log.marks["fix"] = pilot.t
        pilot.wait(15.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def restarts(simulator: Simulator, folder: Path, times: int) -> Log:
    """Hover on ODOMETRY while the daemon is killed and started again, several times."""
    with vehicle(simulator, folder, dict(simulator.flown_on)) as (pilot, companion, log):
        climb(pilot, log)
        for _ in range(times):
            companion.kill()
            pilot.wait(RESTART)
            companion.start()
            pilot.wait(10.0 - RESTART)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def switch(simulator: Simulator, folder: Path) -> Log:
    """Change from the receiver to ODOMETRY in the hover, fly a square on it, and change back."""
    with vehicle(simulator, folder, dict(simulator.alternative)) as (pilot, _, log):
        climb(pilot, log)
        simulator.change(pilot, is_into=True)
        log.marks["into"] = pilot.t
        pilot.wait(8.0)
        pilot.follow(*square())
        simulator.change(pilot, is_into=False)
        log.marks["back"] = pilot.t
        pilot.wait(10.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def endurance(simulator: Simulator, folder: Path) -> Log:
    """Hover and fly squares on ODOMETRY for ten minutes."""
    with vehicle(simulator, folder, dict(simulator.flown_on)) as (pilot, _, log):
        climb(pilot, log)
        for _ in range(10):
            pilot.follow(*square())
            pilot.wait(38.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def reboot(simulator: Simulator, folder: Path) -> float:
    """Restart the autopilot on the ground; return after how long ODOMETRY comes again, s."""
    folder.mkdir(parents=True, exist_ok=True)
    companion = Companion(folder, simulator.companion)
    simulator.start(folder, dict(simulator.flown_on))
    try:
        Pilot(simulator.pilot).close()
        companion.start()
        time.sleep(SETTLED)
        simulator.stop()
        time.sleep(2.0)
        simulator.start(folder, dict(simulator.flown_on))
        pilot = Pilot(simulator.pilot)
        pilot.wait(SETTLED)
        pilot.close()
    finally:
        companion.stop()
        simulator.stop()
    return resumed_after(companion.recordings[-1])
