"""The seed article's simulated flight: our errors beside its own filter's and the limits.

400 s of a fixed wing over a flat Earth that does not turn: inertial samples, and a magnetometer
without dip, at 10 Hz, fixes at 1 Hz. Each inertial sample is a reading at its time; the specific
force is made from the central difference of the velocity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from benchmarks.document import is_there, table
from benchmarks.matched import ALMOST_NONE
from ekf_companion.core.settings.settings import (
    FilterSettings,
    GnssSettings,
    HeadingSettings,
    ImuSettings,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import FREE_AIR, LocalFrame, gravity
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Table
from ekf_companion.replay.smoothing import smooth

FOLDER = "seed-basicekf-sim"
PERIOD = 0.1
"""s."""
FIX_EVERY = 10
"""Inertial samples."""
GRAVITY = 9.81
"""m/s^2."""
GYRO_NOISE, GYRO_BIAS = 0.005, 0.01
"""One sigma of a sample and of the constant bias, rad/s."""
ACCEL_NOISE, ACCEL_BIAS = 0.01, 0.05
"""m/s^2."""
POSITION_STD, VELOCITY_STD = 1.0, 0.05
"""m, m/s."""
MAG_STD = 0.02
"""Of each axis of the unit vector."""
STRENGTH = 0.5
"""The unit vector is scaled to it, gauss."""
STRETCH = np.array([1.00256746, 0.99797194, 1.0])
"""Metres north, east and down of the truth's positions for each metre that its velocities integrate
to (least squares over the flight; what is left is 0.5 and 10 mm): the positions are a sphere's
metres of degrees that were an ellipsoid's, near 34 degrees of latitude."""
LAT = float(np.radians(75.0))
"""Where the flight is put on our Earth, rad. So far north the Earth turns nearly about the
vertical, which a gyro's bias explains, and an eastward speed has little effect; still further
north the meridians converge too much."""
FRAME = LocalFrame(LAT, 0.15, float((gravity(LAT, 160.0) - GRAVITY) / FREE_AIR))
"""Its altitudes are such that gravity is the simulation's; alt is that of the seed's sea."""
START = 20.0
"""s; the errors before are not counted."""
LIMITS = {
    "roll, deg": 0.27,
    "pitch, deg": 0.27,
    "yaw, deg": 0.20,
    "north, m": 0.55,
    "east, m": 0.42,
    "height, m": 0.19,
    "vN, m/s": 0.050,
    "vE, m/s": 0.053,
    "vD, m/s": 0.025,
}
"""Of the RMSE. Estimates have these columns, in SI and radians."""


@dataclass(frozen=True, slots=False, eq=False)
class Truth:
    """The motion, at the inertial samples."""

    t: Array
    """s."""
    pos_n: Array
    """North, east, down, m, of a flat Earth; down from the sea."""
    vel_n: Array
    euler: Array
    rate_b: Array
    """Of the gyro without its errors, rad/s."""

    @cached_property
    def q_nb(self) -> Array:
        """The attitude."""
        return so3.from_euler(*self.euler.T)

    @cached_property
    def force_b(self) -> Array:
        """Of the accelerometer without its errors, m/s^2."""
        accel_n = np.gradient(self.vel_n, PERIOD, axis=0) - [0.0, 0.0, GRAVITY]
        return so3.rotate(so3.conjugate(self.q_nb), accel_n)

    @cached_property
    def field_b(self) -> Array:
        """The direction of the field in the body: north, without dip."""
        north = np.broadcast_to([1.0, 0.0, 0.0], self.vel_n.shape)
        return so3.rotate(so3.conjugate(self.q_nb), north)


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """The sensors' samples."""

    gyro_b: Array
    accel_b: Array
    mag_b: Array
    """Unit vectors."""
    fixes: Array
    """North, east, down, m, velocity, m/s, every ``FIX_EVERY`` samples, shape (n, 6)."""


@cache
def truth(data: Path) -> Truth:
    """Read the motion."""
    T = np.genfromtxt(data / FOLDER / "uavTruth.csv", delimiter=",", names=True)
    return Truth(
        t=T["time_s"],
        pos_n=np.stack([T["north_m"], T["east_m"], -T["h_msl_m"]], axis=1),
        vel_n=np.stack([T["vn_mps"], T["ve_mps"], T["vd_mps"]], axis=1),
        euler=np.radians(np.stack([T["roll_deg"], T["pitch_deg"], T["yaw_deg"]], axis=1)),
        rate_b=np.stack([T["wx_rps"], T["wy_rps"], T["wz_rps"]], axis=1),
    )


@cache
def draw_42(data: Path) -> Draw:
    """Read the draw of the Octave run."""
    S = np.genfromtxt(data / FOLDER / "uavSensors.csv", delimiter=",", skip_header=1)
    fixes = S[::FIX_EVERY, 12:18] * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]
    return Draw(S[:, 1:4], S[:, 4:7], S[:, 7:10], fixes)


def events(motion: Truth, drawn: Draw) -> Events:
    """Return a draw as events for our pipeline."""
    t_ns = np.rint(motion.t * 1e9).astype(np.int64)
    place = FRAME.to_geodetic(drawn.fixes[:, :3] / STRETCH)
    # sigmas; then declination, flags, dip and strength of the simulation's field
    receiver = (POSITION_STD, POSITION_STD, VELOCITY_STD, 0.0, 0.0, 0.0, STRENGTH)
    columns = (np.full(len(drawn.fixes), value) for value in receiver)
    return merge(
        Events.from_columns(t_ns[::FIX_EVERY], Kind.GNSS, *place, *drawn.fixes[:, 3:].T, *columns),
        Events.from_columns(t_ns, Kind.IMU, *drawn.gyro_b.T, *drawn.accel_b.T),
        Events.from_columns(t_ns, Kind.MAG, *(STRENGTH * drawn.mag_b).T),
    )


def settings() -> FilterSettings:
    """Return the settings that declare the simulation's noise."""
    root = PERIOD**0.5
    return FilterSettings(
        imu=ImuSettings(
            gyro_noise=GYRO_NOISE * root,
            accel_noise=ACCEL_NOISE * root,
            gyro_bias_walk=0.0,
            accel_bias_walk=0.0,
            gyro_bias=GYRO_BIAS,
            accel_bias=ACCEL_BIAS,
            learn_noise=False,
            lag=0.0,
            samples="instant",
        ),
        gnss=GnssSettings(
            delay=0.0,
            delay_std=0.0,
            timing_std=0.0,
            lever_arm_std=0.0,
            velocity_slow_std=0.0,
            white_share=1.0,
            position_std=0.0,
            height_std=0.0,
            velocity_std=0.0,
        ),
        heading=HeadingSettings(
            magnetometer_std=ALMOST_NONE,
            hard_iron_std=ALMOST_NONE,
            hard_iron_walk=0.0,
            magnetometer_noise=MAG_STD * STRENGTH,
            heading_std=MAG_STD,
        ),
    )


def rmse(motion: Truth, t: Array, estimate: Array) -> Array:
    """Return RMSE by column: degrees, m, m/s; NaN where one is not known."""
    rows = np.rint(t / PERIOD).astype(int)
    true = np.concatenate([motion.euler, motion.pos_n * [1.0, 1.0, -1.0], motion.vel_n], axis=1)
    error = estimate - true[rows]
    error[:, :3] = np.degrees(so3.wrap(error[:, :3]))
    return np.asarray(np.sqrt(np.mean(np.square(error[t >= START - 1e-6]), axis=0)))


def rmse_of(motion: Truth, estimates: Table) -> Array:
    """Return the RMSE of our estimates."""
    lat, lon = (np.radians(estimates.column(name)) for name in ("lat_deg", "lon_deg"))
    pos_n = FRAME.to_ned(lat, lon, estimates.column("alt_m")) * STRETCH * [1.0, 1.0, -1.0]
    names = ("roll", "pitch", "yaw", "vel_n", "vel_e", "vel_d")
    columns = [estimates.column(name) for name in names]
    states = np.stack([*columns[:3], *pos_n.T, *columns[3:]], axis=1)
    return rmse(motion, np.asarray(estimates.stamp_ns * 1e-9, dtype=np.float64), states)


def ours(data: Path) -> Array:
    """Return the RMSE of our live estimates of draw 42."""
    motion = truth(data)
    return rmse_of(motion, Pipeline(settings()).run(events(motion, draw_42(data))))


def tables(data: Path) -> Iterator[str]:
    """Yield the RMSE of draw 42."""
    if not is_there(data, FOLDER):
        return iter(())
    motion = truth(data)
    theirs = np.genfromtxt(data / FOLDER / "uavEst.csv", delimiter=",", skip_header=1)[:, 1:10]
    found = {
        "limit": np.array(list(LIMITS.values())),
        "the seed's own filter": rmse(motion, motion.t, theirs),
        "**ours**": ours(data),
        "ours, smoothed": rmse_of(motion, smooth(events(motion, draw_42(data)), settings())),
    }
    return table(
        " | ".join([f"RMSE from {START:.0f} s on", *LIMITS]),
        (" | ".join([name, *(f"{value:.3f}" for value in row)]) for name, row in found.items()),
    )
