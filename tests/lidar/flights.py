"""Flights of a lidar as logs of an autopilot: inertial samples, fixes made of the truth, heading.

Of the sequences of ../shared, and of the simulator's worlds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame

FRAME = LocalFrame(np.deg2rad(47.0), np.deg2rad(8.0), 400.0)
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
DOWN = np.array([1.0, -1.0, -1.0])
"""From forward, left, up to forward, right, down."""
LATE = 0.12
"""By which fixes are late, s."""
WALK_TIME = 60.0
"""Correlation time of the slow error of fixes, s."""
HEADING_STD = np.deg2rad(1.0)
"""Of two antennas half a metre apart."""
BOOT = 10.0
"""Time of the autopilot's clock when the lidar's is zero, s."""
HEADER = (
    "time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,"
    "gps_lat_deg,gps_lon_deg,gps_alt_m,gps_vn_mps,gps_ve_mps,gps_vd_mps,gps_std_h_m,gps_std_v_m,"
    "gps_std_vel_mps,heading_deg,heading_std_deg"
)


@dataclass(frozen=True)
class Flight:
    """Times in s of the lidar's clock; world east, north, up; body forward, left, up."""

    imu_t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    t: np.ndarray
    pos: np.ndarray
    vel: np.ndarray
    q: np.ndarray
    """w, x, y, z, body to world."""

    @classmethod
    def of_sequence(cls, folder):
        imu, truth = np.load(folder / "imu.npz"), np.load(folder / "truth.npz")
        return cls(
            imu["stamp"],
            imu["gyro"].astype(float),
            imu["accel"].astype(float),
            truth["t"],
            truth["p"],
            truth["v"].astype(float),
            truth["q"][:, [3, 0, 1, 2]],
        )

    @property
    def end(self):
        return float(min(self.t[-1], self.imu_t[-1]))

    def place(self, t):
        """Return the true position, NED of FRAME, at times of the lidar's clock."""
        return np.stack([np.interp(t, self.t, one) for one in self.pos.T], axis=1) @ TO_NED.T

    def fixes(self, seed, rate=5.0):
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

    def headings(self, seed, rate=5.0):
        """Return times and columns of a heading of two antennas."""
        t = np.arange(self.t[0], self.end, 1.0 / rate)
        forward = so3.to_matrix(self.q)[:, :, 0]
        heading = np.unwrap(np.arctan2(forward[:, 0], forward[:, 1]))
        rng = np.random.default_rng(seed + 1000)
        said = np.interp(t, self.t, heading) + rng.normal(0.0, HEADING_STD, len(t))
        degrees = np.degrees(np.column_stack([said, np.full(len(t), HEADING_STD)]))
        return t, np.column_stack([degrees[:, 0] % 360.0, degrees[:, 1]])

    def write(self, path, seed, cut=(0.0, 0.0)):
        """Write a log; fixes and headings are gone for a time.

        Args:
            path: Of the .csv.
            seed: Of the errors.
            cut: From when until when there are none, s.
        """
        cells = np.full((len(self.imu_t), HEADER.count(",") + 1), np.nan)
        cells[:, 0] = self.imu_t + BOOT
        cells[:, 1:4], cells[:, 4:7] = self.gyro * DOWN, self.accel * DOWN
        for (t, rows), first in ((self.fixes(seed), 7), (self.headings(seed), 16)):
            kept = (t < cut[0]) | (t >= cut[1])
            at = np.searchsorted(self.imu_t, t[kept])
            at, rows = at[at < len(cells)], rows[kept][at < len(cells)]
            cells[at, first : first + rows.shape[1]] = rows
        lines = [",".join("" if one != one else f"{one:.12g}" for one in row) for row in cells]
        path.write_text("\n".join([HEADER, *lines]) + "\n")

    def errors(self, table):
        """Return times since the begin, errors and sigmas of an estimate's positions."""
        t = table.stamp_ns * 1e-9 - BOOT
        lat, lon = (np.deg2rad(table.column(one)) for one in ("lat_deg", "lon_deg"))
        error = FRAME.to_ned(lat, lon, table.column("alt_m")) - self.place(t)
        return t, error, table.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])
