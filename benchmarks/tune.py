"""``fleet tune`` on seeded flights of one vehicle whose noise, delay and lever arm are known.

``python -m benchmarks.tune`` makes 40 flights by the independent generator of ``make truth``, tunes
to them, and prints each parameter beside the truth; it ends with exit code 1 if a noise is off by
more than 10 %, the delay by more than 5 ms, or flights left out gain nothing. ``--vehicle 1`` draws
another vehicle by that seed. ``--groups`` counts how often the intervals of groups of these flights
hold the truth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
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
from ekf_companion.fleet.tune_parameter import HIGH, LOW, PARAMETERS, to_theta
from ekf_companion.nav.arrays import Array

DURATION = 60.0
"""s of each flight."""
RATE = 100
"""Inertial samples, Hz."""
STATED_STD = (0.5, 0.8, 0.05)
"""White noise of the receiver of ``truth.sensors``: position, height, m; velocity, m/s."""
MOST_NOISE, MOST_DELAY = 0.1, 0.005
"""Largest relative error of a noise, and error of the delay, s."""
NOISE = [4, 5, 6, 8, 9]
KNOWN = [0, 1, 2, 3, *NOISE]
"""All but the error of the stamps in time, which is none."""
SIZES, DRAWS = (6, 8, 12, 24), 20
"""Flights of a group, and how often groups are drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """A multicopter and its receiver."""

    delay: float = 0.137
    arm_b: tuple[float, ...] = (0.3, -0.2, -0.15)
    receiver_std: tuple[float, ...] = STATED_STD
    """White noise of position and height, m, and velocity, m/s; as ``STATED_STD`` or more."""
    accel_noise: float = 0.05
    """m/s^2 per square root of Hz: its vibration, beside the sensor's own."""
    gyro_noise: float = 3e-3
    """rad/s per square root of Hz."""

    @classmethod
    def drawn(cls, seed: int) -> Vehicle:
        """Return another vehicle."""
        rng = np.random.default_rng([seed, *b"vehicle"])
        worse = np.exp(rng.uniform(0.0, np.log(4.0), 3))
        return cls(
            delay=rng.uniform(0.0, 0.4),
            arm_b=tuple(rng.uniform(-0.6, 0.6, 3)),
            receiver_std=tuple(worse * STATED_STD),
            accel_noise=np.exp(rng.uniform(np.log(0.02), np.log(0.15))),
            gyro_noise=np.exp(rng.uniform(np.log(1e-3), np.log(8e-3))),
        )

    @property
    def truth(self) -> Array:
        """In the order of ``PARAMETERS``."""
        noise = (*self.receiver_std, 0.0, self.accel_noise, self.gyro_noise)
        return np.array([self.delay, *self.arm_b, *noise])


def fly(path: Path, seed: int, vehicle: Vehicle) -> None:
    """Write a flight: figure-eights, straights with turns, or gusts in a hover."""
    draw = Draw(seed, "tune")
    motion = (paths.figure_eights, paths.steady_and_stopping, paths.hover)[seed % 3](draw)
    readings = flown(draw, motion, DURATION, imu_rate=RATE, delay=vehicle.delay)
    inertial, fixes = readings.inertial, readings.fixes
    fixes.lever_b = np.array(vehicle.arm_b)
    noises = vehicle.accel_noise, vehicle.gyro_noise
    for values, noise in zip((inertial.accel, inertial.gyro), noises, strict=True):
        values += noise * np.sqrt(RATE) * draw.rng.standard_normal(values.shape)
    level, down, velocity = np.sqrt(np.square(vehicle.receiver_std) - np.square(STATED_STD))
    for errors, std in ((fixes.pos_error_n, [level, level, down]), (fixes.vel_error_n, velocity)):
        errors += std * draw.rng.standard_normal(errors.shape)
    log.write_log(path, readings)


def fly_all(folder: Path, flights: int, first: int, vehicle: Vehicle) -> None:
    """Write so many flights from a seed on."""
    for seed in range(first, first + flights):
        fly(folder / f"{seed:05}.csv", seed, vehicle)


def fit(flights: int, first: int, jobs: int, vehicle: Vehicle) -> Fit:
    """Tune to so many flights from a seed on."""
    with tempfile.TemporaryDirectory() as folder:
        fly_all(Path(folder), flights, first, vehicle)
        return tune.tune(list(Listing([folder])), Config(), engine.executor(jobs))


def one(flights: int, first: int, jobs: int, vehicle: Vehicle) -> int:
    """Print what is found, beside the truth; return the exit code."""
    found, truth = fit(flights, first, jobs, vehicle), vehicle.truth
    rows = [
        f"{p.name}, {p.unit} | {truth[i]:.4g} | {found.values[i]:.4g} | "
        + f"{found.low[i]:.4g} to {found.high[i]:.4g}{'' if found.is_shown[i] else ', not shown'}"
        for i, p in enumerate(PARAMETERS)
    ]
    print(*table("parameter | truth | found | 95 %", rows), sep="\n")
    (fixed, error), (learnt, other) = (tune.mean_and_error(gains) for gains in found.gains.T)
    print(f"{found.flights} flights, {found.moves} steps; left aside: {found.refused or 'none'}")
    print(f"gain left out: fixed {fixed:.1f} +- {error:.1f}, learnt {learnt:.1f} +- {other:.1f}")
    share = np.abs(found.values[NOISE] / truth[NOISE] - 1.0)
    is_held = (found.low <= truth) & (truth <= found.high)
    print(f"noise off by {share.max():.1%} at most; {is_held[KNOWN].sum()} of {len(KNOWN)} held")
    is_right = (share <= MOST_NOISE).all() and abs(found.values[0] - truth[0]) <= MOST_DELAY
    return 0 if is_right and max(fixed - 2.0 * error, learnt - 2.0 * other) > 0.0 else 1


def groups(flights: int, first: int, jobs: int, vehicle: Vehicle) -> None:
    """Print how many intervals hold the truth, of groups that are drawn from so many flights.

    Each group takes one Newton step from the truth: its likelihood is a parabola that near.
    """
    with np.errstate(divide="ignore"):
        theta = np.clip(to_theta(vehicle.truth), LOW, HIGH)
    with tempfile.TemporaryDirectory() as folder:
        fly_all(Path(folder), flights, first, vehicle)
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
        known = np.array(held)[:, KNOWN]
        shares = " | ".join(f"{share:.2f}" for share in known.mean(axis=0))
        rows.append(f"{size} | {known.sum()} of {known.size} | {shares}")
    names = " | ".join(PARAMETERS[i].name for i in KNOWN)
    print(*table(f"flights | held | {names}", rows), sep="\n")


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="benchmarks.tune", description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--vehicle", type=int, metavar="SEED", help="another vehicle")
    parser.add_argument("--groups", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    vehicle = Vehicle() if asked.vehicle is None else Vehicle.drawn(asked.vehicle)
    if asked.groups:
        groups(asked.flights, asked.first, asked.jobs, vehicle)
        return 0
    return one(asked.flights, asked.first, asked.jobs, vehicle)


if __name__ == "__main__":
    sys.exit(main())
