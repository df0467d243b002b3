"""A multirotor that really moves: thrust along its axis, drag, ground under it, and its sensors.

It is told an acceleration and holds the attitude that gives it *by the autopilot's estimate*: what
the estimate is wrong in, the vehicle does in truth. Kinder than the world in one way: the attitude
follows without overshoot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame, earth_rate_n, gravity
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Fix, Motion
from sim_autopilot.quaternion import back, rotated, turned
from sim_autopilot.sensors import earth_field, pressure

_LAG = 0.1
"""Of the attitude behind the one that is asked for, s: assumed."""
_DRAG = 0.1
"""Deceleration by speed through the air, 1/s: assumed, of a small multirotor."""
_FASTEST_TURN = 3.0
"""rad/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cold:
    """A receiver's error after a cold start."""

    error_n: tuple[float, float, float] = (6.0, 0.0, -4.0)
    """Of its first fixes, north, east, down, m."""
    until: float = 15.0
    """Right from so long after the start, s."""
    fade: float = 0.0
    """The error goes away during so many seconds before, s; 0: at once."""

    def at(self, t: float) -> Array:
        """Return the error at a time since the start."""
        left = self.until - t
        share = float(left > 0.0) if not self.fade else min(max(left / self.fade, 0.0), 1.0)
        return share * np.array(self.error_n)


class Vehicle:
    """The true motion."""

    def __init__(self, frame: LocalFrame, wind_n: tuple[float, float, float] = (0, 0, 0)) -> None:
        """Stand at the frame's origin, pointing north; the wind is in m/s."""
        self.frame, self.wind_n = frame, np.array(wind_n, dtype=float)
        self.pos_n, self.vel_n = np.zeros(3), np.zeros(3)
        self.q_nb = np.array([1.0, 0.0, 0.0, 0.0])
        self.rate_b, self.force_b = np.zeros(3), np.zeros(3)
        """Means over the last step: against the stars, rad/s; m/s^2."""
        self._earth_n = earth_rate_n(frame.lat)

    @property
    def is_landed(self) -> bool:
        """Whether it stands on the ground."""
        return bool(self.pos_n[2] >= 0.0)

    def step(self, dt: float, accel_n: Array, yaw: float, q_estimated: Array) -> None:
        """Fly for a time.

        Args:
            dt: The time, s.
            accel_n: What the controller asks for; down beyond gravity: the motors stand.
            yaw: The heading to hold, rad.
            q_estimated: The attitude by the autopilot.
        """
        weight = float(gravity(self.frame.lat, self.frame.alt - float(self.pos_n[2])))
        push_n = np.asarray(accel_n, dtype=float) - np.array([0.0, 0.0, weight])
        thrust = float(np.linalg.norm(push_n)) if push_n[2] < 0.0 else 0.0
        before, was_n = self.q_nb, self.vel_n
        if not (self.is_landed and thrust < weight):
            wrong = so3.multiply(before, so3.conjugate(q_estimated))
            self._turn(dt, so3.multiply(wrong, _attitude(push_n, yaw)))
        drag_n = -_DRAG * (self.vel_n - self.wind_n)
        force_n = rotated(self.q_nb, (0.0, 0.0, -thrust)) + drag_n
        coriolis_n = 2.0 * so3.cross(self._earth_n, was_n)
        gain_n = force_n + np.array([0.0, 0.0, weight]) - coriolis_n
        vel_n = was_n + gain_n * dt
        pos_n = self.pos_n + 0.5 * (was_n + vel_n) * dt
        if pos_n[2] >= 0.0 and vel_n[2] >= 0.0:
            pos_n, vel_n = np.array([*pos_n[:2], 0.0]), np.zeros(3)
            self.q_nb = so3.from_euler(0.0, 0.0, so3.to_euler(self.q_nb)[2])
        self.pos_n, self.vel_n = pos_n, vel_n
        rate_b = so3.log(so3.multiply(back(before), self.q_nb)) / dt
        self.rate_b = rate_b + rotated(back(before), self._earth_n)
        # The means in the middle of the turn: what integrates back to the motion
        middle = turned(before, 0.5 * rate_b * dt)
        felt_n = (vel_n - was_n) / dt - np.array([0.0, 0.0, weight]) + coriolis_n
        self.force_b = rotated(back(middle), felt_n)

    def _turn(self, dt: float, wanted: Array) -> None:
        way = so3.log(so3.multiply(so3.conjugate(self.q_nb), wanted)) * min(1.0, dt / _LAG)
        length = float(np.linalg.norm(way))
        if length > _FASTEST_TURN * dt:
            way = way * (_FASTEST_TURN * dt / length)
        self.q_nb = turned(self.q_nb, way)

    def motion(self) -> Motion:
        """Return the state of now."""
        lat, lon, alt = (float(value) for value in self.frame.to_geodetic(self.pos_n))
        return Motion(
            lat=lat,
            lon=lon,
            alt=alt,
            pos_n=tuple(self.pos_n.tolist()),
            vel_n=tuple(self.vel_n.tolist()),
            q_nb=tuple(self.q_nb.tolist()),
            euler=tuple(so3.to_euler(self.q_nb).tolist()),
            rate_b=tuple(self.rate_b.tolist()),
            accel_b=tuple(self.force_b.tolist()),
        )


def _attitude(push_n: Array, yaw: float) -> Array:
    """Return the attitude whose thrust pushes that way."""
    up = -push_n / np.linalg.norm(push_n)
    forward = np.cos(yaw) * up[0] + np.sin(yaw) * up[1]
    right = -np.sin(yaw) * up[0] + np.cos(yaw) * up[1]
    roll = -np.arcsin(np.clip(right, -1.0, 1.0))
    return so3.from_euler(roll, np.arctan2(forward, up[2]), yaw)


class Senses:
    """The sensors of a vehicle, drawn as it flies: errors as in :class:`SimConfig`."""

    def __init__(self, vehicle: Vehicle, config: SimConfig, seed: int, cold: Cold | None) -> None:
        """Begin to measure; every sensor has a generator of its own."""
        self._vehicle, self._config, self._cold = vehicle, config, cold
        kinds = np.random.SeedSequence(seed, spawn_key=(500,)).spawn(4)
        self._imu, self._gnss, self._mag, self._baro = map(np.random.default_rng, kinds)
        imu, frame = config.imu, vehicle.frame
        self.gyro_bias_b = imu.gyro_bias_start * self._imu.standard_normal(3)
        self.accel_bias_b = imu.accel_bias_start * self._imu.standard_normal(3)
        self.field_n = earth_field(frame.lat, frame.lon, frame.alt, config.compass.year)
        self._past: deque[tuple[float, Array, Array]] = deque(maxlen=64)
        self.receiver_error_n = np.zeros(3)
        """Of its own, beside that of a cold start: to be set by whoever flies it, m."""

    def imu(self, period: float) -> tuple[Array, Array]:
        """Return angular rate and specific force of the last step."""
        white = self._imu.standard_normal((2, 3)) / np.sqrt(period)
        own, config = self._vehicle, self._config.imu
        gyro_b = own.rate_b + self.gyro_bias_b + config.gyro_noise * white[0]
        return gyro_b, own.force_b + self.accel_bias_b + config.accel_noise * white[1]

    def mag(self) -> Array:
        """Return the field, gauss."""
        noise = self._config.compass.noise_heading * float(np.hypot(*self.field_n[:2]))
        back = so3.conjugate(self._vehicle.q_nb)
        return so3.rotate(back, self.field_n) + noise * self._mag.standard_normal(3)

    def baro(self) -> tuple[float, float]:
        """Return pressure, hPa, and altitude, m."""
        own = self._vehicle
        alt = own.frame.alt - float(own.pos_n[2])
        alt += self._config.baro.noise * float(self._baro.standard_normal())
        return float(pressure(alt)), alt

    def remember(self, t: float) -> None:
        """Keep the motion of now: a fix is older than its stamp."""
        self._past.append((t, self._vehicle.pos_n, self._vehicle.vel_n))

    def fix(self, t: float, t_ns: int) -> Fix:
        """Return the fix that arrives at a time since the start."""
        gnss, true_t = self._config.gnss, t - self._config.gnss.delay
        _, pos_n, vel_n = min(self._past, key=lambda one: abs(one[0] - true_t))
        white = self._gnss.standard_normal(6)
        error_n = white[:3] * [gnss.noise_h, gnss.noise_h, gnss.noise_v] + self.receiver_error_n
        if self._cold is not None:
            error_n = error_n + self._cold.at(t)
        lat, lon, alt = self._vehicle.frame.to_geodetic(pos_n + error_n)
        vel_n = vel_n + gnss.noise_vel * white[3:]
        return Fix(t_ns, float(lat), float(lon), float(alt), tuple(vel_n.tolist()), float("nan"))
