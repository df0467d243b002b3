"""The same estimation problem as a textbook would write it in NumPy: 15 error states, all dense.

The compiled filter is timed against it. It begins at the truth, and has no gates, no late
measurements and no resets.

Source: Groves 2013, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
Systems", ch. 14, with the attitude error in n.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.core.settings.settings import ImuSettings
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame, gravity
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.so3 import skew
from sim_autopilot.truth import Truth

ATT, VEL, POS, BG, BA = (slice(i, i + 3) for i in range(0, 15, 3))


class Reference:
    """State, covariance, and the two steps."""

    def __init__(self, frame: LocalFrame, t_ns: int, truth: Truth) -> None:
        """Begin at the truth."""
        self.t_ns = t_ns
        self.pos_n, self.vel_n = truth.pos_n[0].copy(), truth.vel_n[0].copy()
        self.C_nb = np.asarray(so3.to_matrix(truth.q_nb[0]))
        self.bias_g, self.bias_a = np.zeros(3), np.zeros(3)
        self.P = np.diag(np.repeat([0.02, 0.1, 1.0, 0.02, 0.2], 3) ** 2)
        self._frame = frame
        self._gravity_n = np.array([0.0, 0.0, float(gravity(frame.lat, frame.alt))])
        noise = ImuSettings()
        densities = (
            noise.gyro_noise,
            noise.accel_noise,
            0.0,
            noise.gyro_bias_walk,
            noise.accel_bias_walk,
        )
        self._Q = np.diag(np.repeat(densities, 3) ** 2)

    def run(self, events: Events) -> Array:
        """Run events in order of time; return the position after each inertial sample, (n, 3)."""
        track = []
        rows = zip(events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True)
        for t_ns, kind, values in rows:
            if kind == Kind.IMU:
                self._predict((t_ns - self.t_ns) * 1e-9, values[:3], values[3:6])
                self.t_ns = t_ns
                track.append(self.pos_n)
            elif kind == Kind.GNSS:
                self._fix(values)
            elif kind == Kind.HEADING:
                self._heading(float(values[0]), float(values[1]))
        return np.array(track).reshape(-1, 3)

    def _predict(self, dt: float, gyro_b: Array, accel_b: Array) -> None:
        turn = _rotation((gyro_b - self.bias_g) * dt)
        force_n = self.C_nb @ (accel_b - self.bias_a)
        accel_n = force_n + self._gravity_n

        F = np.zeros((15, 15))
        F[ATT, BG] = -self.C_nb
        F[VEL, ATT] = -skew(force_n)
        F[VEL, BA] = -self.C_nb
        F[POS, VEL] = np.eye(3)
        Phi = np.eye(15) + F * dt
        self.P = Phi @ self.P @ Phi.T + self._Q * dt

        self.pos_n = self.pos_n + self.vel_n * dt + 0.5 * accel_n * dt * dt
        self.vel_n = self.vel_n + accel_n * dt
        self.C_nb = self.C_nb @ turn

    def _fix(self, values: Array) -> None:
        lat, lon, alt = values[:3]
        H = np.zeros((6, 15))
        H[:3, POS] = H[3:, VEL] = np.eye(3)
        measured = np.concatenate((self._frame.to_ned(lat, lon, alt), values[3:6]))
        z = measured - np.concatenate((self.pos_n, self.vel_n))
        std_h, std_v, std_vel = values[6:9]
        self._correct(z, H, np.diag([std_h, std_h, std_v, std_vel, std_vel, std_vel]) ** 2)

    def _heading(self, heading: float, std: float) -> None:
        yaw = np.arctan2(self.C_nb[1, 0], self.C_nb[0, 0])
        H = np.zeros((1, 15))
        # The heading turns with the rotation about down, and with tilt times the nose's slope
        slope = self.C_nb[2, 0] / np.hypot(self.C_nb[0, 0], self.C_nb[1, 0])
        H[0, ATT] = [-np.cos(yaw) * slope, -np.sin(yaw) * slope, 1.0]
        z = np.atleast_1d(so3.wrap(np.asarray(heading - yaw)))
        self._correct(z, H, np.array([[std * std]]))

    def _correct(self, z: Array, H: Array, R: Array) -> None:
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        dx = K @ z
        A = np.eye(15) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T
        self.C_nb = _rotation(dx[ATT]) @ self.C_nb
        self.vel_n, self.pos_n = self.vel_n + dx[VEL], self.pos_n + dx[POS]
        self.bias_g, self.bias_a = self.bias_g + dx[BG], self.bias_a + dx[BA]


def _rotation(phi: Array) -> Array:
    """Return the matrix of a rotation vector by Rodrigues' formula, shape (3, 3)."""
    angle = float(np.linalg.norm(phi))
    if angle < 1e-9:
        return np.eye(3) + skew(phi)
    X = skew(phi / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * X + (1.0 - np.cos(angle)) * (X @ X))
