"""Fly the autopilots' simulators, score them against their truth, and judge each line.

``make sitl PX4=PATH ARDUPILOT=PATH``: a simulator without a path is left out, in a sentence.
docs/SITL.md says what each line means.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.document import table
from benchmarks.sitl import flights
from benchmarks.sitl.flights import Log
from benchmarks.sitl.score import Score, pooled, right_after
from benchmarks.sitl.simulator import ArduCopter, Px4, Simulator
from ekf_companion.errors import CompanionError

HEAD = "simulator | flight | quantity | found | limit | verdict"
_RESTARTS = 10


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

    def row(self, simulator: str) -> str:
        """Return its cells."""
        verdict = "good" if self.found <= self.limit else "**bad**"
        found = f"{self.found:.3g}{self.unit}"
        if len(self.each) > 1:
            found += f" ({', '.join(f'{one:.3g}' for one in self.each)})"
        cells = (found, f"{self.limit:g}{self.unit}", verdict)
        return " | ".join((simulator, self.flight, self.quantity, *cells))


def _pace(flight: str, *logs: Log) -> Line:
    """Return how much slower than time the simulator ran: beyond the limit, fly it again."""
    slowest = min(log.pace for log in logs)
    return Line(flight, "simulator slower than time", 100.0 * (1.0 - slowest), 5.0, " %")


def compared(simulator: Simulator, folder: Path, pairs: int = 1) -> Iterator[Line]:
    """Fly the same paths on the receiver and on ODOMETRY; compare the autopilot's errors."""
    own, ours = [], []
    for number in range(1, pairs + 1):
        own.append(flights.paths(simulator, folder / f"own-{number}", is_flown_on=False))
        ours.append(flights.paths(simulator, folder / f"flown-on-{number}", is_flown_on=True))
    theirs = [log.score("autopilot") for log in own]
    passive = [log.score("ours") for log in own]
    flown = [log.score("autopilot") for log in ours]
    name, whose = "passive", "our {} error, over its own"
    limits = {"horizontal": 1, "velocity": 1, "vertical": 1}
    yield from _ratios(name, whose, passive, theirs, limits)
    yield from _lead(name, "our lead or lag", passive)
    name, whose = "flown on ODOMETRY", "{} error, over own GNSS"
    limits = {"horizontal": 0.8, "velocity": 0.8, "vertical": 1, "roll": 1, "pitch": 1, "yaw": 1}
    yield from _ratios(name, whose, flown, theirs, limits)
    yield from _lead(name, "lead or lag", flown)
    if (usual := max(log.largest_bias for log in own)) > 0.0:
        found = max(log.largest_bias for log in ours) / usual
        yield Line(name, "largest accelerometer bias, over own GNSS", found, 1.0)
    yield _pace(name, *own, *ours)
    yield Line(name, "failsafes", sum(len(log.failsafes) for log in ours), 0)
    yield Line(name, "without a global position", sum(not log.has_global for log in ours), 0)


def _ratios(
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
        yield Line(flight, whose.format(quantity), found, limit, each=each)


def _lead(flight: str, quantity: str, scores: list[Score]) -> Iterator[Line]:
    """Return the largest lead or lag of the flights, and that of each."""
    each = tuple(1e3 * one.lead for one in scores if one.lead is not None)
    if each:
        yield Line(flight, quantity, max(map(abs, each)), 10.0, " ms", each)


def _ratio(score: Score, other: Score, quantity: str) -> float:
    return float(getattr(score, quantity) / getattr(other, quantity))


def lost(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Lose the receiver for twenty seconds, passive and flown on."""
    passive = flights.outage(simulator, folder / "outage-passive", is_flown_on=False)
    name = "receiver off, passive"
    yield Line(name, "untold steps over 1 m", _steps(passive), 0)
    yield Line(name, "ours right after the fix's return", _right_after(passive, "ours"), 2.0, " s")
    yield Line(name, "failsafes", len(passive.failsafes_after(passive.marks["fix"])), 0)
    flown = flights.outage(simulator, folder / "outage-flown-on", is_flown_on=True)
    name = "receiver off, flown on"
    yield Line(name, "untold steps over 1 m", _steps(flown), 0)
    yield Line(name, "drift until it acts or the fix returns", _drift(flown), 10.0, " m")
    for which in ("ours", "autopilot"):
        found = _right_after(flown, which)
        yield Line(name, f"{which} right after the fix's return", found, 2.0, " s")
    yield Line(name, "failsafes after it", len(flown.failsafes_after(flown.marks["fix"])), 0)
    yield _pace(name, passive, flown)


def _right_after(log: Log, which: str) -> float:
    """Return how long after the fix's return a place is within 1 m, s."""
    assert log.flown is not None
    estimate = getattr(log.flown, which)
    before = log.marks["begin"], log.marks["off"]
    rows = estimate.t <= log.marks["end"]
    hovering = replace(estimate, t=estimate.t[rows], pos_n=estimate.pos_n[rows])
    return right_after(hovering, log.flown.truth, before, log.marks["fix"], 1.0)


def _steps(log: Log) -> int:
    """Count steps of ODOMETRY over 1 m beyond its own motion with an unmoved counter."""
    flown = log.flown
    if flown is None or flown.ours is None:
        return 0
    track, dt = flown.ours, np.diff(flown.ours.t)
    moved = np.linalg.norm(np.diff(track.pos_n, axis=0) - track.vel_n[:-1] * dt[:, None], axis=1)
    is_untold = (np.diff(flown.resets.astype(int)) == 0) & (dt < 0.2)
    return int(((moved > 1.0) & is_untold).sum())


def _drift(log: Log) -> float:
    """Return how far the vehicle went from its place until a failsafe or the fix's return, m."""
    assert log.flown is not None
    acted = [t for t, text in log.texts if "failsafe" in text.lower() and t > log.marks["off"]]
    end = min([log.marks["on"], *acted])
    truth = log.flown.truth
    rows = (truth.t >= log.marks["off"]) & (truth.t <= end)
    away = truth.pos_n[rows, :2] - truth.pos_n[rows, :2][0]
    return float(np.hypot(*away.T).max())


def restarted(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Kill and restart the daemon in flight."""
    log = flights.restarts(simulator, folder / "restarts", _RESTARTS)
    name = f"kill -9, {_RESTARTS} times"
    yield Line(name, "largest horizontal error", log.score("autopilot").horizontal_max, 1.0, " m")
    yield Line(name, "failsafes", len(log.failsafes), 0)
    yield _pace(name, log)


def switched(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Change from the receiver to ODOMETRY in flight, and back."""
    log = flights.switch(simulator, folder / "switch")
    name = "in and out in flight"
    yield Line(name, "failsafes", len(log.failsafes), 0)
    yield _pace(name, log)
    if log.flown is not None and log.flown.dead_reckoning is not None:
        yield Line(name, "longest dead reckoning", log.flown.dead_reckoning, 1.0, " s")


def lasting(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly on ODOMETRY for ten minutes."""
    log = flights.endurance(simulator, folder / "endurance")
    flown, name = log.flown, "ten minutes on ODOMETRY"
    assert flown is not None
    begin, end = log.marks["begin"], log.marks["end"]
    error = log.score("autopilot")
    yield Line(name, "horizontal error", error.horizontal, 0.25, " m")
    yield Line(name, "largest horizontal error", error.horizontal_max, 1.0, " m")
    if (own := flown.own_resets) is not None:
        yield Line(name, "resets of the autopilot", int(((own > begin) & (own < end)).sum()), 0)
    if flown.ours is not None:
        rows = (flown.ours.t > begin) & (flown.ours.t < end)
        moved = int(np.count_nonzero(np.diff(flown.resets[rows].astype(int))))
        yield Line(name, "moved counters of ODOMETRY", moved, 0)
    yield Line(name, "largest accelerometer bias", float(abs(flown.accel_bias).max()), 0.25)
    yield Line(name, "failsafes", len(log.failsafes), 0)
    yield _pace(name, log)


def rebooted(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Restart the autopilot."""
    yield Line("reboot", "until ODOMETRY", flights.reboot(simulator, folder / "reboot"), 15.0, " s")


PARTS: dict[str, Callable[[Simulator, Path], Iterator[Line]]] = {
    "paths": compared,
    "outage": lost,
    "restart": restarted,
    "switch": switched,
    "endurance": lasting,
    "reboot": rebooted,
}


def main() -> int:
    """Fly; return 1 if a line is bad."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--px4", metavar="PATH", help="bin/px4 in a build of px4_sitl_default")
    parser.add_argument("--ardupilot", metavar="PATH", help="bin/arducopter in a build for sitl")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--pairs", type=int, default=3, help="of flights of the paths (3)")
    parser.add_argument("--out", type=Path, default=Path("build/sitl"), help="for all logs")
    arguments = parser.parse_args()
    parts = PARTS | {"paths": partial(compared, pairs=arguments.pairs)}
    kinds = (Px4, arguments.px4, "PX4"), (ArduCopter, arguments.ardupilot, "ARDUPILOT")
    rows, is_bad = [], False
    for kind, path, variable in kinds:
        if not path:
            print(
                f"{kind.name}: left out; give the path of its simulator: make sitl {variable}=PATH"
            )
            continue
        simulator = kind(Path(path))
        for part in arguments.only:
            try:
                for line in parts[part](simulator, (arguments.out / kind.name).resolve()):
                    is_bad |= not line.found <= line.limit
                    rows.append(line.row(kind.name))
                    print(rows[-1], flush=True)
            except (CompanionError, OSError) as error:
                is_bad = True
                rows.append(f"{kind.name} | {part} | {error} | | | **not flown**")
                print(rows[-1], flush=True)
    if rows:
        print()
        print("\n".join(table(HEAD, rows)))
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
