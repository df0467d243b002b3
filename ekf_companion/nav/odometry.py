"""What is told to others of the estimate: position, velocity, attitude, and how well known."""

from __future__ import annotations

from typing import NamedTuple


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
