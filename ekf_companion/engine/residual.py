"""What is sent less what is estimated: a jump that is kept from a follower.

A jump can be *spread*: what is sent goes on without a step, and comes to the estimate at a speed
that a follower takes for noise. Or it goes into the *offset* of a continuous frame, and stays.
"""

from __future__ import annotations

import math
from struct import Struct
from typing import NamedTuple

import numpy as np

from ekf_companion.engine.step import Pose, Step
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.matrix3 import Matrix3, apply, from_quaternion, multiply_transposed
from ekf_companion.nav.state import Odometry

SPEEDS = (0.5, 1.0, math.radians(5.0))
"""At which what is spread comes to the estimate: m/s, m/s^2, rad/s. A filter that follows within
0.3 s, as EKF2 and EKF3 do at 30 Hz, lags by half a gate at most: see :mod:`.step`."""
_POSITION = slice(0, 3)
_QUATERNION = slice(3, 7)
_VELOCITY = slice(7, 10)
_POSE_COV, _TWIST_COV = 13, 34
_POSE_ROWS, _TWIST_ROWS = slice(13, 28), slice(34, 49)
"""The first three rows of their triangles."""
_MOTION_PLACES = (0, 1, 2, 6, 7, 11)
_MOTION_AXES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Of a triangle, what its first three rows say of one another."""
_POSE_BYTES = slice(52, 136)
"""The pose's covariance."""
_NUMBERS = Struct("<55f")
_DIAGONAL = (0, 6, 11, 15, 18, 20)
"""Of the upper triangle of a 6 x 6 matrix, row by row."""


class Offset(NamedTuple):
    """Where a continuous frame c lies in n: ``pos_n = R(yaw) pos_c + shift``."""

    shift: tuple[float, float, float]
    """n, m."""
    yaw: float
    """About down, rad."""


NO_OFFSET = Offset((0.0, 0.0, 0.0), 0.0)


def about_down(angle: float) -> Array:
    """Return the matrix of a rotation about the axis down, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Residual:
    """What is added to the estimate before it is sent, and the frame in which it is sent."""

    def __init__(self) -> None:
        self.offset = NO_OFFSET
        """Of the frame in which positions are sent."""
        self.clear()

    def clear(self) -> None:
        """Send the estimate as it is, in the same frame."""
        self._pos_n = np.zeros(3)
        self._vel_n = np.zeros(3)
        self._yaw = 0.0
        self.is_any = False
        """Whether something is to come to the estimate yet."""

    def spread(self, step: Step, position: bool, velocity: bool, yaw: bool) -> None:
        """Keep a step from what is sent, in those of its parts that are named."""
        self.is_any |= position or velocity or yaw
        if position:
            self._pos_n = self._pos_n - step.pos_n
        if velocity:
            self._vel_n = self._vel_n - step.vel_n
        if yaw:
            self._yaw = math.remainder(self._yaw - step.yaw, math.tau)

    def move_frame(self, step: Step, pose: Pose) -> None:
        """Put a step of position and yaw into the frame, given the estimate after it."""
        shift, yaw = self.offset
        pos_n = np.array(pose.pos_n)
        pos_c = about_down(-yaw) @ (pos_n - step.pos_n - shift)
        yaw = math.remainder(yaw + step.yaw, math.tau)
        moved = pos_n - about_down(yaw) @ pos_c
        self.offset = Offset((float(moved[0]), float(moved[1]), float(moved[2])), yaw)

    def decay(self, dt: float) -> None:
        """Let what is spread come nearer to the estimate over a time, s."""
        if not self.is_any:
            return
        speeds = [speed * dt for speed in SPEEDS]
        self._pos_n = _shorten(self._pos_n, speeds[0])
        self._vel_n = _shorten(self._vel_n, speeds[1])
        self._yaw = math.copysign(max(abs(self._yaw) - speeds[2], 0.0), self._yaw)
        self.is_any = bool(self._yaw != 0.0 or self._pos_n.any() or self._vel_n.any())

    def apply(self, odometry: Odometry, pose: Pose) -> Odometry:
        """Return what is sent of an estimate: the same bytes where there is nothing to add.

        The variances grow by the square of what is added.
        """
        shift, yaw = self.offset
        if not self.is_any and self.offset == NO_OFFSET:
            return odometry
        numbers = np.frombuffer(odometry.numbers, dtype="<f4").astype(float)
        R_cn = about_down(-yaw)
        turn = so3.exp(np.array([0.0, 0.0, self._yaw - yaw]))
        numbers[_POSITION] = R_cn @ (self._pos_n + pose.pos_n - shift)
        numbers[_QUATERNION] = so3.normalise(so3.multiply(turn, np.array(pose.q_nb)))
        C_cb = so3.to_matrix(numbers[_QUATERNION])
        numbers[_VELOCITY] = C_cb.T @ R_cn @ (self._vel_n + pose.vel_n)
        if yaw != 0.0:
            numbers[_POSE_ROWS] = _turn_rows(numbers[_POSE_ROWS].tolist(), R_cn.tolist())
        _inflate(numbers, _POSE_COV, [*(R_cn @ self._pos_n), 0.0, 0.0, self._yaw])
        _inflate(numbers, _TWIST_COV, C_cb.T @ R_cn @ self._vel_n)
        return odometry._replace(numbers=numbers.astype("<f4").tobytes())


def _shorten(vector: Array, by: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector * (1.0 - by / length) if length > by else np.zeros(3)


def _inflate(numbers: Array, start: int, residual: Array | list[float]) -> None:
    """Add squares to the variances of a covariance that is known."""
    if math.isfinite(numbers[start]):
        for place, value in zip(_DIAGONAL, residual, strict=False):
            numbers[start + place] += value * value


def _turn_rows(rows: list[float], R: Matrix3) -> list[float]:
    """Return the first three rows of a covariance's triangle with their errors turned."""
    xx, xy, xz, *x, yy, yz, y0, y1, y2, zz, z0, z1, z2 = rows
    if not math.isfinite(xx):
        return rows
    turned = multiply_transposed(R, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = multiply_transposed(turned, R)
    cross: Matrix3 = (x, (y0, y1, y2), (z0, z1, z2))
    if any(map(any, cross)):
        cross = multiply_transposed(R, list(zip(*cross, strict=True)))
    return [xx, xy, xz, *cross[0], yy, yz, *cross[1], zz, *cross[2]]


def state_covariance(
    odometry: Odometry, is_relative: bool = False, climb_factor: float = 1.0
) -> Odometry:
    """Return an ODOMETRY with the covariances that its receiver is told.

    ``is_relative`` leaves the slow error of the receiver's position out of the pose's, where that
    is known; ``climb_factor`` multiplies the variance of the velocity down.
    """
    numbers = odometry.numbers
    if is_relative and odometry.relative is not None:
        numbers = numbers[: _POSE_BYTES.start] + odometry.relative + numbers[_POSE_BYTES.stop :]
    if climb_factor != 1.0:
        numbers = _scale_climb(numbers, climb_factor)
    return odometry if numbers is odometry.numbers else odometry._replace(numbers=numbers)


def _scale_climb(numbers: bytes, factor: float) -> bytes:
    """Return the numbers of an ODOMETRY with the variance of the velocity down times a factor.

    The covariance is along the axes of b, of which none points down while the vehicle is tilted:
    what is added to it is along down, so that the velocity over ground stays as exact as it was.
    """
    given = list(_NUMBERS.unpack(numbers))
    if not math.isfinite(given[_TWIST_COV]):
        return numbers
    down_b = from_quaternion(*given[_QUATERNION])[2]
    xx, xy, xz, yy, yz, zz = (given[_TWIST_COV + place] for place in _MOTION_PLACES)
    rows = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    variance = sum(
        a * sum(b * c for b, c in zip(row, down_b, strict=True))
        for a, row in zip(down_b, rows, strict=True)
    )
    for place, (i, j) in zip(_MOTION_PLACES, _MOTION_AXES, strict=True):
        given[_TWIST_COV + place] += (factor - 1.0) * variance * down_b[i] * down_b[j]
    return _NUMBERS.pack(*given)


def scale_errors(odometry: Odometry, factor: float) -> Odometry:
    """Return an ODOMETRY with the covariances of position and velocity times a factor."""
    numbers = np.frombuffer(odometry.numbers, dtype="<f4").astype(float)
    rows, columns = np.triu_indices(6)
    root = math.sqrt(factor)
    for start in (_POSE_COV, _TWIST_COV):
        if math.isfinite(numbers[start]):
            scale = np.where(rows < 3, root, 1.0) * np.where(columns < 3, root, 1.0)
            numbers[start : start + 21] *= scale
    return odometry._replace(numbers=numbers.astype("<f4").tobytes())


def local_velocity(odometry: Odometry) -> Odometry:
    """Return an ODOMETRY with its velocity, and the covariance of that, along the local axes."""
    numbers = list(_NUMBERS.unpack(odometry.numbers))
    C_nb = from_quaternion(*numbers[_QUATERNION])
    numbers[_VELOCITY] = apply(C_nb, numbers[_VELOCITY])
    numbers[_TWIST_ROWS] = _turn_rows(numbers[_TWIST_ROWS], C_nb)
    return odometry._replace(numbers=_NUMBERS.pack(*numbers))


def stds(odometry: Odometry) -> tuple[float, float, float]:
    """Return one sigma of the horizontal position (m), of the velocity (m/s) and of the yaw (rad).

    Infinite where they are not known.
    """
    numbers = _NUMBERS.unpack(odometry.numbers)
    pose, twist = numbers[_POSE_COV:_TWIST_COV], numbers[_TWIST_COV:]
    if not (math.isfinite(pose[0]) and math.isfinite(twist[0])):
        return math.inf, math.inf, math.inf
    velocity = math.sqrt(twist[0] + twist[6] + twist[11])
    return math.sqrt(pose[0] + pose[6]), velocity, math.sqrt(pose[20])


def std_ground_speed(odometry: Odometry) -> float:
    """Return one sigma of the velocity over ground, both axes, m/s; infinite if not known."""
    twist = _NUMBERS.unpack(local_velocity(odometry).numbers)[_TWIST_COV:]
    return math.sqrt(twist[0] + twist[6]) if math.isfinite(twist[0]) else math.inf


def std_attitude(odometry: Odometry) -> float:
    """Return the largest sigma of roll, pitch and yaw, rad; 0 where none is stated."""
    numbers = _NUMBERS.unpack(odometry.numbers)
    angles = [numbers[_POSE_COV + place] for place in (15, 18, 20)]
    return math.sqrt(max(filter(math.isfinite, angles), default=0.0))
