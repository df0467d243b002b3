"""Beginnings: a cold receiver, a daemon started late or again, a daemon before the first fix."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.sitl.basic import into, landing
from benchmarks.sitl.flight import Log, climb, hover, to_ground, vehicle
from benchmarks.sitl.line import Line, dangers, pace
from benchmarks.sitl.pilot import Pilot, line
from benchmarks.sitl.place import from_home
from benchmarks.sitl.recording import read_origins
from benchmarks.sitl.score import moved
from benchmarks.sitl.simulator import ALONE, Simulator

_NORTH, _UP = 6.0, 4.0
"""What the first fixes of a cold receiver are off, m."""
_WARM = 15.0
"""s until it is right."""
_LEAD = 12.0
"""s from the daemon's start in the air to the change to ODOMETRY."""


def fly_cold(simulator: Simulator, folder: Path, is_before: bool) -> Log:
    """Start with a cold receiver, and the daemon before it or after; change to it and return."""
    cold = {"SIM_GPS1_GLTCH_X": _NORTH / 111319.5, "SIM_GPS1_GLTCH_Z": _UP}
    parameters = {**simulator.alternative, **cold}
    with vehicle(simulator, folder, parameters, starts=is_before) as (pilot, companion, log):
        pilot.wait_for(lambda: pilot.has_fix, 60.0)
        log.marks["fix"] = pilot.t
        while (passed := pilot.t - log.marks["fix"]) < _WARM:
            share = 1.0 - passed / _WARM
            pilot.shift_receiver(share * _NORTH, 0.0, share * _UP)
            pilot.wait(0.5)
        pilot.shift_receiver(0.0, 0.0, 0.0)
        if not is_before:
            companion.start()
        _in_and_back(simulator, pilot, log)
    return log


def _in_and_back(simulator: Simulator, pilot: Pilot, log: Log) -> None:
    """Climb on the receiver, change to ODOMETRY, hold, and return to home on it."""
    climb(pilot, log)
    pilot.wait(5.0)
    _change_and_return(simulator, pilot, log)


def _change_and_return(simulator: Simulator, pilot: Pilot, log: Log) -> None:
    simulator.change(pilot, is_into=True)
    log.marks["into"] = pilot.t
    pilot.wait(10.0)
    log.marks["end"] = pilot.t
    to_ground(pilot, log)


def cold(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Start with a receiver whose first fixes are 6 m north and 4 m up off."""
    for is_before, words in ((True, "before"), (False, "after")):
        log = fly_cold(simulator, folder / f"cold-{words}", is_before)
        yield from _held(f"cold receiver, daemon {words} it", log)


def _held(name: str, log: Log) -> Iterator[Line]:
    yield into(name, log, 9.5)
    yield landing(name, log)
    yield from dangers(name, log, begin="into", quiet=0.0, error=1.0)
    yield pace(name, log)


def fly_late(simulator: Simulator, folder: Path, away: float) -> Log:
    """Start the daemon in the air, away from home; change to it and return."""
    parameters = {**simulator.alternative, **ALONE}
    with vehicle(simulator, folder, parameters, starts=False) as (pilot, companion, log):
        climb(pilot, log)
        pilot.follow(*line(away))
        companion.start()
        log.marks["started"] = pilot.t
        pilot.wait(_LEAD)
        hover(simulator, pilot, log)
        _change_and_return(simulator, pilot, log)
    return log


def late(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Start the daemon 40 and 60 m away from home."""
    for away in (40.0, 60.0):
        log = fly_late(simulator, folder / f"late-{away:.0f}", away)
        yield from _held(f"daemon started {away:.0f} m away", log)


def fly_stale(simulator: Simulator, folder: Path) -> Log:
    """Kill the daemon, fly on for longer than a checkpoint lasts, and start it again."""
    parameters, settings = dict(simulator.alternative), "checkpoint: {limit: 2.0}"
    with vehicle(simulator, folder, parameters, settings) as (pilot, companion, log):
        climb(pilot, log)
        companion.kill()
        pilot.follow(*line(40.0))
        companion.start()
        log.marks["started"] = pilot.t
        pilot.wait(_LEAD)
        _change_and_return(simulator, pilot, log)
    return log


def fly_stale_hover(simulator: Simulator, folder: Path) -> Log:
    """Hover on ODOMETRY, and start the daemon again with a checkpoint that is refused."""
    parameters, settings = dict(simulator.flown_on), "checkpoint: {limit: 0.2}"
    with vehicle(simulator, folder, parameters, settings) as (pilot, companion, log):
        climb(pilot, log)
        pilot.wait(3.0)
        log.marks["kill"] = pilot.t
        companion.kill()
        pilot.wait(0.3)
        companion.start()
        pilot.wait(25.0)
        log.marks["end"] = pilot.t
        to_ground(pilot, log)
    return log


def stale(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Start again with a checkpoint that is too old."""
    yield from _held("checkpoint too old", fly_stale(simulator, folder / "stale"))
    log = fly_stale_hover(simulator, folder / "stale-hover")
    assert log.flown is not None
    name = "checkpoint too old, flown on"
    found = moved(log.flown.truth, log.marks["kill"], after=25.0)
    # Without ODOMETRY for long it has no position and lands: that is right
    acted = log.alarms(log.marks["kill"], log.marks["end"])
    if acted:
        found = moved(log.flown.truth, log.marks["kill"], after=2.0)
        yield Line(name, "alarms of the autopilot", len(acted), np.inf)
    yield Line(name, "true motion, any axis", found, 0.5, " m")
    told = log.told_after("not sent|withheld|restart|new start|frame|origin", log.marks["kill"])
    yield Line(name, "until the pilot reads of it", told, 10.0, " s")
    yield pace(name, log)


def stand_before_fix(simulator: Simulator, folder: Path) -> Log:
    """Start the daemon before the receiver's first fix, and stand for forty seconds."""
    with vehicle(simulator, folder, dict(simulator.alternative)) as (pilot, _, log):
        log.marks["begin"] = pilot.t
        pilot.wait_for(lambda: pilot.has_fix, 60.0)
        log.marks["fix"] = pilot.t
        pilot.wait(30.0)
        log.marks["end"] = pilot.t
    return log


def before_fix(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Start the daemon before the first fix, three boots."""
    name, far, told, apart, logs = "daemon before the first fix", [], [], [], []
    for boot in range(1, 4):
        where = folder / f"before-fix-{boot}"
        log = stand_before_fix(simulator, where)
        places = from_home(read_origins(sorted(where.glob("companion-*.tlog"))))
        far.append(float(abs(places).max()) if len(places) else np.inf)
        told.append(float(sum(" jumps " in text or " reset " in text for _, text in log.said)))
        score = log.score("ours", "fix")
        apart.append(max(score.horizontal_max, score.vertical_max))
        logs.append(log)
    yield Line(name, "our origin, any axis", max(far), 10.0, " m", tuple(far))
    yield Line(name, "error of what was sent, any axis", max(apart), 10.0, " m", tuple(apart))
    yield Line(name, "jumps told that were none", sum(told), 0, "", tuple(told))
    yield pace(name, *logs)
