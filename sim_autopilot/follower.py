"""A small filter that fuses our ODOMETRY as the autopilots' filters do, to see how well it flies.

Position, velocity, attitude and the biases of gyro and accelerometer, fifteen errors, at a delayed
time horizon; the output is predicted to the present by the samples since then. A message is treated
as by the autopilot that is imitated: lower bounds of the noise, gates, resets by the counter and by
time, the shift of the stamp, the least interval. Left out: wind, the magnetic field's states, the
smooth output predictor, several cores. For comparison it also flies on a receiver of its own, with
the same samples.

:mod:`sim_autopilot.ekf3` and :mod:`sim_autopilot.ekf2` add geographic positions, a barometer and
the switch between sources. The numbers of both are in :mod:`sim_autopilot.tuning`; they are the
autopilots', the code is ours.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.quaternion import rotated, turned
from sim_autopilot.tuning import EKF2, EKF3, Tuning

__all__ = ["EKF2", "EKF3", "Follower", "Motion", "Tuning"]

ATT, VEL, POS, GYRO_BIAS, ACCEL_BIAS = (slice(k, k + 3) for k in range(0, 15, 3))
_GRAVITY = np.array([0.0, 0.0, 9.80665])
NEVER = -1e9
"""s."""
_LEAST_VAR = 1e-9
_LOCAL_NED = 1


@dataclass(slots=True)
class _Increment:
    """Inertial samples of one step, summed."""

    t: float
    """Their end, s."""
    dt: float
    turn: Array
    """rad, shape (3,), in b."""
    gain: Array
    """m/s, shape (3,), in b."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Motion:
    """Output of the follower."""

    t: float
    """s."""
    pos_n: Array
    vel_n: Array
    q_nb: Array


class Follower:
    """One filter, on ODOMETRY or on a receiver of its own."""

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning
        self.q_nb = np.array([1.0, 0.0, 0.0, 0.0])
        self.vel_n, self.pos_n = np.zeros(3), np.zeros(3)
        self.gyro_bias, self.accel_bias = np.zeros(3), np.zeros(3)
        start = (0.1, 0.5, 1.0, 0.02, tuning.accel_bias_start)
        self.P: Array = np.diag(np.repeat(np.square(start), 3))
        self.events: list[tuple[float, str]] = []
        """Resets and ends of fusion, each with its time, s."""
        self.rejected = 0
        """Measurements beyond their gate."""
        self.is_aligned = False
        self.worst_bias = 0.0
        """Largest accelerometer bias so far, m/s^2."""
        self._sum = _Increment(0.0, 0.0, np.zeros(3), np.zeros(3))
        self._steps: deque[_Increment] = deque()
        self._waiting: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._t: float | None = None
        self._horizon_t = NEVER
        self._last_message = self._last_stamp = self._accepted = NEVER
        self._counter: int | None = None
        self._is_fusing = False

    # What comes in

    def sample(self, t: float, gyro: Array, accel: Array) -> None:
        """Process an inertial sample: rad/s and m/s^2, shape (3,), in b."""
        if self._t is not None:
            dt = t - self._t
            one = self._sum
            one.t, one.dt = t, one.dt + dt
            one.turn = one.turn + gyro * dt
            one.gain = one.gain + accel * dt
            if one.dt >= self.tuning.step - 1e-6:
                self._steps.append(one)
                self._sum = _Increment(t, 0.0, np.zeros(3), np.zeros(3))
        else:
            self._level(accel)
        self._t = t
        while self._steps and self._steps[0].t < t - self.tuning.horizon:
            self._advance(self._steps.popleft())

    def odometry(self, m: Any, stamp: float | None = None) -> None:
        """Fuse an ODOMETRY message by its stamp on the samples' clock, or by the given one, s."""
        t = m.time_usec * 1e-6 if stamp is None else stamp
        own = self.tuning
        if t - self._last_stamp < own.least_interval or self._t is None:
            return
        self._last_stamp = t
        at = t - own.delay - 0.5 * own.step
        self._later(at, lambda: self._fuse_odometry(m, at))

    def fix(self, t: float, pos_n: Array, vel_n: Array, stds: tuple[float, float, float]) -> None:
        """Fuse a fix that was true at t: sigmas of the horizontal, the height and the velocity."""
        horizontal, vertical, velocity = stds

        def fuse() -> None:
            own = self.tuning
            floor = np.maximum([velocity, velocity, 1.5 * velocity], 0.3)
            self._fuse_vector(VEL, vel_n - self.vel_n, np.square(floor), 5.0)
            place = np.square(np.maximum([horizontal, horizontal, vertical], [0.5, 0.5, 0.75]))
            self._fuse_vector(POS, pos_n - self.pos_n, place, own.position_gate)

        self._later(t - 0.5 * self.tuning.step, fuse)

    def heading(self, t: float, yaw: float, std: float) -> None:
        """Fuse a heading of its own magnetometer, rad from north."""
        self._later(t, lambda: self._fuse_yaw(yaw, std, self.tuning.yaw_gate))

    def motion(self) -> Motion:
        """Return the present estimate."""
        q_nb, vel_n, pos_n = self.q_nb, self.vel_n, self.pos_n
        for one in (*self._steps, self._sum):
            q_nb, vel_n, pos_n = self._carried(q_nb, vel_n, pos_n, one)
        return Motion(t=self._t or 0.0, pos_n=pos_n, vel_n=vel_n, q_nb=q_nb)

    # The horizon moves

    def _later(self, at: float, fuse: Callable[[], None]) -> None:
        """Fuse a measurement as soon as the horizon has reached its time."""
        self._count += 1
        heapq.heappush(self._waiting, (at, self._count, fuse))

    def _level(self, accel: Array) -> None:
        """Begin level by the first specific force, with heading north."""
        roll = np.arctan2(-accel[1], -accel[2])
        pitch = np.arctan2(accel[0], np.hypot(accel[1], accel[2]))
        self.q_nb = so3.from_euler(roll, pitch, 0.0)
        self.P[2, 2] = 1.0

    def _carried(
        self, q_nb: Array, vel_n: Array, pos_n: Array, one: _Increment
    ) -> tuple[Array, Array, Array]:
        """Return the motion after one step."""
        gain = rotated(q_nb, one.gain - self.accel_bias * one.dt) + _GRAVITY * one.dt
        q_nb = turned(q_nb, one.turn - self.gyro_bias * one.dt)
        return q_nb, vel_n + gain, pos_n + (vel_n + 0.5 * gain) * one.dt

    def _advance(self, one: _Increment) -> None:
        """Predict one step, and fuse the measurements that were true by then."""
        own, dt = self.tuning, one.dt
        C = so3.to_matrix(self.q_nb)
        force = C @ (one.gain - self.accel_bias * dt)
        self.q_nb, self.vel_n, self.pos_n = self._carried(self.q_nb, self.vel_n, self.pos_n, one)
        F = np.eye(15)
        F[ATT, GYRO_BIAS] = -C * dt
        F[VEL, ATT] = -so3.skew(force)
        F[VEL, ACCEL_BIAS] = -C * dt
        F[POS, VEL] = np.eye(3) * dt
        noise = (own.gyro_noise * dt, own.accel_noise * dt, 0.0)
        walk = (own.gyro_bias_noise * dt, own.accel_bias_noise * dt)
        self.P = F @ self.P @ F.T + np.diag(np.repeat(np.square((*noise, *walk)), 3))
        self._horizon_t = one.t
        while self._waiting and self._waiting[0][0] <= one.t:
            at, _, fuse = heapq.heappop(self._waiting)
            if one.t - at < 0.1:
                fuse()
        if self._is_fusing and one.t - self._last_message > own.longest_interval:
            self._is_fusing = False
            self.events.append((one.t, "the stream has ended"))
        limit = own.accel_bias_limit
        self.accel_bias = np.clip(self.accel_bias, -limit, limit)
        self.worst_bias = max(self.worst_bias, float(abs(self.accel_bias).max()))

    # Fusion

    def _fuse_odometry(self, m: Any, at: float) -> None:
        own = self.tuning
        self._last_message = at
        if own.quality_min > 0 and m.quality < own.quality_min:
            return
        pos_n = np.array([m.x, m.y, m.z], dtype=float)
        q_nb = np.array(m.q, dtype=float)
        vel_b = np.array([m.vx, m.vy, m.vz], dtype=float)
        c = m.pose_covariance
        place, speed = self._variances(m)
        yaw = float(so3.to_euler(q_nb)[2])
        # Of the body's axes EKF2 turns the velocity by its own attitude, ArduPilot by the message's
        is_local = m.child_frame_id == _LOCAL_NED
        vel_n = vel_b if is_local else so3.rotate(q_nb, vel_b)
        is_turned = own.is_message_trusted and not is_local
        velocity = so3.rotate(self.q_nb, vel_b) if is_turned else vel_n
        is_moved = self._counter is not None and m.reset_counter != self._counter
        self._counter = m.reset_counter
        if is_moved or not self._is_fusing or at - self._accepted > own.retry:
            if self._is_fusing:
                self.events.append((at, "reset by the counter" if is_moved else "reset by time"))
            self._reset(pos_n, place, vel_n, speed, yaw)
            self._is_fusing, self._accepted = True, at
            return
        yaw_std = max(own.yaw_floor, float(np.sqrt(c[20])) if c[20] > 0.0 else 0.0)
        self._fuse_yaw(yaw, yaw_std, own.yaw_gate)
        turning = so3.skew(velocity) if is_turned else None
        self._fuse_vector(VEL, velocity - self.vel_n, speed, own.velocity_gate, turning)
        if self._fuse_vector(POS, pos_n - self.pos_n, place, own.position_gate):
            self._accepted = at

    def _variances(self, m: Any) -> tuple[Array, Array]:
        """Return the variances that it assumes for a message's position and velocity."""
        own, c, v = self.tuning, m.pose_covariance, m.velocity_covariance
        if own.is_message_trusted:
            stated = np.nan_to_num([c[0], c[6], c[11]]), np.nan_to_num([v[0], v[6], v[11]])
            return (
                np.maximum(stated[0], own.position_floor**2),
                np.maximum(stated[1], own.velocity_floor**2),
            )
        # A cube root of squared variances: neither a variance nor a deviation
        std = 0.0 if np.isnan(c[0]) else (c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1.0 / 3.0)
        std = min(max(std, own.position_floor), 100.0)
        return np.full(3, std**2), np.full(3, own.velocity_floor**2)

    def _reset(self, pos_n: Array, place: Array, vel_n: Array, speed: Array, yaw: float) -> None:
        """Set position, velocity and yaw, and their correlations to zero."""
        self.pos_n, self.vel_n = pos_n, vel_n
        roll, pitch, _ = so3.to_euler(self.q_nb)
        self.q_nb = so3.from_euler(roll, pitch, yaw)
        for rows, variance in ((POS, place), (VEL, speed)):
            self.P[rows, :] = 0.0
            self.P[:, rows] = 0.0
            self.P[rows, rows] = np.diag(variance)
        self.P[2, :] = 0.0
        self.P[:, 2] = 0.0
        self.P[2, 2] = self.tuning.yaw_floor**2
        self.is_aligned = True

    def _fuse_vector(
        self, rows: slice, z: Array, R: Array, gate: float, turning: Array | None = None
    ) -> bool:
        """Fuse three components in turn, or refuse them together; return whether fused."""
        H = np.zeros((3, 15))
        H[:, rows] = np.eye(3)
        if turning is not None:
            H[:, ATT] = turning
        variance = np.einsum("ij,jk,ik->i", H, self.P, H) + R
        if (np.square(z) > gate**2 * variance).any():
            self.rejected += 1
            return False
        for k in range(3):
            self._fuse_row(z[k], H[k], R[k])
            z = z - H @ self._dx
        return True

    def _fuse_yaw(self, yaw: float, std: float, gate: float) -> None:
        if not self.is_aligned:
            roll, pitch, _ = so3.to_euler(self.q_nb)
            self.q_nb = so3.from_euler(roll, pitch, yaw)
            self.P[2, 2] = std**2
            self.is_aligned = True
            return
        _, pitch, own = so3.to_euler(self.q_nb)
        H = np.zeros(15)
        H[:3] = np.cos(own) * np.tan(pitch), np.sin(own) * np.tan(pitch), 1.0
        z = float(so3.wrap(yaw - own))
        if z * z <= gate**2 * (H @ self.P @ H + std**2):
            self._fuse_row(z, H, std**2)
        else:
            self.rejected += 1

    def _fuse_row(self, z: float, H: Array, R: float) -> None:
        """Fuse one number."""
        PHt = self.P @ H
        K = PHt / (H @ PHt + R)
        self.P = self.P - np.outer(K, PHt)
        self.P[np.diag_indices(15)] = np.maximum(np.diagonal(self.P), _LEAST_VAR)
        self._dx = dx = K * z
        self.q_nb = so3.normalise(so3.multiply(so3.exp(dx[ATT]), self.q_nb))
        self.vel_n = self.vel_n + dx[VEL]
        self.pos_n = self.pos_n + dx[POS]
        self.gyro_bias = self.gyro_bias + dx[GYRO_BIAS]
        self.accel_bias = self.accel_bias + dx[ACCEL_BIAS]
