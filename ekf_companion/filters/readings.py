"""What filters of attitude alone take and give: samples side by side, quaternions as a solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.filters.samples import LONGEST, inertial, levelled, unbroken
from ekf_companion.filters.solution import COVARIANCE_PERIOD_NS, Solution, euler_sigmas
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import COLUMNS, Status, Table

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

DECLINATION = 9
"""Where a GNSS row holds the declination (nav.measurements.GnssFix.row)."""
LONGEST_CARRY = 0.1
"""A field measured longer before an inertial sample is not carried to it, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Readings:
    """Inertial samples in order of time, and what the magnetometer said by each."""

    t_ns: Stamps
    """Strictly ascending, shape (n,)."""
    gyro_b: Array
    """rad/s, shape (n, 3): the rate since the sample before."""
    accel_b: Array
    """Specific force, m/s^2, shape (n, 3)."""
    mag_b: Array
    """gauss, turned into b at the sample's time; NaN where there is no new one, shape (n, 3)."""
    declination: float
    """Of the first GNSS fix that knows it, rad; 0: yaw counts from magnetic north."""
    notes: tuple[str, ...]
    """What the user should know, one sentence each."""

    @property
    def steps(self) -> Array:
        """Return the time since the sample before, s, shape (n,); the first is as the median."""
        gaps = np.diff(self.t_ns) * 1e-9
        return np.concatenate([[np.median(gaps) if len(gaps) else 0.01], gaps])


def read(events: Events, gap: float = LONGEST) -> Readings:
    """Lay the inertial samples and the field side by side.

    Args:
        events: In any order.
        gap: Silence of the inertial sensor beyond which only the longest part counts, s.

    Raises:
        LogError: There are no inertial samples.
    """
    imu = inertial(events)
    if not len(imu):
        raise LogError(
            "the log holds no inertial samples, without which there is no attitude; "
            "ask the autopilot to log or stream its gyro and accelerometer"
        )
    imu, broken = unbroken(imu, gap)
    t_ns, values = imu.t_ns, imu.values
    mag_b = _carried(events.take(events.kind == Kind.MAG), t_ns, values[:, :3])
    fixes = events.values[events.kind == Kind.GNSS, DECLINATION]
    known = fixes[np.isfinite(fixes)]
    notes = [*broken]
    if not np.isfinite(mag_b).any():
        notes.append("no magnetometer: yaw begins at zero and drifts")
    elif not len(known):
        notes.append("no declination is known: yaw counts from magnetic north")
    return Readings(
        t_ns=t_ns,
        gyro_b=values[:, :3],
        accel_b=values[:, 3:6],
        mag_b=mag_b,
        declination=float(known[0]) if len(known) else 0.0,
        notes=tuple(notes),
    )


def known_rows(values: Array) -> npt.NDArray[np.bool_]:
    """Return which rows have no NaN, shape (n,)."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def _carried(mag: Events, t_ns: Stamps, gyro_b: Array) -> Array:
    """Turn each field into the body at the next inertial sample; of several, give the mean."""
    fields = mag.values[:, :3]
    at = np.searchsorted(t_ns, mag.t_ns)
    good = known_rows(fields) & (at < len(t_ns)) & (mag.t_ns >= t_ns[0] - LONGEST_CARRY * 1e9)
    fields, at, stamps = fields[good], at[good], mag.t_ns[good]
    wait = (t_ns[at] - stamps) * 1e-9
    near = wait <= LONGEST_CARRY
    fields, at, wait = fields[near], at[near], wait[near]
    turned = so3.rotate(so3.exp(-gyro_b[at] * wait[:, None]), fields)
    total, count = np.zeros((len(t_ns), 3)), np.zeros(len(t_ns))
    np.add.at(total, at, turned)
    np.add.at(count, at, 1.0)
    count[count == 0.0] = np.nan
    return np.asarray(total / count[:, None])


def solution(
    name: str,
    readings: Readings,
    q_nb: Array,
    *,
    bias: Array | None = None,
    covariance: Array | None = None,
    is_still: npt.NDArray[np.bool_] | None = None,
    counts: Mapping[str, tuple[int, int]] | None = None,
    notes: tuple[str, ...] = (),
) -> Solution:
    """Return a solution of attitude alone; what is not known is NaN.

    Args:
        name: Of the filter.
        readings: What it took.
        q_nb: From magnetic north, shape (n, 4); the declination is added here.
        bias: Of the gyro, rad/s, b, shape (n, 3).
        covariance: Of the rotation vector in n, rad^2, shape (n, 3, 3).
        is_still: Where it took the sensor to stand still, shape (n,).
        counts: By aid: how many were fused, how many refused.
        notes: Of the filter, behind those of the readings.
    """
    n = len(q_nb)
    turn = so3.from_euler(0.0, 0.0, readings.declination)
    q_nb = so3.normalise(so3.multiply(turn, q_nb))
    values = np.full((n, len(COLUMNS) - 1), np.nan)
    put = {column: values[:, index] for index, column in enumerate(COLUMNS[1:])}
    angles = so3.to_euler(q_nb)
    for index, column in enumerate(("q_w", "q_x", "q_y", "q_z")):
        put[column][:] = q_nb[:, index]
    for index, column in enumerate(("roll", "pitch", "yaw")):
        put[column][:] = angles[:, index]
    if bias is not None:
        for index, axis in enumerate("xyz"):
            put[f"gyro_bias_{axis}"][:] = bias[:, index]
    if covariance is not None:
        covariance = np.einsum(
            "ij,njk,lk->nil", so3.to_matrix(turn), covariance, so3.to_matrix(turn)
        )
        for column, sigma in zip(
            ("sd_roll", "sd_pitch", "sd_yaw"), euler_sigmas(angles, covariance).T, strict=True
        ):
            put[column][:] = sigma
    seen = np.flatnonzero(known_rows(readings.mag_b))
    put["status"][:] = Status.ATTITUDE
    put["status"][: seen[0] if len(seen) else 0] = Status.ALIGNING
    put["reset_count"][:] = 0.0
    kept = _every(readings.t_ns, COVARIANCE_PERIOD_NS)
    blocks = np.full((len(kept), 9, 9), np.nan)
    if covariance is not None:
        blocks[:, :3, :3] = covariance[kept]
    return Solution(
        name=name,
        table=Table(stamp_ns=readings.t_ns, values=values),
        covariance_ns=readings.t_ns[kept],
        covariance=blocks,
        is_still=is_still,
        counts=dict(counts or {}),
        notes=readings.notes + notes,
    )


def _every(t_ns: Stamps, period_ns: int) -> npt.NDArray[np.int64]:
    """Return the index of the first sample of each period."""
    return np.unique((t_ns - t_ns[0]) // period_ns, return_index=True)[1]


def first_attitude(readings: Readings) -> Array:
    """Return q_nb of the first sample's specific force and the first field, from magnetic north."""
    level = levelled(readings.accel_b[0])
    seen = np.flatnonzero(known_rows(readings.mag_b))
    yaw = 0.0
    if len(seen):
        field = so3.rotate(level, readings.mag_b[seen[0]])
        yaw = -float(np.arctan2(field[1], field[0]))
    return so3.multiply(so3.from_euler(0.0, 0.0, yaw), level)
