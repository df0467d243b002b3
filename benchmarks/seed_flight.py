"""The seed article's simulated flight: its truth, its draws of sensor noise, and as our events.

400 s of a fixed wing over a flat Earth that does not turn: inertial samples, and a magnetometer
without dip, at 10 Hz, fixes at 1 Hz. Each inertial sample is a reading at its time; the specific
force is made from the central difference of the velocity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3
from ekf_companion.nav.earth import (
    FREE_AIR,
    LocalFrame,
    earth_rate_n,
    gravity,
    transport_rate_n,
)
from ekf_companion.nav.measurements import Events, HeadingSource, Kind, merge
from ekf_companion.nav.state import Table

Array = npt.NDArray[np.float64]

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
"""What the unit vector is scaled to, gauss."""
STRETCH = (1.00256746, 0.99797194)
"""Metres north and east of the truth's positions for each metre that its velocities integrate to
(least squares over the flight; what is left is 0.5 and 10 mm): the positions are a sphere's metres
of degrees that were an ellipsoid's, near 34 degrees of latitude."""
NAMES = ("roll", "pitch", "yaw", "north", "east", "height", "vN", "vE", "vD")


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
    """What the gyro shows but for its errors, rad/s."""

    @cached_property
    def q_nb(self) -> Array:
        """Give the attitude."""
        return so3.from_euler(*self.euler.T)

    @cached_property
    def force_b(self) -> Array:
        """Give what the accelerometer shows but for its errors, m/s^2."""
        accel_n = np.gradient(self.vel_n, PERIOD, axis=0) - [0.0, 0.0, GRAVITY]
        return so3.rotate(so3.conjugate(self.q_nb), accel_n)

    @cached_property
    def field_b(self) -> Array:
        """Give the direction of the field in the body: north, without dip."""
        north = np.broadcast_to([1.0, 0.0, 0.0], self.vel_n.shape)
        return so3.rotate(so3.conjugate(self.q_nb), north)


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """What the sensors said."""

    gyro_b: Array
    accel_b: Array
    mag_b: Array | None
    """Unit vectors; None: the draw has only ``yaw``."""
    yaw: Array
    """Of the magnetometer as if the vehicle were level: atan2(-y, x), rad."""
    fixes: Array
    """North, east, down, m, velocity, m/s, every ``FIX_EVERY`` samples, shape (n, 6)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where on our Earth, which turns and bulges, the flight is put."""

    lat: float = 75.0
    """deg. So far north the Earth turns about the vertical nearly, which a gyro's bias explains,
    and an eastward speed weighs little; still further north the meridians converge too much."""
    turns: bool = False
    """Add to the samples what the Earth's turning would show, by the truth."""
    stretched: bool = True
    """Take the positions back to the metres of the velocities."""

    @property
    def frame(self) -> LocalFrame:
        """Give the frame whose altitudes are such that gravity is the simulation's.

        Of a height h above the seed's sea the altitude is ``frame.alt + h``.
        """
        lat = np.radians(self.lat)
        return LocalFrame(float(lat), 0.15, float((gravity(lat, 160.0) - GRAVITY) / FREE_AIR))

    @property
    def stretch(self) -> Array:
        """Give the seed's metres per metre, north, east, down."""
        return np.array([*STRETCH, 1.0]) if self.stretched else np.ones(3)


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
    return Draw(S[:, 1:4], S[:, 4:7], S[:, 7:10], np.radians(S[:, 10]), fixes)


@cache
def draw_author(data: Path) -> Draw:
    """Read the draw that the seed's author committed: a yaw instead of the vector."""
    S = np.loadtxt(data / FOLDER / "published-cpp" / "UavData_SquareSpiral.txt", delimiter=",")
    fixes = S[::FIX_EVERY, 10:16] * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]
    return Draw(S[:, 1:4], S[:, 4:7], None, np.radians(S[:, 8]), fixes)


def draw(motion: Truth, seed: int) -> Draw:
    """Draw anew by the seed's recipe."""
    rng = np.random.default_rng(seed)
    n = len(motion.t)
    mag_b = motion.field_b + MAG_STD * rng.standard_normal((n, 3))
    mag_b /= np.linalg.norm(mag_b, axis=1, keepdims=True)
    state = np.concatenate([motion.pos_n, motion.vel_n], axis=1)[::FIX_EVERY]
    sigmas = np.repeat([POSITION_STD, VELOCITY_STD], 3)
    return Draw(
        motion.rate_b
        + GYRO_BIAS * rng.standard_normal(3)
        + GYRO_NOISE * rng.standard_normal((n, 3)),
        motion.force_b
        + ACCEL_BIAS * rng.standard_normal(3)
        + ACCEL_NOISE * rng.standard_normal((n, 3)),
        mag_b,
        np.arctan2(-mag_b[:, 1], mag_b[:, 0]),
        state + sigmas * rng.standard_normal(state.shape),
    )


def estimate_of_seed(data: Path) -> Array:
    """Read what the seed's own filter made of draw 42, columns as ``NAMES``, SI and radians."""
    E = np.genfromtxt(data / FOLDER / "uavEst.csv", delimiter=",", skip_header=1)
    return np.asarray(E[:, 1:10])


def estimate_of_author(data: Path) -> Array:
    """Read what the author's C++ filter made of the author's draw."""
    path = data / FOLDER / "published-cpp" / "EstInsGpsEulerDirectEKF.txt"
    return np.asarray(np.loadtxt(path, delimiter=",")[:, 1:10])


def events(motion: Truth, drawn: Draw, place: Place) -> Events:
    """Give a draw as our pipeline takes it."""
    t_ns = np.rint(motion.t * 1e9).astype(np.int64)
    gyro_b, accel_b = drawn.gyro_b, drawn.accel_b
    if place.turns:
        gyro_b, accel_b = _on_turning_earth(motion, gyro_b, accel_b, place)
    pos_n = drawn.fixes[:, :3] / place.stretch
    lat, lon, alt = place.frame.to_geodetic(pos_n)
    each = np.full(len(pos_n), 1.0)
    nothing = 0.0 * each
    tables = [
        Events.from_columns(
            t_ns[::FIX_EVERY],
            Kind.GNSS,
            *(lat, lon, alt, *drawn.fixes[:, 3:].T),
            *(POSITION_STD * each, POSITION_STD * each, VELOCITY_STD * each),
            # declination, flags, dip, strength: the simulation's field, not the Earth's
            *(nothing, nothing, nothing, STRENGTH * each),
        ),
        Events.from_columns(t_ns, Kind.IMU, *gyro_b.T, *accel_b.T),
    ]
    if drawn.mag_b is not None:
        tables.append(Events.from_columns(t_ns, Kind.MAG, *(STRENGTH * drawn.mag_b).T))
    else:
        std, source = np.full(len(t_ns), MAG_STD), float(HeadingSource.MAGNETOMETER)
        yaw = so3.wrap(drawn.yaw)
        tables.append(Events.from_columns(t_ns, Kind.HEADING, yaw, std, np.full(len(t_ns), source)))
    return merge(*tables)


def _on_turning_earth(
    motion: Truth, gyro_b: Array, accel_b: Array, place: Place
) -> tuple[Array, Array]:
    """Add the Earth's and the transport rate, and Coriolis, to the samples."""
    frame = place.frame
    lat, _, alt = frame.to_geodetic(motion.pos_n / place.stretch)
    earth_n, transport_n = earth_rate_n(lat), transport_rate_n(lat, alt, motion.vel_n)
    back = so3.conjugate(motion.q_nb)
    coriolis_n = np.cross(2.0 * earth_n + transport_n, motion.vel_n)
    return gyro_b + so3.rotate(back, earth_n + transport_n), accel_b + so3.rotate(back, coriolis_n)


def states(table: Table, place: Place) -> Array:
    """Give our estimates as the seed's are, columns as ``NAMES``; shape (n, 9)."""
    lat, lon = np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg"))
    pos_n = place.frame.to_ned(lat, lon, table.column("alt_m")) * place.stretch
    names = ("roll", "pitch", "yaw", "vel_n", "vel_e", "vel_d")
    columns = [table.column(name) for name in names]
    return np.stack([*columns[:3], pos_n[:, 0], pos_n[:, 1], -pos_n[:, 2], *columns[3:]], axis=1)


def rmse(motion: Truth, t: Array, estimate: Array, start: float = 20.0) -> Array:
    """Give RMSE from a time (s) on by ``NAMES``: degrees, m, m/s; NaN where one is not known."""
    rows = np.rint(t / PERIOD).astype(int)
    true = np.concatenate([motion.euler, motion.pos_n * [1.0, 1.0, -1.0], motion.vel_n], axis=1)
    error = estimate - true[rows]
    error[:, :3] = np.degrees(so3.wrap(error[:, :3]))
    return np.asarray(np.sqrt(np.mean(np.square(error[t >= start - 1e-6]), axis=0)))
