"""Decide units, order, gaps and axes of the inertial samples."""

from __future__ import annotations

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.order import untangle
from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.readers.units import ACCELERATION, SECONDS, nearest
from ekf_companion.lidar.recording import InertialSamples
from ekf_companion.nav.arrays import Array

USUAL_INTERVAL = 0.005
"""s: inertial sensors of lidars sample at 100 to 400 Hz."""
GRAVITY = 9.80665
GAP = 3.5
"""Intervals without a sample that are called a gap: three samples are missing."""


def decide_inertial(source: Source) -> tuple[InertialSamples, list[str]]:
    """Return the samples in SI units and in order, and sentences about them.

    Raises:
        LogError: There are none, or they cannot be meant.
    """
    stored, name = source.inertial, source.inertial_name
    where = f"{source.name}: {name}"
    sentences = list[str]()
    if len(stored.stamp) < 2:
        raise LogError(f"{where}: {len(stored.stamp)} inertial samples; scans alone do not suffice")
    rows = np.column_stack((stored.stamp, stored.gyro, stored.accel))
    good = np.isfinite(rows).all(axis=1)
    if not good.all():
        sentences.append(f"{(~good).sum()} inertial samples are not finite: left out")
        rows = rows[good]
    kept, words = untangle(rows[:, 0], "inertial samples")
    rows = rows[kept]
    sentences += words
    again = np.zeros(len(rows), bool)
    again[1:] = np.diff(rows[:, 0]) == 0
    if again.any():
        sentences.append(f"{again.sum()} inertial samples repeat a stamp: left out")
        rows = rows[~again]
    if len(rows) < 2:
        raise LogError(f"{where}: fewer than two inertial samples with stamps of their own")
    step = float(np.median(np.diff(rows[:, 0])))
    unit = source.inertial_stamp_unit or nearest(step, USUAL_INTERVAL, SECONDS)
    if source.inertial_stamp_unit is None and unit != 1.0:
        sentences.append(f"stamps of inertial samples are {SECONDS[unit]}, not seconds")
    stamp = rows[:, 0] if unit == 1.0 else rows[:, 0] / round(1.0 / unit)
    gyro, accel = rows[:, 1:4], rows[:, 4:7]
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    if size == 0 or not np.ptp(rows[:, 1:], axis=0).any():
        raise LogError(
            f"{where}: all {len(rows)} samples are the same: the sensor was not read, "
            "or another topic has the real ones"
        )
    scale = nearest(size, GRAVITY, ACCELERATION)
    if scale != 1.0:
        sentences.append(
            f"specific force is in {ACCELERATION[scale]} (median {size:.3g}): "
            f"multiplied by {scale:g}"
        )
        accel = accel * scale
        size *= scale
    if not 0.5 < size / GRAVITY < 2.0:  # a vehicle that flies on average carries its weight
        raise LogError(
            f"{where}: the specific force is {size:.3g} m/s2 (median), gravity is 9.81: "
            "neither m/s2 nor g; the accelerometer's scale or topic is wrong"
        )
    sentences.append(
        f"{len(rows)} inertial samples at {1 / (step * unit):.0f} Hz, specific force in "
        f"{ACCELERATION[scale]}"
    )
    sentences += [*_gaps(stamp), _gravity(accel)]
    return InertialSamples(stamp, gyro, accel), sentences


def _gaps(stamp: Array) -> list[str]:
    steps = np.diff(stamp)
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    if not len(gaps):
        return []
    longest = gaps[np.argmax(steps[gaps])]
    return [
        f"inertial samples are missing {len(gaps)} times, {steps[gaps].sum():.2f} s in all; the "
        f"longest gap is {steps[longest]:.2f} s at {stamp[longest] - stamp[0]:.1f} s"
    ]


def _gravity(accel: Array) -> str:
    """Return the sentence that names the axis along which gravity lies."""
    mean = accel.mean(axis=0)
    axis = int(np.argmax(np.abs(mean)))
    side = "+" if mean[axis] > 0 else "-"
    angle = float(np.degrees(np.arccos(abs(mean[axis]) / np.linalg.norm(mean))))
    name = f"{side}{'xyz'[axis]}"
    if name == "+z":
        return f"gravity lies along z, {angle:.0f} deg off: z is up"
    return (
        f"gravity lies along {name} of the inertial sensor, not +z ({angle:.0f} deg off): it is "
        "mounted so, or its axes are exchanged; poses count from its first attitude"
    )
