"""The state of the odometry, and its error state.

World w: the body at the first pose. Body b: forward, left, up. Error state: attitude (rotation
vector in b), position (w), velocity (w), gyro bias, accelerometer bias, direction of gravity (two
angles), mounting of the lidar (rotation vector in its frame, position in b), delay, rate beyond the
gyro's range; then six each, attitude and position, of the anchors that the map is tied to.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_minus, direction_plus

ATT, POS, VEL = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS, DOWN = slice(9, 12), slice(12, 15), slice(15, 17)
MOUNT_ATT, MOUNT_POS, DELAY = slice(17, 20), slice(20, 23), 23
CALIBRATION = slice(17, 24)
EXCESS = slice(24, 27)
N = 27
POSE = 6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class State:
    """Nominal state at the end of a scan."""

    C_wb: Array = field(default_factory=lambda: np.eye(3))
    pos_w: Array = field(default_factory=lambda: np.zeros(3))
    """m."""
    vel_w: Array = field(default_factory=lambda: np.zeros(3))
    """m/s."""
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    """rad/s."""
    accel_bias: Array = field(default_factory=lambda: np.zeros(3))
    """m/s^2."""
    down_w: Array = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Unit vector."""
    C_bl: Array = field(default_factory=lambda: np.eye(3))
    """Lidar to body."""
    pos_b: Array = field(default_factory=lambda: np.zeros(3))
    """Of the lidar, m."""
    delay: float = 0.0
    """Of the inertial stamps relative to the lidar's, s."""
    excess: Array = field(default_factory=lambda: np.zeros(3))
    """Rate beyond the range of the gyro in this part of a scan, negative, rad/s."""

    def plus(self, dx: Array) -> State:
        """Add an error state, shape (27,) or longer."""
        return State(
            C_wb=self.C_wb @ exp(dx[ATT]),
            pos_w=self.pos_w + dx[POS],
            vel_w=self.vel_w + dx[VEL],
            gyro_bias=self.gyro_bias + dx[GYRO_BIAS],
            accel_bias=self.accel_bias + dx[ACCEL_BIAS],
            down_w=direction_plus(self.down_w, dx[DOWN]),
            C_bl=self.C_bl @ exp(dx[MOUNT_ATT]),
            pos_b=self.pos_b + dx[MOUNT_POS],
            delay=self.delay + float(dx[DELAY]),
            excess=self.excess + dx[EXCESS],
        )

    def minus(self, other: State) -> Array:
        """Return the error state from the other to this state, shape (27,)."""
        return np.concatenate(
            [
                log(other.C_wb.T @ self.C_wb),
                self.pos_w - other.pos_w,
                self.vel_w - other.vel_w,
                self.gyro_bias - other.gyro_bias,
                self.accel_bias - other.accel_bias,
                direction_minus(self.down_w, other.down_w),
                log(other.C_bl.T @ self.C_bl),
                self.pos_b - other.pos_b,
                [self.delay - other.delay],
                self.excess - other.excess,
            ]
        )

    def moved(self, C_wb: Array, pos_w: Array, vel_w: Array) -> State:
        """Return the state with another pose and velocity."""
        return replace(self, C_wb=C_wb, pos_w=pos_w, vel_w=vel_w)


def exp(phi: Array) -> Array:
    """Return the matrices of rotation vectors, rad, shape (..., 3, 3)."""
    return so3.to_matrix(so3.exp(phi))


def log(C: Array) -> Array:
    """Return the rotation vector of a matrix, rad, shape (3,); up to half a turn."""
    return so3.log(so3.from_matrix(C))
