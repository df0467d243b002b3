"""An inertial interval: its mean motion, the advance over it, and a gap without samples."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids.delay import forget_gain
from cython.cimports.ekf_companion.core.aids.rest import begin_window
from cython.cimports.ekf_companion.core.filter import columns, past, tape
from cython.cimports.ekf_companion.core.filter.covariance import propagate_covariance
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance
from cython.cimports.ekf_companion.core.filter.strapdown import integrate_strapdown
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_BA,
    E_BG,
    E_POS,
    E_VEL,
    MODE_LEVEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import ImuRow, Motion, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start import align, yaw_frame
from cython.cimports.ekf_companion.core.trust import gate, silence
from cython.cimports.ekf_companion.core.trust.process_noise import scale_noise
from cython.cimports.libc.math import isfinite, sqrt, tanh

MOTION_TIME = cython.declare(cython.double, 0.4)
"""Time over which a vehicle's rate and force are correlated, s: what two samples say of the motion
between them fades with it (measured on recorded flights: ``benchmarks/gaps.py``)."""
RATE_STD = cython.declare(cython.double, 0.5)
"""One sigma of the rate of a vehicle that is flown hard, rad/s, if both ends show no more."""
FORCE_STD = cython.declare(cython.double, 6.7)
"""The same of its specific force beside that of a vehicle at rest, m/s^2."""
COVARIANCE_INTERVAL = cython.declare(cython.double, 0.0095)
"""Interval at which P is carried on, s: 10 ms, give or take the samples' jitter."""
LARGEST_TURN = cython.declare(cython.double, 4.0)
"""Largest square of the turn, rad^2, that is integrated from one sample."""


def carry_on(x: State, k: Parameters, w: Scratch) -> None:
    """Carry P on to the state's time."""
    dt = x.pending.dt
    if dt > 0.0:
        scale_noise(x, k, address(w.motion))
        propagate_covariance(x, k, address(w.motion))
        if w.observation.has_bank:
            columns.move(address(w.observation.bank[0]), k, address(w.motion), dt)
        if w.tape.is_on:
            tape.record_motion(x, k, w, dt)


def advance(x: State, k: Parameters, w: Scratch, t: float, begin: float, span: float) -> None:
    """Advance the state to a time within the interval of length span (s) that began at begin.

    P follows where that is worth it; a tape wants it at each sample, and so does an axis that does
    not measure.
    """
    m = address(w.motion)
    dt = (t - x.t) * 1e-9
    if dt > 0.0:
        # the mean over this part of the interval, from that over the whole
        part = ((t - begin) + (x.t - begin)) * 0.5e-9 - 0.5 * span
        for i in range(3):
            m.rate[i] = m.mean[i] + part * m.rate_slope[i]
            m.force[i] = m.mean[3 + i] + part * m.force_slope[i]
        if x.mode == MODE_LEVEL:
            align.integrate(x, m, dt)
        else:
            integrate_strapdown(x, k, m, dt)
            if x.pending.dt >= COVARIANCE_INTERVAL or w.tape.is_on or not silence.is_measured(x):
                carry_on(x, k, w)
            if x.needs_reset != 0.0:
                align.integrate(x, m, dt)
        yaw_frame.integrate(address(x.yaw_bank), m, dt)
        x.t = t
        past.keep_velocity(x)


def find_interval_motion(x: State, k: Parameters, m: Motion, imu: ImuRow, span: float) -> None:
    """Write the mean rate and force of the interval before a sample, and their slopes.

    A sample stands for the interval before it, if it is a mean and none is missing; else it is a
    reading at its end. Either way two in a row say how fast rate and force change.
    """
    turn = 0.0
    is_regular = cython.declare(cython.bint, span <= 1.5 * x.dt)
    for i in range(3):
        turn += imu.gyro[i] * imu.gyro[i]
    if turn * span * span > LARGEST_TURN:
        find_lost_motion(x, k, m, imu, 0.0)
        is_regular = False
    elif span > k.gap:
        find_lost_motion(x, k, m, imu, MOTION_TIME / span * tanh(0.5 * span / MOTION_TIME))
        is_regular = False
    else:
        for i in range(3):
            m.mean[i] = imu.gyro[i]
            m.mean[3 + i] = imu.accel[i]
            if k.mean_samples == 0.0 or not is_regular:
                m.mean[i] = 0.5 * (m.mean[i] + x.gyro[i])
                m.mean[3 + i] = 0.5 * (m.mean[3 + i] + x.accel[i])
    for i in range(3):
        m.rate_slope[i] = 0.0
        m.force_slope[i] = 0.0
        if is_regular and x.samples > 1.0:
            m.rate_slope[i] = (imu.gyro[i] - x.gyro[i]) / span
            m.force_slope[i] = (imu.accel[i] - x.accel[i]) / span


def find_lost_motion(x: State, k: Parameters, m: Motion, imu: ImuRow, share: float) -> None:
    """Write the mean rate and force expected over a time from the samples at both its ends.

    Args:
        x: The state at the begin, with the sample there.
        k: The parameters.
        m: Receives the mean.
        imu: The sample at the end.
        share: What each end counts beside no turn and no acceleration; 0.5: the mean of both.
    """
    to_dcm(x.q_nb, m.C_nb)
    for i in range(3):
        rate = x.gyro_bias[i]
        force = x.accel_bias[i] - k.gravity * m.C_nb[2][i]
        m.mean[i] = rate + share * (x.gyro[i] + imu.gyro[i] - 2.0 * rate)
        m.mean[3 + i] = force + share * (x.accel[i] + imu.accel[i] - 2.0 * force)


def shown_rate(x: State, imu: ImuRow) -> float:
    """Return the RMS of the rates at both ends of a gap, per axis, rad/s."""
    power = 0.0
    for i in range(3):
        power += x.gyro[i] * x.gyro[i] + imu.gyro[i] * imu.gyro[i]
    return sqrt(power / 6.0)


def inflate_after_gap(x: State, k: Parameters, span: float, rate: float, is_gap: bool) -> None:
    """Inflate P by what may have happened while no sample came; reset velocity after a long gap.

    Rate and force are those of a first-order Gauss-Markov process, of which the samples at both
    ends are known: over a time T the integral has a variance of 2 s^2 c^2 (T/c - 2 tanh(T / 2 c)),
    where s is their sigma and c their correlation time. Tilt is bounded, heading and speed hardly
    are. A stream that is always as slow has no gap, only doubt.

    Args:
        x: The state at the end.
        k: The parameters.
        span: Length of the gap, s.
        rate: RMS of the rates at both ends, per axis, rad/s.
        is_gap: Samples are missing.
    """
    if is_gap:
        x.gaps += 1.0
        x.force_sum[0] = NAN
        forget_gain(x)
        begin_window(x, x.t)
    if x.mode == MODE_LEVEL:
        if is_gap:
            x.alignment.motion.has_fix = 0.0
        return
    add_lost(x, span, rate, 1.0)
    if is_gap and span > k.gap_reset and x.mode == MODE_NAVIGATE:
        gate.go_by_fixes(x)


def inflate_within_gap(x: State, rate: float, done: float, now: float) -> float:
    """Inflate P before a reading within a gap by what may have happened so far; return the time.

    By what has been added since the reading before: in all it is what ``inflate_after_gap`` adds
    for the whole. Fault hypotheses would else take for a fault what no sample has shown.

    Args:
        x: The state at the reading.
        rate: RMS of the rates at both ends, per axis, rad/s.
        done: When that was, from the begin of the gap, s.
        now: The time of the reading, likewise.
    """
    if now <= done:
        return done
    add_lost(x, now, rate, 1.0)
    if done > 0.0:
        add_lost(x, done, rate, -1.0)
    return now


def add_lost(x: State, span: float, rate: float, sign: float) -> None:
    """Add to P what may have happened in a time (s) without samples, or take it back."""
    ratio = span / MOTION_TIME
    spread = MOTION_TIME * sqrt(2.0 * (ratio - 2.0 * tanh(0.5 * ratio)))
    turned = (rate if rate > RATE_STD else RATE_STD) * spread
    gained = FORCE_STD * spread
    yawed = turned
    if yawed > 1.8:
        yawed = 1.8
    if turned > 0.5:
        turned = 0.5
    if gained > 20.0:
        gained = 20.0
    for i in range(2):
        add_variance(x, E_ATT + i, sign * turned * turned)
    add_variance(x, E_ATT + 2, sign * yawed * yawed)
    for i in range(3):
        add_variance(x, E_VEL + i, sign * gained * gained)
        add_variance(x, E_POS + i, sign * 0.25 * gained * gained * span * span)


def inflate_after_change(x: State, k: Parameters, imu: ImuRow) -> None:
    """Inflate P before the first sample of another inertial unit, or of one that is doubted.

    By how much its biases may differ from those that were estimated, as at a start where that is
    infinite, and by what the samples before may have done to attitude and velocity.
    """
    gyro = imu.gyro_std if isfinite(imu.gyro_std) else k.gyro_bias_std
    accel = imu.accel_std if isfinite(imu.accel_std) else k.accel_bias_std
    for i in range(3):
        add_variance(x, E_BG + i, gyro * gyro)
        add_variance(x, E_BA + i, accel * accel)
        add_variance(x, E_ATT + i, imu.turned * imu.turned)
        add_variance(x, E_VEL + i, imu.gained * imu.gained)
