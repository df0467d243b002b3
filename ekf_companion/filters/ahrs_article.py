"""The article's attitude filter: Euler angles, each with a Kalman filter of its own.

The gyro turns roll, pitch and yaw by Euler's kinematics; the accelerometer measures roll and pitch,
the magnetometer, levelled by these, yaw; each angle is corrected by a gain from its own variance,
as if the three were independent. The magnetometer is calibrated beforehand by the largest and
smallest value of each axis in the whole recording.

Two errors of the article are corrected, and kept by the preset ``article``: the yaw innovation is
not wrapped at +-180 deg, so that a field just beyond turns the yaw by a whole turn; and yaw is
computed by ``atan`` of the ratio, which does not distinguish south from north. The method's own
limits remain: the kinematics fail at a pitch of +-90 deg, and any acceleration counts as gravity.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from ekf_companion.filters.inertial import LONGEST_GAP
from ekf_companion.filters.marg import MargSamples, marg_samples
from ekf_companion.filters.solution import AttitudeEstimates, Solution, attitude_solution
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, known_rows
from ekf_companion.nav.measurements import Events

Preset = Literal["corrected", "article"]

COVERED = 0.6
"""Least range of an axis, as a share of the widest one, for the field to be calibrated."""
ROUND = 0.2
"""Largest error of the calibrated field's mean length from 1, and largest sigma of it: beyond, the
ranges are those of noise or of a turn about one axis, and not of a sphere."""
STEEP = 0.05
"""Least cosine of the pitch in the kinematics."""


GYRO, ACCEL, MAG = 1e-3, 0.03, 0.03
"""As in the article: the growth of the variance of each angle, rad^2/s; the variances of roll and
pitch by the accelerometer, and of yaw by the magnetometer, rad^2."""


def run(events: Events, preset: Preset = "corrected", gap: float = LONGEST_GAP) -> Solution:
    """Estimate attitude over a recording; the magnetometer's calibration uses all of it.

    Beyond a gap in the inertial samples, s, only the longest part counts.

    Raises:
        LogError: There are no inertial samples.
    """
    samples = marg_samples(events, gap)
    mag_b, note = calibrated(samples.mag_b)
    angles, variances = _filter(samples, mag_b, is_original=preset == "article")
    C = so3.to_matrix(so3.from_euler(0.0, 0.0, angles[:, 2]))
    covariance = variances[:, :, None] * np.eye(3)
    found = AttitudeEstimates(
        q_nb=so3.from_euler(*angles.T),
        covariance=np.einsum("nij,njk,nlk->nil", C, covariance, C),
        notes=(note,) if note else (),
    )
    name = "ahrs-article" if preset == "corrected" else "ahrs-article (as printed)"
    return attitude_solution(name, samples, found)


def calibrated(mag_b: Array) -> tuple[Array, str]:
    """Subtract the middle of each axis's range of fields, shape (n, 3), and equalise the ranges.

    The sentence says why the field is not calibrated; it is empty if it is.
    """
    seen = mag_b[known_rows(mag_b)]
    if not len(seen):
        return mag_b, ""
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = 0.5 * (high - low)
    length = np.linalg.norm((seen - 0.5 * (high + low)) / np.maximum(half, 1e-9), axis=1)
    is_round = abs(float(length.mean()) - 1.0) < ROUND and float(length.std()) < ROUND
    if half.min() < COVERED * half.max() or not is_round:
        reached = ", ".join(f"{each:.2f}" for each in half)
        return mag_b, (
            "the magnetometer is not calibrated: its axes reached only +-"
            f"{reached} gauss about their middles; turn the vehicle about all three axes"
        )
    return (mag_b - 0.5 * (high + low)) * (half.mean() / half), ""


def _filter(samples: MargSamples, mag_b: Array, *, is_original: bool) -> tuple[Array, Array]:
    """Return roll, pitch, yaw, rad, and their variances, shapes (n, 3)."""
    roll, pitch, yaw = so3.to_euler(samples.first_attitude()).tolist()
    rolls = pitches = yaws = 1.0
    angles, variances = [], []
    for dt, gyro, (fx, fy, fz), mag, missed in replace(samples, mag_b=mag_b).rows():
        # Predict by Euler's kinematics
        if missed is not None:
            if missed.gyro is not None:
                roll, pitch, yaw = _turned(roll, pitch, yaw, missed.gyro, missed.span)
            rolls, pitches = (v + missed.lost.tilt**2 for v in (rolls, pitches))
            yaws += missed.lost.yaw**2
        roll, pitch, yaw = _turned(roll, pitch, yaw, gyro, dt)
        rolls, pitches, yaws = (v + GYRO * dt for v in (rolls, pitches, yaws))
        # Correct roll and pitch by the accelerometer
        roll, rolls = _fused(roll, rolls, math.atan2(-fy, -fz), ACCEL)
        level_pitch = math.atan2(fx, math.hypot(fy, fz))
        pitch, pitches = _fused(pitch, pitches, level_pitch, ACCEL)
        # Correct yaw by the levelled field
        if mag is not None:
            north, east = _horizontal(mag, roll, pitch)
            if is_original:
                seen = math.atan(-east / north) if north else 0.0
                gain = yaws / (yaws + MAG)
                yaw, yaws = yaw + gain * (seen - yaw), (1.0 - gain) * yaws
            else:
                yaw, yaws = _fused(yaw, yaws, math.atan2(-east, north), MAG)
        roll, pitch, yaw = _wrap(roll), _wrap(pitch), _wrap(yaw)
        angles.append((roll, pitch, yaw))
        variances.append((rolls, pitches, yaws))
    return np.array(angles), np.array(variances)


def _turned(
    roll: float, pitch: float, yaw: float, gyro: list[float], dt: float
) -> tuple[float, float, float]:
    """Return the angles after a time, s, by Euler's kinematics in one step."""
    p, q, r = gyro
    sr, cr = math.sin(roll), math.cos(roll)
    cp = math.cos(pitch)
    cp = math.copysign(max(abs(cp), STEEP), cp)
    across = q * sr + r * cr
    turned = roll + (p + across * math.sin(pitch) / cp) * dt
    return turned, pitch + (q * cr - r * sr) * dt, yaw + across / cp * dt


def _fused(angle: float, variance: float, measured: float, R: float) -> tuple[float, float]:
    """Return an angle and its variance after a measurement of it."""
    gain = variance / (variance + R)
    return angle + gain * _wrap(measured - angle), (1.0 - gain) * variance


def _horizontal(mag: list[float], roll: float, pitch: float) -> tuple[float, float]:
    """Return the field's components along the heading and to the right of it."""
    x, y, z = mag
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    return x * cp + (y * sr + z * cr) * sp, y * cr - z * sr


def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
