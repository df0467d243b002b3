"""Many seeded flights: drawn, run in pieces on both cores, and compared with the truth."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from benchmarks.engine import in_order
from ekf_companion.core.memory.enums import (
    E_ATT,
    E_BA,
    E_BARO,
    E_BG,
    E_DELAY,
    E_GNSS,
    E_HEADING,
    E_IRON,
    E_POS,
    E_VEL,
    Mode,
)
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import delays_ns, imu_lag
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Table
from sim_autopilot import events as wire
from sim_autopilot.config import CompassConfig, GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

Job = TypeVar("Job")
Result = TypeVar("Result")

PROCESSES = 2
"""1: this one."""
SCENARIOS = ("figure-eight", "loiter", "hover", "square-spiral")
RECEIVERS = {
    "white": GnssConfig(noise_h=1.0, noise_v=1.5),
    "slow": GnssConfig(noise_h=0.3, noise_v=0.45, slow_h=1.0, slow_v=1.5),
}
"""The error of a fix: independent from fix to fix, or for the most part a slow random walk."""
RATE = 100.0
"""Inertial samples, Hz: a rate of telemetry; no figure depends on it by much."""
DELAY_STD = 0.02
"""One sigma of the receiver's delay from flight to flight, s."""
HARD_IRON_STD = 0.005
"""One sigma per axis of the vehicle's own field from flight to flight, gauss."""


def each(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    label: str,
) -> list[Result]:
    """Do all jobs by the engine and print the progress on stderr; results in the jobs' order.

    Args:
        function: Of a module, so that another process finds it.
        jobs: One argument each.
        label: What is counted.
    """
    begin, results = time.monotonic(), []
    step = max(1, len(jobs) // 20)
    for result in in_order(function, jobs, PROCESSES):
        results.append(result)
        if len(results) % step:
            continue
        spent = time.monotonic() - begin
        print(f"{label}: {len(results)} of {len(jobs)}, {spent:.0f} s", file=sys.stderr)
    return results


def roster(flights: int) -> list[tuple[str, int]]:
    """Return scenarios and seeds, no seed twice, all flights of a scenario in a row."""
    return [
        (name, 1000 * i + seed)
        for i, name in enumerate(SCENARIOS)
        for seed in range(1, flights + 1)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A simulated flight and its events."""

    flight: Flight
    events: Events
    nominal: SimConfig
    """What the filter may know: without what was drawn for this flight."""


def fly(name: str, seed: int, receiver: str = "white", duration: float = 180.0) -> Flown:
    """Draw a flight; the receiver's delay and the hard iron differ from flight to flight."""
    nominal = SimConfig(
        imu=ImuConfig(rate=RATE),
        gnss=RECEIVERS[receiver],
        compass=CompassConfig(slow_heading=float(np.radians(1.0))),
    )
    luck = np.random.default_rng([seed, 77]).standard_normal(4)
    late = max(0.0, nominal.gnss.delay + DELAY_STD * luck[0])
    x, y, z = (HARD_IRON_STD * luck[1:]).tolist()
    config = replace(
        nominal,
        gnss=replace(nominal.gnss, delay=late),
        compass=replace(nominal.compass, hard_iron=(x, y, z)),
    )
    flight = Flight.plan(name, config, seed=seed, duration=duration)
    return Flown(flight, wire.events(flight, has_vel_down=True), nominal)


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The filter's state, and when it was true."""

    t_ns: int
    block: Array

    @property
    def x(self) -> State:
        """Return it by its fields."""
        return as_state(self.block)

    @property
    def is_navigating(self) -> bool:
        """Whether there is a position."""
        return bool(self.x.mode == Mode.NAVIGATE)

    @property
    def frame(self) -> LocalFrame:
        """The local frame."""
        origin = self.x.origin
        return LocalFrame(origin.lat, origin.lon, origin.alt)

    def covariance(self, first: int, size: int) -> Array:
        """Return a diagonal block of the covariance."""
        return np.array(self.x.P)[first : first + size, first : first + size]


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """The result of a part of the events."""

    table: Table
    snapshot: Snapshot
    pipeline: Pipeline
    """As it is now; it changes with the next piece."""


def pieces(
    settings: FilterSettings,
    events: Events,
    instants_ns: Sequence[int],
    family: str = "unknown",
    gnss_delay: float | None = None,
) -> Iterator[Piece]:
    """Run events (in order of arrival) and stop after the last inertial sample of each instant.

    Whatever comes after the last instant is run as one more piece.
    """
    pipeline = Pipeline(settings, family, gnss_delay)
    lag_ns = round(imu_lag(settings, family) * 1e9)
    samples = np.flatnonzero(events.kind == Kind.IMU)
    newest = np.maximum.accumulate(events.t_ns[samples])
    last = np.searchsorted(newest, np.asarray(instants_ns, dtype=np.int64), side="right") - 1
    begin = 0
    for end in [*(samples[np.maximum(last, 0)] + 1).tolist(), len(events)]:
        table = pipeline.run(events.take(np.arange(begin, end)))
        # the only place that reads the pipeline's state block
        block = pipeline._timeline.block()
        yield Piece(table, Snapshot(pipeline.stamp_ns - lag_ns, block), pipeline)
        begin = max(begin, end)


def errors(
    snapshot: Snapshot, flown: Flown, settings: FilterSettings, family: str = "unknown"
) -> dict[str, tuple[Array, Array]]:
    """Return truth minus estimate, and its covariance, of every block of error states.

    The attitude's is the rotation vector in n that turns the estimate into the truth. A state
    that the filter takes as known has no variance and is left out.
    """
    x, flight = snapshot.x, flown.flight
    now = flight.truth_at(np.array([snapshot.t_ns]))
    t = float(now.t[0])
    pos_n = snapshot.frame.to_ned(now.lat, now.lon, now.alt)[0]
    bias_g, bias_a = (
        np.array([np.interp(t, flight.imu.t, axis) for axis in bias.T])
        for bias in (flight.imu.gyro_bias_b, flight.imu.accel_bias_b)
    )
    turn = so3.multiply(now.q_nb[0], so3.conjugate(np.array(x.q_nb)))
    nominal = delays_ns(settings, family)[Kind.GNSS] * 1e-9
    heading = np.interp(t, flight.mag.t, flight.mag.heading_error)
    drift = np.interp(t, flight.baro.t, flight.baro.drift)
    slow_n = np.array([np.interp(t, flight.gnss.t, axis) for axis in flight.gnss.slow_n.T])
    iron = flight.config.compass.hard_iron
    blocks = {
        "position": (E_POS, pos_n - x.pos_n),
        "velocity": (E_VEL, now.vel_n[0] - x.vel_n),
        "attitude": (E_ATT, so3.log(turn)),
        "gyro bias": (E_BG, bias_g - x.gyro_bias),
        "accel bias": (E_BA, bias_a - x.accel_bias),
        "baro offset": (E_BARO, np.array([drift - x.baro_offset])),
        "GNSS delay": (E_DELAY, np.array([flight.config.gnss.delay - nominal - x.gnss_delay])),
        "heading offset": (E_HEADING, np.array([heading - x.heading_offset])),
        "GNSS slow error": (E_GNSS, slow_n - x.gnss_offset),
        "hard iron": (E_IRON, np.array(iron) - x.hard_iron),
    }
    known = {name: (e, snapshot.covariance(i, len(e))) for name, (i, e) in blocks.items()}
    return {name: (e, P) for name, (e, P) in known.items() if (np.diag(P) > 0.0).all()}


def nees(error: Array, P: Array) -> float:
    """Return the normalised estimation error squared."""
    return float(error @ np.linalg.solve(P, error))


def band(dof: int, share: float = 0.95) -> tuple[float, float]:
    """Return the chi-square interval that holds a share of the probability, over its dof."""
    low, high = chi2.ppf([0.5 - 0.5 * share, 0.5 + 0.5 * share], dof) / dof
    return float(low), float(high)


def position_errors(table: Table, flown: Flown) -> Array:
    """Return estimate minus truth, north, east, down, m, shape (n, 3); NaN: no estimate."""
    now, frame = flown.flight.truth_at(table.stamp_ns), flown.flight.trajectory.frame
    lat, lon = np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg"))
    return frame.to_ned(lat, lon, table.column("alt_m")) - now.pos_n


def yaw_errors(table: Table, flown: Flown) -> Array:
    """Return the yaw estimate minus the truth, rad, shape (n,); NaN: no estimate."""
    true = flown.flight.truth_at(table.stamp_ns).euler[:, 2]
    return np.asarray(so3.wrap(table.column("yaw") - true))


def settled(t: Array, is_good: npt.NDArray[np.bool_]) -> float:
    """Return the time from which on all is good, 0 if from the start; inf: not at the end."""
    if not (t >= 0.0).any():
        return np.inf
    bad = np.flatnonzero(~is_good & (t >= 0.0))
    if not len(bad):
        return 0.0
    return float(t[bad[-1] + 1]) if bad[-1] + 1 < len(t) else np.inf


def median_and_worst(values: Sequence[float], digits: int) -> str:
    """Format the median and, in brackets, the worst; "never" and how often for infinite ones."""
    array = np.asarray(values, dtype=np.float64)
    lost = int(np.count_nonzero(np.isinf(array)))
    middle, worst = np.median(array), array.max()
    if np.isinf(middle):
        return "never" if lost == len(array) else f"never in {lost} of {len(array)}"
    end = f"never in {lost} of {len(array)}" if lost else f"{worst:.{digits}f}"
    return f"{middle:.{digits}f} ({end})"
