"""Where a filter begins: level from the mean specific force, north from a heading, the first fix.

Source: Qin et al. 2020, "LINS: a lidar-inertial state estimator", section IV; Groves 2013,
section 5.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.observation import Azimuth, Observation, Position, Velocity
from ekf_companion.filters.samples import is_stationary, levelled
from ekf_companion.filters.strapdown import ATT, BA, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

MOVING_TILT = 0.2
"""One sigma of a level that was taken in motion, rad: a turn at 2 m/s^2."""
STANDING = 0.5
"""m/s; a receiver at rest says less."""
UNKNOWN_VELOCITY = 10.0
"""One sigma of a velocity that no fix says, m/s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Start:
    """The first estimate."""

    t_ns: int
    """Of an inertial sample."""
    state: Nominal
    P: Array
    """Covariance of the error state, shape (15, 15)."""


def find_start(
    t_ns: npt.NDArray[np.int64],
    gyro: Array,
    accel: Array,
    aids: Sequence[tuple[int, Observation]],
    settings: FilterSettings,
    rate_n: Array | None = None,
) -> Start:
    """Begin at the first fix that has a window of samples, and a heading in it, behind it.

    Where the sensor rests in the window, the mean of the gyro is its bias, and the variance of both
    sensors says how sure bias and level are.

    Args:
        t_ns: Times of the inertial samples, ascending, shape (n,).
        gyro: rad/s, b, shape (n, 3).
        accel: m/s^2, b, shape (n, 3).
        aids: Times and aids, ascending.
        settings: Those of the daemon: window, thresholds of rest, sigmas.
        rate_n: The Earth's rotation, rad/s; None: it does not turn.

    Raises:
        LogError: The recording ends before, or right there.
    """
    rate_n = np.zeros(3) if rate_n is None else rate_n
    window_ns = round(settings.align.time * 1e9)
    last = _find(t_ns, aids, window_ns)
    now = int(t_ns[last])
    rows = slice(int(np.searchsorted(t_ns, now - window_ns)), last + 1)
    recent = [aid for t, aid in aids if now - window_ns <= t <= now]
    fix = [aid for aid in recent if isinstance(aid, Position)][-1]
    speeds = [aid for aid in recent if isinstance(aid, Velocity)]
    samples = np.hstack([gyro[rows], accel[rows]])
    is_rest = bool(
        is_stationary(samples.mean(axis=0), samples.std(axis=0), settings.align)
    ) and not (speeds and float(np.linalg.norm(speeds[-1].vel_n)) > STANDING)
    level = levelled(accel[rows].mean(axis=0))
    yaw, north = _north(level, [aid for aid in recent if isinstance(aid, Azimuth)])
    q_nb = so3.multiply(so3.from_euler(0.0, 0.0, yaw), level)
    vel_n, vel_std = np.zeros(3), np.full(3, UNKNOWN_VELOCITY)
    if speeds:
        told = len(speeds[-1].vel_n)
        vel_n[:told], vel_std[:told] = speeds[-1].vel_n, speeds[-1].std
    if is_rest:
        vel_std = np.minimum(vel_std, STANDING)
    to_b = so3.to_matrix(q_nb).T
    state = Nominal(
        q_nb=q_nb,
        vel_n=vel_n,
        # The fix is of the antenna
        pos_n=fix.pos_n - to_b.T @ fix.lever_b,
        # What a gyro at rest reads beside the Earth's rotation
        gyro_bias=gyro[rows].mean(axis=0) - to_b @ rate_n if is_rest else np.zeros(3),
    )
    n = len(t_ns[rows])
    shaken = float(accel[rows].std(axis=0).max()) / np.sqrt(n) / STANDARD_GRAVITY
    tilt = shaken if is_rest else np.hypot(shaken, MOVING_TILT)
    bias = gyro[rows].std(axis=0).max() / np.sqrt(n)
    bias = np.hypot(bias, 0.1 * settings.imu.gyro_bias) if is_rest else settings.imu.gyro_bias
    own = np.concatenate(
        [
            np.zeros(3),
            *(vel_std, fix.std),
            *(np.full(3, bias), np.full(3, settings.imu.accel_bias)),
        ]
    )
    P = np.diag(np.square(own))
    P[np.ix_(_LEVELLED, _LEVELLED)] = _levelled(state, north, tilt, settings.imu.accel_bias)
    return Start(t_ns=now, state=state, P=P)


def _find(t_ns: Stamps, aids: Sequence[tuple[int, Observation]], window_ns: int) -> int:
    """Return the first sample after a whole window, at a fix, with a heading in the window.

    Raises:
        LogError: There is none, or none behind which a sample is left to estimate.
    """
    fixes = np.array([t for t, aid in aids if isinstance(aid, Position)], dtype=np.int64)
    norths = np.array([t for t, aid in aids if isinstance(aid, Azimuth)], dtype=np.int64)
    if not len(fixes) or not len(norths):
        raise LogError("no fix or no heading: there is nothing to begin from")
    # A fix in motion is soon of another place, so the start is at one
    at = np.searchsorted(t_ns, np.maximum(fixes, int(t_ns[0]) + window_ns))
    at = at[at < len(t_ns) - 1]
    now, seen = t_ns[at], np.searchsorted(norths, t_ns[at], side="right") - 1
    is_begun = (seen >= 0) & (norths[np.maximum(seen, 0)] >= now - window_ns)
    is_begun &= fixes[: len(at)] >= now - window_ns
    if not is_begun.any():
        raise LogError(
            "the recording ends before level, north and position are known: a fix and a heading "
            f"within {window_ns * 1e-9:g} s (align.time) of each other are needed, and motion "
            "after them"
        )
    return int(at[np.argmax(is_begun)])


def _north(level: Array, azimuths: Sequence[Azimuth]) -> tuple[float, Azimuth]:
    """Return the yaw that azimuths show to a levelled attitude, and the last of them.

    One that points to the vertical shows none; where all do, any yaw is as good.
    """
    unturned = Nominal(q_nb=level, vel_n=np.zeros(3), pos_n=np.zeros(3))
    seen = [aid for aid in azimuths if aid.is_seen(unturned)]
    if not seen:
        return 0.0, replace(azimuths[-1], std=np.pi)
    turns = np.array([float(aid.innovation(unturned)[0]) for aid in seen])
    return float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean())), seen[-1]


_LEVELLED = np.r_[ATT, BA]


def _levelled(state: Nominal, azimuth: Azimuth, tilt: float, accel_bias: float) -> Array:
    """Return the covariance of attitude and accelerometer bias, shape (6, 6), of a levelled start.

    A level is wrong by the bias over gravity, and takes the heading with it: by the Jacobian of
    what showed north, so much the more the steeper the field. All three stay tied together.

    Args:
        state: As levelled and turned.
        azimuth: What showed north.
        tilt: One sigma of the level for other reasons than the bias, rad.
        accel_bias: One sigma, m/s^2.
    """
    C_nb = so3.to_matrix(state.q_nb)
    # Turns about north and east by: bias (b), other tilt, heading
    by = np.zeros((3, 6))
    by[:2, :3] = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) @ C_nb / STANDARD_GRAVITY
    by[:2, 3:5] = tilt * np.eye(2)
    # The heading that was seen fits whatever the level is
    seen = azimuth.jacobian(state)[0, ATT] @ C_nb.T
    by[2] = -seen[:2] @ by[:2] / seen[2]
    by[2, 5] = azimuth.std / seen[2]
    errors = np.zeros((6, 6))
    errors[:3] = C_nb.T @ by
    errors[3:, :3] = np.eye(3)
    errors[:, :3] *= accel_bias
    return np.asarray(errors @ errors.T)
