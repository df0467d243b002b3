"""VQF by its authors' own package, for comparison only; ``pip install vqf`` installs it.

Source: Laidig, Seel 2023, "VQF: highly accurate IMU orientation estimation with bias estimation
and magnetic disturbance rejection", Information Fusion 91, arXiv 2203.17024.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from ekf_companion.errors import part_of
from ekf_companion.filters.gap import SHORTEST, SLOW
from ekf_companion.filters.inertial import LONGEST_GAP, turn
from ekf_companion.filters.marg import BLIND, MargSamples, marg_samples
from ekf_companion.filters.solution import AttitudeEstimates, Solution, attitude_solution
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask, known_rows
from ekf_companion.nav.measurements import Events

UNEVEN = 0.2
"""Largest share of steps that differ from the usual one by more than half of it."""


def run(events: Events, gap: float = LONGEST_GAP) -> Solution:
    """Run VQF with its own settings; it assumes evenly spaced samples.

    Beyond a gap in the inertial samples, s, only the longest part counts.

    Raises:
        LogError: There are no inertial samples.
        MissingPackageError: The package is not installed.
    """
    with part_of("filters", "filter vqf"):
        package = importlib.import_module("vqf")
    samples = marg_samples(events, gap)
    steps = samples.steps
    step = float(np.median(steps))
    estimator = package.VQF(step)
    at, *even = _even(samples, step)
    gyro, accel, mag = (_forward_left_up(v) for v in even)
    has_mag = known_rows(mag)
    if has_mag.all():
        found = estimator.updateBatch(gyro, accel, mag)
        q_nb, bias, is_still = found["quat9D"], found["bias"], found["restDetected"]
    else:
        q_nb, bias, is_still = _one_by_one(estimator, gyro, accel, mag, has_mag)
    q_nb, bias, is_still = q_nb[at], bias[at], np.asarray(is_still)[at]
    q_nb = _north_east_down(q_nb)
    if not has_mag.any():
        # Its yaw of 0 points east
        q_nb = turn(q_nb, -0.5 * np.pi)
    notes: tuple[str, ...] = ()
    if np.mean(np.abs(steps - step) > 0.5 * step) > UNEVEN:
        notes = ("the samples are not evenly spaced, which VQF takes them to be",)
    is_still = np.asarray(is_still, dtype=bool)
    bias = _forward_left_up(bias)
    found = AttitudeEstimates(q_nb=q_nb, bias=bias, is_still=is_still, notes=notes)
    return attitude_solution("vqf", samples, found)


def _even(samples: MargSamples, step: float) -> tuple[Indices, Array, Array, Array]:
    """Return where the samples are among even ones, and these: rates, specific forces, fields.

    In a gap they are interpolated or, where it is too long for that, do not turn.
    """
    t = (samples.t_ns - samples.t_ns[0]) * 1e-9
    spans = np.where(samples.steps > max(SHORTEST, SLOW * step), samples.steps, step)
    spans[0] = step
    at = np.cumsum(np.maximum(np.rint(spans / step), 1.0).astype(np.int64)) - 1
    index = np.arange(at[-1] + 1)
    time = np.interp(index, at, t)
    gyro, accel = (
        np.stack([np.interp(time, t, axis) for axis in values.T], axis=1)
        for values in (samples.gyro_b, samples.accel_b)
    )
    gyro[at], accel[at] = samples.gyro_b, samples.accel_b
    for i in np.flatnonzero(spans > BLIND):
        gyro[at[i - 1] + 1 : at[i]] = 0.0
    mag = np.full_like(gyro, np.nan)
    mag[at] = samples.mag_b
    return at, gyro, accel, mag


def _one_by_one(
    estimator: Any, gyro: Array, accel: Array, mag: Array, has_mag: Mask
) -> tuple[Array, Array, Mask]:
    q, bias, is_still = np.empty((len(gyro), 4)), np.empty((len(gyro), 3)), np.zeros(len(gyro))
    has_any = bool(has_mag.any())
    for i in range(len(gyro)):
        if has_mag[i]:
            estimator.update(gyro[i], accel[i], mag[i])
        else:
            estimator.update(gyro[i], accel[i])
        q[i] = estimator.getQuat9D() if has_any else estimator.getQuat6D()
        bias[i] = estimator.getBiasEstimate()[0]
        is_still[i] = estimator.getRestDetected()
    return q, bias, is_still.astype(bool)


def _forward_left_up(values: Array) -> Array:
    """Convert vectors between forward-right-down and forward-left-up, either way."""
    return np.ascontiguousarray(values * np.array([1.0, -1.0, -1.0]))


def _north_east_down(q: Array) -> Array:
    """Return q_nb of east-north-up from forward-left-up."""
    half = np.sqrt(0.5)
    swap = np.array([0.0, half, half, 0.0])  # east-north-up into north-east-down
    roll = np.array([0.0, 1.0, 0.0, 0.0])  # forward-left-up from forward-right-down
    return np.asarray(so3.multiply(so3.multiply(swap, q), roll))
