"""The estimate: one row per inertial sample, a trajectory, an ODOMETRY message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

from ekf_companion.nav.arrays import Array, Stamps


class Status(IntEnum):
    """How far the estimate can be trusted."""

    INIT = 0
    """Waiting for the first inertial samples."""
    ALIGNING = 1
    """Finding down and north."""
    ATTITUDE = 2
    """Roll and pitch are estimated; no position has been known yet."""
    OK = 3
    """Everything is estimated and aided."""
    DEGRADED = 4
    """Estimated, but position, velocity, height or heading lacks its aid or is contradicted by it,
    or the attitude is being found again: after a gap while its sigma is above 10 degrees, and for
    ten seconds after inertial samples that were of no use."""
    DEAD_RECKONING = 5
    """No position or velocity aid for a second or more: the error grows."""
    INVALID = 6
    """The error has passed its limit: do not use the estimate."""

    @property
    def words(self) -> str:
        """The name in words: ``dead reckoning``."""
        return self.name.lower().replace("_", " ")


class Reason(IntFlag):
    """Why an estimate with a position is not called OK: its status is the worst of the reasons."""

    UNCERTAIN = 1 << 0
    """The sigma of the position has passed its limit: INVALID."""
    UNAIDED = 1 << 1
    """No position and no velocity was fused for a second or more: DEAD_RECKONING. All that follow
    make it DEGRADED."""
    GAP = 1 << 2
    """Inertial samples were missing, and fixes have not shown position and attitude again yet."""
    SLOW_SAMPLES = 1 << 3
    """Inertial samples come too rarely for the attitude of a vehicle."""
    UNPROVEN = 1 << 4
    """The attitude, or the autopilot's clock, is new, and fixes have not confirmed it yet."""
    AUTOPILOTS = 1 << 5
    """The position is the autopilot's own estimate, whose errors are correlated in time."""
    POSITION_REFUSED = 1 << 6
    """The receiver's position is refused."""
    POSITION_MISSING = 1 << 7
    """None is fused, and none was refused."""
    VELOCITY_REFUSED = 1 << 8
    """The receiver's velocity is refused."""
    POSITION_OFF = 1 << 9
    """The receiver's positions deviate to one side, each by too little to be refused."""
    SLIDE = 1 << 10
    """The receiver's position drifts away from the integral of its velocity."""
    ATTITUDE = 1 << 11
    """The attitude is not well known."""
    HEADING_REFUSED = 1 << 12
    """The heading in use, of two antennas or of another estimate, is refused."""
    HEADING_MISSING = 1 << 13
    """No such heading is fused, and none was refused."""
    HEIGHT_REFUSED = 1 << 14
    """The receiver's height is refused."""
    HEIGHT_MISSING = 1 << 15
    """None is fused, and none was refused."""
    HEIGHT_OFF = 1 << 16
    """The receiver's heights deviate to one side."""
    CLIMB_HEIGHT = 1 << 17
    """The receiver's height contradicts its vertical velocity and the barometer."""
    CLIMB_VELOCITY = 1 << 18
    """The receiver's vertical velocity contradicts its height and the barometer."""
    CLIMB_BARO = 1 << 19
    """The barometer contradicts the receiver's height and vertical velocity."""
    CLIMB_ANY = 1 << 20
    """Barometer, receiver's height and vertical velocity disagree; none is the odd one out."""
    FALL = 1 << 21
    """The inertial samples contradict the vertical velocity, and no barometer confirms it."""
    COMPASS_REFUSED = 1 << 22
    """The compass, whose heading is in use, is refused."""
    COMPASS_MISSING = 1 << 23
    """No heading of it is fused, and none was refused."""


GEODETIC = ("lat_deg", "lon_deg", "alt_m")
POSITION = ("pos_n", "pos_e", "pos_d")
VELOCITY = ("vel_n", "vel_e", "vel_d")
QUATERNION = ("q_w", "q_x", "q_y", "q_z")
EULER = ("roll", "pitch", "yaw")
GYRO_BIAS = ("gyro_bias_x", "gyro_bias_y", "gyro_bias_z")
ACCEL_BIAS = ("accel_bias_x", "accel_bias_y", "accel_bias_z")
MOTION = (*GEODETIC, *POSITION, *VELOCITY, *QUATERNION, *EULER)
SIGMA = tuple(f"sd_{name}" for name in (*POSITION, *VELOCITY, *EULER))
WIND = ("wind_n", "wind_e")
"""Where the air moves to, m/s; NaN where nothing shows it."""
WIND_SIGMA = ("sd_wind_n", "sd_wind_e")
COLUMNS = ["time_us", *MOTION, *GYRO_BIAS, *ACCEL_BIAS, *SIGMA, *WIND, *WIND_SIGMA]
COLUMNS += ["status", "reset_count", "reasons"]
"""Names of an estimate's numbers, in the order of a CSV row."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Table:
    """Estimates, one per inertial sample."""

    stamp_ns: Stamps
    """The samples' own stamps, shape (n,)."""
    values: Array
    """``COLUMNS`` without the time, shape (n, 38); NaN: not known."""

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def column(self, name: str) -> Array:
        """Return one column by its name in ``COLUMNS``."""
        return self.values[:, COLUMNS.index(name) - 1]

    def columns(self, names: Sequence[str]) -> Array:
        """Return several columns by name, shape (n, k)."""
        return np.stack([self.column(name) for name in names], axis=-1)


def join(tables: Sequence[Table]) -> Table:
    """Join one or more tables in their order."""
    return Table(
        stamp_ns=np.concatenate([table.stamp_ns for table in tables]),
        values=np.concatenate([table.values for table in tables]),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """A motion sampled in time: a truth, or an estimate.

    Position, velocity and attitude have stamps of their own, ascending, on the autopilot's clock;
    a series that the source lacks is empty.
    """

    name: str
    """Its source, in words: ``EKF2 (vehicle_local_position)``."""
    pos_t_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Shape (n,)."""
    lat: Array = field(default_factory=lambda: np.zeros(0))
    """rad, shape (n,)."""
    lon: Array = field(default_factory=lambda: np.zeros(0))
    """rad, shape (n,)."""
    alt: Array = field(default_factory=lambda: np.zeros(0))
    """Above mean sea level, m, shape (n,); NaN where not known."""
    vel_t_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Shape (m,)."""
    vel_n: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """North, east, down, m/s, shape (m, 3); NaN where not known."""
    att_t_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Shape (k,)."""
    q_nb: Array = field(default_factory=lambda: np.zeros((0, 4)))
    """Shape (k, 4)."""

    def __repr__(self) -> str:
        """Return its source, and how much it holds."""
        kinds = ("positions", self.pos_t_ns), ("velocities", self.vel_t_ns)
        counts = [f"{len(one)} {what}" for what, one in (*kinds, ("attitudes", self.att_t_ns))]
        return f"<Trajectory {self.name}: {', '.join(counts)}>"


ODOMETRY_SIZE = 220
"""Bytes of the 55 numbers of ODOMETRY."""


class Odometry(NamedTuple):
    """The numbers of one ODOMETRY message."""

    t_ns: int
    """Time of validity, autopilot clock, ns."""
    numbers: bytes
    """55 floats of 32 bits, in the order of the message ODOMETRY: position, north, east, down of
    the origin (m); quaternion from b to n, of unit norm; velocity in b (m/s); angular rate in b
    without the gyro's bias (rad/s); upper triangle, row by row, of the covariance of position and
    roll, pitch, yaw; the same of velocity in b and the rates. A covariance that begins with NaN is
    not known."""
    reset_count: int
    """Discontinuities so far, >= 0."""
    quality: int
    """-1 failed, 0 not known, 1 to 100 per cent."""
    relative: bytes | None = None
    """21 floats of 32 bits that may replace the first covariance: without the slow error of the
    receiver's position, which is constant for minutes. None: not known."""
    origin: tuple[float, float, float] | None = None
    """Latitude, longitude (rad) and altitude (m) of the origin of the positions; None: not sent."""
