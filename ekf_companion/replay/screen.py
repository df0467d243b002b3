"""Rows of a log that are no measurement, whatever its format: they are left out, and named.

What a telemetry log holds is judged by the readers of its messages, by the same rules.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from ekf_companion.nav.arrays import Array, Indices, Mask
from ekf_companion.nav.earth import TROPOSPHERE, is_place
from ekf_companion.nav.held_heading import HELD_NS, HeldHeading
from ekf_companion.nav.held_velocity import HELD, SINGLE, HeldVelocities
from ekf_companion.nav.measurements import GNSS_VELOCITY, Events, HeadingSource, Kind
from ekf_companion.nav.repetition import Repetition

KINDS = (Kind.IMU, Kind.GNSS, Kind.HEADING, Kind.MAG, Kind.BARO)
"""Of measurements that are looked at."""
VELOCITIES = (3, 5)
"""Columns of the velocity north and of that down."""
NO_PLACE = "without a place, as latitude and longitude 0"
NO_FIELD = "of zeros"
NO_PRESSURE = "of no pressure of the air"
"""Why a fix, a magnetic field and a pressure are none; the other reasons are those of ``nav``."""
GYRO_BIAS = 0.005
"""rad/s: a gyro may seem to turn so fast when it does not, after its autopilot's calibration."""
DIGIT = 0.005
"""rad: such a turn moves a level field of 0.2 gauss by 1 mG, the coarsest digit of a log."""
LONGEST_STEP = 1.0
"""s; what a gyro turned in a longer gap is not known."""


class Screen:
    """Leaves out of events, in the order of their arrival, what is no measurement."""

    def __init__(self) -> None:
        """Begin before the first event."""
        self._refused: Counter[tuple[Kind, str]] = Counter()
        self.total: Counter[Kind] = Counter()
        """Of each kind, with those that were left out."""
        self.repeated = self.back = 0
        """Inertial samples with the stamp of the one before, and with an earlier one."""
        self._repetition = Repetition()
        self._velocities = HeldVelocities()
        self._headings: dict[float, HeldHeading] = {}  # by source
        self._since: dict[float, tuple[int, Array]] = {}  # time and attitude of the last new one
        self._imu_ns: int | None = None
        self._turned: Array = np.zeros(3)
        self._seen: Array = np.zeros(3)
        self._field: Array = np.full(4, np.nan)  # the last, and what was when it came first
        self._field_ns = self._field_used_ns = 0
        self._field_turned: Array = np.zeros(3)

    def pass_on(self, events: Events) -> Events:
        """Return the next events without those that are no measurement."""
        is_good = np.ones(len(events), dtype=np.bool_)
        kinds = {kind: np.flatnonzero(events.kind == kind) for kind in KINDS}
        for kind, rows in kinds.items():
            self.total[kind] += len(rows)
        imu, mag = kinds[Kind.IMU], kinds[Kind.MAG]
        turned = self._turns(events, imu)
        is_good[kinds[Kind.HEADING]] = self._are_headings(events, kinds[Kind.HEADING], turned)
        fields = np.vstack([self._seen, events.values[mag, :3]])
        self._seen = fields[-1]
        fields = fields[np.searchsorted(mag, imu)]
        is_good[imu] = self._repetition.judge_rows(events.t_ns[imu], events.values[imu, :6], fields)
        is_good[mag] = events.values[mag, :3].any(axis=1)
        self._count(Kind.MAG, NO_FIELD, int(np.count_nonzero(~is_good[mag])))
        is_good[mag] &= self._are_fields(events, mag, turned)
        is_good[kinds[Kind.GNSS]] = self._are_places(events, kinds[Kind.GNSS])
        is_good[kinds[Kind.BARO]] = self._are_pressures(events, kinds[Kind.BARO])
        events = self._without_velocities(events, kinds[Kind.GNSS])
        return events if is_good.all() else events.take(is_good)

    @property
    def left_out(self) -> Counter[tuple[Kind, str]]:
        """How many were left out, by kind and reason."""
        return self._refused + Counter(
            {(Kind.IMU, why): count for why, count in self._repetition.refused.items()}
        )

    def _count(self, kind: Kind, why: str, count: int = 1) -> None:
        if count:
            self._refused[kind, why] += count

    def _turns(self, events: Events, imu: Indices) -> Array:
        """Return by how much the gyro had turned in all, rad: before, and at each sample."""
        if not len(imu):
            return self._turned[None]
        t_ns = events.t_ns[imu]
        first = t_ns[0] - 1 if self._imu_ns is None else self._imu_ns
        dt = np.clip(np.diff(t_ns, prepend=first) * 1e-9, 0.0, LONGEST_STEP)
        self.repeated += int(np.count_nonzero(np.diff(t_ns, prepend=first) == 0))
        self.back += int(np.count_nonzero(t_ns < np.append(first, t_ns[:-1])))
        steps = np.nan_to_num(events.values[imu, :3]) * dt[:, None]
        turned = np.cumsum([self._turned, *steps], axis=0)
        self._imu_ns, self._turned = int(t_ns[-1]), turned[-1]
        return np.asarray(turned)

    def _are_headings(self, events: Events, rows: Indices, turned: Array) -> Mask:
        """Return which headings are new ones."""
        is_good = np.ones(len(rows), dtype=np.bool_)
        at = np.searchsorted(np.flatnonzero(events.kind == Kind.IMU), rows)
        for n, row in enumerate(rows.tolist()):
            heading, std, source = events.values[row, :3].tolist()
            t_ns, now = int(events.t_ns[row]), turned[at[n]]
            judge = self._headings.setdefault(source, HeldHeading())
            since_ns, then = self._since[source] if judge.is_repeated(heading) else (t_ns, now)
            is_estimate = source == HeadingSource.AUTOPILOT
            # Few digits of an estimate may well be the same while the vehicle rolls
            angle = abs(float((now - then)[2])) if is_estimate else np.linalg.norm(now - then)
            angle -= GYRO_BIAS * abs(t_ns - since_ns) * 1e-9
            why = judge.judge(t_ns, heading, is_still=angle < std, is_estimate=is_estimate)
            if why is None:
                self._since[source] = since_ns, then
            else:
                is_good[n] = False
                self._count(Kind.HEADING, why)
        return is_good

    def _are_fields(self, events: Events, rows: Indices, turned: Array) -> Mask:
        """Return which magnetic fields are new ones.

        One that repeats to the bit counts once a second, as long as the vehicle has not turned.
        """
        values = events.values[rows, :4]
        same = (values == np.vstack([self._field, values[:-1]])).all(axis=1)
        is_good = ~same
        at = np.searchsorted(np.flatnonzero(events.kind == Kind.IMU), rows)
        # When the field came first, when it counted last, and how far the gyro had turned then
        for n in np.flatnonzero(same | np.append(same[1:], True)).tolist():
            t_ns, now = int(events.t_ns[rows[n]]), turned[at[n]]
            if not same[n]:
                self._field_ns = self._field_used_ns = t_ns
                self._field_turned = now
                continue
            angle = float(np.linalg.norm(now - self._field_turned))
            angle -= GYRO_BIAS * abs(t_ns - self._field_ns) * 1e-9
            is_good[n] = angle < DIGIT and t_ns - self._field_used_ns >= HELD_NS
            if is_good[n]:
                self._field_used_ns = t_ns
        if len(rows):
            self._field = values[-1]
        return np.asarray(is_good)

    def _are_places(self, events: Events, rows: Indices) -> Mask:
        """Return which fixes have a place, or are not finite, which the filter counts."""
        lat, lon = np.rad2deg(events.values[rows, :2]).T
        is_good = np.asarray(is_place(lat, lon) | ~np.isfinite(lat + lon), dtype=np.bool_)
        self._count(Kind.GNSS, NO_PLACE, int(np.count_nonzero(~is_good)))
        return is_good

    def _are_pressures(self, events: Events, rows: Indices) -> Mask:
        """Return which altitudes the pressure of the air can have, or are not finite, as above."""
        alt = events.values[rows, 0]
        lowest, highest = TROPOSPHERE
        is_good = np.asarray(((alt > lowest) & (alt < highest)) | ~np.isfinite(alt))
        self._count(Kind.BARO, NO_PRESSURE, int(np.count_nonzero(~is_good)))
        return is_good

    def _without_velocities(self, events: Events, rows: Indices) -> Events:
        """Return the events without the velocities of fixes that are none.

        A log is looked at ahead, as far as the events go: what is found to be none was none
        before. But where a receiver has said others, and then repeats one of motion, its first was
        a measurement.
        """
        vel = events.values[rows, GNSS_VELOCITY]
        is_half = np.isfinite(vel[:, :2]).sum(axis=1) == 1
        if is_half.any() or np.isinf(vel).any():
            # What is known in part is not known
            values = events.values.copy()
            vel[is_half, :2] = np.nan
            values[rows, GNSS_VELOCITY] = np.where(np.isinf(vel), np.nan, vel)
            events = replace(events, values=values)
        numbers = np.zeros((len(rows), 2), dtype=np.int64)
        whole: dict[tuple[int, int], str] = {}  # by part and number of the velocity
        single: list[tuple[int, int, str]] = []  # place, part, and why
        judge = self._velocities
        for n, row in enumerate(rows.tolist()):
            lat, lon, alt, *vel, std_h, std_v = events.values[row, :8].tolist()
            if not is_place(lat, lon):
                continue
            known = [None if one != one else one for one in vel]
            north, east, down = known if None not in known[:2] else (None, None, known[2])
            t_ns, place = int(events.t_ns[row]), (lat, lon, alt)
            whys = judge.judge(t_ns, place, (north, east, down), std_h, std_v)
            numbers[n] = judge.horizontal.number, judge.vertical.number
            for part, why in enumerate(whys):
                if why in SINGLE or (why == HELD and part == 0 and numbers[n, 0] > 1):
                    single.append((n, part, why))
                elif why is not None:
                    whole[part, int(numbers[n, part])] = why
        if not whole and not single:
            return events
        values = events.values.copy()
        for (part, number), why in whole.items():
            of = rows[(numbers[:, part] == number) & np.isfinite(values[rows, VELOCITIES[part]])]
            values[of, _columns(part)] = np.nan
            self._count(Kind.GNSS, why if part == 0 else f"vertical {why}", len(of))
        for n, part, why in single:
            values[rows[n], _columns(part)] = np.nan
            if part == 0:
                self._count(Kind.GNSS, why)
        return replace(events, values=values)


def _columns(part: int) -> slice | int:
    """Return the columns of a velocity, or of its vertical part."""
    return VELOCITIES[1] if part else GNSS_VELOCITY
