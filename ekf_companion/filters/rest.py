"""The rest with which a walk begins: which way is down, and what the sensors say when still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.filters.detector import moving_variance, runs
from ekf_companion.filters.samples import levelled
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]

WINDOW = 0.5
"""Over which the samples must agree, s."""
SHORTEST = 0.5
"""Of a rest, s."""
LATEST = 10.0
"""After the first sample a rest must have begun, s."""
GYRO = 0.03
"""Largest deviation at rest, root mean square, rad/s: a standing person sways by a third."""
ACCEL = 0.2
"""Largest deviation at rest, root mean square, m/s^2: five times a small sensor's noise."""
LIGHTEST, HEAVIEST = 5.0, 15.0
"""m/s^2; what an accelerometer reads at rest may be off by its scale, not by half."""
SLOWEST = 50.0
"""Samples per second below which a stride cannot be followed, Hz."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rest:
    """What was found."""

    first: int
    """Index of its first sample."""
    period: float
    """From one sample to the next, s."""
    gravity: float
    """Mean of the specific force, its length, m/s^2: gravity as this accelerometer measures it."""
    gyro: Array
    """Mean rate, rad/s, b: the bias."""
    q_nb: Array
    """Level from the mean specific force, yaw 0."""
    gyro_noise: float
    """Root mean square of all axes about their means, rad/s."""
    accel_noise: float
    """m/s^2."""
    notes: tuple[str, ...]
    """What the user should know."""


def find(imu: Events) -> Rest:
    """Find the first rest of inertial samples with ascending stamps.

    Raises:
        LogError: There are too few samples, they move from the start, or they do not feel gravity.
    """
    if len(imu) < 2:
        raise LogError(
            f"{len(imu)} inertial samples: too few to navigate by; record gyro and accelerometer "
            f"at {SLOWEST:g} Hz or more"
        )
    period = float(np.median(np.diff(imu.t_ns))) * 1e-9
    if period * SLOWEST > 1.0:
        raise LogError(
            f"{1.0 / period:.1f} inertial samples per second: too few to follow a stride; record "
            f"at {SLOWEST:g} Hz or more"
        )
    gyro, accel = imu.values[:, 0:3], imu.values[:, 3:6]
    half = round(0.5 * WINDOW / period)
    is_still = moving_variance(gyro, half) < GYRO**2
    is_still &= moving_variance(accel, half) < ACCEL**2
    stamps = (imu.t_ns - imu.t_ns[0]) * 1e-9
    for first, last in runs(is_still):
        # Half a window at an edge where it moves has seen that motion, and spoils the bias.
        first, last = first + half * (first > 0), last - half * (last < len(imu))
        if (
            first < last
            and stamps[first] <= LATEST
            and stamps[last - 1] - stamps[first] >= SHORTEST
        ):
            return _rest(gyro[first:last], accel[first:last], first, period, float(stamps[first]))
    raise LogError(
        f"no rest of {SHORTEST:g} s in the first {LATEST:g} s of {stamps[-1]:.1f} s: down and the "
        "bias of the gyro cannot be found; stand still for two seconds before walking"
    )


def _rest(gyro: Array, accel: Array, first: int, period: float, start: float) -> Rest:
    mean = accel.mean(axis=0)
    gravity = float(np.linalg.norm(mean))
    if not LIGHTEST < gravity < HEAVIEST:
        raise LogError(
            f"the accelerometer reads {gravity:.2f} m/s^2 at rest, where gravity is 9.8: it is "
            "dead, or the log has another unit"
        )
    late = f"the first {start:.1f} s, before the sensor came to rest, were left out"
    return Rest(
        first=first,
        period=period,
        gravity=gravity,
        gyro=gyro.mean(axis=0),
        q_nb=levelled(mean),
        gyro_noise=float(np.sqrt(gyro.var(axis=0).sum())),
        accel_noise=float(np.sqrt(accel.var(axis=0).sum())),
        notes=(late,) if first else (),
    )
