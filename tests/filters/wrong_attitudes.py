"""Flights on which a filter starts in motion, with an attitude as wrong as its prior says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.matched import matched
from ekf_companion.analysis.consistency import Nees, nees
from ekf_companion.filters import sequence
from ekf_companion.filters.alignment import InitialEstimate
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.sequence import MeasurementSequence, NavigationFilter, Setup
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight

DURATION = 40.0
BEGIN = 12.0
"""The filter starts so far into the flight, in motion, s."""
SETTLED = 20.0
"""Errors count from here on, s after the start."""
FOUND = np.radians(10.0)
"""Largest heading error with which the heading counts as found."""
UNKNOWN = float(np.pi / np.sqrt(3.0))
"""One sigma of a heading of which nothing is known, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A flight, and how wrong the filter begins."""

    scenario: str = "figure-eight"
    heading: float | None = None
    """Error of the first heading, deg, and its sigma; None: drawn with 2 deg."""
    tilt: float | None = None
    """Error of the first tilt, deg, and its sigma per axis; None: drawn with 1 deg."""
    is_compassless: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight by one filter."""

    nees: Nees
    """Once settled."""
    has_north: bool
    """The heading was found, and kept over the last quarter."""


def begin(
    case: Case, path: MeasurementSequence, flight: Flight, rng: np.random.Generator
) -> InitialEstimate:
    """Draw a start whose errors have the covariance that it comes with."""
    t_ns = int(path.t_ns[np.searchsorted(path.t_ns, flight.to_ns(BEGIN))])
    now = flight.truth_at(np.array([t_ns]))
    tilt = np.radians(1.0 if case.tilt is None else case.tilt)
    heading = np.radians(2.0 if case.heading is None else case.heading)
    sigma_n = np.array([tilt, tilt, min(heading, UNKNOWN)])
    off_n = sigma_n * rng.standard_normal(3)
    if case.tilt is not None:
        off_n[:2] *= tilt / np.hypot(*off_n[:2])
    if case.heading is not None:
        off_n[2] = np.copysign(heading, off_n[2])
    q_nb = so3.multiply(so3.exp(-off_n), now.q_nb[0])
    C_nb = so3.to_matrix(q_nb)
    imu, gnss = flight.config.imu, flight.config.gnss
    rest = np.repeat([0.2, gnss.noise_h, imu.gyro_bias_start, imu.accel_bias_start], 3)
    pos_n = path.frame.to_ned(now.lat, now.lon, now.alt)[0]
    P = np.zeros((15, 15))
    P[:3, :3], P[3:, 3:] = C_nb.T @ np.diag(sigma_n**2) @ C_nb, np.diag(rest**2)
    off = rest[:6] * rng.standard_normal(6)
    state = Nominal(q_nb=q_nb, vel_n=now.vel_n[0] - off[:3], pos_n=pos_n - off[3:])
    return InitialEstimate(t_ns=t_ns, state=state, P=P)


def fly(case: Case, seed: int, make: Callable[[Setup], NavigationFilter]) -> Outcome:
    """Run a filter over a case's flight and compare it with the truth."""
    config = SimConfig(imu=ImuConfig(rate=25.0))
    flight = Flight.plan(case.scenario, config, seed=seed, duration=DURATION)
    settings = matched(config)
    path = MeasurementSequence(wire.events(flight, has_vel_down=True), settings)
    if case.is_compassless:
        path.aids = [one for one in path.aids if one[1].aid != "heading"]
    start = begin(case, path, flight, np.random.default_rng([seed, 15]))
    setup = Setup(start=start, earth=path.earth, noise=path.noise, gate=Gate(settings.gate))
    solution = sequence.run_sequence("filter", make(setup), path, setup)

    settled_ns = start.t_ns + round(SETTLED * 1e9)
    table = solution.table
    rows = np.flatnonzero(table.stamp_ns >= settled_ns)
    q_nb = np.stack([table.column(f"q_{axis}")[rows] for axis in "wxyz"], axis=-1)
    true_q_nb = flight.truth_at(table.stamp_ns[rows]).q_nb
    turn_n = so3.log(so3.multiply(true_q_nb, so3.conjugate(q_nb)))
    return Outcome(
        nees=nees(solution, wire.truth(flight), settled_ns, flight.to_ns(flight.duration)),
        has_north=bool(np.abs(turn_n[-len(turn_n) // 4 :, 2]).max() < FOUND),
    )
