"""Logs as comma-separated text: every column and every unit is declared, nothing is guessed.

Native files declare them in the header. A column is a quantity and its unit::

    time_us | time_ms | time_s                      needed; the sample's stamp
    gyro_x_rps | gyro_x_dps   (and y, z)            body frame: forward, right, down
    accel_x_mps2 | accel_x_g  (and y, z)            specific force: -9.8 down at rest
    gyro2_x_rps, accel2_x_mps2, ... gyro4, accel4   other inertial units, in the same axes
    mag_x_gauss | mag_x_uT | mag_x_mG  (and y, z)
    baro_alt_m | baro_press_hPa | baro_press_Pa
    range_m, range_std_m                            to the ground, along the body's down axis
    flow_x_rps, flow_y_rps                          of a camera that looks down: by the sensor's
    flow_gyro_x_rps, flow_gyro_y_rps                axes, as OPTICAL_FLOW_RAD has it; its own gyro
    flow_quality, flow_std_rps                      0 nothing seen, 1 best
    anchor_range_m, anchor, anchor_std_m            its number in the configuration; or where it
    anchor_north_m, anchor_east_m, anchor_down_m    is, about the origin
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

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import clock_run, csv_known, repeats
from ekf_companion.logs.csv_columns import (
    OPTIONS,
    QUANTITIES,
    Source,
    check_groups,
    find_map,
    from_header,
    from_map,
)
from ekf_companion.logs.csv_events import Columns, EventMaker
from ekf_companion.logs.recording import Recording, dropped, misfits
from ekf_companion.logs.spool import Spool
from ekf_companion.logs.spooled_events import SpooledEvents
from ekf_companion.logs.table import AT_ONCE, Table
from ekf_companion.nav.arrays import Array, Mask, Stamps

SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas"}
"""Characters that may stand between columns, and their names."""


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
    _check_separated(path, table.names, delimiter)
    entries = {key: columns[key] for key in columns if key not in OPTIONS}
    notes = [*table.notes]
    zero_height = 0.0
    if not entries and (known := csv_known.find(table.names)) is not None:
        where = str(path)
        notes.append(f"header of {known.name}: read without a map")
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
    maker = EventMaker(where, sources, options)
    names = sorted({source.column for source in sources.values() if source.column is not None})
    events, total = SpooledEvents(), 0
    with table.spool(names) as rows, _Clock(path, sources["time"], names, rows) as clock:
        notes += clock.notes()
        lost, rows_in_all = clock.lost, len(rows)
        for row, t_ns, values in clock.kept():
            total += len(t_ns)
            events.append(maker.events(t_ns, row, _values(values, names, sources)))
    notes += maker.notes(total)
    if not len(events):
        raise LogError(
            f"{path}: no measurement found; declare its columns in {path.name}.columns.yaml "
            f"(quantities: {', '.join(QUANTITIES)})"
        )
    return Recording(
        family="unknown",
        events=events,
        notes=tuple(notes),
        lost_share=lost / max(rows_in_all, 1),
        damage=dropped(lost, rows_in_all),
        zero_height=zero_height,
    )


def _check_separated(path: Path, names: list[str], delimiter: str) -> None:
    """Refuse a header that another character separates.

    Raises:
        LogError: It is refused.
    """
    others = [one for one in SEPARATORS if one != delimiter]
    other = next((one for one in others if len(names) == 1 and names[0].count(one) > 1), "")
    if other:
        text = "\\t" if other == "\t" else other
        raise LogError(
            f'{path}: {SEPARATORS[other]} separate its columns; say delimiter: "{text}" in a file '
            f"{path.name}.columns.yaml beside it (numbers with a decimal point, not a comma)"
        )


def _values(rows: Array, names: list[str], sources: Mapping[str, Source]) -> Columns:
    """Return all quantities but the time in SI; NaN for what is no measurement."""
    values: Columns = {}
    for name, source in sources.items():
        if name == "time":
            continue
        if source.column is None:
            column = np.full(len(rows), source.value)
        else:
            column = rows[:, names.index(source.column)].copy()
        # No sensor measures 1e30, which would overflow when scaled
        column[~(np.abs(column) < 1e30)] = np.nan
        values[name] = column * source.scale
    return values


class _Clock:
    """The rows of a table that are on one run of the clock, and their times."""

    def __init__(self, path: Path, source: Source, names: list[str], rows: Spool) -> None:
        """Read the times of all rows, and find the run.

        Raises:
            LogError: No row has a time.
        """
        self._source, self._rows, self._times = source, rows, Spool(1)
        self._per_unit = round(abs(source.scale) * 1e9)
        largest, found = 0.0, repeats.Repeats()
        for part in rows.blocks(AT_ONCE):
            if source.column is None:
                time = np.full(len(part), source.value)
            else:
                time = part[:, names.index(source.column)]
            is_time = self._is_time(time)
            t_ns = np.where(is_time, time * self._per_unit, 0.0).astype(np.int64)
            time = np.where(found.take(t_ns, part), np.nan, time)
            self._times.append(time[:, None])
            largest = float(np.abs(time[self._is_time(time)]).max(initial=largest))
        self._repeated = found.count
        # Where the float's last digit is coarser than 1 ns, the file holds microseconds
        self._step = 1000 if np.spacing(largest) * self._per_unit > 1.0 else 1
        self._ranges = clock_run.of_parts(t_ns for _, t_ns in self._stamps())[0]
        if not self._ranges:
            raise LogError(f"{path}: no row with a time; the file ends after its header")

    def __enter__(self) -> _Clock:
        return self

    def __exit__(self, *_: object) -> None:
        """Delete the times."""
        self._times.__exit__()

    @property
    def lost(self) -> int:
        """Return how many rows are not on the run, and no copies of others."""
        used = sum(end - first for first, end in self._ranges)
        return len(self._rows) - used - self._repeated

    def notes(self) -> Iterator[str]:
        """Return notes on rows that were dropped."""
        why = "without a time, or with one that does not fit the rest"
        parts = (t_ns for _, t_ns in self._stamps()) if self.lost else ()
        zeros = clock_run.zeros_off(parts, self._holds)
        yield from misfits(self.lost, len(self._rows), why, zeros)
        yield from repeats.note(self._repeated)

    def kept(self) -> Iterator[tuple[Stamps, Stamps, Array]]:
        """Yield numbers, stamps (ns) and values of the rows on the run, part by part."""
        first = timed = 0
        for is_time, t_ns in self._stamps():
            is_kept = self._holds(timed, t_ns)
            place = np.flatnonzero(is_time)[is_kept]
            if len(place):
                rows = self._rows.read(first, len(is_time))
                if len(place) < len(rows):
                    rows = rows[place]
                yield first + place, t_ns[is_kept], rows
            first, timed = first + len(is_time), timed + len(t_ns)

    def _holds(self, first: int, t_ns: Stamps) -> Mask:
        """Return which timed rows of a part are on the run, by the number of the first."""
        return clock_run.in_ranges(self._ranges, first, len(t_ns))

    def _stamps(self) -> Iterator[tuple[Mask, Stamps]]:
        """Yield, part by part, which rows have a time, and the times, ns, of those that do."""
        is_count = self._per_unit in (1000, 1_000_000)  # of us or ms: it may have 32 bits
        unwinder = clock_run.Unwinder(self._per_unit) if is_count else None
        for part in self._times.blocks(AT_ONCE):
            is_time = self._is_time(part[:, 0])
            time = part[is_time, 0]
            # Whole units apart: microseconds since 1970 in ns have more digits than a float
            whole = np.floor(time)
            t_ns = whole.astype(np.int64) * self._per_unit
            parts = np.rint((time - whole) * (self._per_unit / self._step))
            t_ns += parts.astype(np.int64) * self._step
            yield is_time, unwinder.take(t_ns) if unwinder else t_ns

    def _is_time(self, time: Array) -> Mask:
        return np.asarray(np.abs(time) < 9e18 / self._per_unit)
