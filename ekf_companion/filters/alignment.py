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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Window:
    """The samples and aids from which the first estimate is made."""

    gyro: Array
    accel: Array
    fix: Position
    velocity: Velocity | None
    azimuths: Sequence[Azimuth]
    is_rest: bool


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
    window = _window(gyro[rows], accel[rows], recent, settings)
    levelled = level(window.accel.mean(axis=0))
    yaw, north = _north(levelled, window.azimuths)
    q_nb = turn(levelled, yaw)
    C_nb = so3.to_matrix(q_nb)
    vel_n, vel_std = _velocity(window)
    state = Nominal(
        q_nb=q_nb,
        vel_n=vel_n,
        # The fix is of the antenna
        pos_n=window.fix.pos_n - C_nb @ window.fix.lever_b,
        # A gyro at rest measures its bias and the Earth's rotation
        gyro_bias=window.gyro.mean(axis=0) - C_nb.T @ rate_n if window.is_rest else np.zeros(3),
    )
    P = _covariance(state, window, north, vel_std, settings)
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


def _window(
    gyro: Array, accel: Array, recent: Sequence[Observation], settings: FilterSettings
) -> _Window:
    velocities = [aid for aid in recent if isinstance(aid, Velocity)]
    velocity = velocities[-1] if velocities else None
    moves = velocity is not None and float(np.linalg.norm(velocity.vel_n)) > LARGEST_REST_SPEED
    samples = np.hstack([gyro, accel])
    is_quiet = is_stationary(samples.mean(axis=0), samples.std(axis=0), settings.align)
    return _Window(
        gyro=gyro,
        accel=accel,
        fix=[aid for aid in recent if isinstance(aid, Position)][-1],
        velocity=velocity,
        azimuths=[aid for aid in recent if isinstance(aid, Azimuth)],
        is_rest=bool(is_quiet) and not moves,
    )


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


def _velocity(window: _Window) -> tuple[Array, Array]:
    """Return the velocity and one sigma of each of its components, m/s."""
    vel_n, std = np.zeros(3), np.full(3, UNKNOWN_VELOCITY)
    if window.velocity is not None:
        known = slice(len(window.velocity.vel_n))
        vel_n[known], std[known] = window.velocity.vel_n, window.velocity.std
    return vel_n, np.minimum(std, LARGEST_REST_SPEED) if window.is_rest else std


def _covariance(
    state: Nominal, window: _Window, north: Azimuth, vel_std: Array, settings: FilterSettings
) -> Array:
    imu = settings.imu
    # One sigma of the means, of the worst axis
    of_gyro, of_accel = (
        float(one.std(axis=0).max()) / np.sqrt(len(one)) for one in (window.gyro, window.accel)
    )
    tilt = of_accel / STANDARD_GRAVITY
    bias = imu.gyro_bias
    if window.is_rest:
        bias = np.hypot(of_gyro, 0.1 * imu.gyro_bias)
    else:
        tilt = np.hypot(tilt, MOVING_TILT)
    of_biases = np.repeat([bias, imu.accel_bias], 3)
    P = np.diag(np.square(np.concatenate([np.zeros(3), vel_std, window.fix.std, of_biases])))
    P[np.ix_(_ATT_BA, _ATT_BA)] = _levelled_covariance(state, north, tilt, imu.accel_bias)
    return P


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
