"""Whether it flies better on ODOMETRY, and whether it survives outages and restarts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.sitl.companion import Companion
from benchmarks.sitl.flight import SETTLED, Log, climb, hover, to_ground, vehicle
from benchmarks.sitl.line import Line, dangers, lead, motion, pace, ratios
from benchmarks.sitl.lock import alone
from benchmarks.sitl.pilot import Pilot, figure_eight, square
from benchmarks.sitl.recording import resumed_after
from benchmarks.sitl.score import moved, right_after, silence, untold_steps
from benchmarks.sitl.simulator import Simulator

RESTART = 0.3
"""s from a kill to the next start: RestartSec of systemd/ekf-companion.service."""
MONITOR = "Companion: autopilot does not follow"
"""Beginning of the daemon's text about that."""
_RESTARTS = 10


def fly_paths(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Hover, a square and a figure of eight, on its own receiver or on ODOMETRY."""
    parameters = dict(simulator.flown_on) if is_flown_on else {}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["moving"] = pilot.t
        pilot.follow(*square())
        pilot.follow(*figure_eight())
        log.marks["end"] = pilot.t
        log.has_global = pilot.global_t is not None and pilot.t - pilot.global_t < 2.0
        pilot.land()
    return log


def compared(simulator: Simulator, folder: Path, pairs: int = 1) -> Iterator[Line]:
    """Fly the same paths on the receiver and on ODOMETRY; compare the autopilot's errors."""
    own, ours = [], []
    for number in range(1, pairs + 1):
        own.append(fly_paths(simulator, folder / f"own-{number}", is_flown_on=False))
        ours.append(fly_paths(simulator, folder / f"flown-on-{number}", is_flown_on=True))
    theirs = [log.score("autopilot") for log in own]
    passive = [log.score("ours") for log in own]
    flown = [log.score("autopilot") for log in ours]
    name, whose = "passive", "our {} error, over its own"
    limits = {"horizontal": 1.0, "velocity": 1.0, "vertical": 1.0}
    yield from ratios(name, whose, passive, theirs, limits)
    yield from lead(name, "our lead or lag", passive)
    name, whose = "flown on ODOMETRY", "{} error, over own GNSS"
    limits = {"horizontal": 0.8, "velocity": 0.8, "vertical": 1, "roll": 1, "pitch": 1, "yaw": 1}
    yield from ratios(name, whose, flown, theirs, limits)
    yield from lead(name, "lead or lag", flown)
    if (usual := max(log.largest_bias for log in own)) > 0.0:
        found = max(log.largest_bias for log in ours) / usual
        yield Line(name, "largest accelerometer bias, over own GNSS", found, 1.0)
    yield pace(name, *own, *ours)
    for log in ours:
        yield from dangers(name, log, quiet=0.0, error=1.0)
    yield Line(name, "without a global position", sum(not log.has_global for log in ours), 0)


def fly_outage(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
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


def lost(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Lose the receiver for twenty seconds, passive and flown on."""
    passive = fly_outage(simulator, folder / "outage-passive", is_flown_on=False)
    flown = fly_outage(simulator, folder / "outage-flown-on", is_flown_on=True)
    yield from returned("receiver off, passive", passive, ("ours",))
    name = "receiver off, flown on"
    yield Line(name, "drift until it acts or the fix returns", drift(flown), 10.0, " m")
    yield from returned(name, flown, ("ours", "autopilot"))
    yield pace(name, passive, flown)


def returned(name: str, log: Log, which: tuple[str, ...]) -> Iterator[Line]:
    """Return the lines on an outage and the receiver's return."""
    assert log.flown is not None
    flown, fix, end = log.flown, log.marks["fix"], log.marks["end"]
    steps = untold_steps(flown.ours, flown.resets, flown.truth, 1.0)
    yield Line(name, "untold steps over 1 m", steps, 0)
    spoke = silence(flown.arrival, log.marks["off"], fix).total
    yield Line(name, "ODOMETRY silent in the outage", spoke, np.inf, " s")
    for one in which:
        found = right_after(getattr(flown, one), flown.truth, fix, end, 1.0)
        yield Line(name, f"{one} right after the fix's return", found, 2.0, " s")
    alarms = log.alarms(fix, end)
    yield Line(name, "alarms of the autopilot after it", len(alarms), 0)
    told = log.told_after("GNSS|receiver|GPS", log.marks["off"])
    yield Line(name, "until the pilot reads of it", told, 5.0, " s")


def drift(log: Log) -> float:
    """Return how far the vehicle went from its place until a failsafe or the fix's return, m."""
    assert log.flown is not None
    acted = [t for t, text in log.texts if "failsafe" in text.lower() and t > log.marks["off"]]
    end = min([log.marks["on"], *acted])
    return moved(log.flown.truth, log.marks["off"], after=end - log.marks["off"])


def fly_restarts(simulator: Simulator, folder: Path, times: int) -> Log:
    """Hover on ODOMETRY while the daemon is killed and started again, several times; return."""
    with vehicle(simulator, folder, dict(simulator.flown_on)) as (pilot, companion, log):
        climb(pilot, log)
        pilot.wait(3.0)
        hover(simulator, pilot, log)
        for number in range(times):
            log.marks[f"kill {number}"] = pilot.t
            companion.kill()
            pilot.wait(RESTART)
            companion.start()
            pilot.wait(10.0 - RESTART)
        log.marks["end"] = pilot.t
        to_ground(pilot, log)
    return log


def restarted(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Kill and restart the daemon in flight."""
    log = fly_restarts(simulator, folder / "restarts", _RESTARTS)
    assert log.flown is not None
    name, error = f"kill -9, {_RESTARTS} times", log.score("autopilot", "kill 0")
    kills = [f"kill {number}" for number in range(_RESTARTS)]
    yield motion(name, "true motion after a kill, any axis", log, kills, 9.9)
    yield Line(name, "largest horizontal error", error.horizontal_max, 1.0, " m")
    yield Line(name, "largest vertical error", error.vertical_max, 1.0, " m")
    longest = silence(log.flown.arrival, log.marks["kill 0"], log.marks["end"]).longest
    yield Line(name, "longest silence of ODOMETRY", longest, 3.0, " s")
    yield from dangers(name, log)
    yield landing(name, log)
    yield pace(name, log)


def landing(name: str, log: Log) -> Line:
    """Return the distance of the vehicle's landing from the place of its arming."""
    away = log.truth_at("landed") - log.truth_at("arming")
    return Line(name, "landed from home", float(np.hypot(away[0], away[1])), 1.0, " m")


def fly_switch(simulator: Simulator, folder: Path) -> Log:
    """Change from the receiver to ODOMETRY in the hover, fly a square on it, and change back."""
    with vehicle(simulator, folder, dict(simulator.alternative)) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        hover(simulator, pilot, log)
        simulator.change(pilot, is_into=True)
        log.marks["into"] = pilot.t
        pilot.wait(8.0)
        pilot.follow(*square())
        simulator.change(pilot, is_into=False)
        log.marks["back"] = pilot.t
        pilot.wait(10.0)
        log.marks["end"] = pilot.t
        to_ground(pilot, log)
    return log


def switched(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Change from the receiver to ODOMETRY in flight, and back."""
    log = fly_switch(simulator, folder / "switch")
    name = "in and out in flight"
    yield into(name, log)
    # On PX4's way back both sources are on for 1.5 s, and ODOMETRY is withheld meanwhile
    yield from dangers(name, log, quiet=2.0, error=1.0)
    yield landing(name, log)
    yield pace(name, log)
    if log.flown is not None and log.flown.dead_reckoning is not None:
        yield Line(name, "longest dead reckoning", log.flown.dead_reckoning, 1.0, " s")


def into(name: str, log: Log, after: float = 7.0) -> Line:
    """Return how far the vehicle went at the change to ODOMETRY."""
    return motion(name, "true motion at the switch, any axis", log, ["into"], after)


def fly_endurance(simulator: Simulator, folder: Path) -> Log:
    """Hover and fly squares on ODOMETRY for ten minutes."""
    with vehicle(simulator, folder, dict(simulator.flown_on)) as (pilot, _, log):
        climb(pilot, log)
        for _ in range(10):
            pilot.follow(*square())
            pilot.wait(38.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def lasting(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly on ODOMETRY for ten minutes."""
    log = fly_endurance(simulator, folder / "endurance")
    flown, name = log.flown, "ten minutes on ODOMETRY"
    assert flown is not None
    begin, end = log.marks["begin"], log.marks["end"]
    error = log.score("autopilot")
    yield Line(name, "horizontal error", error.horizontal, 0.25, " m")
    yield Line(name, "largest horizontal error", error.horizontal_max, 1.0, " m")
    yield Line(name, "largest vertical error", error.vertical_max, 1.0, " m")
    if (own := flown.own_resets) is not None:
        yield Line(name, "resets of the autopilot", int(((own > begin) & (own < end)).sum()), 0)
    if flown.ours is not None:
        rows = (flown.ours.t > begin) & (flown.ours.t < end)
        turned = int(np.count_nonzero(np.diff(flown.resets[rows])))
        yield Line(name, "moved counters of ODOMETRY", turned, 0)
    yield Line(name, "largest accelerometer bias", float(abs(flown.accel_bias).max()), 0.25)
    false = [text for _, text in log.said if text.startswith(MONITOR)]
    yield Line(name, "false alarms of the daemon's monitor", len(false), 0)
    yield from dangers(name, log, quiet=0.0, error=1.0)
    yield pace(name, log)


def rebooted(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Restart the autopilot on the ground: how long until ODOMETRY comes again."""
    folder = folder / "reboot"
    folder.mkdir(parents=True, exist_ok=True)
    companion = Companion(folder, simulator.companion)
    with alone():
        simulator.start(folder, dict(simulator.flown_on))
        try:
            Pilot(simulator.pilot).close()
            companion.start()
            time.sleep(SETTLED)
            simulator.stop()
            time.sleep(2.0)
            simulator.start(folder, {**simulator.flown_on, **simulator.rebooted})
            pilot = Pilot(simulator.pilot)
            pilot.wait(SETTLED)
            pilot.close()
        finally:
            companion.stop()
            simulator.stop()
    found = resumed_after(companion.recordings[-1])
    yield Line("reboot", "until ODOMETRY", found, 15.0, " s")
