"""Sources that disagree: a second companion, one bad compass of three, one receiver of two off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from benchmarks.sitl.flight import Log, climb, vehicle
from benchmarks.sitl.line import Line, dangers, pace
from benchmarks.sitl.pilot import square
from benchmarks.sitl.score import moved
from benchmarks.sitl.second import SecondCompanion
from benchmarks.sitl.simulator import ArduPilot, Simulator

_OFF = 350.0
"""What one compass is off, mG."""
_FAULT = 20.0
"""s in the hover with a fault."""


def fly_second(simulator: ArduPilot, folder: Path) -> Log:
    """Hover on ODOMETRY while a second companion sends positions that are 2.8 m off."""
    parameters = {**simulator.flown_on, "SERIAL2_PROTOCOL": 2}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["fault"] = pilot.t
        with SecondCompanion(simulator.other):
            pilot.wait(_FAULT)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def second(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly beside a second companion."""
    assert isinstance(simulator, ArduPilot)
    log = fly_second(simulator, folder / "second")
    name = "second companion"
    told = log.told_after("poses|VISION_POSITION|another", log.marks["fault"])
    yield Line(name, "until the pilot reads of it", told, 5.0, " s")
    assert log.flown is not None
    found = moved(log.flown.truth, log.marks["fault"], after=_FAULT)
    yield Line(name, "true motion, any axis", found, 0.5, " m")
    yield from _ours(name, log)
    yield pace(name, log)


def fly_compass(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Hover and fly a square with one compass of three 350 mG off."""
    parameters = dict(simulator.flown_on) if is_flown_on else {}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["fault"] = pilot.t
        pilot.set("SIM_MAG1_OFS_X", 5.0 + _OFF)
        pilot.wait(_FAULT)
        log.marks["moving"] = pilot.t
        pilot.follow(*square())
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def compass(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly with a bad compass, passive and on ODOMETRY."""
    for is_flown_on, words in ((False, "passive"), (True, "flown on")):
        where = folder / f"compass-{words.replace(' ', '-')}"
        log = fly_compass(simulator, where, is_flown_on)
        name = f"compass 1 of 3 off, {words}"
        hover, way = log.score("ours", "fault", "moving"), log.score("ours", "moving")
        yield Line(name, "our largest yaw error, hover", hover.yaw_max, 5.0, " deg")
        yield Line(name, "our largest yaw error, square", way.yaw_max, 5.0, " deg")
        its = log.score("autopilot", "fault").yaw_max
        yield Line(name, "autopilot's largest yaw error", its, math.inf, " deg")
        yield from _ours(name, log, is_flown_on=is_flown_on)
        yield pace(name, log)


def fly_receivers(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Hover with two receivers, of which the first is off for twenty seconds."""
    two = {"SIM_GPS2_ENABLE": 1, "GPS2_TYPE": 1, "SERIAL4_PROTOCOL": 5, "GPS_AUTO_SWITCH": 1}
    parameters = {**(simulator.flown_on if is_flown_on else {}), **two}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["fault"] = pilot.t
        pilot.set("SIM_GPS1_ENABLE", 0)
        pilot.wait(_FAULT)
        pilot.set("SIM_GPS1_ENABLE", 1)
        pilot.wait(10.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def receivers(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Lose one receiver of two, passive and on ODOMETRY."""
    for is_flown_on, words in ((False, "passive"), (True, "flown on")):
        where = folder / f"receiver-{words.replace(' ', '-')}"
        log = fly_receivers(simulator, where, is_flown_on)
        name = f"receiver 1 of 2 off, {words}"
        yield from _ours(name, log, is_flown_on=is_flown_on)
        yield pace(name, log)


def _ours(name: str, log: Log, *, is_flown_on: bool = True) -> Iterator[Line]:
    """Return how far off we were from the fault on, and the dangers."""
    found = log.score("ours", "fault")
    yield Line(name, "our largest horizontal error", found.horizontal_max, 1.0, " m")
    yield Line(name, "our largest vertical error", found.vertical_max, 1.0, " m")
    yield Line(name, "our largest yaw error", found.yaw_max, 5.0, " deg")
    own = log.score("autopilot", "fault")
    limit = 1.0 if is_flown_on else math.inf
    yield Line(name, "autopilot's largest horizontal error", own.horizontal_max, limit, " m")
    quiet = 1.0 if is_flown_on else None
    yield from dangers(name, log, begin="fault", quiet=quiet)
