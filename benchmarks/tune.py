"""``fleet tune`` on seeded flights of one vehicle whose noise, delay and lever arm are known.

``python -m benchmarks.tune`` makes 40 flights by the independent generator of ``make truth``, tunes
to them, and prints each parameter beside the truth; it ends with exit code 1 if a noise of the
receiver is off by more than 10 %, the delay by more than 5 ms, or flights left out gain nothing.
``--fleets 20 --flights 8`` counts how often the intervals hold the truth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import engine
from benchmarks.document import table
from benchmarks.truth import log, paths
from benchmarks.truth.cases.case import flown
from benchmarks.truth.draw import Draw
from benchmarks.truth.earth import Array
from ekf_companion.config.config import Config
from ekf_companion.fleet import tune
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.tune import PARAMETERS, Fit

DURATION = 60.0
"""s of each flight."""
RATE = 100
"""Inertial samples, Hz."""
DELAY, ARM = 0.137, np.array([0.3, -0.2, -0.15])
ACCEL_NOISE, GYRO_NOISE = 0.05, 3e-3
"""m/s^2 and rad/s per square root of Hz: a multicopter's vibration, beside the sensor's own."""
TRUTH = np.array([DELAY, *ARM, 0.5, 0.8, 0.05, 0.0, ACCEL_NOISE, GYRO_NOISE])
"""In the order of ``PARAMETERS``; the receiver is that of ``benchmarks.truth.sensors``."""
MOST_NOISE, MOST_DELAY = 0.1, 0.005
"""Largest relative error of a noise of the receiver, and error of the delay, s."""
RECEIVER = (4, 5, 6)
HELD = (0, *RECEIVER, 8)
"""Delay, the receiver's noise and the accelerometer's: what is promised to lie in the intervals."""
NO_TRUTH = 7
"""The stamps of the simulated receiver have no error in time."""


def fly(path: Path, seed: int) -> None:
    """Write a flight: figure-eights, straights with turns, or gusts in a hover."""
    draw = Draw(seed, "tune")
    motion = (paths.figure_eights, paths.steady_and_stopping, paths.hover)[seed % 3](draw)
    readings = flown(draw, motion, DURATION, imu_rate=RATE, delay=DELAY)
    readings.fixes.lever_b = ARM
    inertial = readings.inertial
    for values, noise in ((inertial.accel, ACCEL_NOISE), (inertial.gyro, GYRO_NOISE)):
        values += noise * np.sqrt(RATE) * draw.rng.standard_normal(values.shape)
    log.write_log(path, readings)


def fit(flights: int, first: int, jobs: int) -> Fit:
    """Tune to so many flights from a seed on."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + flights):
            fly(Path(folder) / f"{seed:05}.csv", seed)
        return tune.tune(list(Listing([folder])), Config(), engine.executor(jobs))


def is_held(found: Fit) -> Array:
    """Return 1 where an interval holds the truth, 0 where it does not, NaN without a truth."""
    held = (found.low <= TRUTH) & (found.high >= TRUTH)
    return np.where(np.arange(len(TRUTH)) == NO_TRUTH, np.nan, held)


def one(flights: int, first: int, jobs: int) -> int:
    """Print what is found, beside the truth; return the exit code."""
    found = fit(flights, first, jobs)
    rows = [
        f"{p.name}, {p.unit} | {TRUTH[i]:.4g} | {found.values[i]:.4g} | "
        + f"{found.low[i]:.4g} to {found.high[i]:.4g}{'' if found.is_shown[i] else ', not shown'}"
        for i, p in enumerate(PARAMETERS)
    ]
    print(*table("parameter | truth | found | 95 %", rows), sep="\n")
    (fixed, error), (learnt, other) = (tune.mean_and_error(gains) for gains in found.gains.T)
    print(f"{found.flights} flights, {found.moves} steps; left aside: {found.refused or 'none'}")
    print(f"gain left out: fixed {fixed:.1f} +- {error:.1f}, learnt {learnt:.1f} +- {other:.1f}")
    share = np.abs(found.values / np.where(TRUTH == 0.0, np.nan, TRUTH) - 1.0)
    is_right = all(share[i] <= MOST_NOISE for i in RECEIVER)
    is_right &= abs(found.values[0] - DELAY) <= MOST_DELAY
    return 0 if is_right and max(fixed - 2.0 * error, learnt - 2.0 * other) > 0.0 else 1


def many(fleets: int, flights: int, first: int, jobs: int) -> None:
    """Print how many intervals hold the truth, over several fleets."""
    held = []
    for number in range(fleets):
        held.append(is_held(fit(flights, first + number * flights, jobs)))
        rows = [
            f"{p.name} | {np.nansum(column):.0f} of {np.count_nonzero(np.isfinite(column))}"
            for p, column in zip(PARAMETERS, np.transpose(held), strict=True)
        ]
        promised = np.array(held)[:, HELD]
        rows.append(f"delay, receiver and accel_noise | {promised.sum():.0f} of {promised.size}")
        print(
            f"{number + 1} fleets of {flights} flights", *table("parameter | held", rows), sep="\n"
        )
        sys.stdout.flush()


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="benchmarks.tune", description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--fleets", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    if asked.fleets:
        many(asked.fleets, asked.flights, asked.first, asked.jobs)
        return 0
    return one(asked.flights, asked.first, asked.jobs)


if __name__ == "__main__":
    sys.exit(main())
