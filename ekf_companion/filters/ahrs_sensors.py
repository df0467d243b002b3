"""Gyro, accelerometer and magnetometer as :mod:`~ekf_companion.filters.ahrs` uses them.

The gyro turns a frame i: the body, rotated back by the gyro's integral, which hardly turns itself.
There gravity is the low-pass of the specific force. The velocity of a hand or a vehicle is bounded,
so the accelerations of its motion have no power at low frequencies, while gravity has power there
only. With white velocity, and an attitude error that is a random walk, the filter of least error
between the two is a Butterworth filter of second order. All in plain numbers, component by
component: it runs at every sample.

Source: the frame and the order of the low-pass are those of Laidig, Seel 2023, "VQF", arXiv
2203.17024; the reason is Wiener's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ekf_companion.nav.arrays import Array

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]
Quaternion = tuple[float, float, float, float]

REST_AFTER = 1.5
"""Time without motion after which it is a rest, s."""
REST_MEMORY = 0.5
"""Time constant of the means from which a sample at rest may differ, s."""
PUSH = 0.3
"""Longest acceleration in one direction during a start in motion, s."""
NEAR = 0.1
"""Difference from the reference field, as a share of its strength, that is no disturbance."""
CANDIDATE_MEMORY = 5.0
"""Time constant of the mean of a field that may become the reference, s."""
FIRST = 2.0
"""Time over which the first reference field is averaged, s."""


def rotated(q: Quaternion, wx: float, wy: float, wz: float, dt: float) -> Quaternion:
    """Rotate an attitude of unit norm by a rate in b, rad/s, over a time, s."""
    half = 0.5 * dt * math.sqrt(wx * wx + wy * wy + wz * wz)
    s = 0.5 * dt * (math.sin(half) / half if half > 1e-8 else 1.0)
    c, sx, sy, sz = math.cos(half), s * wx, s * wy, s * wz
    w, x, y, z = q
    w, x, y, z = (
        w * c - x * sx - y * sy - z * sz,
        w * sx + x * c + y * sz - z * sy,
        w * sy - x * sz + y * c + z * sx,
        w * sz + x * sy - y * sx + z * c,
    )
    size = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # one step of Newton to unit norm
    return w * size, x * size, y * size, z * size


def to_rows(q: Quaternion) -> Rows:
    """Return the rows of the direction cosine matrix of a quaternion of unit norm."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


class GyroFrame:
    """The attitude of the body in frame i, and sums over a step."""

    def __init__(self) -> None:
        self.q_ib: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.C_ib = to_rows(self.q_ib)
        self.begin_step()

    def begin_step(self) -> None:
        """Reset the sums."""
        self.elapsed = 0.0
        self.squared_rate = 0.0
        """Integral of the squared rate, rad^2/s."""
        self.integral = [0.0] * 9
        """Integral of C_ib, s, by rows."""
        self.field_sum = [0.0, 0.0, 0.0]
        self.fields = 0

    def rotate(self, gyro: list[float], bias: list[float], dt: float) -> None:
        """Rotate the body by a rate over a time."""
        wx, wy, wz = gyro[0] - bias[0], gyro[1] - bias[1], gyro[2] - bias[2]
        self.q_ib = rotated(self.q_ib, wx, wy, wz, dt)
        self.C_ib = to_rows(self.q_ib)
        self.elapsed += dt
        self.squared_rate += (wx * wx + wy * wy + wz * wz) * dt
        total = self.integral
        for i, row in enumerate(self.C_ib):
            total[3 * i] += row[0] * dt
            total[3 * i + 1] += row[1] * dt
            total[3 * i + 2] += row[2] * dt

    def to_frame(self, v: list[float]) -> Vector:
        """Rotate a vector from b into i."""
        x, y, z = v
        first, second, third = self.C_ib
        return (
            first[0] * x + first[1] * y + first[2] * z,
            second[0] * x + second[1] * y + second[2] * z,
            third[0] * x + third[1] * y + third[2] * z,
        )

    def add_field(self, mag: list[float]) -> None:
        """Add a field in b to the sum."""
        for i, value in enumerate(self.to_frame(mag)):
            self.field_sum[i] += value
        self.fields += 1


class GravityFilter:
    """The low-pass of specific force in frame i, and the uncertainty of its direction."""

    def __init__(self, memory: float, spread_memory: float) -> None:
        """Start without samples; both time constants are in s."""
        self._omega = math.sqrt(2.0) / memory
        self._memory, self._spread_memory = memory, spread_memory
        self.restart()
        self.gravity = 0.0
        """Mean length of the output, m/s^2: gravity by this accelerometer's scale."""
        self._learnt = 0.0

    def restart(self) -> None:
        """Restart after a gap in the samples."""
        self.x = self.y = self.z = 0.0
        self._vx = self._vy = self._vz = 0.0
        self._square = 0.0
        self._variance = 0.0
        self.age = 0.0
        """Time filtered, s."""

    @property
    def is_warm(self) -> bool:
        """Whether it is a low-pass; before that it is the mean since the start."""
        return self.age >= self._memory

    def add(self, fx: float, fy: float, fz: float, dt: float) -> None:
        """Add a specific force in i, m/s^2, over a time, s."""
        if self.age >= self._memory:
            omega = min(self._omega, 0.5 / dt)
            k, d, keep = omega * omega * dt, 1.4142135623730951 * omega * dt, 1.0
            keep /= 1.0 + d
            self._vx = (self._vx + k * (fx - self.x)) * keep
            self._vy = (self._vy + k * (fy - self.y)) * keep
            self._vz = (self._vz + k * (fz - self.z)) * keep
            self.x += self._vx * dt
            self.y += self._vy * dt
            self.z += self._vz * dt
            self.age += dt
            return
        self.age += dt
        share = dt / self.age
        dx, dy, dz = fx - self.x, fy - self.y, fz - self.z
        self.x += share * dx
        self.y += share * dy
        self.z += share * dz
        self._square += share * ((1.0 - share) * (dx * dx + dy * dy + dz * dz) - self._square)

    def sigma(self, dt: float) -> float:
        """Return one sigma of the direction per axis, rad, after a further time, s.

        While it is a mean: that of accelerations as strong as measured, in one direction for
        ``PUSH``, that do not cancel yet. Later: the variation of the length of its output, as
        motion affects all three axes alike.
        """
        length = math.sqrt(self.x * self.x + self.y * self.y + self.z * self.z)
        if self.age < self._memory:
            push = math.sqrt(self._square / 3.0)
            self._variance = (push * min(PUSH / self.age, 1.0) / max(length, 1.0)) ** 2
            self.gravity = length
            return math.sqrt(self._variance)
        self._learnt = min(self._learnt + dt, 4.0 * self._spread_memory)
        stray = length - self.gravity
        self.gravity += dt / (self._learnt + self._memory) * stray
        share = dt / self._spread_memory
        self._variance += share * ((stray / max(self.gravity, 1.0)) ** 2 - self._variance)
        return math.sqrt(self._variance)


class LowPass:
    """The same low-pass for an array, once per step; it starts at zero."""

    def __init__(self, memory: float, shape: tuple[int, ...]) -> None:
        """Start at zero; the time constant is in s."""
        self._omega = math.sqrt(2.0) / memory
        self.value = np.zeros(shape)
        self._speed = np.zeros(shape)

    def add(self, values: Array, dt: float) -> None:
        """Add values over a time, s."""
        omega = min(self._omega, 0.5 / dt)
        self._speed += omega * omega * dt * (values - self.value)
        self._speed /= 1.0 + math.sqrt(2.0) * omega * dt
        self.value += self._speed * dt


class Wander:
    """How far the low-passed specific force moves in frame i, where gravity is constant.

    What moves it is the acceleration of the vehicle, which cannot be distinguished from a tilt: the
    filter follows it, and is wrong by it. The length of the specific force does not show that: a
    level acceleration of a tenth of gravity is a tilt of 6 degrees and changes the length by 0.5 %.
    """

    def __init__(self, memory: float) -> None:
        """Start without samples; the time constant is in s."""
        self._memory = memory
        self.restart()

    def restart(self) -> None:
        """Restart after a gap in the samples."""
        self._age = 0.0
        self._mean = np.zeros(3)
        self._now = 0.0
        self._mean_square = 0.0

    def add(self, down_i: Array, dt: float) -> None:
        """Add a direction, a unit vector in i, over a time, s."""
        self._age += dt
        share = dt / min(self._age, self._memory)
        apart = down_i - self._mean
        self._mean = self._mean + share * apart
        self._now = (1.0 - share) * float(apart @ apart)
        self._mean_square += share * (self._now - self._mean_square)

    @property
    def variance(self) -> float:
        """Return the variance of the tilt about each level axis, rad^2.

        That of the last while or, if a wandering has only begun, of now.
        """
        return 0.5 * max(self._mean_square, self._now)


class RestDetector:
    """Detects rest, and averages the rate over it."""

    def __init__(self, gyro: float, accel: float) -> None:
        """Start in motion; rad/s and m/s^2 are the largest differences from the means at rest."""
        self._gyro2, self._accel2 = gyro * gyro, accel * accel
        self.restart()

    def restart(self) -> None:
        """Restart after a gap in the samples."""
        self.rate: Vector = (0.0, 0.0, 0.0)
        """Mean rate, rad/s, b."""
        self._force: Vector = (0.0, 0.0, 0.0)
        self.seconds = 0.0
        """Time without motion."""
        self._age = 0.0

    @property
    def is_still(self) -> bool:
        """Whether nothing has moved for long enough."""
        return self.seconds >= REST_AFTER

    def add(self, gyro: Sequence[float], accel: Sequence[float], dt: float) -> None:
        """Add a sample over a time, s."""
        self._age += dt
        share = dt / min(self._age, REST_MEMORY + dt)
        rx, ry, rz = self.rate
        dx, dy, dz = gyro[0] - rx, gyro[1] - ry, gyro[2] - rz
        fx, fy, fz = self._force
        ex, ey, ez = accel[0] - fx, accel[1] - fy, accel[2] - fz
        self.rate = (rx + share * dx, ry + share * dy, rz + share * dz)
        self._force = (fx + share * ex, fy + share * ey, fz + share * ez)
        is_quiet = (
            dx * dx + dy * dy + dz * dz < self._gyro2 and ex * ex + ey * ey + ez * ez < self._accel2
        )
        self.seconds = self.seconds + dt if is_quiet else 0.0


class FieldTurn:
    """The bias about the vertical by the magnetic field at rest, wherever that points to.

    The gyro's integral less the field's turn is the bias: a straight line over the time, fitted by
    least squares.
    """

    def __init__(self, q_ni: Array) -> None:
        """Start at the attitude of frame i, which stays for as long as the rest lasts."""
        self.q_ni = q_ni
        self._first: float | None = None
        self._t = self._removed = 0.0
        self._sums = np.zeros((2, 2))
        self._turns = np.zeros(2)
        self._square = 0.0

    def add(self, azimuth: float | None, bias: float, dt: float) -> None:
        """Add the field's azimuth in frame i, rad, at the end of a step, s; None: there was none.

        The bias, rad/s, is the one that was taken from the gyro meanwhile.
        """
        self._t += dt
        self._removed += bias * dt
        if azimuth is None:
            return
        if self._first is None:
            self._first = azimuth
        apart = azimuth - self._first
        y = math.remainder(apart, 2.0 * math.pi) + self._removed
        row = np.array([1.0, self._t])
        self._sums += np.outer(row, row)
        self._turns += y * row
        self._square += y * y

    @property
    def bias(self) -> float:
        """Return the slope of the line, rad/s, once there is one."""
        return float(np.linalg.solve(self._sums, self._turns)[1])

    def std(self, field_turn: float) -> float:
        """Return one sigma of it, by a turn of the field, rad, and the scatter; inf: too short."""
        n = self._sums[0, 0]
        if n < 5.0 or self._t < 1.0:
            return math.inf
        line = np.linalg.solve(self._sums, self._turns)
        scatter = max(self._square - float(line @ self._turns), 0.0) / (n - 2.0)
        spread = self._sums[1, 1] - self._sums[0, 1] ** 2 / n
        return math.sqrt(scatter / spread + (field_turn / self._t) ** 2)


class ReferenceField:
    """The magnetic field of the place, and the uncertainty of the present field's heading.

    The Earth's field at a place has one horizontal and one vertical component. What a disturbance
    adds to these is measurable; what it adds across them turns the heading and is not. A
    disturbance has no preferred direction, so the measurable part bounds the other.
    """

    def __init__(self, memory: float, patience: float) -> None:
        """Start without a reference.

        Both in s: the time constant of reference and disturbance, and the time in motion after
        which another, steady field becomes the reference.
        """
        self._memory, self._patience = memory, patience
        self.horizontal = self.down = 0.0
        """Components of the reference, gauss."""
        self._age = 0.0
        self._square = 0.0
        self._other_horizontal = self._other_down = 0.0
        self._other_for = 0.0

    def judge(
        self, horizontal: float, down: float, dt: float, *, is_still: bool
    ) -> tuple[float, bool]:
        """Return one sigma of the field's heading, rad, and whether the reference is a new one.

        The components of the present field are in gauss, the time since the last one in s. At rest
        the field may be that of this one spot, so the reference does not change.
        """
        self._age += dt
        a, b = horizontal - self.horizontal, down - self.down
        strength = math.hypot(self.horizontal, self.down)
        stray = math.hypot(a, b)
        is_new = False
        if self._age <= FIRST or stray < NEAR * strength:
            share = dt / (min(self._age, FIRST) if self._age <= FIRST else self._memory)
            if self._age <= FIRST or not is_still:
                self.horizontal += share * a
                self.down += share * b
            self._other_for = max(self._other_for - dt, 0.0)
        elif not is_still:
            is_new = self._consider(horizontal, down, dt)
        stray2 = 0.0 if self._age <= FIRST or is_new else stray * stray
        self._square += min(dt / self._memory, 1.0) * (stray2 - self._square)
        across = math.sqrt(0.5 * max(stray2, self._square))
        return across / max(horizontal, 1e-6), is_new

    def _consider(self, horizontal: float, down: float, dt: float) -> bool:
        """Average a different field; return whether it has become the reference."""
        a, b = horizontal - self._other_horizontal, down - self._other_down
        if math.hypot(a, b) > NEAR * math.hypot(horizontal, down):
            self._other_for = max(self._other_for - dt, 0.0)
        else:
            self._other_for += dt
        share = min(dt / CANDIDATE_MEMORY, 1.0)
        self._other_horizontal += share * a
        self._other_down += share * b
        if self._other_for < self._patience:
            return False
        self.horizontal, self.down = self._other_horizontal, self._other_down
        self._other_for = self._square = 0.0
        return True
