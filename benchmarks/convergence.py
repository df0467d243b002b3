"""Where an iterated update converges and a linear one does not: starts with the heading far wrong.

python -m benchmarks.convergence            the tables of docs/filters/iterated.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.matched import matched
from benchmarks.sighting import Sighting
from ekf_companion.core.settings import GateSettings
from ekf_companion.filters.alignment import InitialEstimate
from ekf_companion.filters.gate import Decision, Gate
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.observation import Azimuth, Observation, Position
from ekf_companion.filters.sequence import MeasurementSequence, Setup
from ekf_companion.filters.strapdown import (
    ATT,
    POS,
    VEL,
    Earth,
    Interval,
    N,
    Noise,
    Nominal,
)
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

Array = npt.NDArray[np.float64]

HEADING_ERRORS = (60.0, 90.0, 120.0, 150.0)
"""deg."""
HEADING_STD = np.radians(100.0)
"""One sigma that the filter is told of the first heading, rad."""
FIELD_N = np.array([0.215, 0.013, 0.433])
"""gauss: 47 deg north."""
FIELD_STD = 0.003
"""gauss: a heading to 0.8 deg."""
ANTENNAS = (np.array([1.0, 0.0, -0.2]), np.array([-1.0, 0.0, -0.2]))
"""m, b."""
CARRIER_STD = 0.01
"""m: a heading to 0.4 deg."""


class Open(Gate):
    """Believes everything: a linear step would refuse what it cannot explain."""

    def test_nis(self, aid: str, t_ns: int, nis: float, dof: int) -> Decision:
        """Give that it is to be fused."""
        return super().test_nis(aid, t_ns, 0.0 * nis, dof)


def standing(
    aids: Callable[[Nominal, np.random.Generator], Sequence[Observation]],
    error: float,
    seed: int,
    updates: int,
    max_iterations: int,
) -> tuple[float, float]:
    """Correct a vehicle that stands, its first heading wrong by so much (deg).

    Returns:
        Error of the heading and its sigma as the filter says it, rad.
    """
    rng = np.random.default_rng(seed)
    roll, pitch, yaw = rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-np.pi, np.pi)
    tilt, pos_std = np.radians(1.0), 5.0
    sigmas = np.full(N, 0.01)
    sigmas[ATT], sigmas[VEL], sigmas[POS] = (tilt, tilt, HEADING_STD), 0.1, pos_std
    truth = Nominal(q_nb=so3.from_euler(roll, pitch, yaw), vel_n=np.zeros(3), pos_n=np.zeros(3))
    # Sigmas of the attitude are about north, east, down
    C_nb = so3.to_matrix(truth.q_nb)
    turn_n = np.array([*rng.normal(0.0, tilt, 2), 0.0])
    wrong = so3.multiply(so3.exp(turn_n), truth.q_nb)
    wrong = so3.multiply(so3.exp(np.array([0.0, 0.0, np.radians(error)])), wrong)
    first = replace(truth, q_nb=wrong, pos_n=rng.normal(0.0, pos_std, 3))
    P = np.diag(np.square(sigmas))
    C_nb = so3.to_matrix(wrong)
    P[ATT, ATT] = C_nb.T @ P[ATT, ATT] @ C_nb
    setup = Setup(
        start=InitialEstimate(t_ns=0, state=first, P=P),
        earth=Earth.flat(9.81),
        noise=Noise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4),
        gate=Open(GateSettings()),
    )
    tried = Iterated(setup, max_iterations=max_iterations)
    still = np.zeros(3)
    force = so3.to_matrix(truth.q_nb).T @ np.array([0.0, 0.0, -9.81])
    over = Interval(dt=0.02, gyro0=still, gyro1=still, accel0=force, accel1=force)
    for k in range(updates):
        if k:
            tried.predict(over)
        tried.correct((k + 1) * 20_000_000, aids(truth, rng))
    turn = so3.log(so3.multiply(truth.q_nb, so3.conjugate(tried.state.q_nb)))
    return abs(float(turn[2])), float(np.sqrt(tried.covariance()[2, 2]))


def field(truth: Nominal, rng: np.random.Generator) -> Sequence[Observation]:
    """Give the Earth's field as a magnetometer sees it."""
    seen = so3.to_matrix(truth.q_nb).T @ FIELD_N + rng.normal(0.0, FIELD_STD, 3)
    return [Sighting(seen_b=seen, known_n=FIELD_N, std=FIELD_STD)]


def antennas(truth: Nominal, rng: np.random.Generator) -> Sequence[Observation]:
    """Give the positions of two antennas, to a centimetre."""
    return [
        Position(
            pos_n=truth.pos_n + so3.to_matrix(truth.q_nb) @ lever + rng.normal(0.0, CARRIER_STD, 3),
            std=np.full(3, CARRIER_STD),
            lever_b=lever,
        )
        for lever in ANTENNAS
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Sortie:
    """A simulated flight on a course of fixes without a heading."""

    flight: Flight
    course: MeasurementSequence
    setup: Setup

    @classmethod
    def plan(cls, seed: int, quiet: tuple[float, float], seconds: float) -> Sortie:
        """Draw a figure-eight that begins at rest; no fix comes in a time after the start (s)."""
        config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(delay=0.0))
        flight = Flight.plan("figure-eight", config, seed=seed, duration=seconds + 2.0)
        course = MeasurementSequence(wire.events(flight, has_vel_down=True), matched(config))
        setup = course.setup()
        first, last = (setup.start.t_ns + round(t * 1e9) for t in quiet)
        course.aids = [
            (t, aid)
            for t, aid in course.aids
            if not isinstance(aid, Azimuth) and not first < t < last
        ]
        return cls(flight, course, setup)


def turned(setup: Setup, error: float) -> Setup:
    """Turn the first heading by so much (deg), and say that it is unsure."""
    start = setup.start
    by = so3.exp(np.array([0.0, 0.0, np.radians(error)]))
    state = replace(start.state, q_nb=so3.multiply(by, start.state.q_nb))
    down_b = so3.to_matrix(state.q_nb)[2]
    P = start.P.copy()
    P[ATT, ATT] += HEADING_STD**2 * np.outer(down_b, down_b)
    return replace(setup, start=replace(start, state=state, P=P), gate=Open(GateSettings()))


def flown(one: Sortie, tried: Iterated, after: float, fixes: Sequence[int]) -> Array:
    """Take a filter through a flight.

    Args:
        one: Its course.
        tried: The filter.
        after: Fixes count from here on, s after the start.
        fixes: After which to look, ascending.

    Returns:
        Heading error and its sigma as the filter says it, rad, shape (fixes, 2).
    """
    start_ns, seen, found = one.setup.start.t_ns, 0, []
    for step in one.course.steps(start_ns):
        if step.over is not None:
            tried.predict(step.over)
        if not step.aids:
            continue
        tried.correct(step.t_ns, step.aids)
        seen += (step.t_ns - start_ns) * 1e-9 >= after
        if seen and seen in fixes and len(found) < len(fixes):
            true = one.flight.truth_at(np.array([step.t_ns])).q_nb[0]
            turn = so3.log(so3.multiply(true, so3.conjugate(tried.state.q_nb)))
            found.append([abs(float(turn[2])), float(np.sqrt(tried.covariance()[2, 2]))])
        if seen >= fixes[-1]:
            break
    return np.array(found)


FILTERS: dict[str, dict[str, Any]] = {
    "linear": {"max_iterations": 1},
    "iterated": {},
    "linear, robocentric": {"max_iterations": 1, "frame": "robocentric"},
    "iterated, robocentric": {"frame": "robocentric"},
}
FIXES = (1, 2, 5, 25, 100)
QUIET = (4.0, 11.0)
"""s after the start: no fix from the rest until at speed."""


def _cell(found: Array) -> str:
    """Give the median error, and how many lie within 3 sigma or 1 deg; found: (runs, 2)."""
    error, sigma = np.degrees(found).T
    good = (error <= np.maximum(3.0 * sigma, 1.0)) & (error < 10.0)
    return f"{np.median(error):.1f} ({100 * good.mean():.0f} %)"


def tables(runs: int) -> Iterator[str]:
    """Give the tables of the standing vehicle and of the flights."""
    yield "Standing: median heading error, deg, and share that ended well"
    yield "| seen | filter, updates | " + " | ".join(f"{e:.0f} deg" for e in HEADING_ERRORS) + " |"
    yield "|---" * (len(HEADING_ERRORS) + 2) + "|"
    for label, aids in (("field", field), ("two antennas", antennas)):
        for name, updates, most in (
            ("linear, 1", 1, 1),
            ("linear, 50", 50, 1),
            ("iterated, 1", 1, 20),
        ):
            cells = [
                _cell(np.array([standing(aids, e, seed, updates, most) for seed in range(runs)]))
                for e in HEADING_ERRORS
            ]
            yield f"| {label} | {name} | " + " | ".join(cells) + " |"
    few = max(2, runs // 10)
    flights = [Sortie.plan(seed, QUIET, 36.0) for seed in range(1, few + 1)]
    yield f"\nIn flight, {few} flights: the same after so many fixes (5 Hz) that follow a silence"
    yield "| first error | filter | " + " | ".join(str(n) for n in FIXES) + " |"
    yield "|---" * (len(FIXES) + 2) + "|"
    for e in HEADING_ERRORS:
        for name, options in FILTERS.items():
            found = np.array(
                [
                    flown(
                        one,
                        Iterated(turned(one.setup, e if i % 2 else -e), **options),
                        QUIET[1],
                        FIXES,
                    )
                    for i, one in enumerate(flights)
                ]
            )
            cells = [_cell(found[:, j]) for j in range(len(FIXES))]
            yield f"| {e:.0f} deg | {name} | " + " | ".join(cells) + " |"
    yield "\nAt rest with fixes for 5 s, nothing can show north: sigma of the heading, deg"
    still = [Sortie.plan(seed, (0.0, 0.0), 8.0) for seed in range(1, few + 1)]
    for name, options in FILTERS.items():
        found = np.array(
            [flown(one, Iterated(turned(one.setup, 90.0), **options), 0.0, [25]) for one in still]
        )
        yield f"{name}: {np.degrees(np.median(found[:, 0, 1])):.0f}"


if __name__ == "__main__":
    for line in tables(int(sys.argv[1]) if len(sys.argv) > 1 else 100):
        print(line, flush=True)
