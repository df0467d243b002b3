"""Is an unscented filter better than the linear one on this problem? The same flights for both.

Both have the same states, motion, noise, gate and start; what differs is how they take a covariance
through a model that is not linear. ``python -m benchmarks.unscented [case ...]``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.campaign import PROCESSES, each
from benchmarks.matched import matched
from ekf_companion.analysis.consistency import Nees, nees
from ekf_companion.filters.alignment import InitialEstimate
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.sequence import (
    MeasurementSequence,
    NavigationFilter,
    Setup,
    run_sequence,
)
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.filters.ukf import Unscented
from ekf_companion.nav import so3
from sim_autopilot import events as wire
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

Array = npt.NDArray[np.float64]

FILTERS: dict[str, Callable[[Setup], NavigationFilter]] = {
    "linear": Iterated,
    "unscented": Unscented,
}
SEEDS = 6
DURATION = 60.0
BEGIN = 12.0
"""The filters are started so far into the flight, in motion, s."""
SETTLED = 20.0
"""s after the start: where what is said to be settled begins."""
FOUND = np.radians(10.0)
"""A heading that stays nearer than this has been found."""
_GOOD, _RECEIVER = ImuConfig(rate=50.0), GnssConfig()
UNKNOWN = float(np.pi / np.sqrt(3.0))
"""One sigma of a heading of which nothing is known, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is flown, and how wrong the filters begin."""

    name: str
    scenario: str = "figure-eight"
    heading: float | None = None
    """Error of the first heading, degrees, and its sigma; None: drawn with 2 degrees."""
    tilt: float | None = None
    """Error of the first tilt, degrees, and its sigma per axis; None: drawn with 1 degree."""
    is_compassless: bool = False
    imu: ImuConfig = _GOOD
    gnss: GnssConfig = _RECEIVER


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One flight by one filter."""

    position: Array
    """Squares of the errors once settled, north, east, down, m^2: their mean."""
    velocity: Array
    attitude: Array
    """rad^2, rotation vector in n."""
    early: Nees
    """Before."""
    late: Nees
    """Since."""
    has_north: bool
    seconds: float
    """Of a sample."""


_GRADE = ImuConfig(
    rate=50.0, gyro_noise=3e-3, accel_noise=3e-2, gyro_bias_start=0.02, accel_bias_start=0.2
)
"""Ten times the noise: an inertial unit of a telephone, shaken."""
_WIDE = (30.0, 60.0, 90.0, 120.0, 150.0)
CASES = {
    "usual": [
        Case(name=name, scenario=name)
        for name in ("figure-eight", "loiter", "hover", "square-spiral")
    ],
    "heading": [Case(name=f"heading {e:.0f} deg off, compass", heading=e) for e in _WIDE[1::3]],
    "compassless": [
        Case(name=f"heading {e:.0f} deg off, no compass", heading=e, is_compassless=True)
        for e in _WIDE
    ],
    "tilt": [Case(name=f"tilt {e:.0f} deg off", tilt=e) for e in (15.0, 30.0, 60.0, 90.0)],
    "both": [
        Case(name=f"heading and tilt {e:.0f} deg off", tilt=e, heading=e, is_compassless=True)
        for e in (30.0, 60.0, 90.0)
    ],
    "sparse": [
        Case(name="fixes of 1 Hz", gnss=GnssConfig(rate=1.0)),
        Case(name="fixes of 1 Hz, poor sensors", gnss=GnssConfig(rate=1.0), imu=_GRADE),
        Case(name="fixes of 0.2 Hz, poor sensors", gnss=GnssConfig(rate=0.2), imu=_GRADE),
        Case(name="inertial samples of 10 Hz", imu=ImuConfig(rate=10.0)),
        Case(name="10 Hz, poor sensors", imu=replace(_GRADE, rate=10.0)),
    ],
}


def begin(
    case: Case, path: MeasurementSequence, flight: Flight, rng: np.random.Generator
) -> InitialEstimate:
    """Draw a start whose errors are of the covariance that goes with it."""
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


def fly(job: tuple[Case, int], duration: float = DURATION) -> list[Outcome]:
    """Fly a case with a seed; give what came of it by filter."""
    case, seed = job
    config = SimConfig(imu=case.imu, gnss=case.gnss)
    flight = Flight.plan(case.scenario, config, seed=seed, duration=duration)
    settings = matched(config)
    path = MeasurementSequence(wire.events(flight, has_vel_down=True), settings)
    if case.is_compassless:
        path.aids = [one for one in path.aids if one[1].aid != "heading"]
    start = begin(case, path, flight, np.random.default_rng([seed, 15]))
    outcomes = []
    for name, make in FILTERS.items():
        setup = Setup(start=start, earth=path.earth, noise=path.noise, gate=Gate(settings.gate))
        before = time.process_time()
        solution = run_sequence(name, make(setup), path, setup)
        spent = (time.process_time() - before) / len(solution.table)
        outcomes.append(judge(solution, flight, start.t_ns, spent))
    return outcomes


def judge(solution: Solution, flight: Flight, start_ns: int, seconds: float) -> Outcome:
    """Hold a solution against the truth."""
    settled_ns = start_ns + round(SETTLED * 1e9)
    truth, end_ns = wire.truth(flight), flight.to_ns(flight.duration)
    table = solution.table
    rows = np.flatnonzero(table.stamp_ns >= settled_ns)
    now, frame = flight.truth_at(table.stamp_ns[rows]), flight.trajectory.frame
    lat, lon, alt = (table.column(name)[rows] for name in ("lat_deg", "lon_deg", "alt_m"))
    vel_n, q_nb = (
        np.stack([table.column(name)[rows] for name in names.split()], axis=-1)
        for names in ("vel_n vel_e vel_d", "q_w q_x q_y q_z")
    )
    turns = so3.log(so3.multiply(now.q_nb, so3.conjugate(q_nb)))
    last = turns[-len(turns) // 4 :, 2]
    return Outcome(
        position=np.square(now.pos_n - frame.to_ned(np.radians(lat), np.radians(lon), alt)).mean(
            axis=0
        ),
        velocity=np.square(now.vel_n - vel_n).mean(axis=0),
        attitude=np.square(turns).mean(axis=0),
        early=nees(solution, truth, start_ns, settled_ns),
        late=nees(solution, truth, settled_ns, end_ns),
        has_north=bool(np.abs(last).max() < FOUND),
        seconds=seconds,
    )


def report(case: Case, flown: Sequence[Sequence[Outcome]]) -> list[str]:
    """Give a line per filter: RMS by axis once settled, NEES before and since, time."""
    lines = []
    for i, name in enumerate(FILTERS):
        all_of = [one[i] for one in flown]
        cells = []
        for block, scale in (("position", 1.0), ("velocity", 1.0), ("attitude", np.rad2deg(1.0))):
            rms = np.sqrt(np.mean([getattr(one, block) for one in all_of], axis=0)) * scale
            cells.append(" ".join(f"{value:6.2f}" for value in rms))
        for span in ("early", "late"):
            found = [getattr(one, span) for one in all_of]
            blocks = ([one.position for one in found], [one.velocity for one in found])
            means = [np.mean(values) for values in (*blocks, [one.attitude for one in found])]
            cells.append(" ".join(f"{value:7.2f}" for value in means))
        north = sum(one.has_north for one in all_of)
        spent = np.median([one.seconds for one in all_of]) * 1e6
        lines.append(
            f"{case.name:<34} {name:<9} | {' | '.join(cells)} | {north:2d}/{len(all_of)} | "
            f"{spent:4.0f}"
        )
    return lines


def main(wanted: Sequence[str]) -> None:
    """Fly the cases and print their table."""
    print(
        f"{'':<34} {'':<9} | {'RMS position NED, m':<20} | {'velocity, m/s':<20} | "
        f"{'attitude n e d, deg':<20} | {'NEES/3 p v a, first 20 s':<23} | "
        f"{'NEES/3 p v a, since':<23} | north | us"
    )
    for case in (one for name in wanted or CASES for one in CASES[name]):
        jobs = [(case, seed) for seed in range(1, SEEDS + 1)]
        print("\n".join(report(case, each(fly, jobs, case.name, PROCESSES))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
