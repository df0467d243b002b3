"""The inertial unit clips, vibrates, or has errors that are not configured."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.truth import paths
from benchmarks.truth.cases.case import Case, flown, shake
from benchmarks.truth.draw import DEG, Draw
from benchmarks.truth.motion import Motion
from benchmarks.truth.sensors import Readings

G = 9.81


def clip_accel(draw: Draw) -> Readings:
    """An aeroplane's circuits, turns of 1.34 g; the accelerometer stops at about 1.3 g an axis."""
    readings = flown(draw, paths.circuits(draw), 120.0)
    limit = draw.about(1.3 * G, 0.03)
    np.clip(readings.inertial.accel, -limit, limit, out=readings.inertial.accel)
    return readings


def clip_gyro(draw: Draw) -> Readings:
    """Fast figure-eights; the gyro stops at about 70 % of the highest rate."""
    readings = flown(draw, paths.figure_eights(draw, 14.0), 120.0)
    limit = draw.about(0.7, 0.15) * float(np.abs(readings.inertial.gyro).max())
    np.clip(readings.inertial.gyro, -limit, limit, out=readings.inertial.gyro)
    return readings


def vibration_1(draw: Draw) -> Readings:
    """Figure-eights; a vibration sampled as a slow wave of about 1 m/s2 and 0.02 rad/s."""
    return _shaken(draw, 1.0, 0.02)


def vibration_3(draw: Draw) -> Readings:
    """Figure-eights; a vibration sampled as a slow wave of about 3 m/s2 and 0.02 rad/s."""
    return _shaken(draw, 3.0, 0.02)


def _shaken(draw: Draw, accel: float, gyro: float) -> Readings:
    readings = flown(draw, paths.figure_eights(draw), 100.0)
    shake(draw, readings, accel, gyro)
    return readings


def scale_error(draw: Draw) -> Readings:
    """Loops and rolls; gyro and accelerometer scaled about 1 % wrong, each axis its own sign."""
    readings = flown(draw, paths.aerobatics(draw), 120.0)
    for values in (readings.inertial.gyro, readings.inertial.accel):
        values *= 1.0 + np.array([draw.about(0.01) * draw.sign() for _ in range(3)])
    return readings


def misaligned(draw: Draw) -> Readings:
    """Figure-eights; gyro and accelerometer turned by about 1 deg, each about its own axis."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    for values in (readings.inertial.gyro, readings.inertial.accel):
        values[:] = Rotation.from_rotvec(draw.about(1.0 * DEG) * draw.unit()).apply(values)
    return readings


def lever_arm(draw: Draw) -> Readings:
    """Fast figure-eights; the antenna is about 1 m from the inertial unit, not configured."""
    readings = flown(draw, paths.figure_eights(draw, 14.0), 120.0)
    readings.fixes.lever_b[:] = draw.about(1.0) * draw.unit()
    return readings


def bias_25_hz(draw: Draw) -> Readings:
    """Hover, inertial rows at 25 Hz; the accelerometer is biased by about 0.5 m/s2."""
    readings = flown(draw, paths.hover(draw), 120.0, imu_rate=25)
    readings.inertial.accel += draw.about(0.5) * draw.unit()
    return readings


def bias_step(draw: Draw) -> Readings:
    """Figure-eights; the accelerometer's bias steps by about 0.25 m/s2, as after a shock."""
    return _stepping(draw, paths.figure_eights(draw))


def bias_step_hover(draw: Draw) -> Readings:
    """Hover; the accelerometer's bias steps by about 0.25 m/s2, as after a shock."""
    return _stepping(draw, paths.hover(draw))


def _stepping(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 120.0)
    inertial = readings.inertial
    inertial.accel[inertial.t > draw.about(60.0)] += draw.about(0.25) * draw.unit()
    return readings


CASES: tuple[Case, ...] = (
    clip_accel,
    clip_gyro,
    vibration_1,
    vibration_3,
    scale_error,
    misaligned,
    lever_arm,
    bias_25_hz,
    bias_step,
    bias_step_hover,
)
