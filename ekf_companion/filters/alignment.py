"""Initial alignment: level by the mean specific force, north by a heading, position by a fix.

Source: Groves 2013, section 5.6; Qin et al. 2020, "LINS: a lidar-inertial state estimator",
section IV.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.inertial import is_stationary, level, turn
from ekf_companion.filters.observation import Azimuth, Observation, Position, Velocity
from ekf_companion.filters.strapdown import ATT, BA, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import STANDARD_GRAVITY

MOVING_TILT = 0.2
"""One sigma of a level by the specific force in motion, rad: a turn at 2 m/s^2."""
LARGEST_REST_SPEED = 0.5
"""m/s; a receiver at rest reports less."""
UNKNOWN_VELOCITY = 10.0
"""One sigma of a velocity that no fix measures, m/s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InitialEstimate:
    """The first estimate."""

    t_ns: int
    """Stamp of an inertial sample."""
    state: Nominal
    P: Array
    """Covariance of the error state, shape (15, 15)."""


def align(
    t_ns: Stamps,
    gyro: Array,
    accel: Array,
    aids: Sequence[tuple[int, Observation]],
    settings: FilterSettings,
    rate_n: Array | None = None,
) -> InitialEstimate:
    """Align at the first fix that follows a window of samples with a heading in it.

    If the sensor rests in the window, the mean of the gyro is its bias, and the variance of both
    sensors gives the uncertainty of bias and level. Samples (rad/s and m/s^2, b, shape (n, 3)) and
    aids are in order of time; ``rate_n`` is the Earth's rotation, rad/s, None: it does not turn.

    Raises:
        LogError: The recording ends before that, or right there.
    """
    rate_n = np.zeros(3) if rate_n is None else rate_n
    window_ns = round(settings.align.time * 1e9)
    last = _find(t_ns, aids, window_ns)
    now = int(t_ns[last])
    rows = slice(int(np.searchsorted(t_ns, now - window_ns)), last + 1)
    recent = [aid for t, aid in aids if now - window_ns <= t <= now]
    fix = [aid for aid in recent if isinstance(aid, Position)][-1]
    velocity = next((aid for aid in reversed(recent) if isinstance(aid, Velocity)), None)
    moves = velocity is not None and float(np.linalg.norm(velocity.vel_n)) > LARGEST_REST_SPEED
    samples = np.hstack([gyro[rows], accel[rows]])
    mean, std = samples.mean(axis=0), samples.std(axis=0)
    is_rest = bool(is_stationary(mean, std, settings.align)) and not moves
    levelled = level(mean[3:])
    yaw, north = _north(levelled, [aid for aid in recent if isinstance(aid, Azimuth)])
    q_nb = turn(levelled, yaw)
    C_nb = so3.to_matrix(q_nb)
    vel_n, vel_std = _velocity(velocity, is_rest=is_rest)
    state = Nominal(
        q_nb=q_nb,
        vel_n=vel_n,
        # The fix is of the antenna
        pos_n=fix.pos_n - C_nb @ fix.lever_b,
        # A gyro at rest measures its bias and the Earth's rotation
        gyro_bias=mean[:3] - C_nb.T @ rate_n if is_rest else np.zeros(3),
    )
    # One sigma of the means of gyro and accelerometer, of the worst axis
    of_gyro, of_accel = std.reshape(2, 3).max(axis=1) / np.sqrt(len(samples))
    imu, tilt = settings.imu, of_accel / STANDARD_GRAVITY
    tilt = tilt if is_rest else np.hypot(tilt, MOVING_TILT)
    bias = np.hypot(of_gyro, 0.1 * imu.gyro_bias) if is_rest else imu.gyro_bias
    stds = [np.zeros(3), vel_std, fix.std, np.repeat([bias, imu.accel_bias], 3)]
    P = np.diag(np.square(np.concatenate(stds)))
    P[np.ix_(_ATT_BA, _ATT_BA)] = _levelled_covariance(state, north, tilt, imu.accel_bias)
    return InitialEstimate(t_ns=now, state=state, P=P)


def _find(t_ns: Stamps, aids: Sequence[tuple[int, Observation]], window_ns: int) -> int:
    """Return the first sample after a whole window, at a fix, with a heading in the window.

    Raises:
        LogError: There is none, or none that leaves a sample to estimate.
    """
    fixes = np.array([t for t, aid in aids if isinstance(aid, Position)], dtype=np.int64)
    headings = np.array([t for t, aid in aids if isinstance(aid, Azimuth)], dtype=np.int64)
    if not len(fixes) or not len(headings):
        raise LogError("no fix or no heading: there is nothing to begin from")
    # At a fix, as in motion its position is soon out of date
    at = np.searchsorted(t_ns, np.maximum(fixes, int(t_ns[0]) + window_ns))
    at = at[at < len(t_ns) - 1]
    now, before = t_ns[at], np.searchsorted(headings, t_ns[at], side="right") - 1
    is_ready = (before >= 0) & (headings[np.maximum(before, 0)] >= now - window_ns)
    is_ready &= fixes[: len(at)] >= now - window_ns
    if not is_ready.any():
        raise LogError(
            "the recording ends before level, north and position are known: a fix and a heading "
            f"within {window_ns * 1e-9:g} s (align.time) of each other are needed, and motion "
            "after them"
        )
    return int(at[np.argmax(is_ready)])


def _north(levelled: Array, azimuths: Sequence[Azimuth]) -> tuple[float, Azimuth]:
    """Return the yaw of a levelled attitude by azimuths, and the last of these.

    An azimuth of a vertical direction does not count; if all are, the yaw is not known.
    """
    state = Nominal(q_nb=levelled, vel_n=np.zeros(3), pos_n=np.zeros(3))
    usable = [aid for aid in azimuths if aid.is_usable(state)]
    if not usable:
        return 0.0, replace(azimuths[-1], std=np.pi)
    turns = np.array([float(aid.innovation(state)[0]) for aid in usable])
    return float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean())), usable[-1]


def _velocity(measured: Velocity | None, *, is_rest: bool) -> tuple[Array, Array]:
    """Return the velocity and one sigma of each of its components, m/s."""
    vel_n, std = np.zeros(3), np.full(3, UNKNOWN_VELOCITY)
    if measured is not None:
        known = slice(len(measured.vel_n))
        vel_n[known], std[known] = measured.vel_n, measured.std
    return vel_n, np.minimum(std, LARGEST_REST_SPEED) if is_rest else std


_ATT_BA = np.r_[ATT, BA]


def _levelled_covariance(state: Nominal, azimuth: Azimuth, tilt: float, accel_bias: float) -> Array:
    """Return the covariance of attitude and accelerometer bias, shape (6, 6), of a levelled start.

    The error of a level is the bias over gravity. It turns the heading too, by the Jacobian of the
    azimuth: the more, the steeper the field. All three are correlated. The sigmas are of the level
    by other causes than the bias, rad, and of the bias, m/s^2.
    """
    C_nb = so3.to_matrix(state.q_nb)
    # Turns about north, east and down by: bias (b), other tilt, azimuth
    by = np.zeros((3, 6))
    by[:2, :3] = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) @ C_nb / STANDARD_GRAVITY
    by[:2, 3:5] = tilt * np.eye(2)
    # The azimuth measured is predicted whatever the error of the level is
    H_n = azimuth.jacobian(state)[0, ATT] @ C_nb.T
    by[2] = -H_n[:2] @ by[:2] / H_n[2]
    by[2, 5] = azimuth.std / H_n[2]
    errors = np.zeros((6, 6))
    errors[:3] = C_nb.T @ by
    errors[3:, :3] = np.eye(3)
    errors[:, :3] *= accel_bias
    return np.asarray(errors @ errors.T)
