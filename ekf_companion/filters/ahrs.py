"""Attitude alone, our own: a Kalman filter of attitude error and gyro bias, six states.

The gyro turns a frame i, which hardly turns itself, as bias and noise are small: specific force
is low-passed there (:mod:`~ekf_companion.filters.plumb`), and the field is averaged. Some times a
second the filter compares both with down and north and moves frame i, not what was low-passed in
it. Gravity moves roll, pitch and bias; the field moves yaw and bias, never roll and pitch. Errors
of both last for seconds: a variance counts as often as the errors are new.

Error state: rotation vector in n (q_nb (true) = exp(theta_n) q_nb), gyro bias in b (true less
estimated). Source: Sola 2017, arXiv 1711.02508; Laidig, Seel 2023, "VQF", arXiv 2203.17024, for
frame i, rest and the recovery after a disturbance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters import readings
from ekf_companion.filters.ahrs_estimator import USUAL, AhrsSettings, Estimator
from ekf_companion.filters.readings import Readings
from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]

NAME = "ahrs"


def run(events: Events, settings: AhrsSettings = USUAL) -> Solution:
    """Estimate attitude and gyro bias over a recording, each from what came before.

    Raises:
        LogError: There are no inertial samples.
    """
    # A gap is doubted, not integrated: what comes after it is known again
    taken = readings.read(events, math.inf)
    found = track(taken, settings)
    # What calibration leaves in gravity does not become less by looking on
    floor = np.diag([settings.gravity_sigma**2, settings.gravity_sigma**2, 0.0])
    return readings.solution(
        NAME,
        taken,
        found.q_nb,
        bias=found.bias,
        covariance=found.covariance[:, :3, :3] + floor,
        is_still=found.is_still,
        counts=found.counts,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Track:
    """All that the filter estimates."""

    q_nb: Array
    """From magnetic north, shape (n, 4)."""
    bias: Array
    """rad/s, b, shape (n, 3)."""
    covariance: Array
    """Of the error state, shape (n, 6, 6)."""
    is_still: npt.NDArray[np.bool_]
    """Shape (n,)."""
    counts: dict[str, tuple[int, int]]
    """By aid: how many were fused, how many refused."""


def track(taken: Readings, settings: AhrsSettings = USUAL) -> Track:
    """Run the filter over readings."""
    estimator = Estimator(settings)
    estimator.take(taken)
    at = np.array(estimator.step_of)
    return Track(
        q_nb=so3.multiply(np.array(estimator.corrections)[at], np.array(estimator.strapdown)),
        bias=np.array(estimator.biases)[at],
        covariance=np.array(estimator.covariances)[at],
        is_still=np.array(estimator.is_still),
        counts={aid: (count, estimator.refused[aid]) for aid, count in estimator.counts.items()},
    )


__all__ = ["AhrsSettings", "Track", "run", "track"]
