"""Starts with a heading that is far wrong: an iterated update converges, a linear one does not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.matched import matched
from ekf_companion.core.settings.settings import GateSettings
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
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, VehicleState, merge
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.filters.sighting import Sighting

HEADING_STD = np.radians(100.0)
"""One sigma of the first heading, as the filter's prior has it, rad."""
FIELD_N = np.array([0.215, 0.013, 0.433])
"""gauss: 47 deg north."""
FIELD_STD = 0.003
"""gauss: a heading to 0.8 deg."""
ANTENNAS = (np.array([1.0, 0.0, -0.2]), np.array([-1.0, 0.0, -0.2]))
"""m, b."""
CARRIER_STD = 0.01
"""m: a heading to 0.4 deg."""


class Open(Gate):
    """Accepts every observation, also those that a linear step cannot explain."""

    def decide(self, aid: str, t_ns: int, nis: float, dof: int) -> Decision:
        """Judge as if the NIS were zero."""
        return super().decide(aid, t_ns, 0.0 * nis, dof)


def at_rest(
    aids: Callable[[Nominal, np.random.Generator], Sequence[Observation]],
    error: float,
    seed: int,
    updates: int,
    max_iterations: int,
) -> tuple[float, float]:
    """Correct a vehicle at rest whose first heading is wrong by ``error`` (deg).

    Returns:
        Error of the heading and its sigma by the filter, rad.
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
    """Measure the Earth's field by a magnetometer."""
    seen = so3.to_matrix(truth.q_nb).T @ FIELD_N + rng.normal(0.0, FIELD_STD, 3)
    return [Sighting(seen_b=seen, known_n=FIELD_N, std=FIELD_STD)]


def antennas(truth: Nominal, rng: np.random.Generator) -> Sequence[Observation]:
    """Measure the positions of two antennas to a centimetre."""
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
    """A simulated flight with fixes and without a heading."""

    flight: Flight
    course: MeasurementSequence
    setup: Setup

    @classmethod
    def plan(cls, seed: int, quiet: tuple[float, float], seconds: float) -> Sortie:
        """Draw a figure-eight that begins at rest, without fixes in a time after the start (s)."""
        config = SimConfig(imu=ImuConfig(rate=50.0), gnss=GnssConfig(delay=0.0))
        flight = Flight.plan("figure-eight", config, seed=seed, duration=seconds + 2.0)
        # The autopilot reports that it stands: the rest shows the bias of the gyro
        standing = VehicleState(t_ns=flight.to_ns(0.1), is_armed=False, is_landed=True)
        events = merge(Events.from_rows([standing.row()]), wire.events(flight, has_vel_down=True))
        course = MeasurementSequence(events, matched(config))
        setup = course.setup()
        first, last = (setup.start.t_ns + round(t * 1e9) for t in quiet)
        course.aids = [
            (t, aid)
            for t, aid in course.aids
            if not isinstance(aid, Azimuth) and not first < t < last
        ]
        return cls(flight, course, setup)


def turned(setup: Setup, error: float) -> Setup:
    """Turn the first heading by an error (deg), and inflate its variance."""
    start = setup.start
    by = so3.exp(np.array([0.0, 0.0, np.radians(error)]))
    state = replace(start.state, q_nb=so3.multiply(by, start.state.q_nb))
    down_b = so3.to_matrix(state.q_nb)[2]
    P = start.P.copy()
    P[ATT, ATT] += HEADING_STD**2 * np.outer(down_b, down_b)
    return replace(setup, start=replace(start, state=state, P=P), gate=Open(GateSettings()))


def flown(one: Sortie, tried: Iterated, after: float, fixes: Sequence[int]) -> Array:
    """Run a filter over a flight.

    Args:
        one: The flight.
        tried: The filter.
        after: Fixes count from here on, s after the start.
        fixes: Numbers of the fixes after which the heading is compared, ascending.

    Returns:
        Heading error and its sigma by the filter, rad, shape (fixes, 2).
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
QUIET = (4.0, 11.0)
"""s after the start: no fix between rest and full speed."""
