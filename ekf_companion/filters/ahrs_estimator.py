"""The six states of :mod:`~ekf_companion.filters.ahrs`, predicted and corrected step by step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.compass import Compass
from ekf_companion.filters.gyroframe import Strapdown
from ekf_companion.filters.plumb import REST_MEMORY, Lag, Plumb, Rest
from ekf_companion.filters.readings import Readings, known_rows
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

GAP = 0.25
"""Samples so far apart have lost the motion between them, s."""
LOST_RATE = 1.0
"""One sigma of the rate in a gap, rad/s."""
GATE = 16.0
"""Squared sigmas within which the rate at rest is a bias and no slow turn."""
NO_YAW = math.pi
"""One sigma of a yaw that nothing has shown, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AhrsSettings:
    """What the sensor, the motion and the field are like. One setting is meant for all."""

    gyro_noise: float = 2e-4
    """White noise of the rate, rad/s per square root of Hz."""
    scale_noise: float = 6e-3
    """What errors of scale, axes and time add to it per rad/s of rate."""
    bias_sigma: float = 0.0175
    """One sigma of the bias at the start, rad/s."""
    bias_walk: float = 5e-5
    """Of the bias, rad/s per square root of s."""
    gravity_memory: float = 3.0
    """Time constant of the low-pass of specific force, s."""
    gravity_sigma: float = 0.003
    """One sigma of its direction where nothing moves, rad: what calibration leaves."""
    spread_memory: float = 15.0
    """How long a stray of the low-passed specific force counts, s."""
    learn_sigma: float = 2e-3
    """Least sigma of the rate by which the tilt is corrected in motion, rad/s."""
    field_sigma: float = 0.035
    """One sigma of the field's heading where its strength and dip are as known, rad."""
    field_correlation: float = 10.0
    """For so long an error of the field lasts, s."""
    field_memory: float = 20.0
    """Time constant of the known field, s."""
    field_patience: float = 30.0
    """After so long in motion another steady field is the known one, s."""
    start_sigma: float = 0.09
    """One sigma of the first yaw, rad: the field at one place."""
    rest_gyro: float = 0.035
    """Largest difference of a rate from its mean at rest, rad/s."""
    rest_accel: float = 0.5
    """Likewise of the specific force, m/s^2."""
    rest_sigma: float = 5e-4
    """One sigma of the mean rate at rest, rad/s."""
    step: float = 0.05
    """From one correction to the next, s."""


USUAL = AhrsSettings()


class Estimator:
    """Runs over the samples; what a sample needs is in plain numbers, what a step in arrays."""

    def __init__(self, settings: AhrsSettings) -> None:
        """Begin with nothing known."""
        self.settings = settings
        self.strapdown: list[tuple[float, float, float, float]] = []
        """q_ib of each sample."""
        self.step_of: list[int] = []
        """The correction that holds for each sample."""
        self.is_still: list[bool] = []
        self.corrections: list[Array] = []
        """q_ni after each correction; likewise:"""
        self.biases: list[Array] = []
        self.covariances: list[Array] = []
        self.counts = {"gravity": 0, "rest": 0, "field": 0}
        self.refused = {"gravity": 0, "rest": 0, "field": 0}
        self._frame = Strapdown()
        self._plumb = Plumb(settings.gravity_memory, settings.spread_memory)
        self._rest = Rest(settings.rest_gyro, settings.rest_accel)
        self._compass = Compass(settings.field_memory, settings.field_patience)
        self._q_ni = np.array([1.0, 0.0, 0.0, 0.0])
        self._bias = np.zeros(3)
        self._P = np.diag([1.0, 1.0, NO_YAW**2] + [settings.bias_sigma**2] * 3)
        self._since_field = 0.0
        self._seen_for = 0.0
        self._has_moved = False
        self._lag = Lag(settings.gravity_memory, (3, 4))
        self._stray2 = 0.0

    def take(self, taken: Readings) -> None:
        """Run over all samples."""
        frame, plumb, rest, step = self._frame, self._plumb, self._rest, self.settings.step
        bias = [0.0, 0.0, 0.0]
        has_mag = known_rows(taken.mag_b).tolist()
        for dt, gyro, accel, mag, is_seen in zip(
            taken.steps.tolist(),
            taken.gyro_b.tolist(),
            taken.accel_b.tolist(),
            taken.mag_b.tolist(),
            has_mag,
            strict=True,
        ):
            if dt > GAP:
                self._lose(dt)
                dt = 1e-3  # what it turned in the gap is not known
            frame.turn(gyro, bias, dt)
            plumb.add(*frame.out(accel), dt)
            rest.add(gyro, accel, dt)
            if is_seen:
                frame.see(mag)
            if frame.elapsed >= step - 1e-9 or not self.biases:
                self._advance()
                bias = self._bias.tolist()
                frame.clear()
            self.strapdown.append(frame.q_ib)
            self.step_of.append(len(self.biases) - 1)
            self.is_still.append(rest.is_still)

    def _lose(self, dt: float) -> None:
        """Doubt the attitude after a gap, and begin the low-pass anew."""
        lost = min(LOST_RATE * dt, NO_YAW) ** 2
        self._P = self._P + lost * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        self._plumb.restart()
        self._rest.restart()
        self._keep()

    def _advance(self) -> None:
        """Predict over the step, correct, keep the result."""
        s, frame = self.settings, self._frame
        # Predict: the bias turns the body, and so do the gyro's own errors
        A = so3.to_matrix(self._q_ni) @ np.array(frame.integral).reshape(3, 3)
        Phi = np.eye(6)
        Phi[2, 3:] = -A[2]
        P = Phi @ self._P @ Phi.T
        turned = s.gyro_noise**2 * frame.elapsed + s.scale_noise**2 * frame.turn2
        P[:3, :3] += turned * np.eye(3)
        P[3:, 3:] += s.bias_walk**2 * frame.elapsed * np.eye(3)
        self._P = P
        # Correct by what is seen
        theta = self._level()
        if self._rest.is_still:
            self._stand()
        elif self._plumb.is_warm:
            self._has_moved = True
        self._learn(theta / frame.elapsed, A / frame.elapsed)
        self._since_field += frame.elapsed
        if frame.fields:
            self._point(np.array(frame.field) / frame.fields)
        self._keep()

    def _keep(self) -> None:
        self.corrections.append(self._q_ni)
        self.biases.append(self._bias)
        self.covariances.append(self._P)

    def _level(self) -> Array:
        """Turn the low-passed specific force to the vertical; return the turn about north and east.

        The error of what was low-passed is the error of the tilt, not a noise to be averaged.
        """
        s, plumb = self.settings, self._plumb
        spread = plumb.spread(self._frame.elapsed)
        up = so3.rotate(self._q_ni, np.array([plumb.x, plumb.y, plumb.z]))
        x, y, z = (up / -max(math.sqrt(float(up @ up)), 1e-6)).tolist()
        across = math.hypot(x, y)
        angle = math.atan2(across, z)
        scale = angle / across if across > 1e-9 else 1.0
        innovation = np.array([y * scale, -x * scale])
        sigma2 = (s.gravity_sigma**2 + spread**2) * np.eye(2)
        if not plumb.is_warm:
            # A mean since the start: it holds all that is known
            self._turn(np.array([innovation[0], innovation[1], 0.0]))
            self._P[:2, :2] = sigma2
            return np.zeros(2)
        R = sigma2 + self._lagging()
        dx = self._correct(np.eye(6)[:2], innovation, R)
        self.counts["gravity"] += 1
        return dx[:2]

    def _lagging(self) -> Array:
        """Return the covariance of the tilt by the bias while the low-pass lags, shape (2, 2)."""
        C = self.settings.gravity_memory * self._lag.value[:2, :3]
        return np.asarray(C @ self._P[3:, 3:] @ C.T)

    def _learn(self, rate_n: Array, C_nb: Array) -> None:
        """Learn the bias from how fast the tilt must be corrected, while the sensor moves.

        The corrections are what the low-pass made of bias and motion, so the bias as it was
        estimated meanwhile goes through the same low-pass. How much their rate varies is
        measured; it varies no faster than the low-pass does, and is new only so often.

        Args:
            rate_n: Of the correction about north and east, rad/s, shape (2,).
            C_nb: Mean over the step.
        """
        s, dt = self.settings, self._frame.elapsed
        if not self._plumb.is_warm:
            self._lag = Lag(s.gravity_memory, (3, 4))
            return
        self._lag.add(np.column_stack([C_nb, C_nb @ self._bias]), dt)
        C = self._lag.value[:2]
        innovation = C[:, 3] - rate_n - C[:, :3] @ self._bias
        stray2 = 0.5 * float(innovation @ innovation)
        self._stray2 += min(dt / s.spread_memory, 1.0) * (stray2 - self._stray2)
        if self._rest.is_still:
            return
        R = (self._stray2 + s.learn_sigma**2) * max(2.0 * s.gravity_memory / dt, 1.0)
        H = np.zeros((2, 6))
        H[:, 3:] = C[:, :3]
        self._correct(H, innovation, R * np.eye(2))

    def _stand(self) -> None:
        """Take the mean rate at rest for the bias, unless it is too far off: then it is a turn."""
        innovation = np.array(self._rest.rate) - self._bias
        S = np.diagonal(self._P)[3:] + self.settings.rest_sigma**2
        if float(np.max(innovation**2 / S)) > GATE:
            self.refused["rest"] += 1
            return
        R = self.settings.rest_sigma**2 * max(2.0 * REST_MEMORY / self._frame.elapsed, 1.0)
        self._correct(np.eye(6)[3:], innovation, R * np.eye(3))
        self.counts["rest"] += 1

    def _point(self, field_i: Array) -> None:
        """Turn the horizontal field to the north."""
        s, P = self.settings, self._P
        x, y, z = so3.rotate(self._q_ni, field_i).tolist()
        level = math.hypot(x, y)
        dt, self._since_field = self._since_field, 0.0
        still = self._rest.is_still
        innovation = -math.atan2(y, x)
        tilt2 = 0.5 * (P[0, 0] + P[1, 1]) * (z / max(level, 1e-6)) ** 2
        across, is_new = 0.0, False
        if self._plumb.is_warm:
            across, is_new = self._compass.judge(level, z, dt, is_still=still)
        if not self._has_moved:
            # The mean at one place, which says as much as that place's field does
            self._seen_for += dt
            share = dt / min(self._seen_for, s.field_correlation)
            self._turn(np.array([0.0, 0.0, min(share, 1.0) * innovation]))
            P[2, :] = P[:, 2] = 0.0
            P[2, 2] = s.start_sigma**2 + tilt2
            return
        if is_new:
            P[2, 2] += innovation**2
        if still:
            return
        sigma2 = s.field_sigma**2 + across**2 + tilt2
        R = sigma2 * max(2.0 * s.field_correlation / dt, 1.0)
        self._correct(np.eye(6)[2:3], np.array([innovation]), np.array([[R]]))
        self.counts["field"] += 1

    def _correct(self, H: Array, innovation: Array, R: Array) -> Array:
        """Fuse an innovation by the Joseph form; return by what the error state was moved."""
        P = self._P
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        dx = K @ innovation
        left = np.eye(6) - K @ H
        P = left @ P @ left.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)
        self._bias = self._bias + dx[3:]
        self._turn(dx[:3])
        return np.asarray(dx)

    def _turn(self, theta_n: Array) -> None:
        self._q_ni = so3.normalise(so3.multiply(so3.exp(theta_n), self._q_ni))
