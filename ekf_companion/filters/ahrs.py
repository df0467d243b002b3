"""Attitude alone, our own: a Kalman filter of attitude error and gyro bias, six states.

The gyro turns a frame i, which hardly turns itself, as bias and noise are small: specific force
is low-passed there, and the field is averaged (:mod:`~ekf_companion.filters.ahrs_sensors`). Some
times a second the filter compares both with down and north and corrects the attitude of frame i in
n, not what was low-passed in it. Gravity corrects roll, pitch and bias; the field corrects yaw and
bias, never roll and pitch. Errors of both last for seconds: a measurement counts only as often as
its error is new.

Error state: rotation vector in n (q_nb (true) = exp(theta_n) q_nb), gyro bias in b (true less
estimated). Source: Sola 2017, arXiv 1711.02508; Laidig, Seel 2023, "VQF", arXiv 2203.17024, for
frame i, rest and the recovery after a disturbance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.filters.ahrs_sensors import (
    REST_MEMORY,
    FieldTurn,
    GravityFilter,
    GyroFrame,
    LowPass,
    ReferenceField,
    RestDetector,
    Wander,
)
from ekf_companion.filters.gap import Lost
from ekf_companion.filters.marg import MargSamples, marg_samples
from ekf_companion.filters.solution import AttitudeEstimates, Solution, attitude_solution
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events

HIDDEN_LATER = 1.0
"""One sigma of a turn about the vertical that a rest after the first may hide, rad/s."""
GATE = 16.0
"""Largest normalised innovation squared of the rate at rest; beyond, it is a slow turn."""
UNKNOWN_YAW = math.pi
"""One sigma of a yaw that is not known, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AhrsSettings:
    """Properties of the sensor, the motion and the field; one set is meant for all recordings."""

    gyro_noise: float = 2e-4
    """White noise of the rate, rad/s per square root of Hz."""
    scale_noise: float = 6e-3
    """Additional noise per rad/s of rate, by errors of scale, axes and time."""
    bias_sigma: float = 0.0175
    """One sigma of the bias at the start, rad/s."""
    bias_walk: float = 5e-5
    """Random walk of the bias, rad/s per square root of s."""
    gravity_memory: float = 3.0
    """Time constant of the low-pass of specific force, s."""
    gravity_sigma: float = 0.003
    """One sigma of its direction without motion, rad: what calibration leaves."""
    spread_memory: float = 15.0
    """Time constant of the uncertainty of the low-passed specific force, s."""
    learn_sigma: float = 2e-3
    """Least sigma of the tilt's rate of correction in motion, rad/s."""
    field_sigma: float = 0.035
    """One sigma of the field's heading if it agrees with the reference, rad."""
    field_correlation: float = 10.0
    """Time for which an error of the field lasts, s."""
    field_memory: float = 20.0
    """Time constant of the reference field, s."""
    field_patience: float = 30.0
    """Time in motion after which another steady field becomes the reference, s."""
    start_sigma: float = 0.09
    """One sigma of the first yaw, rad: by the field at one spot."""
    rest_gyro: float = 0.035
    """Largest difference of a rate from its mean at rest, rad/s."""
    rest_accel: float = 0.5
    """Likewise of the specific force, m/s^2."""
    rest_sigma: float = 5e-4
    """One sigma of the mean rate at rest, rad/s."""
    hidden_turn: float = 0.02
    """One sigma of a steady turn about the vertical that the first rest may hide, rad/s."""
    field_turn: float = 0.01
    """One sigma of a turn of the magnetic field itself during a rest, rad."""
    step: float = 0.05
    """Time from one correction to the next, s."""


USUAL = AhrsSettings()


def run(events: Events, settings: AhrsSettings = USUAL) -> Solution:
    """Estimate attitude and gyro bias over a recording, each from the samples until then.

    Raises:
        LogError: There are no inertial samples.
    """
    # Over a gap the attitude becomes uncertain, and is found again after it
    samples = marg_samples(events, math.inf)
    found = track(samples, settings)
    # What calibration leaves in gravity does not become less by averaging
    floor = np.diag([settings.gravity_sigma**2, settings.gravity_sigma**2, 0.0, 0.0, 0.0, 0.0])
    return attitude_solution("ahrs", samples, replace(found, covariance=found.covariance + floor))


def track(samples: MargSamples, settings: AhrsSettings = USUAL) -> AttitudeEstimates:
    """Run the filter over samples; the covariance is that of the error state, shape (n, 6, 6)."""
    estimator = _Estimator(settings)
    estimator.run(samples)
    at = np.array(estimator.step_of)
    return AttitudeEstimates(
        q_nb=so3.multiply(np.array(estimator.corrections)[at], np.array(estimator.strapdown)),
        bias=np.array(estimator.biases)[at],
        covariance=np.array(estimator.covariances)[at],
        is_still=np.array(estimator.is_still),
        counts={aid: (count, estimator.refused[aid]) for aid, count in estimator.counts.items()},
    )


class _Estimator:
    """Runs over the samples; in plain numbers at each sample, in arrays at each step."""

    def __init__(self, settings: AhrsSettings) -> None:
        self.settings = settings
        self.strapdown: list[tuple[float, float, float, float]] = []
        """q_ib of each sample."""
        self.step_of: list[int] = []
        """Index of the correction that holds for each sample."""
        self.is_still: list[bool] = []
        self.corrections: list[Array] = []
        """q_ni after each correction; likewise:"""
        self.biases: list[Array] = []
        self.covariances: list[Array] = []
        self.counts = {"gravity": 0, "rest": 0, "field": 0}
        self.refused = {"gravity": 0, "rest": 0, "field": 0}
        self._frame = GyroFrame()
        self._gravity = GravityFilter(settings.gravity_memory, settings.spread_memory)
        self._rest = RestDetector(settings.rest_gyro, settings.rest_accel)
        self._reference = ReferenceField(settings.field_memory, settings.field_patience)
        self._q_ni = np.array([1.0, 0.0, 0.0, 0.0])
        self._bias = np.zeros(3)
        self._P = np.diag([1.0, 1.0, UNKNOWN_YAW**2] + [settings.bias_sigma**2] * 3)
        self._wander = Wander(settings.spread_memory)
        self._slope = 0.0
        self._since_field = 0.0
        self._field_time = 0.0
        self._has_moved = False
        self._has_rested = False
        self._turn = FieldTurn(self._q_ni)
        self._lag = LowPass(settings.gravity_memory, (3, 4))
        self._stray2 = 0.0

    def run(self, samples: MargSamples) -> None:
        """Run over all samples."""
        frame, gravity, rest, step = self._frame, self._gravity, self._rest, self.settings.step
        bias = [0.0, 0.0, 0.0]
        for dt, gyro, accel, mag, missed in samples.rows():
            if missed is not None:
                if missed.gyro is not None:
                    frame.rotate(missed.gyro, bias, missed.span)
                self._bridge(missed.lost)
            frame.rotate(gyro, bias, dt)
            gravity.add(*frame.to_frame(accel), dt)
            rest.add(gyro, accel, dt)
            if mag is not None:
                frame.add_field(mag)
            if frame.elapsed >= step - 1e-9 or not self.biases:
                self._advance()
                bias = self._bias.tolist()
                frame.begin_step()
            self.strapdown.append(frame.q_ib)
            self.step_of.append(len(self.biases) - 1)
            self.is_still.append(rest.is_still)

    def _bridge(self, lost: Lost) -> None:
        """Inflate the attitude's covariance after a gap, and restart the low-pass."""
        self._P = self._P + np.diag([lost.tilt**2, lost.tilt**2, lost.yaw**2, 0.0, 0.0, 0.0])
        self._gravity.restart()
        self._wander.restart()
        self._rest.restart()
        # What was averaged before was seen from elsewhere
        self._field_time = 0.0
        self._keep()

    def _advance(self) -> None:
        """Predict over the step, correct, and keep the result."""
        s, frame = self.settings, self._frame
        # Predict: bias and noise of the gyro turn the attitude
        A = so3.to_matrix(self._q_ni) @ np.array(frame.integral).reshape(3, 3)
        Phi = np.eye(6)
        Phi[2, 3:] = -A[2]
        P = Phi @ self._P @ Phi.T
        turned = s.gyro_noise**2 * frame.elapsed + s.scale_noise**2 * frame.squared_rate
        P[:3, :3] += turned * np.eye(3)
        P[3:, 3:] += s.bias_walk**2 * frame.elapsed * np.eye(3)
        self._P = P
        # Correct by gravity, by rest, by the tilt's rate and by the field
        theta = self._correct_tilt()
        if self._rest.is_still:
            self._correct_bias_at_rest()
        else:
            self._turn = FieldTurn(self._q_ni)
            self._has_moved = self._has_moved or self._gravity.is_warm
        self._correct_bias_in_motion(theta / frame.elapsed, A / frame.elapsed)
        self._since_field += frame.elapsed
        if frame.fields:
            self._correct_yaw(np.array(frame.field_sum) / frame.fields)
        self._keep()

    def _keep(self) -> None:
        """Store the result, with the acceleration that looks like a tilt in its covariance.

        It is correlated over seconds, so more steps do not average it. In a dipping field it turns
        the yaw.
        """
        self.corrections.append(self._q_ni)
        self.biases.append(self._bias)
        one = np.array([1.0, 1.0, self._slope**2, 0.0, 0.0, 0.0])
        self.covariances.append(self._P + self._wander.variance * np.diag(one))

    def _correct_tilt(self) -> Array:
        """Correct roll and pitch by the low-passed gravity; return the rotation about n and e.

        The error of the low-pass is that of the tilt, and not white noise that averages.
        """
        s, gravity = self.settings, self._gravity
        sigma = gravity.sigma(self._frame.elapsed)
        force_i = np.array([gravity.x, gravity.y, gravity.z])
        down_i = force_i / -max(math.sqrt(float(force_i @ force_i)), 1e-6)
        if gravity.is_warm:
            self._wander.add(down_i, self._frame.elapsed)
        x, y, z = so3.rotate(self._q_ni, down_i).tolist()
        across = math.hypot(x, y)
        angle = math.atan2(across, z)
        scale = angle / across if across > 1e-9 else 1.0
        innovation = np.array([y * scale, -x * scale])
        sigma2 = (s.gravity_sigma**2 + sigma**2) * np.eye(2)
        if not gravity.is_warm:
            # The mean since the start contains all that is known
            self._rotate(np.array([innovation[0], innovation[1], 0.0]))
            self._P[:2, :2] = sigma2
            return np.zeros(2)
        # The tilt by bias and lag of the low-pass
        C = s.gravity_memory * self._lag.value[:2, :3]
        R = sigma2 + C @ self._P[3:, 3:] @ C.T
        dx = self._correct(np.eye(6)[:2], innovation, R)
        self.counts["gravity"] += 1
        return dx[:2]

    def _correct_bias_in_motion(self, rate_n: Array, C_nb: Array) -> None:
        """Correct the bias by the rate at which the tilt is corrected, about north and east, rad/s.

        The corrections are bias and motion after the low-pass, so the bias estimated meanwhile
        passes through the same low-pass, by the mean of C_nb over the step. The variance of the
        rate is measured; its errors last as long as the low-pass, so it counts only so often.
        """
        s, dt = self.settings, self._frame.elapsed
        if not self._gravity.is_warm:
            self._lag = LowPass(s.gravity_memory, (3, 4))
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

    def _correct_bias_at_rest(self) -> None:
        """Fuse the mean rate at rest as bias, about the vertical only as far as nothing turns.

        A slow turn about a level axis is refused beyond the gate; one about the vertical looks like
        rest, and what it has hidden once is hidden in every later rest too.
        """
        s, frame = self.settings, self._frame
        down_b = so3.to_matrix(so3.multiply(self._q_ni, np.array(frame.q_ib)))[2]
        hidden = s.hidden_turn if not self._has_rested else HIDDEN_LATER
        down2 = np.outer(down_b, down_b)
        innovation = np.array(self._rest.rate) - self._bias
        level = innovation - down_b * float(down_b @ innovation)
        S = np.diagonal(self._P)[3:] + s.rest_sigma**2
        if float(np.max(level**2 / S)) > GATE:
            self.refused["rest"] += 1
            return
        R = s.rest_sigma**2 * max(2.0 * REST_MEMORY / frame.elapsed, 1.0) * np.eye(3)
        self._correct(np.eye(6)[3:], innovation, R + hidden**2 * down2)
        self._has_rested = True
        self.counts["rest"] += 1
        self._compare_with_field(down_b)

    def _compare_with_field(self, down_b: Array) -> None:
        """Fuse the gyro bias about the vertical for which the field, at rest, does not turn.

        The field's own error remains, however many steps agree.
        """
        s, frame, turn = self.settings, self._frame, self._turn
        if not frame.fields:
            turn.add(None, float(down_b @ self._bias), frame.elapsed)
            return
        north, east, _ = so3.rotate(turn.q_ni, np.array(frame.field_sum)).tolist()
        turn.add(math.atan2(east, north), float(down_b @ self._bias), frame.elapsed)
        H = np.concatenate([np.zeros(3), down_b])[None]
        variance, std = float(H[0] @ self._P @ H[0]), turn.std(s.field_turn)
        if std * std < 0.9 * variance:
            R = std * std * variance / (variance - std * std)
            self._correct(H, turn.bias - H[:, 3:] @ self._bias, np.array([[R]]))

    def _correct_yaw(self, field_i: Array) -> None:
        """Correct yaw by the horizontal direction of the field."""
        s, P = self.settings, self._P
        x, y, z = so3.rotate(self._q_ni, field_i).tolist()
        horizontal = math.hypot(x, y)
        dt, self._since_field = self._since_field, 0.0
        still = self._rest.is_still
        innovation = -math.atan2(y, x)
        self._slope = z / max(horizontal, 1e-6)
        tilt2 = 0.5 * (P[0, 0] + P[1, 1]) * self._slope**2
        across, is_new = 0.0, False
        if self._gravity.is_warm:
            across, is_new = self._reference.judge(horizontal, z, dt, is_still=still)
        if not self._has_moved:
            # Average at one spot, whose field limits the accuracy
            self._field_time += dt
            share = dt / min(self._field_time, s.field_correlation)
            self._rotate(np.array([0.0, 0.0, min(share, 1.0) * innovation]))
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
        """Fuse an innovation by the Joseph form; return the error state."""
        P = self._P
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        dx = K @ innovation
        A = np.eye(6) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)
        self._bias = self._bias + dx[3:]
        self._rotate(dx[:3])
        return np.asarray(dx)

    def _rotate(self, theta_n: Array) -> None:
        self._q_ni = so3.normalise(so3.multiply(so3.exp(theta_n), self._q_ni))
