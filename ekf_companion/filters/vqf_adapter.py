"""VQF by its authors' own package, for comparison only; ``pip install vqf`` brings it.

Source: Laidig, Seel 2023, "VQF: highly accurate IMU orientation estimation with bias estimation
and magnetic disturbance rejection", Information Fusion 91, arXiv 2203.17024.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import ConfigError
from ekf_companion.filters import readings
from ekf_companion.filters.samples import LONGEST
from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]

NAME = "vqf"
UNEVEN = 0.2
"""Share of the samples' steps that may differ from the usual one by half of it."""


def run(events: Events, gap: float = LONGEST) -> Solution:
    """Run VQF with its own settings; it takes the samples as evenly spaced.

    Args:
        events: The recording.
        gap: Silence of the inertial sensor beyond which only the longest part counts, s.

    Raises:
        LogError: There are no inertial samples.
        ConfigError: The package is not installed.
    """
    package = _package()
    taken = readings.read(events, gap)
    steps = taken.steps
    step = float(np.median(steps))
    estimator = package.VQF(step)
    gyro, accel, mag = (_forward_left_up(v) for v in (taken.gyro_b, taken.accel_b, taken.mag_b))
    has_mag = readings.known_rows(mag)
    if has_mag.all():
        found = estimator.updateBatch(gyro, accel, mag)
        q_nb, bias, is_still = found["quat9D"], found["bias"], found["restDetected"]
    else:
        q_nb, bias, is_still = _one_by_one(estimator, gyro, accel, mag, has_mag)
    q_nb = _north_east_down(q_nb)
    if not has_mag.any():
        # Its yaw of nought points east
        q_nb = so3.multiply(so3.from_euler(0.0, 0.0, -0.5 * np.pi), q_nb)
    notes: tuple[str, ...] = ()
    if np.mean(np.abs(steps - step) > 0.5 * step) > UNEVEN:
        notes = ("the samples are not evenly spaced, which VQF takes them to be",)
    return readings.solution(
        NAME,
        taken,
        q_nb,
        bias=_forward_left_up(bias),
        is_still=np.asarray(is_still, dtype=bool),
        notes=notes,
    )


def _package() -> Any:
    try:
        return importlib.import_module("vqf")
    except ImportError as error:
        raise ConfigError(
            "filter vqf: its package is not installed; pip install vqf brings it"
        ) from error


def _one_by_one(
    estimator: Any, gyro: Array, accel: Array, mag: Array, has_mag: npt.NDArray[np.bool_]
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
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
    """Turn vectors between forward-right-down and forward-left-up, either way."""
    return np.ascontiguousarray(values * np.array([1.0, -1.0, -1.0]))


def _north_east_down(q: Array) -> Array:
    """Return q_nb of east-north-up from forward-left-up."""
    half = np.sqrt(0.5)
    swap = np.array([0.0, half, half, 0.0])  # east-north-up into north-east-down
    roll = np.array([0.0, 1.0, 0.0, 0.0])  # forward-left-up from forward-right-down
    return np.asarray(so3.multiply(so3.multiply(swap, q), roll))
