"""Print live against smoothed errors per axis: ``python -m benchmarks.smoothing [--seeds N]``.

Simulated flights of one minute, 100 Hz, a receiver of 1 m and 0.1 m/s; RMS over all seeds from 10 s
on. Both estimators run with the default settings, and with what the simulator's sensors are.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import (
    BaroSettings,
    FilterSettings,
    GnssSettings,
    HeadingSettings,
    ImuSettings,
)
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import Table, Trajectory, join
from ekf_companion.replay.smoothing import Smoothing
from sim_autopilot import events as wireless
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.flight import Flight

Array = npt.NDArray[np.float64]

SCENARIOS = ("figure-eight", "loiter", "hover", "square-spiral", "walk")
AXES = (
    *("north, m", "east, m", "down, m", "v north, m/s", "v east, m/s", "v down, m/s"),
    *("roll, deg", "pitch, deg", "yaw, deg"),
)
GNSS = GnssSettings(delay=0.12, delay_std=0.02)
SETTINGS = {
    "default settings": FilterSettings(gnss=GNSS),
    "settings of the simulated sensors": FilterSettings(
        imu=ImuSettings(
            gyro_noise=5e-4,
            accel_noise=5e-3,
            gyro_bias_walk=4e-6,
            accel_bias_walk=1.6e-4,
            accel_bias=0.03,
        ),
        gnss=GNSS,
        heading=HeadingSettings(magnetometer_std=0.01),
        baro=BaroSettings(std=0.1, walk=0.04),
    ),
}
SETTLED_NS = 10_000_000_000


def squares(name: str, settings: FilterSettings, seed: int, duration: float) -> Array:
    """Give the mean squared error of each axis, live and smoothed, shape (2, 9)."""
    flight = Flight.plan(name, SimConfig(imu=ImuConfig(rate=100.0)), seed=seed, duration=duration)
    truth = wireless.truth(flight)
    with Smoothing(settings) as estimator:
        live = estimator.run(wireless.events(flight, has_vel_down=True))
        smoothed = join(list(estimator.tables()))
    return np.array([np.mean(errors(table, truth) ** 2, axis=0) for table in (live, smoothed)])


def errors(table: Table, truth: Trajectory) -> Array:
    """Give estimate less truth once settled: position, velocity, Euler angles in degrees."""

    def columns(names: str) -> Array:
        return np.stack([table.column(name) for name in names.split()], axis=1)[settled]

    settled = table.stamp_ns > table.stamp_ns[0] + SETTLED_NS
    rows = np.searchsorted(truth.pos_t_ns, table.stamp_ns[settled])
    frame = LocalFrame(float(truth.lat[0]), float(truth.lon[0]), float(truth.alt[0]))
    lat, lon, alt = columns("lat_deg lon_deg alt_m").T
    pos = frame.to_ned(np.radians(lat), np.radians(lon), alt)
    pos = pos - frame.to_ned(truth.lat[rows], truth.lon[rows], truth.alt[rows])
    vel = columns("vel_n vel_e vel_d") - truth.vel_n[rows]
    turn = columns("roll pitch yaw") - so3.to_euler(truth.q_nb[rows])
    return np.hstack([pos, vel, np.degrees(so3.wrap(turn))])


def report(seeds: int, duration: float = 60.0) -> Iterator[str]:
    """Give the tables, line by line."""
    for title, settings in SETTINGS.items():
        yield f"\n{title}\n\n| RMS | " + " | ".join(AXES) + " |"
        yield "|---" * (len(AXES) + 1) + "|"
        for name in SCENARIOS:
            each = [squares(name, settings, seed, duration) for seed in range(1, seeds + 1)]
            for what, row in zip(("live", "smoothed"), np.sqrt(np.mean(each, axis=0)), strict=True):
                yield f"| {name}, {what} | " + " | ".join(f"{value:.3f}" for value in row) + " |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="flights of each scenario")
    for line in report(parser.parse_args().seeds):
        print(line)


if __name__ == "__main__":
    main()
