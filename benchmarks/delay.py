"""Print the table of ``calibrate delay`` in docs/CALIBRATION.md: how often its interval is right.

``python -m benchmarks.delay``. With ``--write FILE`` it goes between the marks in that file.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks import document
from benchmarks.campaign import each
from benchmarks.document import Part, of_flights, table
from ekf_companion.calibrate import delay
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

FLIGHTS = 20
"""Of each motion and sensor."""
DURATION = 90.0
"""s."""
LATEST = 0.3
"""Largest delay drawn, s."""
MOTIONS = ("figure-eight", "hover", "square-spiral")
SENSORS = {
    "": ImuConfig(rate=50.0),
    ", noisy": ImuConfig(rate=50.0, gyro_noise=0.006, accel_noise=0.08),
}

Job = tuple[str, str, int]
"""Motion, sensors and seed."""


def measured(job: Job) -> tuple[float, float, float] | None:
    """Return error and both ends of the interval less the truth, s; None: refused."""
    motion, sensors, seed = job
    late = float(np.random.default_rng([seed, 21]).uniform(0.0, LATEST))
    config = SimConfig(imu=SENSORS[sensors], gnss=GnssConfig(delay=late))
    flight = Flight.plan(motion, config, seed=seed, duration=DURATION)
    flown = Recording(family="unknown", events=wire.events(flight, has_vel_down=True))
    try:
        found = delay.measure(flown, FilterSettings())
    except LogError:
        return None
    return found.best - late, found.low - late, found.high - late


def intervals(runs: int | None = None) -> Iterator[str]:
    """Yield errors of the delay, and how many intervals contain the truth."""
    jobs = [
        (motion, sensors, 1000 * i + 100 * j + luck)
        for i, motion in enumerate(MOTIONS, 1)
        for j, sensors in enumerate(SENSORS)
        for luck in range(runs or FLIGHTS)
    ]
    results = each(measured, jobs, "delay, flights")
    rows, inside, counted = [], 0, 0
    for motion in MOTIONS:
        for sensors in SENSORS:
            found = [
                r for job, r in zip(jobs, results, strict=True) if job[:2] == (motion, sensors)
            ]
            known = np.array([one for one in found if one is not None])
            refused = len(found) - len(known)
            cells = [motion + sensors, "-", "-", "-", "-"]
            if len(known):
                error, low, high = 1e3 * known.T
                covered = int(np.count_nonzero((low <= 0.0) & (high >= 0.0)))
                inside, counted = inside + covered, counted + len(known)
                cells[1:] = [
                    f"{np.sqrt(np.mean(error**2)):.1f} ms",
                    f"{np.abs(error).max():.1f} ms",
                    f"{np.median(high - low) / 2.0:.1f} ms",
                    f"{covered} of {len(known)}",
                ]
            rows.append(" | ".join([*cells, str(refused)]))
    rows.append(f"all | | | | {inside} of {counted} | {len(jobs) - counted}")
    return table(
        "motion, sensors | error RMS | largest | half interval, median | covered | refused", rows
    )


PARTS: dict[str, Part] = {"delay": of_flights(intervals)}


if __name__ == "__main__":
    document.main(__doc__, PARTS)
