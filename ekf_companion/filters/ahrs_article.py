"""The article's attitude filter: Euler angles, each with a Kalman filter of its own.

The gyro turns roll, pitch and yaw by Euler's kinematics; the accelerometer shows roll and pitch,
the magnetometer, levelled by these, yaw; each angle is corrected by a gain of its own variance,
as if the three had nothing to do with each other. The magnetometer is calibrated beforehand by
the largest and smallest value that each axis has in the whole recording.

Two slips are corrected, and shown by the preset ``article``: the yaw innovation is not wrapped
at +-180 deg, so that north seen from the other side pulls the yaw once round; and yaw is taken
by ``atan`` of the ratio, which cannot tell south from north. What is the method's own stays: the
kinematics fail at a pitch of +-90 deg, and any acceleration is taken for gravity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ekf_companion.filters import readings
from ekf_companion.filters.readings import Readings, first_attitude, known_rows
from ekf_companion.filters.samples import LONGEST
from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]
Preset = Literal["corrected", "article"]

COVERED = 0.6
"""Every axis must reach so much of the range of the widest one, or the field is not calibrated."""
ROUND = 0.2
"""How far the calibrated field's mean length may be from 1, and one sigma of it: or its ranges
are those of noise or of a turn about one axis, and not of a sphere."""
STEEP = 0.05
"""Least cosine of the pitch in the kinematics."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArticleSettings:
    """Variances, one per angle; those of the article's kind."""

    gyro: float = 1e-3
    """What a second adds to that of each angle, rad^2/s."""
    accel: float = 0.03
    """Of roll and pitch by the accelerometer, rad^2."""
    mag: float = 0.03
    """Of yaw by the magnetometer, rad^2."""


def run(
    events: Events,
    preset: Preset = "corrected",
    settings: ArticleSettings = ArticleSettings(),
    gap: float = LONGEST,
) -> Solution:
    """Estimate attitude over a recording; the calibration of the magnetometer knows all of it.

    Args:
        events: The recording.
        preset: ``article`` has the two slips.
        settings: The variances.
        gap: Silence of the inertial sensor beyond which only the longest part counts, s.

    Raises:
        LogError: There are no inertial samples.
    """
    taken = readings.read(events, gap)
    mag_b, note = calibrated(taken.mag_b)
    angles, variances = _filter(taken, mag_b, settings, has_slips=preset == "article")
    turn = so3.to_matrix(so3.from_euler(0.0, 0.0, angles[:, 2]))
    covariance = np.zeros((len(angles), 3, 3))
    for index in range(3):
        covariance[:, index, index] = variances[:, index]
    return readings.solution(
        "ahrs-article" if preset == "corrected" else "ahrs-article (as printed)",
        taken,
        so3.from_euler(*angles.T),
        covariance=np.einsum("nij,njk,nlk->nil", turn, covariance, turn),
        notes=(note,) if note else (),
    )


def calibrated(mag_b: Array) -> tuple[Array, str]:
    """Take off the middle of each axis's range and make the ranges alike.

    Args:
        mag_b: gauss, shape (n, 3), NaN where there is none.

    Returns:
        The field, and why it is not calibrated, in a sentence; empty if it is.
    """
    seen = mag_b[np.isfinite(mag_b).all(axis=1)]
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


def _filter(
    taken: Readings, mag_b: Array, settings: ArticleSettings, *, has_slips: bool
) -> tuple[Array, Array]:
    """Return roll, pitch, yaw, rad, and their variances, shapes (n, 3)."""
    roll, pitch, yaw = so3.to_euler(first_attitude(taken)).tolist()
    rolls = pitches = yaws = 1.0
    angles, variances = [], []
    has_mag = known_rows(mag_b).tolist()
    for dt, (p, q, r), (fx, fy, fz), mag, is_seen in zip(
        taken.steps.tolist(),
        taken.gyro_b.tolist(),
        taken.accel_b.tolist(),
        mag_b.tolist(),
        has_mag,
        strict=True,
    ):
        # Predict by Euler's kinematics
        sr, cr = math.sin(roll), math.cos(roll)
        cp = math.cos(pitch)
        cp = math.copysign(max(abs(cp), STEEP), cp)
        across = q * sr + r * cr
        roll += (p + across * math.sin(pitch) / cp) * dt
        pitch += (q * cr - r * sr) * dt
        yaw += across / cp * dt
        rolls, pitches, yaws = (v + settings.gyro * dt for v in (rolls, pitches, yaws))
        # Correct roll and pitch by the accelerometer
        roll, rolls = _mixed(roll, rolls, math.atan2(-fy, -fz), settings.accel)
        level_pitch = math.atan2(fx, math.hypot(fy, fz))
        pitch, pitches = _mixed(pitch, pitches, level_pitch, settings.accel)
        # Correct yaw by the levelled field
        if is_seen:
            north, east = _levelled(mag, roll, pitch)
            if has_slips:
                seen = math.atan(-east / north) if north else 0.0
                gain = yaws / (yaws + settings.mag)
                yaw, yaws = yaw + gain * (seen - yaw), (1.0 - gain) * yaws
            else:
                yaw, yaws = _mixed(yaw, yaws, math.atan2(-east, north), settings.mag)
        roll, pitch, yaw = _wrap(roll), _wrap(pitch), _wrap(yaw)
        angles.append((roll, pitch, yaw))
        variances.append((rolls, pitches, yaws))
    return np.array(angles), np.array(variances)


def _mixed(angle: float, variance: float, seen: float, R: float) -> tuple[float, float]:
    """Return an angle and its variance after a measurement of it."""
    gain = variance / (variance + R)
    return angle + gain * _wrap(seen - angle), (1.0 - gain) * variance


def _levelled(mag: list[float], roll: float, pitch: float) -> tuple[float, float]:
    """Return the field's parts along the heading and to the right of it."""
    x, y, z = mag
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    return x * cp + (y * sr + z * cr) * sp, y * cr - z * sr


def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
