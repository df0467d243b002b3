"""Down, from specific force low-passed in a frame that hardly turns; and whether it stands still.

A hand or a vehicle cannot go on accelerating: its velocity is bounded, so the accelerations of
its motion have no power at low frequencies, while gravity has no other where the frame does not
turn. With a velocity of white noise and an attitude that drifts as a random walk, the filter of
least error between the two is a Butterworth one of second order. Source: the frame and the order
are those of Laidig, Seel 2023, "VQF", arXiv 2203.17024; the reason is Wiener's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

REST_AFTER = 1.5
"""So long without motion before it is a rest, s."""
REST_MEMORY = 0.5
"""Time constant of the means from which a sample at rest may differ, s."""
PUSH = 0.3
"""Longest push in one direction that a start in motion reckons with, s."""


class Plumb:
    """Gravity in a frame that hardly turns."""

    def __init__(self, memory: float, spread_memory: float) -> None:
        """Begin with nothing.

        Args:
            memory: Time constant of the low-pass, s.
            spread_memory: Of what is thought of its output, s.
        """
        self._omega = math.sqrt(2.0) / memory
        self._memory, self._spread_memory = memory, spread_memory
        self.restart()
        self.gravity = 0.0
        """What the accelerometer calls gravity, m/s^2: slowly learnt, for its scale is not ours."""
        self._learnt = 0.0

    def restart(self) -> None:
        """Forget what was low-passed: samples were lost."""
        self.x = self.y = self.z = 0.0
        self._vx = self._vy = self._vz = 0.0
        self._square = 0.0
        self._variance = 0.0
        self.age = 0.0
        """How long it has been fed, s."""

    @property
    def is_warm(self) -> bool:
        """Whether it has taken in enough to be more than a mean."""
        return self.age >= self._memory

    def add(self, fx: float, fy: float, fz: float, dt: float) -> None:
        """Take a specific force in the frame that hardly turns, m/s^2, over a time, s."""
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

    def spread(self, dt: float) -> float:
        """Return one sigma of the direction per axis, rad, after a further time, s.

        While it is a mean: that of pushes of ``PUSH``, as strong as seen, that do not yet cancel.
        Later: what the length of its output strays, which motion does to all three axes alike.
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


class Lag:
    """The same low-pass, of an array, once per step; it begins at zero."""

    def __init__(self, memory: float, shape: tuple[int, ...]) -> None:
        """Begin with zeros.

        Args:
            memory: Time constant, s.
            shape: Of the array.
        """
        self._omega = math.sqrt(2.0) / memory
        self.value = np.zeros(shape)
        self._speed = np.zeros(shape)

    def add(self, values: Array, dt: float) -> None:
        """Take values over a time, s."""
        omega = min(self._omega, 0.5 / dt)
        self._speed += omega * omega * dt * (values - self.value)
        self._speed /= 1.0 + math.sqrt(2.0) * omega * dt
        self.value += self._speed * dt


class Rest:
    """Whether the sensor stands still."""

    def __init__(self, gyro: float, accel: float) -> None:
        """Begin in motion.

        Args:
            gyro: Largest difference of a rate from the mean at rest, rad/s.
            accel: Likewise of the specific force, m/s^2.
        """
        self._gyro2, self._accel2 = gyro * gyro, accel * accel
        self.restart()

    def restart(self) -> None:
        """Forget: samples were lost."""
        self.rate: Vector = (0.0, 0.0, 0.0)
        """Mean rate, rad/s, b."""
        self._force: Vector = (0.0, 0.0, 0.0)
        self.seconds = 0.0
        """For how long nothing has moved."""
        self._age = 0.0

    @property
    def is_still(self) -> bool:
        """Whether nothing has moved for long enough."""
        return self.seconds >= REST_AFTER

    def add(self, gyro: Sequence[float], accel: Sequence[float], dt: float) -> None:
        """Take a sample over a time, s."""
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
