"""A small filter that fuses our ODOMETRY as the autopilots' own do: how well does one fly on it?

Position, velocity, attitude and the biases of gyro and accelerometer, fifteen errors, at a horizon
in the past; what is given out is carried on to now by the samples since then. What it does with a
message is that of the autopilot it imitates: floors of the noise, gates, resets by the counter and
by time, the shift of the stamp, the least interval. Left out: wind, the magnetic field's states,
the smooth output predictor, several cores. It flies as well on a receiver of its own: the same
filter with the same samples, to compare with.

Sources of the constants, with the parameters' defaults: PX4 1.17, ``ekf2/EKF/common.h``,
``ekf2/params_*.yaml`` and ``EKF/aid_sources/external_vision``; ArduPilot 4.7, ``AP_NavEKF3``
(``AP_NavEKF3.h``, ``_Measurements.cpp``, ``_PosVelFusion.cpp``, ``_MagFusion.cpp``) and
``AP_VisualOdom.cpp``. The numbers are theirs, the code is ours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

ATT, VEL, POS, GYRO_BIAS, ACCEL_BIAS = (slice(k, k + 3) for k in range(0, 15, 3))
_GRAVITY = np.array([0.0, 0.0, 9.80665])
_NEVER = -1e9
_LEAST_VAR = 1e-9
_LOCAL_NED = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What distinguishes one autopilot's filter from another's."""

    name: str
    step: float
    """Interval of prediction and fusion, s (EKF2_PREDICT_US; EKF_TARGET_DT)."""
    horizon: float
    """How far in the past it fuses, s (EKF2_DELAY_MAX; the largest sensor delay of EKF3)."""
    delay: float
    """Taken off the stamp, s (EKF2_EV_DELAY, VISO_DELAY_MS); half a step comes on top."""
    gyro_noise: float = 0.015
    """rad/s in one step (EKF2_GYR_NOISE, EK3_GYRO_P_NSE)."""
    accel_noise: float = 0.35
    """m/s^2 in one step (EKF2_ACC_NOISE, EK3_ACC_P_NSE)."""
    gyro_bias_noise: float = 1e-3
    """rad/s^2 (EKF2_GYR_B_NOISE, EK3_GBIAS_P_NSE)."""
    accel_bias_noise: float
    """m/s^3 (EKF2_ACC_B_NOISE, EK3_ABIAS_P_NSE)."""
    accel_bias_start: float
    """One sigma, m/s^2 (EKF2_ABIAS_INIT; ACCEL_BIAS_LIM_SCALER of EKF3)."""
    accel_bias_limit: float
    """m/s^2 (EKF2_ABL_LIM; ACCEL_BIAS_LIMIT of EKF3)."""
    is_message_trusted: bool
    """The velocity's sigma is the message's, floored (EKF2_EV_NOISE_MD 0); else the parameter's."""
    position_floor: float
    """m (EKF2_EVP_NOISE, VISO_POS_M_NSE)."""
    velocity_floor: float
    """m/s (EKF2_EVV_NOISE, VISO_VEL_M_NSE)."""
    yaw_floor: float
    """rad. EKF2 floors the variance by EKF2_EVA_NOISE itself: the sigma is its root."""
    position_gate: float = 5.0
    """Sigmas (EKF2_EVP_GATE, EK3_POS_I_GATE)."""
    velocity_gate: float
    """Sigmas (EKF2_EVV_GATE, EK3_VEL_I_GATE)."""
    yaw_gate: float
    """Sigmas (EKF2_HDG_GATE, EK3_YAW_I_GATE)."""
    retry: float
    """Without an accepted position for so long it is reset to the next, s (``no_aid_timeout_max``;
    ``posRetryTimeUseVel_ms``)."""
    least_interval: float
    """Between messages, s: what comes sooner is dropped (``extNavIntervalMin_ms``)."""
    longest_interval: float
    """s: after a longer silence fusion ends (twice ``EV_MAX_INTERVAL``)."""
    quality_min: int = 0
    """EKF2_EV_QMIN, VISO_QUAL_MIN; 0: off."""


EKF2 = Tuning(
    name="EKF2",
    step=0.010,
    horizon=0.200,
    delay=0.0,
    accel_bias_noise=0.003,
    accel_bias_start=0.2,
    accel_bias_limit=0.4,
    is_message_trusted=True,
    position_floor=0.1,
    velocity_floor=0.1,
    yaw_floor=0.316,
    velocity_gate=3.0,
    yaw_gate=2.6,
    retry=1.0,
    least_interval=0.0,
    longest_interval=0.4,
)
"""PX4's."""
EKF3 = Tuning(
    name="EKF3",
    step=0.012,
    horizon=0.220,
    delay=0.0,
    accel_bias_noise=0.02,
    accel_bias_start=0.2,
    accel_bias_limit=1.0,
    is_message_trusted=False,
    position_floor=0.2,
    velocity_floor=0.1,
    yaw_floor=0.2,
    velocity_gate=5.0,
    yaw_gate=3.0,
    retry=10.0,
    least_interval=0.020,
    longest_interval=0.5,
)
"""ArduPilot's, with the VISO_DELAY_MS that our documents ask for; its default is 10."""


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
    """What the follower gives out."""

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
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._t: float | None = None
        self._last_message = self._last_stamp = self._accepted = _NEVER
        self._counter: int | None = None
        self._is_fusing = False

    # What comes in

    def sample(self, t: float, gyro: Array, accel: Array) -> None:
        """Take an inertial sample: rad/s and m/s^2, shape (3,), in b."""
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

    def odometry(self, m: Any) -> None:
        """Take an ODOMETRY message, its stamp on the samples' clock."""
        t = m.time_usec * 1e-6
        own = self.tuning
        if t - self._last_stamp < own.least_interval or self._t is None:
            return
        self._last_stamp = t
        at = t - own.delay - 0.5 * own.step
        self._waiting.append((at, lambda: self._fuse_odometry(m, at)))

    def fix(self, t: float, pos_n: Array, vel_n: Array, stds: tuple[float, float, float]) -> None:
        """Take a fix that was true at t: sigmas of the horizontal, the height and the velocity."""
        horizontal, vertical, velocity = stds

        def fuse() -> None:
            own = self.tuning
            floor = np.maximum([velocity, velocity, 1.5 * velocity], 0.3)
            self._fuse_vector(VEL, vel_n - self.vel_n, np.square(floor), 5.0)
            place = np.square(np.maximum([horizontal, horizontal, vertical], [0.5, 0.5, 0.75]))
            self._fuse_vector(POS, pos_n - self.pos_n, place, own.position_gate)

        self._waiting.append((t - 0.5 * self.tuning.step, fuse))

    def heading(self, t: float, yaw: float, std: float) -> None:
        """Take a heading of its own magnetometer, rad from north."""
        self._waiting.append((t, lambda: self._fuse_yaw(yaw, std, self.tuning.yaw_gate)))

    def motion(self) -> Motion:
        """Return the estimate of now."""
        q_nb, vel_n, pos_n = self.q_nb, self.vel_n, self.pos_n
        for one in (*self._steps, self._sum):
            q_nb, vel_n, pos_n = self._carried(q_nb, vel_n, pos_n, one)
        return Motion(t=self._t or 0.0, pos_n=pos_n, vel_n=vel_n, q_nb=q_nb)

    # The horizon moves

    def _level(self, accel: Array) -> None:
        """Begin level, by the first force, pointing north."""
        roll = np.arctan2(-accel[1], -accel[2])
        pitch = np.arctan2(accel[0], np.hypot(accel[1], accel[2]))
        self.q_nb = so3.from_euler(roll, pitch, 0.0)
        self.P[2, 2] = 1.0

    def _carried(
        self, q_nb: Array, vel_n: Array, pos_n: Array, one: _Increment
    ) -> tuple[Array, Array, Array]:
        """Return the motion after one step."""
        gain = so3.rotate(q_nb, one.gain - self.accel_bias * one.dt) + _GRAVITY * one.dt
        turned = so3.multiply(q_nb, so3.exp(one.turn - self.gyro_bias * one.dt))
        return so3.normalise(turned), vel_n + gain, pos_n + (vel_n + 0.5 * gain) * one.dt

    def _advance(self, one: _Increment) -> None:
        """Predict one step, and fuse what was true by then."""
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
        while self._waiting and self._waiting[0][0] <= one.t:
            at, fuse = self._waiting.popleft()
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
        """Return the variances of position and velocity that it takes a message for."""
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
        """Set position, velocity and yaw, and forget how they were correlated."""
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
        """Fuse three components in turn, or refuse them together; return whether they count."""
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
