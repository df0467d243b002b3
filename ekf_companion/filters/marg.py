"""Gyro, accelerometer and magnetometer (MARG) samples, for the filters of attitude alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.filters.gap import SHORTEST, SLOW, Lost, hidden
from ekf_companion.filters.inertial import (
    LONGEST_GAP,
    inertial_samples,
    level,
    longest_part,
    turn,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows
from ekf_companion.nav.measurements import GNSS_DECLINATION, Events, Kind

LONGEST_CARRY = 0.1
"""Longest time over which a field is rotated to the next inertial sample, s."""


BLIND = 0.5
"""Longest gap over which a turn is interpolated, s: a sensor in a hand swings back within it."""
SEEN_RATE, UNSEEN_RATE = 0.2, 0.5
"""One sigma of its rate, rad/s, beside what both ends of a shorter gap show, and in a longer."""


class Missed(NamedTuple):
    """A gap, up to one usual step before the sample that ends it."""

    span: float
    """s."""
    gyro: list[float] | None
    """Mean of the rates at both ends, rad/s; None: too long to interpolate the turn over."""
    lost: Lost
    """What it hides."""


Row = tuple[float, list[float], list[float], list[float] | None, Missed | None]
"""Step, s, rate, specific force, field (None: no new one), and the gap that it ends."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MargSamples:
    """Inertial samples in order of time, and the magnetic field at each."""

    t_ns: Stamps
    """Strictly ascending, shape (n,)."""
    gyro_b: Array
    """rad/s, shape (n, 3): the rate since the sample before."""
    accel_b: Array
    """Specific force, m/s^2, shape (n, 3)."""
    mag_b: Array
    """gauss, rotated into b at the sample's time; NaN where there is no new one, shape (n, 3)."""
    declination: float
    """Of the first GNSS fix that has it, rad; 0: yaw is relative to magnetic north."""
    notes: tuple[str, ...]
    """What the user should know, one sentence each."""

    @property
    def steps(self) -> Array:
        """Return the time since the sample before, s, shape (n,); first the median."""
        gaps = np.diff(self.t_ns) * 1e-9
        return np.concatenate([[np.median(gaps) if len(gaps) else 0.01], gaps])

    @property
    def has_mag(self) -> Mask:
        """Return which samples have a new field, shape (n,)."""
        return known_rows(self.mag_b)

    def rows(self) -> Iterator[Row]:
        """Yield each sample; the step of one that ends a gap is the usual one."""
        fields = (
            field if is_known else None
            for field, is_known in zip(self.mag_b.tolist(), self.has_mag.tolist(), strict=True)
        )
        gyro, accel, steps = self.gyro_b.tolist(), self.accel_b.tolist(), self.steps
        usual = float(np.median(steps))
        missed: list[Missed | None] = [None] * len(steps)
        for i in np.flatnonzero(steps > SHORTEST).tolist():
            span = float(steps[i])
            mean = (0.5 * (self.gyro_b[i - 1] + self.gyro_b[i])).tolist()
            if i and span > SLOW * usual:
                is_blind = span > BLIND
                turned = span * (UNSEEN_RATE if is_blind else SEEN_RATE)
                lost = hidden(span, turned, 0.0)
                missed[i] = Missed(span - usual, None if is_blind else mean, lost)
        steps = np.where([one is not None for one in missed], usual, steps)
        return zip(steps.tolist(), gyro, accel, fields, missed, strict=True)

    def first_attitude(self) -> Array:
        """Return q_nb by the first specific force and the first field, from magnetic north."""
        q_nb = level(self.accel_b[0])
        seen = np.flatnonzero(self.has_mag)
        if not len(seen):
            return turn(q_nb, 0.0)
        field = so3.rotate(q_nb, self.mag_b[seen[0]])
        return turn(q_nb, -float(np.arctan2(field[1], field[0])))


def marg_samples(events: Events, gap: float = LONGEST_GAP) -> MargSamples:
    """Pair the inertial samples of events in any order with the magnetic field.

    Beyond a gap in the inertial samples, s, only the longest part counts.

    Raises:
        LogError: There are no inertial samples.
    """
    imu = inertial_samples(events)
    if not len(imu):
        raise LogError(
            "the log holds no inertial samples, without which there is no attitude; "
            "ask the autopilot to log or stream its gyro and accelerometer"
        )
    imu, notes = longest_part(imu, gap)
    mag_b = _fields(events.take(events.kind == Kind.MAG), imu.t_ns, imu.values[:, :3])
    declinations = events.values[events.kind == Kind.GNSS, GNSS_DECLINATION]
    known = declinations[np.isfinite(declinations)]
    if not np.isfinite(mag_b).any():
        notes += ("no magnetometer: yaw begins at zero and drifts",)
    elif not len(known):
        notes += ("no declination is known: yaw counts from magnetic north",)
    return MargSamples(
        t_ns=imu.t_ns,
        gyro_b=imu.values[:, :3],
        accel_b=imu.values[:, 3:6],
        mag_b=mag_b,
        declination=float(known[0]) if len(known) else 0.0,
        notes=notes,
    )


def _fields(mag: Events, t_ns: Stamps, gyro_b: Array) -> Array:
    """Rotate each field into the body at the next inertial sample, and average those of one."""
    fields = mag.values[:, :3]
    at = np.searchsorted(t_ns, mag.t_ns)
    wait = (t_ns[np.minimum(at, len(t_ns) - 1)] - mag.t_ns) * 1e-9
    good = known_rows(fields) & (at < len(t_ns)) & (wait <= LONGEST_CARRY)
    fields, at, wait = fields[good], at[good], wait[good]
    carried = so3.rotate(so3.exp(-gyro_b[at] * wait[:, None]), fields)
    total, count = np.zeros((len(t_ns), 3)), np.zeros(len(t_ns))
    np.add.at(total, at, carried)
    np.add.at(count, at, 1.0)
    count[count == 0.0] = np.nan
    return np.asarray(total / count[:, None])
