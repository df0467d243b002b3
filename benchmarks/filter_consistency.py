"""Is a rival filter as wrong as it says? NEES of position, velocity and attitude, flight by flight.

python -m benchmarks.filter_consistency [flights]
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import band
from benchmarks.matched import matched
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.sequence import MeasurementSequence, NavigationFilter, Setup, advance
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight

Array = npt.NDArray[np.float64]

INSTANTS = (0.1, 5.0, 15.0, 30.0, 45.0)
"""s after the filter's start."""
BLOCKS = ("attitude", "velocity", "position")
RATE = 50.0
"""Inertial samples, Hz."""
SCENARIOS = ("figure-eight", "square-spiral")


def squares(flight: Flight, make: Callable[[Setup], NavigationFilter]) -> Array:
    """Give NEES over dof of each block at the instants, shape (instants, 3)."""
    course = MeasurementSequence(wire.events(flight, has_vel_down=True), matched(flight.config))
    setup = course.setup()
    tried, due, found = make(setup), list(INSTANTS), []
    for step in course.steps(setup.start.t_ns):
        advance(tried, step)
        if due and step.is_sample and (step.t_ns - setup.start.t_ns) * 1e-9 >= due[0]:
            due.pop(0)
            found.append(_nees(flight, course, step.t_ns, tried))
    return np.array(found)


def _nees(
    flight: Flight, course: MeasurementSequence, t_ns: int, tried: NavigationFilter
) -> list[float]:
    now, state, P = flight.truth_at(np.array([t_ns])), tried.state, tried.covariance()
    pos_n = course.frame.to_ned(now.lat, now.lon, now.alt)[0]
    turn_n = so3.log(so3.multiply(now.q_nb[0], so3.conjugate(state.q_nb)))
    gaps = (turn_n, now.vel_n[0] - state.vel_n, pos_n - state.pos_n)
    parts = [slice(i, i + 3) for i in (0, 3, 6)]
    return [
        float(gap @ np.linalg.solve(P[part, part], gap)) / 3.0
        for gap, part in zip(gaps, parts, strict=True)
    ]


def main(flights: int) -> None:
    """Print a table."""
    makers: dict[str, Callable[[Setup], NavigationFilter]] = {
        "linear": lambda setup: Iterated(setup, max_iterations=1),
        "iterated": Iterated,
        "robocentric": lambda setup: Iterated(setup, frame="robocentric"),
    }
    config = SimConfig(imu=ImuConfig(rate=RATE))
    low, high = band(3 * flights * len(SCENARIOS))
    print(f"{flights} flights each of {', '.join(SCENARIOS)}; 95 % band {low:.2f} to {high:.2f}")
    print("| filter | block | " + " | ".join(f"{t:g} s" for t in INSTANTS) + " | mean |")
    print("|---" * (len(INSTANTS) + 3) + "|")
    plans = [
        Flight.plan(name, config, seed=seed, duration=INSTANTS[-1] + 5.0)
        for i, name in enumerate(SCENARIOS)
        for seed in range(1000 * i + 1, 1000 * i + flights + 1)
    ]
    for label, make in makers.items():
        all_of = np.array([squares(flight, make) for flight in plans])
        for i, block in enumerate(BLOCKS):
            cells = [*all_of[:, :, i].mean(axis=0).tolist(), float(all_of[:, :, i].mean())]
            print(f"| {label} | {block} | " + " | ".join(f"{c:.2f}" for c in cells) + " |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
