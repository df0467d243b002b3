"""Events from the rows of a table, part by part: the sensors in each row."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import aids, series
from ekf_companion.logs.csv_columns import DEGREE, GROUPS, UNITS, Source
from ekf_companion.logs.inertial_units import Samples
from ekf_companion.logs.recording import counted
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.earth import LocalFrame, is_place, pressure_altitude
from ekf_companion.nav.event_columns import Arrivals, EventColumns, merged
from ekf_companion.nav.measurements import Events, GnssFlag, HeadingSource, Kind

Columns = dict[str, Array]
"""Quantities in SI and radians, NaN where a row has none."""

GNSS_STD = {"gps_std_h": 2.0, "gps_std_v": 3.0, "gps_std_vel": 0.5}
"""m, m, m/s where the file holds no accuracy: a receiver in the open, rounded up."""
HEADING_STD_DEG = 5.0
"""deg, where the file holds no accuracy."""
_HOLDABLE = ("gps", "mag", "baro", "heading", *(one.hold for one in aids.CSV.values()))


class EventMaker:
    """Makes events from the rows of a table, part by part."""

    def __init__(
        self, where: str, sources: Mapping[str, Source], options: Mapping[str, Any]
    ) -> None:
        """Take the sources of the quantities, and the options of a map.

        Raises:
            LogError: An option is none; ``where`` names the map.
        """
        hold = options.get("hold", [])
        if not isinstance(hold, list) or any(name not in _HOLDABLE for name in hold):
            raise LogError(f"{where}: hold: {hold!r} is not a list of {', '.join(_HOLDABLE)}")
        known = {member.name.lower(): member for member in HeadingSource}
        source = options.get("heading_source", "magnetometer")
        if source not in known:
            raise LogError(f"{where}: heading_source: {source!r}; known are {', '.join(known)}")
        self._hold, self._heading_source = hold, float(known[source])
        self._origin = None
        if "gps_north" in sources:
            self._origin = _origin(where, options.get("origin"))
        self._names = sources.keys()
        self._constant = {name for name, source in sources.items() if source.column is None}
        self._last: tuple[Stamps, Indices, Columns] | None = None
        self._repeated = 0
        self._nowhere = 0
        others = [GROUPS[f"imu{unit}"][0] for unit in UNITS[1:]]
        self._units = Samples(1, ()) if {*others} & {*sources} else None
        self._begun_ns: int | None = None

    def notes(self, total: int) -> list[str]:
        """Return notes on all rows, given their number."""
        notes = []
        if self._units is not None and self._begun_ns is not None:
            names = {n: f"gyro{unit}, accel{unit}" for n, unit in enumerate(UNITS, 1)}
            notes += self._units.notes("IMU", names, self._begun_ns)
        if "gps_north" in self._names or "gps_lat" in self._names:
            if missing := [name for name in GNSS_STD if name not in self._names]:
                said = ", ".join(f"{name} {GNSS_STD[name]:g}" for name in missing)
                notes.append(f"accuracy not declared, so assumed (m, m/s): {said}")
            if self._nowhere:
                were = "was" if self._nowhere == 1 else "were"
                rows = f"{counted(self._nowhere, 'row')} of the receiver without a place, as 0, 0,"
                notes.append(f"{rows} {were} left out")
            if "gps" not in self._hold and self._repeated > total / 2:
                notes.append(
                    f"{self._repeated} of {total} rows repeat the GPS values of the row before: if "
                    "the file holds them until new ones come, declare hold: [gps]"
                )
        if "heading" in self._names and "heading_std" not in self._names:
            notes.append(
                f"accuracy not declared, so assumed (deg): heading_std {HEADING_STD_DEG:g}"
            )
        return notes

    def events(self, t_ns: Stamps, row: Indices, values: Columns) -> Events:
        """Return the events of the next rows, given their stamps, numbers and quantities."""
        if self._last is not None:  # the row before: values may be held since
            before_ns, before, known = self._last
            t_ns, row = np.append(before_ns, t_ns), np.append(before, row)
            values = {name: np.append(known[name], column) for name, column in values.items()}
        is_new = np.ones(len(t_ns), dtype=bool)
        is_new[:1] = self._last is None
        self._last = t_ns[-1:], row[-1:], {name: column[-1:] for name, column in values.items()}
        found: Arrivals = []
        for kind, aid in aids.CSV.items():
            part = _part(t_ns, is_new, values, aid.csv, self._constant)
            found += self._aid(kind, aid, part)
        if self._begun_ns is None and len(t_ns):
            self._begun_ns = int(t_ns[0])
        units = {}
        if self._units is not None:
            for number, unit in enumerate(UNITS, 1):
                group = GROUPS[f"imu{unit}"]
                units[number] = _part(t_ns, is_new, values, group, self._constant)
        gnss, heading, mag, baro, imu = (
            _part(
                t_ns,
                is_new,
                values,
                [one for one in values if one.startswith(begin)],
                self._constant,
            )
            for begin in ("gps_", "heading", "mag_", "baro_", "")
        )
        found += [*self._gnss(gnss), *self._heading(heading), *self._sensor("mag", Kind.MAG, mag)]
        found += self._barometer(baro)
        found += self._sensor("imu", Kind.IMU, imu) if self._units is None else self._lanes(units)
        if not found:
            return Events.from_rows([])
        return merged([(events, row[at]) for events, at in found])

    def _aid(self, kind: Kind, aid: aids.Logged, part: _Part) -> Arrivals:
        if not {*[*aid.csv][: aid.measured]} <= {*part.values}:
            return []
        columns = [part.values.get(one, np.full(len(part.row), np.nan)) for one in aid.csv]
        measured = columns[: aid.measured]
        held = measured if aid.hold in self._hold else None
        return _found(part, kind, columns, measured, held)

    def _sensor(self, group: str, kind: Kind, part: _Part) -> Arrivals:
        if not part.values.keys() >= {*GROUPS[group]}:
            return []
        axes = [part.values[name] for name in GROUPS[group]]
        return _found(part, kind, axes, axes, axes if group in self._hold else None)

    def _lanes(self, parts: Mapping[int, _Part]) -> Arrivals:
        """Return the samples in use of several inertial units."""
        assert self._units is not None
        numbers, rows, stamps, samples = [], [], [], []
        for number, unit in enumerate(UNITS, 1):
            for events, row in self._sensor(f"imu{unit}", Kind.IMU, parts[number]):
                numbers.append(np.full(len(row), number))
                rows.append(row)
                stamps.append(events.t_ns)
                samples.append(np.stack(events.columns, axis=1))
        if not rows:
            return []
        order = np.argsort(np.concatenate(rows), kind="stable")
        of, row, t_ns, values = (
            np.concatenate(each)[order] for each in (numbers, rows, stamps, samples)
        )
        is_bad = np.zeros(len(row), dtype=bool)
        at, used_ns, values = self._units.take(of, t_ns, values, is_bad)
        return [(EventColumns(used_ns, Kind.IMU, *values.T), row[at])]

    def _barometer(self, part: _Part) -> Arrivals:
        values = part.values
        if "baro_alt" in values:
            alt = values["baro_alt"]
        elif "baro_press" in values:
            pressure = values["baro_press"]
            alt = pressure_altitude(np.where(pressure > 0.0, pressure, np.nan))
        else:
            return []
        held = [alt] if "baro" in self._hold else None
        return _found(part, Kind.BARO, [alt], [alt], held)

    def _heading(self, part: _Part) -> Arrivals:
        values = part.values
        if "heading" not in values:
            return []
        heading = values["heading"]
        std = series.accuracy(values.get("heading_std", np.nan * heading), HEADING_STD_DEG * DEGREE)
        columns = (so3.wrap(heading), std, self._heading_source)
        held = [heading] if "heading" in self._hold else None
        return _found(part, Kind.HEADING, columns, [heading], held)

    def _gnss(self, part: _Part) -> Arrivals:
        values, n = part.values, len(part.row)
        if self._origin is not None:
            ned = np.stack([values["gps_north"], values["gps_east"], -values["gps_h"]], axis=1)
            lat, lon, alt = self._origin.to_geodetic(ned)
        elif "gps_lat" in values:
            lat, lon, alt = values["gps_lat"], values["gps_lon"], values["gps_alt"]
            is_known = is_place(lat / DEGREE, so3.wrap(lon) / DEGREE)
            self._nowhere += int(np.count_nonzero(np.isfinite(lat + lon)[part.is_new & ~is_known]))
            lat = np.where(is_known, lat, np.nan)
        else:
            return []
        north = east = unknown = np.full(n, np.nan)
        if "gps_vn" in values:
            north, east = values["gps_vn"], values["gps_ve"]
        elif "gps_speed" in values:
            speed, course = values["gps_speed"], values["gps_course"]
            north, east = speed * np.cos(course), speed * np.sin(course)
        velocity = (north, east, values.get("gps_vd", unknown))
        std = [
            series.accuracy(values.get(name, unknown), least) for name, least in GNSS_STD.items()
        ]
        position = (lat, so3.wrap(lon), alt)
        columns: list[Any] = [*position, *velocity, *std, np.nan, float(GnssFlag.NONE)]
        # A new fix moves; loggers update altitude, speed and course some rows later
        held = [lat, lon]
        is_repeated = np.isfinite(lat[1:]) & ~part.changed(*held)[1:]
        self._repeated += int(np.count_nonzero(is_repeated))
        needed = [lat, lon, alt]
        return _found(part, Kind.GNSS, columns, needed, held if "gps" in self._hold else None)


class _Part(NamedTuple):
    """Rows of the file that hold any quantity of a sensor."""

    row: Indices
    """Row numbers."""
    is_new: Mask
    """Whether they were not there in the part before."""
    t_ns: Stamps
    values: Columns
    is_apart: Mask
    """Whether the row before holds none of them."""

    def changed(self, *columns: Array) -> Mask:
        """Return in which rows a column differs from the row before in the file."""
        return np.asarray(series.changed(*columns) | self.is_apart)


def _part(
    t_ns: Stamps,
    is_new: Mask,
    values: Columns,
    names: Collection[str],
    constant: Collection[str],
) -> _Part:
    """Take some quantities out of the table."""
    chosen = {name: values.pop(name) for name in [*values] if name in names}
    any_known = np.zeros(len(t_ns), dtype=bool)
    for name in chosen.keys() - constant:
        any_known |= np.isfinite(chosen[name])
    row = np.flatnonzero(any_known)
    if len(row) < len(t_ns):
        chosen = {name: column[row] for name, column in chosen.items()}
    is_apart = np.diff(row, prepend=-2) != 1
    return _Part(row, is_new[row], t_ns[row], chosen, is_apart)


def _found(
    part: _Part,
    kind: Kind,
    columns: Sequence[Array | float],
    needed: list[Array],
    held: list[Array] | None,
) -> Arrivals:
    """Return events where the needed columns are known and, with ``hold``, have changed."""
    mask = part.is_new.copy()
    for column in needed:
        mask &= np.isfinite(column)
    if held is not None:
        mask &= part.changed(*held)
    if not mask.any():
        return []
    return [(EventColumns(part.t_ns, kind, *columns).take(mask), part.row[mask])]


def _origin(where: str, origin: Any) -> LocalFrame:
    numbers = {"alt_m": 0.0, **origin} if isinstance(origin, Mapping) else {}
    if set(numbers) != {"lat_deg", "lon_deg", "alt_m"} or any(
        not isinstance(number, (int, float)) or isinstance(number, bool)
        for number in numbers.values()
    ):
        raise LogError(
            f"{where}: gps_north, gps_east, gps_h need an origin; "
            "declare origin: {lat_deg: ..., lon_deg: ...}"
        )
    lat_deg, lon_deg, alt = (float(numbers[key]) for key in ("lat_deg", "lon_deg", "alt_m"))
    return LocalFrame(lat_deg * DEGREE, lon_deg * DEGREE, alt)
