"""The estimator sample by sample, for those who step it themselves."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.arrays.estimates import Origin
from ekf_companion.arrays.run import STD_H, STD_V, STD_VEL
from ekf_companion.core.memory.aid import find
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Arrival
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import ConfigError, DataError
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import (
    BaroSample,
    GnssFix,
    HeadingSample,
    HeadingSource,
    ImuSample,
    Kind,
    MagSample,
    make_row,
)
from ekf_companion.nav.state import (
    COLUMNS,
    EULER,
    GEODETIC,
    POSITION,
    QUATERNION,
    SIGMA,
    VELOCITY,
    Reason,
    Status,
)
from ekf_companion.replay.moments import Moment, stamp_ns
from ekf_companion.review.plausibility import Remedies, check_inertial, check_known, check_rate

CHECKED = 200
"""Inertial samples that are looked at before any is believed to be meant."""
TIMES_CHECKED = 10
"""Inertial samples after which their times are looked at, and as many of each kind after them."""
FARTHEST_NS = 60_000_000_000
"""Between those and the newest inertial sample, if they are of one clock, ns."""
_PLACES = {
    name: [COLUMNS.index(one) - 1 for one in names]
    for name, names in (
        ("pos_n", POSITION),
        ("vel_n", VELOCITY),
        ("q_nb", QUATERNION),
        ("euler", EULER),
        ("sigma", SIGMA),
    )
}
_GEODETIC = [COLUMNS.index(name) - 1 for name in GEODETIC]


_OF_STREAM = Remedies(
    "give np.multiply(accel, 9.80665)", "give np.deg2rad(gyro)", "Stream(check=False)"
)
TIMES = "a Stream takes floats as s and whole numbers as ns"


class StreamEstimate(NamedTuple):
    """The estimate at the newest inertial sample; NaN where nothing is known yet."""

    t_ns: int
    pos_n: Array
    """North, east, down of :attr:`Stream.origin`, m, shape (3,)."""
    vel_n: Array
    """m/s, shape (3,)."""
    q_nb: Array
    """Quaternion (w, x, y, z) from body to north-east-down, shape (4,)."""
    euler: Array
    """Roll, pitch, yaw, rad, shape (3,)."""
    sigma: Array
    """One sigma of position, velocity and roll, pitch, yaw, shape (9,)."""
    status: Status
    lat_deg: float
    """WGS-84 latitude, degrees."""
    lon_deg: float
    """Longitude, degrees."""
    alt: float
    """Height above mean sea level, m."""
    reasons: Reason
    """Why the status is worse than OK: all that hold."""


class Stream:
    """The daemon's estimator, fed by hand; measurements may come late by up to 2 s.

    Times are of one clock: floats in s, whole numbers in ns, or dates; other units are refused.
    Axes are the vehicle's: forward, right, down. Example::

        stream = Stream()
        stream.gnss(0.2, lat_deg=47.4, lon_deg=8.5, alt=488.0, vel_n=(0.0, 0.0, 0.0))
        found = stream.imu(0.21, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, -9.81))
    """

    def __init__(self, settings: FilterSettings | None = None, *, check: bool = True) -> None:
        """Begin with nothing known; ``check`` is whether the first samples must be plausible."""
        self.pipeline = Pipeline(settings or FilterSettings())
        """The estimator itself: its health, biases and counts."""
        self._first: list[tuple[int, npt.NDArray[np.float64]]] | None = [] if check else None
        self._is_checked = check
        self._samples = self._newest_ns = 0
        self._compared: Counter[str] = Counter()
        self._early: dict[str, int] = {}
        """Newest stamp of each kind before there were samples to compare it with, ns."""

    @property
    def origin(self) -> Origin | None:
        """The place from which ``pos_n`` counts; None: there is no position yet.

        It is the fix at which the estimator began to navigate, as a heading was known.
        """
        if (found := self.pipeline.origin) is None:
            return None
        lat, lon, alt = found
        return Origin(float(np.rad2deg(lat)), float(np.rad2deg(lon)), alt)

    def imu(self, t: Moment, gyro: npt.ArrayLike, accel: npt.ArrayLike) -> StreamEstimate | None:
        """Take an inertial sample, rad/s and m/s^2; return the estimate if it is the newest.

        None: it is not, or holds NaN or what no sensor measures: :attr:`dropped` counts these.

        Raises:
            DataError: The first samples cannot be meant: another unit, sign, other axes, or times
                in another unit or on another clock than the other measurements'.
        """
        t_ns, numbers = (
            stamp_ns("time", t),
            np.concatenate([_row("gyro", gyro), _row("accel", accel)]),
        )
        self._newest_ns = t_ns
        self._samples += 1
        if self._first is not None:
            self._check(t_ns, numbers, type(t))
        if self.pipeline.process(ImuSample(t_ns, *numbers.tolist())) is None:
            return None
        values = self.pipeline.values()
        parts = {name: values[places] for name, places in _PLACES.items()}
        status = Status(int(values[COLUMNS.index("status") - 1]))
        lat_deg, lon_deg, alt = values[_GEODETIC].tolist()
        return StreamEstimate(
            t_ns=t_ns,
            status=status,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt=alt,
            reasons=Reason(int(values[COLUMNS.index("reasons") - 1])),
            **parts,
        )

    @property
    def dropped(self) -> dict[str, int]:
        """How many measurements were not used, by kind (``imu``, ``gnss``, ...) and only if any.

        They hold NaN or what no sensor measures, came twice, or later than the window.
        """
        bad = (Arrival.MALFORMED, Arrival.STALE, Arrival.DUPLICATE, Arrival.STRAY)
        arrivals = self.pipeline.health().arrivals
        counts = {kind.name.lower(): sum(arrivals[kind][one] for one in bad) for kind in Kind}
        return {name: count for name, count in counts.items() if count}

    def gnss(
        self,
        t: Moment,
        *,
        lat_deg: float,
        lon_deg: float,
        alt: float,
        vel_n: npt.ArrayLike | None = None,
        std_h: float = STD_H,
        std_v: float = STD_V,
        std_vel: float = STD_VEL,
    ) -> None:
        """Take a fix: degrees, m above mean sea level, m/s north, east, down, and one sigma."""
        if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0):
            raise DataError(f"gnss: {lat_deg}, {lon_deg} is no place on the Earth, in degrees")
        t_ns = self._time("gnss", t)
        given = np.full(3, np.nan) if vel_n is None else _row("vel_n", vel_n)
        north, east, down = (value if np.isfinite(value) else None for value in given.tolist())
        fix = GnssFix(
            t_ns=t_ns,
            lat=float(np.deg2rad(lat_deg)),
            lon=float(so3.wrap(np.deg2rad(lon_deg))),
            alt=alt,
            vel_north=north,
            vel_east=east,
            vel_down=down,
            std_h=std_h,
            std_v=std_v,
            std_vel=std_vel,
        )
        self.pipeline.process(fix)

    def heading(self, t: Moment, heading: float, std: float = 0.05) -> None:
        """Take a heading from true north, clockwise, and its sigma, rad."""
        if abs(heading) > 2.0 * np.pi + 1e-6:
            raise DataError(f"heading: {heading} is no angle in rad; give np.deg2rad(heading)")
        angle, source = float(so3.wrap(heading)), HeadingSource.GNSS
        t_ns = self._time("heading", t)
        self.pipeline.process(HeadingSample(t_ns=t_ns, heading=angle, std=std, source=source))

    def mag(self, t: Moment, field: npt.ArrayLike) -> None:
        """Take a magnetic field, gauss."""
        x, y, z = _row("field", field).tolist()
        self.pipeline.process(MagSample(t_ns=self._time("mag", t), mag_x=x, mag_y=y, mag_z=z))

    def baro(self, t: Moment, alt: float) -> None:
        """Take a barometric height, m; its zero need not be known."""
        self.pipeline.process(BaroSample(t_ns=self._time("baro", t), alt=alt))

    def aid(self, name: str, t: Moment, **values: float) -> None:
        """Take a measurement of an aid that declares itself, ``aid("baro", t, alt=480.2)``."""
        aid = find(name)
        if unknown := {*values} - {*aid.row}:
            raise ConfigError(f"{name}: {min(unknown)}: known are {', '.join(aid.row)}")
        for column, value in aid.row.items():
            if column not in values and not value.is_optional:
                raise DataError(f"{name}: needs {column} ({value.unit})")
        given = [values.get(column) for column in aid.row]
        self.pipeline.process_row(make_row(self._time(name, t), aid.kind, *given))

    def _check(self, t_ns: int, numbers: npt.NDArray[np.float64], kind: type) -> None:
        """Look at the first samples together."""
        assert self._first is not None
        self._first.append((t_ns, numbers))
        if len(self._first) not in (TIMES_CHECKED, CHECKED):
            return
        stamps, rows = zip(*self._first, strict=True)
        taken = "s" if issubclass(kind, (float, np.floating)) else "ns"
        if len(self._first) == TIMES_CHECKED:
            for name, early_ns in self._early.items():
                if t_ns - early_ns > FARTHEST_NS:
                    raise self._far(name, early_ns)
        check_rate("imu", np.array(stamps, dtype=np.int64), taken, f"{TIMES}; it looks like {{}}")
        if len(self._first) == CHECKED:
            values = np.array(rows)
            self._first = None
            check_known("gyro", values[:, :3])
            check_known("accel", values[:, 3:])
            check_inertial(
                values[:, :3], values[:, 3:], np.array(stamps, dtype=np.int64), _OF_STREAM
            )

    def _time(self, name: str, t: Moment) -> int:
        """Return a stamp, ns; compare the first ones of each kind with the inertial samples'."""
        t_ns = stamp_ns("time", t)
        if not self._is_checked:
            return t_ns
        if self._samples < TIMES_CHECKED:
            self._early[name] = max(t_ns, self._early.get(name, t_ns))
            return t_ns
        self._compared[name] += 1
        if self._compared[name] <= TIMES_CHECKED and abs(t_ns - self._newest_ns) > FARTHEST_NS:
            raise self._far(name, t_ns)
        return t_ns

    def _far(self, name: str, t_ns: int) -> DataError:
        """Return the error of a stamp that is far from those of the inertial samples."""
        return DataError(
            f"{name}: its time, {t_ns * 1e-9:.3f} s, is far from that of the inertial samples, "
            f"{self._newest_ns * 1e-9:.3f} s; {TIMES}, all of one clock"
        )


def _row(name: str, given: npt.ArrayLike) -> npt.NDArray[np.float64]:
    values = np.ma.filled(np.ma.asarray(given, dtype=np.float64), np.nan)
    if values.shape != (3,):
        raise DataError(f"{name}: must be three numbers, not of the shape {values.shape}")
    return values
