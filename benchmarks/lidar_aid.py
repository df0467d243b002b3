"""The way of a lidar as an aid of the main filter: half a minute without fixes, and over a plain.

Logs of an autopilot are made of the sequences of shared/data/lidar: their inertial samples, fixes
made of the truth as receivers have them, and the heading of two antennas.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.document import table
from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import BaroSettings, GnssSettings
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import lines_of, solve
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import Table
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.review.convert import estimate

SEQUENCES = Path(__file__).parents[2] / "shared" / "data" / "lidar"
HEAD = (
    "sequence, without fixes | aid | largest error since the last fix, m: RMS of seeds, worst | "
    "RMS over time, m: RMS of seeds, worst | sigmas of an axis, largest | NEES, an axis"
)
CASES = (
    ("street_drive", (13.0, 43.0)),
    ("forest_flight", (15.0, 45.0)),
    ("tunnel_run", (14.0, 44.0)),
    ("plain_flight", None),
)
"""From when until when there are no fixes, s; None: they go on."""
SEEDS = range(1, 9)
FRAME = LocalFrame(np.deg2rad(47.0), np.deg2rad(8.0), 400.0)
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
DOWN = np.array([1.0, -1.0, -1.0])
"""From forward, left, up to forward, right, down."""
LATE = 0.12
"""By which fixes are late, s."""
WALK_TIME = 60.0
"""Correlation time of the slow error of fixes, s."""
HEADING_STD = float(np.deg2rad(1.0))
"""Of two antennas half a metre apart."""
BOOT = 10.0
"""Time of the autopilot's clock when the lidar's is zero, s."""
STARTED = 5.0
"""After which errors count where fixes go on, s."""
CONFIG = Config(gnss=GnssSettings(delay=LATE), baro=BaroSettings(use=False))
COLUMNS = (
    "time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,"
    "gps_lat_deg,gps_lon_deg,gps_alt_m,gps_vn_mps,gps_ve_mps,gps_vd_mps,gps_std_h_m,gps_std_v_m,"
    "gps_std_vel_mps,heading_deg,heading_std_deg"
)


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Samples and truth; times in s of the lidar's clock; world east, north, up; body x forward."""

    imu_t: Array
    gyro: Array
    accel: Array
    t: Array
    pos: Array
    vel: Array
    q: Array
    """w, x, y, z, body to world."""

    @classmethod
    def of(cls, folder: Path) -> Flight:
        """Read a sequence: imu.npz and truth.npz in a folder."""
        imu, truth = np.load(folder / "imu.npz"), np.load(folder / "truth.npz")
        samples = (imu["stamp"], imu["gyro"].astype(float), imu["accel"].astype(float))
        q = truth["q"][:, [3, 0, 1, 2]]
        return cls(*samples, truth["t"], truth["p"], truth["v"].astype(float), q)

    @property
    def end(self) -> float:
        """Return when truth or samples end, s."""
        return float(min(self.t[-1], self.imu_t[-1]))

    def place(self, t: Array) -> Array:
        """Return the true position at times of the lidar's clock, NED of :data:`FRAME`."""
        place = np.stack([np.interp(t, self.t, one) for one in self.pos.T], axis=1)
        return np.asarray(place @ TO_NED.T)

    def fixes(self, seed: int, rate: float = 5.0) -> tuple[Array, Array]:
        """Return times and columns of fixes: 1 m white, 1 m slow, velocities of 0.1 m/s."""
        rng = np.random.default_rng(seed)
        t = np.arange(self.t[0], self.end - LATE, 1.0 / rate)
        share, slow = np.exp(-1.0 / rate / WALK_TIME), rng.normal(size=3)
        pos_n = self.place(t) + rng.normal(size=(len(t), 3))
        for row in pos_n:
            slow = share * slow + np.sqrt(1.0 - share * share) * rng.normal(size=3)
            row += slow
        vel_n = np.stack([np.interp(t, self.t, one) for one in self.vel.T], axis=1) @ TO_NED.T
        vel_n = vel_n + rng.normal(0.0, 0.1, vel_n.shape)
        lat, lon, alt = FRAME.to_geodetic(pos_n)
        stds = [np.full(len(t), std) for std in (2.0**0.5, 2.0**0.5, 0.1)]
        return t + LATE, np.column_stack([np.degrees(lat), np.degrees(lon), alt, vel_n, *stds])

    def headings(self, seed: int, rate: float = 5.0) -> tuple[Array, Array]:
        """Return times and columns of a heading of two antennas."""
        t = np.arange(self.t[0], self.end, 1.0 / rate)
        forward = so3.to_matrix(self.q)[:, :, 0]
        heading = np.unwrap(np.arctan2(forward[:, 0], forward[:, 1]))
        rng = np.random.default_rng(seed + 1000)
        said = np.interp(t, self.t, heading) + rng.normal(0.0, HEADING_STD, len(t))
        degrees = np.degrees(np.column_stack([said, np.full(len(t), HEADING_STD)]))
        return t, np.column_stack([degrees[:, 0] % 360.0, degrees[:, 1]])

    def write(self, path: Path, seed: int, cut: tuple[float, float] | None = None) -> None:
        """Write a log and what its heading is of; fixes and headings are gone for a time.

        Args:
            path: Of the .csv.
            seed: Of the errors.
            cut: From when until when there are none, s; None: they go on.
        """
        begin, end = cut or (0.0, 0.0)
        cells = np.full((len(self.imu_t), COLUMNS.count(",") + 1), np.nan)
        cells[:, 0] = self.imu_t + BOOT
        cells[:, 1:4], cells[:, 4:7] = self.gyro * DOWN, self.accel * DOWN
        for (t, rows), first in ((self.fixes(seed), 7), (self.headings(seed), 16)):
            kept = (t < begin) | (t >= end)
            at = np.searchsorted(self.imu_t, t[kept])
            at, rows = at[at < len(cells)], rows[kept][at < len(cells)]
            cells[at, first : first + rows.shape[1]] = rows
        lines = [",".join("" if one != one else f"{one:.12g}" for one in row) for row in cells]
        path.write_text("\n".join([COLUMNS, *lines]) + "\n", encoding="utf-8")
        beside = path.with_name(f"{path.name}.columns.yaml")
        beside.write_text("heading_source: gnss\n", encoding="utf-8")

    def errors(self, found: Table) -> tuple[Array, Array, Array]:
        """Return times on the lidar's clock, errors and sigmas of an estimate's positions."""
        t = np.asarray(found.stamp_ns * 1e-9 - BOOT)
        lat, lon = (np.deg2rad(found.column(one)) for one in ("lat_deg", "lon_deg"))
        error = FRAME.to_ned(lat, lon, found.column("alt_m")) - self.place(t)
        return t, error, found.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])


def rows() -> Iterator[str]:
    """Yield the rows of the table."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, cut in CASES:
            solution = solve(read(SEQUENCES / name), Settings())
            for kind in (".csv", ".tum", "rel"):
                lines = "\n".join(lines_of(solution, kind))
                (folder / f"pose{kind}").write_text(f"{lines}\n", encoding="utf-8")
            flight = Flight.of(SEQUENCES / name)
            for aid in ("none", ".csv", ".tum", "rel"):
                file = None if aid == "none" else PoseFile(folder / f"pose{aid}")
                yield row(name, aid, flight, cut, folder / "log.csv", file)


def row(
    name: str,
    aid: str,
    flight: Flight,
    cut: tuple[float, float] | None,
    log: Path,
    file: PoseFile | None,
) -> str:
    """Return the row of a flight with an aid, or none."""
    begin, end = cut or (STARTED, flight.end)
    found = []
    for seed in SEEDS:
        flight.write(log, seed, cut)
        t, error, sigma = flight.errors(estimate(log, CONFIG, None, file)[0])
        inside = (t >= begin) & (t < end) & np.isfinite(error[:, 0])
        error, sigma = error[inside], sigma[inside]
        away = np.linalg.norm(error if cut is None else error - error[0], axis=1)
        z = np.abs(error / sigma)
        found.append([away.max(), np.sqrt(np.mean(away**2)), z.max(), np.mean(z**2)])
    of = np.array(found)
    rms, worst = np.sqrt(np.mean(of**2, axis=0)), of.max(axis=0)
    spans = "fixes throughout" if cut is None else f"{begin:g} to {end:g} s"
    errors = [f"{rms[k]:.2f}, {worst[k]:.2f}" for k in (0, 1)]
    return " | ".join(
        [f"{name}, {spans}", aid, *errors, f"{worst[2]:.1f}", f"{of[:, 3].mean():.2f}"]
    )


def main() -> None:
    """Print the table."""
    for one in table(HEAD, rows()):
        print(one, flush=True)


if __name__ == "__main__":
    main()
