"""Logs as comma-separated text: every column and every unit is declared, nothing is guessed.

Native files declare them in the header. A column is a quantity and its unit::

    time_us | time_ms | time_s                      needed; the sample's stamp
    gyro_x_rps | gyro_x_dps   (and y, z)            body frame: forward, right, down
    accel_x_mps2 | accel_x_g  (and y, z)            specific force: -9.8 down at rest
    mag_x_gauss | mag_x_uT | mag_x_mG  (and y, z)
    baro_alt_m | baro_press_hPa | baro_press_Pa
    gps_lat_deg, gps_lon_deg, gps_alt_m             altitude above mean sea level
    gps_vn_mps, gps_ve_mps, gps_vd_mps              or gps_speed_mps | gps_speed_kmph
                                                    with gps_course_deg
    gps_std_h_m, gps_std_v_m, gps_std_vel_mps       one sigma per axis
    heading_deg | heading_rad, heading_std_deg      from true north, clockwise

An empty or NaN cell holds no measurement. Other columns are ignored, and named in a note.

Foreign files have a map beside them, ``LOG.csv.columns.yaml``, or one passed to :func:`read`::

    time: {column: millis, unit: ms}
    gyro_x: {column: rollrate, unit: deg/s}
    accel_z: {column: az, unit: g, sign: -1}        # this sensor's z is up
    gps_std_h: {value: 3.5, unit: m}                # the same in every row
    gps_north: {column: N, unit: m}                 # with gps_east, gps_h: needs the origin
    origin: {lat_deg: 47.4, lon_deg: 8.5, alt_m: 0} # alt_m: where gps_h is 0; 0 if left out
    hold: [gps]                   # values are repeated until new ones come: only changes count
    heading_source: magnetometer  # or gnss, autopilot
    delimiter: ";"

A map without quantities adds its options to a native file. Some headers of other programs need no
map: :mod:`ekf_companion.logs.csv_known`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import csv_known, series
from ekf_companion.logs.csv_columns import (
    DEGREE,
    GROUPS,
    OPTIONS,
    QUANTITIES,
    Source,
    check_groups,
    find_map,
    from_header,
    from_map,
)
from ekf_companion.logs.recording import Damage, Recording
from ekf_companion.logs.table import Table
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.event_columns import EventColumns, MergedEvents
from ekf_companion.nav.measurements import GnssFlag, HeadingSource, Kind

Columns = dict[str, Array]
"""Quantities in SI and radians, NaN where a row has none."""

GNSS_STD = {"gps_std_h": 2.0, "gps_std_v": 3.0, "gps_std_vel": 0.5}
"""m, m, m/s where the file holds no accuracy: a receiver in the open, on the safe side."""
HEADING_STD_DEG = 5.0
"""deg, where the file holds no accuracy."""
SEA_LEVEL_PRESSURE = 101325.0
"""Pa; ICAO standard atmosphere, as the next two."""
SCALE_HEIGHT = 288.15 / 0.0065
"""m: temperature at sea level by its lapse rate."""
PRESSURE_EXPONENT = 0.190263
_HOLDABLE = ("gps", "mag", "baro", "heading")


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def read(path: Path, columns: Mapping[str, Any] | None = None) -> Recording:
    """Read a file into events, by a map as in the module's docstring.

    By default that is the map beside the file or, where there is none, the header.

    Raises:
        LogError: A unit is unknown, a needed column is missing, a cell is no number, or an entry
            of the map is invalid.
    """
    where, columns = find_map(path, columns)
    options = {key: columns[key] for key in columns if key in OPTIONS}
    delimiter = options.get("delimiter", ",")
    if not isinstance(delimiter, str) or len(delimiter) != 1 or not delimiter.isascii():
        raise LogError(f'{where}: delimiter: {delimiter!r} is not one character, such as ";"')
    table = Table(path, delimiter)
    entries = {key: columns[key] for key in columns if key not in OPTIONS}
    notes: list[str] = []
    zero_height = 0.0
    if not entries and (known := csv_known.find(table.names)) is not None:
        where, notes = str(path), [f"header of {known.name}: read without a map"]
        entries = {key: known.columns[key] for key in known.columns if key not in OPTIONS}
        options = {key: known.columns[key] for key in OPTIONS if key in known.columns} | options
        if known.zero_height and options["origin"] == known.columns["origin"]:
            zero_height = known.zero_height
            notes.append(
                f"the file's height of zero is put at {zero_height:.1f} m above mean sea level, "
                "where gravity is the simulation's: altitudes of the estimate are larger by that"
            )
    if entries:
        sources = {name: from_map(where, name, entry) for name, entry in entries.items()}
    else:
        sources = from_header(path, table.names, notes)
    check_groups(path, sources)
    hold = options.get("hold", [])
    if not isinstance(hold, list) or any(name not in _HOLDABLE for name in hold):
        raise LogError(f"{where}: hold: {hold!r} is not a list of {', '.join(_HOLDABLE)}")
    values = _values(table, sources)
    del table  # of an hour it has a hundred megabytes
    total = len(values["time"])
    t_ns, row, values = _in_time(path, sources, values, notes)
    lost = total - len(t_ns)
    has_std = "heading_std" in values or "heading" not in values
    constant = {name for name, source in sources.items() if source.column is None}
    gnss, heading, mag, baro, imu = (
        _part(t_ns, values, begin, constant) for begin in ("gps_", "heading", "mag_", "baro_", "")
    )
    events = _gnss(where, gnss, hold, options.get("origin"), notes)
    events += _heading(where, heading, hold, options.get("heading_source", "magnetometer"))
    if not has_std:
        notes.append(f"accuracy not declared, so assumed (deg): heading_std {HEADING_STD_DEG:g}")
    events += _sensor("mag", Kind.MAG, mag, hold) + _barometer(baro, hold)
    events += _sensor("imu", Kind.IMU, imu, hold)
    if not events:
        raise LogError(
            f"{path}: no measurement found; declare its columns in {path.name}.columns.yaml "
            f"(quantities: {', '.join(QUANTITIES)})"
        )
    arrivals = [row[at] for _, at in events]
    return Recording(
        family="unknown",
        events=MergedEvents([found for found, _ in events], arrivals),
        notes=tuple(notes),
        damage=Damage(f"{lost} rows dropped", lost / total) if lost else Damage(),
        zero_height=zero_height,
    )


def _values(table: Table, sources: Mapping[str, Source]) -> Columns:
    """Return all quantities in SI, but the time as it is; NaN for what is no measurement."""
    names = sorted({source.column for source in sources.values() if source.column is not None})
    raw = table.read(names)
    n = len(raw[names[0]]) if names else 0
    left = Counter(source.column for source in sources.values())
    values: Columns = {}
    for name, source in sources.items():
        left[source.column] -= 1
        if source.column is None:
            column = np.full(n, source.value)
        else:
            # Of an hour a column has 7 MB: the last who needs one need not copy it
            column = raw[source.column].copy() if left[source.column] else raw.pop(source.column)
        values[name] = column
        if name != "time":
            # No sensor measures 1e30, which would overflow when scaled
            column[~(np.abs(column) < 1e30)] = np.nan
            column *= source.scale
    return values


def _in_time(
    path: Path, sources: Mapping[str, Source], values: Columns, notes: list[str]
) -> tuple[Stamps, Indices, Columns]:
    """Return stamps, ns, row numbers and values of the rows on one run of the clock."""
    time = values["time"]
    per_unit = round(abs(sources["time"].scale) * 1e9)
    good = np.abs(time) < 9e18 / per_unit
    row = np.flatnonzero(good)
    time = time[good]
    # Whole units apart: microseconds since 1970 in ns have more digits than a float
    whole = np.floor(time)
    t_ns = whole.astype(np.int64) * per_unit
    # Where the float's last digit is coarser than 1 ns, the file holds microseconds
    step = 1000 if np.spacing(np.abs(time).max(initial=0.0)) * per_unit > 1.0 else 1
    t_ns += np.rint((time - whole) * (per_unit / step)).astype(np.int64) * step
    kept = series.clock_run(t_ns)[0]
    if len(kept) == 0:
        raise LogError(f"{path}: no row with a time; the file ends after its header")
    lost = len(values["time"]) - int(kept.sum())
    if lost:
        notes.append(f"{lost} rows without a time, or one that does not fit the rest, were dropped")
    row, t_ns = row[kept], t_ns[kept]
    if lost:
        values = {name: column[row] for name, column in values.items()}
    return t_ns, row, values


class _Part(NamedTuple):
    """The rows of the file that hold any quantity of a sensor."""

    total: int
    """Rows of the file."""
    row: Indices
    """Their numbers."""
    t_ns: Stamps
    values: Columns
    is_apart: Mask
    """Whether the row before holds none."""

    def changed(self, *columns: Array) -> Mask:
        """Return in which rows a column differs from the row before in the file."""
        return np.asarray(series.changed(*columns) | self.is_apart)


def _part(t_ns: Stamps, values: Columns, begin: str, constant: Collection[str]) -> _Part:
    """Take the quantities whose names begin so out of the table."""
    chosen = {name: values.pop(name) for name in [*values] if name.startswith(begin)}
    any_known = np.zeros(len(t_ns), dtype=bool)
    for name in chosen.keys() - constant:
        any_known |= np.isfinite(chosen[name])
    row = np.flatnonzero(any_known)
    if len(row) < len(t_ns):
        chosen = {name: column[row] for name, column in chosen.items()}
    is_apart = np.diff(row, prepend=-2) != 1
    return _Part(len(t_ns), row, t_ns[row], chosen, is_apart)


Found = list[tuple[EventColumns, Indices]]
"""Events, and the numbers of their rows."""


def _found(
    part: _Part,
    kind: Kind,
    columns: Sequence[Array | float],
    needed: list[Array],
    held: list[Array] | None,
) -> Found:
    """Return events where the needed columns are known and, where values are held, have changed."""
    mask = np.ones(len(part.row), dtype=bool)
    for column in needed:
        mask &= np.isfinite(column)
    if held is not None:
        mask &= part.changed(*held)
    if not mask.any():
        return []
    return [(EventColumns(part.t_ns, kind, *columns).take(mask), part.row[mask])]


def _sensor(group: str, kind: Kind, part: _Part, hold: list[str]) -> Found:
    if not part.values.keys() >= {*GROUPS[group]}:
        return []
    axes = [part.values[name] for name in GROUPS[group]]
    return _found(part, kind, axes, axes, axes if group in hold else None)


def _barometer(part: _Part, hold: list[str]) -> Found:
    values = part.values
    if "baro_alt" in values:
        alt = values["baro_alt"]
    elif "baro_press" in values:
        pressure = values["baro_press"]
        ratio = np.where(pressure > 0.0, pressure, np.nan) / SEA_LEVEL_PRESSURE
        alt = SCALE_HEIGHT * (1.0 - ratio**PRESSURE_EXPONENT)
    else:
        return []
    held = [alt] if "baro" in hold else None
    return _found(part, Kind.BARO, [alt], [alt], held)


def _heading(where: str, part: _Part, hold: list[str], source: Any) -> Found:
    values = part.values
    known = {member.name.lower(): member for member in HeadingSource}
    if source not in known:
        raise LogError(f"{where}: heading_source: {source!r}; known are {', '.join(known)}")
    if "heading" not in values:
        return []
    heading = values["heading"]
    std = series.accuracy(values.get("heading_std", np.nan * heading), HEADING_STD_DEG * DEGREE)
    columns = (so3.wrap(heading), std, float(known[source]))
    held = [heading] if "heading" in hold else None
    return _found(part, Kind.HEADING, columns, [heading], held)


def _gnss(where: str, part: _Part, hold: list[str], origin: Any, notes: list[str]) -> Found:
    values, n = part.values, len(part.row)
    if "gps_north" in values:
        ned = np.stack([values["gps_north"], values["gps_east"], -values["gps_h"]], axis=1)
        lat, lon, alt = _origin(where, origin).to_geodetic(ned)
    elif "gps_lat" in values:
        lat, lon, alt = values["gps_lat"], values["gps_lon"], values["gps_alt"]
        lat = np.where(np.abs(lat) <= np.pi / 2.0, lat, np.nan)
    else:
        return []
    north = east = unknown = np.full(n, np.nan)
    if "gps_vn" in values:
        north, east = values["gps_vn"], values["gps_ve"]
    elif "gps_speed" in values:
        speed, course = values["gps_speed"], values["gps_course"]
        north, east = speed * np.cos(course), speed * np.sin(course)
    velocity = (north, east, values.get("gps_vd", unknown))
    if missing := [name for name in GNSS_STD if name not in values]:
        said = ", ".join(f"{name} {GNSS_STD[name]:g}" for name in missing)
        notes.append(f"accuracy not declared, so assumed (m, m/s): {said}")
    std = [series.accuracy(values.get(name, unknown), least) for name, least in GNSS_STD.items()]
    position = (lat, so3.wrap(lon), alt)
    columns: list[Any] = [*position, *velocity, *std, np.nan, float(GnssFlag.NONE)]
    # A new fix moves; loggers update altitude, speed and course some rows later
    held = [lat, lon]
    repeated = int((np.isfinite(lat[1:]) & ~part.changed(*held)[1:]).sum())
    if "gps" not in hold and repeated > part.total / 2:
        notes.append(
            f"{repeated} of {part.total} rows repeat the GPS values of the row before: if the file "
            "holds them until new ones come, declare hold: [gps]"
        )
    needed = [lat, lon, alt]
    return _found(part, Kind.GNSS, columns, needed, held if "gps" in hold else None)


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
