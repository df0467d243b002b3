"""What is estimated: one row per inertial sample, and its parts as an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


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
    """Estimated, but one of position, velocity, height or heading goes without its aid, or the
    attitude is being found anew after a gap and not known to 10 degrees (one sigma) yet."""
    DEAD_RECKONING = 5
    """No position or velocity aid for a second or more: the error grows."""
    INVALID = 6
    """The error has passed its limit: not to be used."""


COLUMNS = [
    *("time_us", "lat_deg", "lon_deg", "alt_m"),
    *("pos_n", "pos_e", "pos_d", "vel_n", "vel_e", "vel_d"),
    *("q_w", "q_x", "q_y", "q_z", "roll", "pitch", "yaw"),
    *("gyro_bias_x", "gyro_bias_y", "gyro_bias_z"),
    *("accel_bias_x", "accel_bias_y", "accel_bias_z"),
    *("sd_pos_n", "sd_pos_e", "sd_pos_d", "sd_vel_n", "sd_vel_e", "sd_vel_d"),
    *("sd_roll", "sd_pitch", "sd_yaw", "status", "reset_count"),
]
"""Names of an estimate's numbers, in the order of a CSV row."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Table:
    """Estimates, one per inertial sample."""

    stamp_ns: npt.NDArray[np.int64]
    """The samples' own stamps, shape (n,)."""
    values: Array
    """``COLUMNS`` without the time, shape (n, 33); NaN: not known."""

    def __len__(self) -> int:
        """Give the number of estimates."""
        return len(self.stamp_ns)

    def column(self, name: str) -> Array:
        """Give one column by its name in ``COLUMNS``."""
        return self.values[:, COLUMNS.index(name) - 1]


def join(tables: Sequence[Table]) -> Table:
    """Give tables as one, in their order; at least one."""
    return Table(
        stamp_ns=np.concatenate([table.stamp_ns for table in tables]),
        values=np.concatenate([table.values for table in tables]),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """A motion sampled in time: a truth, or another estimator's answer.

    Position, velocity and attitude have stamps of their own, ascending, on the autopilot's clock;
    a series that the source lacks is empty.
    """

    name: str
    """Where it is from, in words: ``EKF2 (vehicle_local_position)``."""
    pos_t_ns: npt.NDArray[np.int64]
    """Shape (n,)."""
    lat: Array
    """rad, shape (n,)."""
    lon: Array
    """rad, shape (n,)."""
    alt: Array
    """Above mean sea level, m, shape (n,); NaN where not known."""
    vel_t_ns: npt.NDArray[np.int64]
    """Shape (m,)."""
    vel_n: Array
    """North, east, down, m/s, shape (m, 3); NaN where not known."""
    att_t_ns: npt.NDArray[np.int64]
    """Shape (k,)."""
    q_nb: Array
    """Shape (k, 4)."""


class Odometry(NamedTuple):
    """One estimate to be told."""

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
