"""A fixed wing in AUTO, at two loop rates, passive."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmarks.sitl.flight import SETTLED, Log, vehicle
from benchmarks.sitl.line import Line, pace, ratios
from benchmarks.sitl.mission import wing
from benchmarks.sitl.score import untold_steps
from benchmarks.sitl.simulator import Simulator
from ekf_companion.errors import CompanionError

_FBWA, _AUTO = 5, 10
_LASTING = 110.0
"""s in the air."""
_WIND = {"SIM_WIND_SPD": 5, "SIM_WIND_TURB": 2, "SIM_WIND_DIR": 250}


def fly_wing(simulator: Simulator, folder: Path, loop: int) -> Log:
    """Fly a mission of sharp turns in a wind of 5 m/s, on the autopilot's own receiver."""
    parameters = {**_WIND, "SCHED_LOOP_RATE": float(loop)}
    with vehicle(simulator, folder, parameters) as (pilot, _, log):
        pilot.wait_for(lambda: pilot.has_fix, 60.0)
        pilot.wait(SETTLED)
        pilot.upload(wing())
        for _ in range(20):
            pilot.order_mode(_FBWA)
            pilot.command(400, 1.0)
            if pilot.wait_for(lambda: pilot.is_armed, 3.0):
                break
        else:
            last = "; ".join(text for _, text in pilot.texts[-4:])
            raise CompanionError(f"it did not arm: {last}")
        pilot.order_mode(_AUTO)
        if not pilot.wait_for(lambda: pilot.local is not None and pilot.local.z < -15.0, 40.0):
            raise CompanionError("it did not take off")
        log.marks["begin"] = pilot.t
        pilot.wait(_LASTING)
        log.marks["end"] = pilot.t
    return log


def winged(simulator: Simulator, folder: Path) -> Iterator[Line]:
    """Fly at both loop rates."""
    for loop in (300, 50):
        log = fly_wing(simulator, folder / f"wing-{loop}", loop)
        name, ours, its = f"AUTO, loop {loop}", log.score("ours"), log.score("autopilot")
        limits = dict.fromkeys(("horizontal", "vertical", "velocity", "roll", "pitch", "yaw"), 1.0)
        yield from ratios(name, "our {} error, over its own", [ours], [its], limits)
        begin, end = log.marks["begin"], log.marks["end"]
        told = sum(begin <= t <= end for t, _ in log.said)
        yield Line(name, f"texts of ours in {_LASTING:.0f} s", told, 4)
        if (flown := log.flown) is not None:
            steps = untold_steps(flown.ours, flown.resets, flown.truth, 1.0)
            yield Line(name, "untold steps of ODOMETRY over 1 m", steps, 0)
        yield pace(name, log)
