"""Inertial navigation aided by zero velocity, for a sensor on a foot or a wheel, without GNSS.

The motion is that of :mod:`ekf_companion.filters.strapdown`. Where a detector finds that the
sensor stands still, its velocity is measured: nought. The error state then goes back into
position, velocity and attitude, whose errors have grown together with that of the velocity.
Yaw and position are those of the start: nothing here can see them.

Errors: 9 (attitude, velocity, position) or 15 (with the biases of both sensors), and 3 more for
the lever arm from where the foot touches the ground, about which it turns while it stands.

Source: Foxlin 2005, "Pedestrian tracking with shoe-mounted inertial sensors", IEEE CG&A 25(6);
Nilsson, Skog, Haendel, Hari 2012, "Foot-mounted INS for everybody", IEEE/ION PLANS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.filters import detector as stance
from ekf_companion.filters import rest as beginning
from ekf_companion.filters import samples, strapdown
from ekf_companion.filters.detector import Array, Detector, Limits, Mask
from ekf_companion.filters.rest import Rest
from ekf_companion.filters.solution import Recorder, Solution
from ekf_companion.filters.strapdown import (
    ATT,
    BA,
    BG,
    VEL,
    Earth,
    Interval,
    Nominal,
    cross,
    skew,
)
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events

LEVER = slice(15, 18)
SIZE = 18
"""Errors that are laid out; those that are not estimated have no variance and stay nought."""
ONE = np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class ZuptSettings:
    """What sensor and foot are like; one setting for every rate of samples."""

    has_biases: bool = True
    """Estimate the biases: 15 errors instead of 9."""
    lever: float = 0.05
    """From the ground's contact to the sensor, one sigma per axis, m; 0: do not estimate it."""
    planted_gyro: float = 0.35
    """How fast a planted foot may turn, root mean square, rad/s."""
    planted_accel: float = 2.1
    """What else than gravity a planted foot may feel, root mean square, m/s^2."""
    noise_factor: float = 3.0
    """So many times the noise of the first rest counts as still too."""
    threshold: float = 1.0
    """Factor on what counts as still (on its square), to see what hangs on it."""
    window: float = 0.04
    """Of the detectors, s; those that do not see a turn have three times as long."""
    speed: float = 1.3e-3
    """Noise of the zero velocity, m/s per square root of Hz: 2 cm/s at 250 Hz."""
    gate: float = 21.1
    """Largest normalised innovation squared: chi-square, 3 dof, 0.9999."""
    patience: float = 0.3
    """A stance that is refused for longer than this is believed all the same, s."""
    gyro: float = 1e-3
    """Noise of the rate, rad/s per square root of Hz: 0.9 deg/s at 250 Hz."""
    gyro_scale: float = 1e-3
    """Grows with the rate: that times it per square root of Hz; 1 % over a stride of 0.01 s."""
    accel: float = 3e-3
    """Noise of the specific force, m/s^2 per square root of Hz."""
    accel_scale: float = 3e-3
    """Grows with the acceleration, as :attr:`gyro_scale`: scale, bandwidth, blows of the heel."""
    gyro_bias: float = 2e-3
    """One sigma of the bias that the first rest leaves, rad/s: nobody stands quite still."""
    accel_bias: float = 0.2
    """One sigma, m/s^2: 20 mg, the offset of a small sensor that nobody has calibrated."""
    gyro_walk: float = 1e-5
    """rad/s per square root of s."""
    accel_walk: float = 1e-4
    """m/s^2 per square root of s."""


def run(
    events: Events,
    settings: ZuptSettings = ZuptSettings(),
    detector: Detector = Detector.SHOE,
    gap: float = samples.LONGEST,
) -> Solution:
    """Walk through a recording.

    Args:
        events: Only inertial samples count. The sensor rests at the start, and may be held in
            any way.
        settings: What sensor and foot are like.
        detector: What finds the stances.
        gap: Silence of the sensor beyond which only the longest part counts, s.

    Returns:
        An estimate per inertial sample from the first rest on: metres from the start, yaw from
        the way the sensor's forward axis pointed there.

    Raises:
        LogError: Too few inertial samples, or no rest at the start.
    """
    imu, broken = samples.unbroken(samples.inertial(events), gap)
    try:
        rest = beginning.find(imu)
    except LogError as error:
        raise LogError("; ".join([*broken, str(error)])) from error
    imu = imu.take(np.arange(rest.first, len(imu)))
    is_still = phases(imu, rest, settings, detector)
    name = f"zupt, {detector.value}, {15 if settings.has_biases else 9} errors"
    recorder = Recorder(name, None)
    walk = _Walk(rest, settings, recorder)
    fused, refused = walk.go(imu, is_still)
    return recorder.solution(
        is_still=is_still, counts={"zero velocity": (fused, refused)}, notes=broken + rest.notes
    )


def phases(imu: Events, rest: Rest, settings: ZuptSettings, detector: Detector) -> Mask:
    """Say at which samples the sensor stands still, shape (n,).

    One rule gives every detector its threshold: what a planted foot may do, and on top of it a
    multiple of the noise that the sensor showed at rest.
    """
    factor2 = settings.noise_factor**2
    limits = Limits(
        gyro=float(np.sqrt(settings.planted_gyro**2 + factor2 * rest.gyro_noise**2)),
        accel=float(np.sqrt(settings.planted_accel**2 + factor2 * rest.accel_noise**2)),
    )
    is_blind = detector in (Detector.VARIANCE, Detector.MAGNITUDE)
    window = settings.window * (3.0 if is_blind else 1.0)
    value = stance.statistic(
        detector,
        imu.values[:, 0:3] - rest.gyro,
        imu.values[:, 3:6],
        rest.gravity,
        limits,
        half=round(0.5 * window / rest.period),
    )
    return np.asarray(value < settings.threshold)


class _Walk:
    """The filter: a state, its covariance, and how both go on."""

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

    def go(self, imu: Events, is_still: Mask) -> tuple[int, int]:
        """Go through all samples; return how many zero velocities were fused and refused."""
        fused = refused = 0
        self._note(int(imu.t_ns[0]))
        for index in range(1, len(imu)):
            # Move on by one sample
            over = _between(imu, index)
            self._predict(over)

            # A sensor that stands has no speed
            if is_still[index]:
                is_believed = self._correct(imu.values[index, :3], over.dt)
                fused, refused = fused + is_believed, refused + (not is_believed)
            else:
                self._refused = 0.0
            self._note(int(imu.t_ns[index]))
        return fused, refused

    def _note(self, t_ns: int) -> None:
        self._recorder.add(t_ns, self._state, strapdown.in_n(self._P, self._state.q_nb))

    def _predict(self, over: Interval) -> None:
        Phi = np.eye(SIZE)
        Phi[:15, :15] = strapdown.transition(self._state, over, self._earth)
        before = self._state.vel_n
        self._state = strapdown.move(self._state, over, self._earth)
        self._P = Phi @ self._P @ Phi.T + self._noise(over, before)

    def _noise(self, over: Interval, before: Array) -> Array:
        """Return what the interval adds to the covariance: more, the wilder the motion."""
        one = self._settings
        rate = float(np.linalg.norm(over.gyro - self._state.gyro_bias))
        push = float(np.linalg.norm(self._state.vel_n - before)) / over.dt
        Q = np.zeros((SIZE, SIZE))
        Q[:15, :15] = strapdown.Noise(
            gyro=float(np.hypot(one.gyro, one.gyro_scale * rate)),
            accel=float(np.hypot(one.accel, one.accel_scale * push)),
            gyro_walk=one.gyro_walk if one.has_biases else 0.0,
            accel_walk=one.accel_walk if one.has_biases else 0.0,
        ).covariance(over.dt)
        return Q

    def _correct(self, gyro: Array, dt: float) -> bool:
        """Fuse a zero velocity of the point that touches the ground, or refuse it."""
        state, P = self._state, self._P
        C_nb = so3.to_matrix(state.q_nb)
        rate_b = gyro - state.gyro_bias
        turning = cross(rate_b, self._lever)
        innovation = C_nb @ turning - state.vel_n
        H = np.zeros((3, SIZE))
        H[:, VEL] = ONE
        H[:, ATT] = C_nb @ skew(turning)
        H[:, BG] = -C_nb @ skew(self._lever)
        H[:, LEVER] = -C_nb @ skew(rate_b)
        R = self._settings.speed**2 / dt * ONE
        PHt = P @ H.T
        S = H @ PHt + R
        if innovation @ np.linalg.solve(S, innovation) > self._settings.gate:
            self._refused += dt
            if self._refused < self._settings.patience:
                return False
        K = np.linalg.solve(S, PHt.T).T
        A = np.eye(SIZE) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)
        dx = K @ innovation
        self._state = state.plus(dx[:15])
        self._lever = self._lever + dx[LEVER]
        return True


def _between(imu: Events, index: int) -> Interval:
    first, second = imu.values[index - 1], imu.values[index]
    return Interval(
        dt=float(imu.t_ns[index] - imu.t_ns[index - 1]) * 1e-9,
        gyro0=first[0:3],
        gyro1=second[0:3],
        accel0=first[3:6],
        accel1=second[3:6],
    )
