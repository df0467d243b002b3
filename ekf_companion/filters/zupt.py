"""Inertial navigation aided by zero velocity, for a sensor on a foot or a wheel, without GNSS.

The motion is that of :mod:`ekf_companion.filters.strapdown`. Where a detector finds the sensor
still, its velocity is measured as zero, which corrects position, velocity and attitude, as their
errors are correlated with that of the velocity. Yaw and position are relative to the start: they
are not observable.

Errors: 9 (attitude, velocity, position) or 15 (with the biases of both sensors), and 3 more for
the lever arm from the point where the foot touches the ground, about which it turns in a stance.

Source: Foxlin 2005, "Pedestrian tracking with shoe-mounted inertial sensors", IEEE CG&A 25(6);
Nilsson, Skog, Haendel, Hari 2012, "Foot-mounted INS for everybody", IEEE/ION PLANS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.filters.gap import hidden, over_gap
from ekf_companion.filters.inertial import LONGEST_GAP, inertial_samples, longest_part
from ekf_companion.filters.solution import Recorder, Solution
from ekf_companion.filters.strapdown import (
    ATT,
    BA,
    BG,
    POS,
    VEL,
    Earth,
    Interval,
    Noise,
    Nominal,
    covariance_in_n,
    integrate_strapdown,
    transition,
)
from ekf_companion.filters.zupt_detector import Detector, Limits, Rest, first_rest, statistic
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.so3 import cross, skew

LEVER = slice(15, 18)
SIZE = 18
"""Number of errors; those that are not estimated have no variance and stay zero."""
ONE = np.eye(3)
SHORTEST_GAP = 0.05
"""Longest step between samples that is no gap, s: a swing lasts ten times as long."""
BLIND = 0.5
"""Longest step over which the motion is interpolated, s; a swing is over by then."""
SWING = (3.0, 20.0)
"""One sigma of what a gap hides of a foot: it turns by 1 rad and goes 1.3 m in 0.6 s. rad/s,
m/s^2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZuptSettings:
    """Properties of sensor and foot; one set for every rate of samples."""

    has_biases: bool = True
    """Estimate the biases: 15 errors instead of 9."""
    lever: float = 0.05
    """Lever arm from the contact with the ground, one sigma per axis, m; 0: not estimated."""
    planted_gyro: float = 0.35
    """Rate of a planted foot, root mean square, rad/s."""
    planted_accel: float = 2.1
    """Acceleration of a planted foot, root mean square, m/s^2."""
    noise_factor: float = 3.0
    """Multiple of the noise at the first rest that is added to these."""
    threshold: float = 1.0
    """Threshold of the detectors' statistics, to study its influence."""
    window: float = 0.04
    """Window of the detectors, s; of those that ignore the rate, three times as long."""
    speed: float = 1.3e-3
    """Noise of the zero velocity, m/s per square root of Hz: 2 cm/s at 250 Hz."""
    gate: float = 21.1
    """Largest normalised innovation squared: chi-square, 3 dof, 0.9999."""
    patience: float = 0.3
    """Time after which a refused stance is fused nevertheless, s."""
    swing_scale: float = 0.01
    """Error of the attitude in a swing per rad turned in it: a small gyro's scale and axes. It is
    the same in each stride, so that the heights that it makes add up."""
    gyro: float = 1e-3
    """Noise of the rate, rad/s per square root of Hz: 0.9 deg/s at 250 Hz."""
    gyro_scale: float = 1e-3
    """Additional noise per rad/s of rate, per square root of Hz; 1 % over a step of 0.01 s."""
    accel: float = 3e-3
    """Noise of the specific force, m/s^2 per square root of Hz."""
    accel_scale: float = 3e-3
    """Likewise per m/s^2 of acceleration: by scale, bandwidth and heel strikes."""
    gyro_bias: float = 2e-3
    """One sigma of the bias after the first rest, rad/s: nobody stands quite still."""
    accel_bias: float = 0.2
    """One sigma, m/s^2: 20 mg, the offset of a small sensor without calibration."""
    gyro_walk: float = 1e-5
    """rad/s per square root of s."""
    accel_walk: float = 1e-4
    """m/s^2 per square root of s."""


def run(
    events: Events,
    settings: ZuptSettings = ZuptSettings(),
    detector: Detector = Detector.SHOE,
    gap: float = LONGEST_GAP,
) -> Solution:
    """Run the filter over the inertial samples of a walk, which begins at rest in any attitude.

    Positions are metres from the start, yaw is relative to the sensor's forward axis there. Beyond
    a gap in the samples, s, only the longest part counts.

    Raises:
        LogError: Too few inertial samples, or no rest at the start.
    """
    imu, notes = longest_part(inertial_samples(events), gap)
    try:
        rest = first_rest(imu)
    except LogError as error:
        raise LogError("; ".join([*notes, str(error)])) from error
    imu = imu.take(np.arange(rest.first, len(imu)))
    is_still = find_stances(imu, rest, settings, detector)
    name = f"zupt, {detector.value}, {15 if settings.has_biases else 9} errors"
    recorder = Recorder(name, None)
    counts = {"zero velocity": _Filter(rest, settings, recorder).run(imu, is_still)}
    return recorder.solution(is_still=is_still, counts=counts, notes=notes + rest.notes)


def find_stances(imu: Events, rest: Rest, settings: ZuptSettings, detector: Detector) -> Mask:
    """Return at which samples the sensor is still, shape (n,).

    One rule for every detector: the threshold is the motion of a planted foot, and a multiple of
    the noise at rest.
    """
    factor2 = settings.noise_factor**2
    limits = Limits(
        gyro=float(np.sqrt(settings.planted_gyro**2 + factor2 * rest.gyro_noise**2)),
        accel=float(np.sqrt(settings.planted_accel**2 + factor2 * rest.accel_noise**2)),
    )
    ignores_rate = detector in (Detector.VARIANCE, Detector.MAGNITUDE)
    window = settings.window * (3.0 if ignores_rate else 1.0)
    half = round(0.5 * window / rest.period)
    gyro, accel = imu.values[:, 0:3] - rest.gyro, imu.values[:, 3:6]
    value = statistic(detector, gyro, accel, rest.gravity, limits, half)
    return np.asarray(value < settings.threshold)


class _Filter:
    """The state and its covariance, predicted and corrected."""

    def __init__(self, rest: Rest, settings: ZuptSettings, recorder: Recorder) -> None:
        self._settings, self._recorder = settings, recorder
        self._earth = Earth.flat(rest.gravity)
        self._state = Nominal(
            q_nb=rest.q_nb, vel_n=np.zeros(3), pos_n=np.zeros(3), gyro_bias=rest.gyro
        )
        self._lever = np.zeros(3)
        tilt = settings.accel_bias / rest.gravity
        C_nb = so3.to_matrix(rest.q_nb)
        self._P = np.zeros((SIZE, SIZE))
        self._P[ATT, ATT] = C_nb.T @ np.diag([tilt * tilt, tilt * tilt, 0.0]) @ C_nb
        if settings.has_biases:
            self._P[BG, BG] = settings.gyro_bias**2 * ONE
            self._P[BA, BA] = settings.accel_bias**2 * ONE
        self._P[LEVER, LEVER] = settings.lever**2 * ONE
        self._refused = 0.0
        self._unaided = 0.0
        self._planted = rest.q_nb
        self._climb = 0.0

    def run(self, imu: Events, is_still: Mask) -> tuple[int, int]:
        """Process all samples; return how many zero velocities were fused and refused."""
        fused = refused = 0
        self._record(int(imu.t_ns[0]))
        for index in range(1, len(imu)):
            over = _between(imu, index)
            self._predict(over)
            self._unaided += over.dt
            # A still sensor has zero velocity
            if is_still[index]:
                self._planted = self._state.q_nb
                is_fused = self._correct(imu.values[index, :3], over.dt)
                fused, refused = fused + is_fused, refused + (not is_fused)
            else:
                self._refused = 0.0
                self._add_climb(over.dt)
            self._record(int(imu.t_ns[index]))
        return fused, refused

    def _record(self, t_ns: int) -> None:
        P = covariance_in_n(self._P, self._state.q_nb)
        P[8, 8] += self._climb**2
        self._recorder.add(t_ns, self._state, P)

    def _add_climb(self, dt: float) -> None:
        """Add the height that an attitude makes which is wrong by a share of the turn of the swing.

        It is gone at the next stance, so no zero velocity shows it, and it comes again in each
        stride: no noise that is new each time, and no state that is known from the last.
        """
        # A turn about the vertical makes no height
        down_b, planted_b = (so3.to_matrix(q)[2] for q in (self._state.q_nb, self._planted))
        turn = float(np.arccos(np.clip(down_b @ planted_b, -1.0, 1.0)))
        speed = float(np.hypot(self._state.vel_n[0], self._state.vel_n[1]))
        self._climb += self._settings.swing_scale * turn * speed * dt

    def _predict(self, over: Interval) -> None:
        if over.dt > BLIND:
            over = over_gap(over, self._state, self._earth, 0.0)
        Phi = np.eye(SIZE)
        Phi[:15, :15] = transition(self._state, over, self._earth)
        before = self._state.vel_n
        self._state = integrate_strapdown(self._state, over, self._earth)
        self._P = Phi @ self._P @ Phi.T + self._noise(over, before)
        if over.dt > SHORTEST_GAP:
            lost = hidden(over.dt, *(rate * over.dt for rate in SWING))
            self._P[:15, :15] += lost.covariance(self._state.q_nb)

    def _noise(self, over: Interval, before: Array) -> Array:
        """Return the covariance that the interval adds, which grows with rate and acceleration."""
        one = self._settings
        rate = float(np.linalg.norm(over.gyro - self._state.gyro_bias))
        accel = float(np.linalg.norm(self._state.vel_n - before)) / over.dt
        Q = np.zeros((SIZE, SIZE))
        Q[:15, :15] = Noise(
            gyro=float(np.hypot(one.gyro, one.gyro_scale * rate)),
            accel=float(np.hypot(one.accel, one.accel_scale * accel)),
            gyro_walk=one.gyro_walk if one.has_biases else 0.0,
            accel_walk=one.accel_walk if one.has_biases else 0.0,
        ).covariance(over.dt)
        return Q

    def _correct(self, gyro: Array, dt: float) -> bool:
        """Fuse a zero velocity of the contact with the ground; return False if it is refused."""
        state, P = self._state, self._P
        C_nb = so3.to_matrix(state.q_nb)
        rate_b = gyro - state.gyro_bias
        swing = cross(rate_b, self._lever)
        innovation = C_nb @ swing - state.vel_n
        H = np.zeros((3, SIZE))
        H[:, VEL] = ONE
        H[:, ATT] = C_nb @ skew(swing)
        H[:, BG] = -C_nb @ skew(self._lever)
        H[:, LEVER] = -C_nb @ skew(rate_b)
        R = self._settings.speed**2 / dt * ONE
        PHt = P @ H.T
        S = H @ PHt + R
        if innovation @ np.linalg.solve(S, innovation) > self._settings.gate:
            self._refused += dt
            if self._refused < self._settings.patience:
                return False
            self._reset(innovation, R)
            return True
        self._unaided = 0.0
        K = np.linalg.solve(S, PHt.T).T
        A = np.eye(SIZE) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)
        dx = K @ innovation
        self._state = state.plus(dx[:15])
        self._lever = self._lever + dx[LEVER]
        return True

    def _reset(self, innovation: Array, R: Array) -> None:
        """Set the velocity that the gate has refused for too long, and leave the others alone.

        By the covariance that has refused it, it would turn and move them. That is too small: for
        as long as no velocity was fused the position was wrong by it, and a tilt has made it.
        """
        error, seconds = float(np.linalg.norm(innovation)), self._unaided
        tilt = min(error / (self._earth.gravity * max(seconds, self._settings.patience)), 1.0)
        self._state = replace(self._state, vel_n=self._state.vel_n + innovation)
        self._P[VEL] = self._P[:, VEL] = 0.0
        self._P[VEL, VEL] = R
        self._P[POS, POS] += (error * seconds) ** 2 * ONE
        self._P[ATT, ATT] += tilt**2 * ONE
        self._refused = self._unaided = 0.0


def _between(imu: Events, index: int) -> Interval:
    first, second = imu.values[index - 1], imu.values[index]
    return Interval(
        dt=float(imu.t_ns[index] - imu.t_ns[index - 1]) * 1e-9,
        gyro0=first[0:3],
        gyro1=second[0:3],
        accel0=first[3:6],
        accel1=second[3:6],
    )
