"""Faults of the receiver while flown on ODOMETRY, and long legs in wind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.sitl.basic import landing, returned
from benchmarks.sitl.flight import SETTLED, Log, climb, to_ground, vehicle
from benchmarks.sitl.line import Line, dangers, pace, ratios
from benchmarks.sitl.mission import legs
from benchmarks.sitl.pilot import figure_eight
from benchmarks.sitl.score import score, silence
from benchmarks.sitl.simulator import Simulator
from ekf_companion.errors import CompanionError

_WIND = {"SIM_WIND_SPD": 5, "SIM_WIND_TURB": 1, "SIM_WIND_DIR": 250}
_AUTO, _GUIDED, _STABILISE = 3, 4, 0
_WRONG = "receiver|GNSS|GPS"


def fly_faults(simulator: Simulator, folder: Path) -> Log:
    """Hover on ODOMETRY through a glitch of 60 m and a drift of 20 m."""
    with vehicle(simulator, folder, dict(simulator.flown_on)) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        log.marks["glitch"] = pilot.t
        pilot.shift_receiver(60.0, 0.0, 0.0)
        pilot.wait(10.0)
        pilot.shift_receiver(0.0, 0.0, 0.0)
        pilot.wait(15.0)
        log.marks["drift"] = pilot.t
        while (east := 0.5 * (pilot.t - log.marks["drift"])) < 20.0:
            pilot.shift_receiver(0.0, east, 0.0)
            pilot.wait(0.2)
        log.marks["stays"] = pilot.t
        pilot.wait(10.0)
        pilot.shift_receiver(0.0, 0.0, 0.0)
        log.marks["back"] = pilot.t
        pilot.wait(10.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def faulty(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Shift the receiver's positions, at once and slowly."""
    log = fly_faults(simulator, folder / "faults")
    for name, begin, end in (
        ("glitch of 60 m", "glitch", "drift"),
        ("drift of 20 m", "drift", "end"),
    ):
        found, ours = log.score("autopilot", begin, end), log.score("ours", begin, end)
        yield Line(name, "autopilot's largest horizontal error", found.horizontal_max, 2.0, " m")
        yield Line(name, "our largest horizontal error", ours.horizontal_max, 2.0, " m")
        yield Line(name, "our largest vertical error", ours.vertical_max, 2.0, " m")
        told = log.told_after(_WRONG, log.marks[begin])
        yield Line(name, "until the pilot reads what is wrong", told, 5.0, " s")
    yield from dangers("glitch and drift", log, begin="glitch", quiet=1.0)
    yield pace("glitch and drift", log)


def fly_moving_outage(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Fly figures of eight in wind, and lose the receiver for 35 s."""
    parameters = {**(simulator.flown_on if is_flown_on else {}), **_WIND}
    path, _ = figure_eight()
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        climb(pilot, log)
        pilot.follow(path, 12.5)
        log.marks["off"] = pilot.t
        pilot.set(simulator.receiver, simulator.receiver_off)
        pilot.follow(path, 33.0)
        pilot.has_fix = False
        log.marks["on"] = pilot.t
        pilot.set(simulator.receiver, simulator.receiver_on)
        pilot.wait_for(lambda: pilot.has_fix, 10.0)
        log.marks["fix"] = pilot.t
        pilot.wait(12.0)
        log.marks["end"] = pilot.t
        pilot.land()
    return log


def moving_outage(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Lose the receiver in motion and wind, passive and flown on."""
    for is_flown_on, words in ((False, "passive"), (True, "flown on")):
        where = folder / f"moving-outage-{words.replace(' ', '-')}"
        log = fly_moving_outage(simulator, where, is_flown_on)
        name = f"receiver off 35 s in motion and wind, {words}"
        flown = log.flown
        assert flown is not None
        found = score(flown.ours, flown.truth, log.marks["off"], log.marks["on"])
        yield Line(name, "largest error of what was sent", found.horizontal_max, 10.0, " m")
        which = ("ours", "autopilot") if is_flown_on else ("ours",)
        yield from returned(name, log, which)
        yield pace(name, log)


def fly_legs(simulator: Simulator, folder: Path, is_flown_on: bool) -> Log:
    """Fly AUTO with legs of 600 m at 13 m/s in wind and turbulence, and return by RTL."""
    speeds = {"WPNAV_SPEED": 1300, "WP_SPD": 13, "RTL_ALT": 1500, "RTL_ALT_M": 15}
    parameters = {**(simulator.flown_on if is_flown_on else {}), **_WIND, **speeds}
    parameters |= {"AUTO_OPTIONS": 3}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        pilot.wait(SETTLED + 5.0)
        pilot.upload(legs())
        log.marks["arming"] = pilot.t
        for _ in range(20):
            pilot.order_mode(_GUIDED)
            pilot.command(400, 1.0)
            if pilot.wait_for(lambda: pilot.is_armed, 3.0):
                break
        else:
            raise CompanionError(f"it did not arm: {pilot.texts[-3:]}")
        pilot.order_mode(_AUTO)
        pilot.command(300)  # MISSION_START
        if not pilot.wait_for(lambda: pilot.local is not None and pilot.local.z < -15.0, 30.0):
            raise CompanionError("it did not take off")
        log.marks["begin"] = pilot.t
        pilot.wait_for(lambda: 4 in pilot.reached, 150.0)
        log.marks["end"] = pilot.t
        to_ground(pilot, log)
    return log


def long_legs(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly far on its receiver and on ODOMETRY."""
    own = fly_legs(simulator, folder / "legs-own", is_flown_on=False)
    ours = fly_legs(simulator, folder / "legs-flown-on", is_flown_on=True)
    name, whose = "AUTO, legs of 600 m", "{} error, over own GNSS"
    limits = dict.fromkeys(("horizontal", "vertical", "velocity", "roll", "pitch", "yaw"), 1.0)
    yield from ratios(name, whose, [ours.score("autopilot")], [own.score("autopilot")], limits)
    worst = ours.score("taken").horizontal_max
    yield Line(name, "largest horizontal error of ODOMETRY", worst, 1.0, " m")
    assert ours.flown is not None
    arrival = ours.flown.arrival
    quiet = silence(arrival, ours.marks["begin"], ours.marks["end"]).total
    yield Line(name, "ODOMETRY silent", quiet, 0.0, " s")
    yield from dangers(name, ours)
    yield landing(f"{name}, on own GNSS", own)._replace(limit=np.inf)
    yield landing(name, ours)
    yield pace(name, own, ours)
