"""``fleet tune`` on seeded flights of one vehicle whose noise, delay and lever arm are known.

``python -m benchmarks.tune`` makes 40 flights by the independent generator of ``make truth``, tunes
to them, and prints each parameter beside the truth; it ends with exit code 1 if a noise of the
receiver is off by more than 10 %, the delay by more than 5 ms, or flights left out gain nothing.
``--groups`` counts how often the intervals of groups of these flights hold the truth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import t

from benchmarks import engine
from benchmarks.document import table
from benchmarks.truth import log, paths
from benchmarks.truth.cases.case import flown
from benchmarks.truth.draw import Draw
from ekf_companion.config.config import Config
from ekf_companion.fleet import tune
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.tune import Fit
from ekf_companion.fleet.tune_flight import Look, look
from ekf_companion.fleet.tune_parameter import HIGH, LOW, NOISES, PARAMETERS

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
HELD = [0, *RECEIVER, 8]
"""Delay, the receiver's noise and the accelerometer's: what is promised to lie in the intervals."""
KNOWN = [0, 1, 2, 3, *RECEIVER, 8, 9]
"""All but the error of the stamps in time, which is none."""
SIZES, DRAWS = (6, 8, 12, 24), 20
"""Flights of a group, and how often groups are drawn."""


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


def fly_all(folder: Path, flights: int, first: int) -> None:
    """Write so many flights from a seed on."""
    for seed in range(first, first + flights):
        fly(folder / f"{seed:05}.csv", seed)


def fit(flights: int, first: int, jobs: int) -> Fit:
    """Tune to so many flights from a seed on."""
    with tempfile.TemporaryDirectory() as folder:
        fly_all(Path(folder), flights, first)
        return tune.tune(list(Listing([folder])), Config(), engine.executor(jobs))


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


def groups(flights: int, first: int, jobs: int) -> None:
    """Print how many intervals hold the truth, of groups that are drawn from so many flights.

    Each group takes one Newton step from the truth: its likelihood is a parabola that near.
    """
    theta = TRUTH.copy()
    theta[NOISES] = np.log(np.maximum(theta[NOISES], 1e-9))
    theta = np.clip(theta, LOW, HIGH)
    with tempfile.TemporaryDirectory() as folder:
        fly_all(Path(folder), flights, first)
        task = partial(look, theta=theta, config=Config())
        found = dict(engine.executor(jobs).run(task, list(Listing([folder]))))
    looks = [found[source] for source in sorted(found, key=lambda one: one.name)]
    if refused := [one for one in looks if not isinstance(one, Look)]:
        raise SystemExit(f"{len(refused)} of {flights} flights cannot be used: {refused[0]}")
    rng, rows = np.random.default_rng(1), []
    for size in (size for size in SIZES if size <= flights):
        held = []
        for _ in range(DRAWS):
            order = rng.permutation(flights)
            for start in range(0, flights - size + 1, size):
                some = [looks[i] for i in order[start : start + size]]
                top = np.clip(theta + tune.newton_step(some), LOW, HIGH)
                sigma = tune.interval_sigma(tune.left_out(theta, some), some)
                held.append(np.abs(top - theta) <= t.ppf(0.975, size - 1) * sigma)
        shares = " | ".join(f"{share:.2f}" for share in np.mean(held, axis=0)[KNOWN])
        promised = np.array(held)[:, HELD]
        rows.append(f"{size} | {promised.sum()} of {promised.size} | {shares}")
    names = " | ".join(PARAMETERS[i].name for i in KNOWN)
    print(*table(f"flights | promised | {names}", rows), sep="\n")


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="benchmarks.tune", description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--groups", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    if asked.groups:
        groups(asked.flights, asked.first, asked.jobs)
        return 0
    return one(asked.flights, asked.first, asked.jobs)


if __name__ == "__main__":
    sys.exit(main())
