"""Which of several sensors and receivers of a PX4 log is used, over time.

PX4 puts what it uses in topics of their own: ``sensor_combined`` the inertial samples,
``vehicle_gps_position`` the fixes. Where such a topic has no good rows, the sensors' own topics are
used. With a filter for each compass, ``estimator_selector_status`` names the one in use.

Source: PX4-Autopilot, EKF2Selector.cpp, voted_sensors_update.cpp (sensor_combined is a mean of
vehicle_imu), VehicleGPSPosition.cpp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.logs import instances, series
from ekf_companion.logs.inertial_units import STDS, Samples, by_time
from ekf_companion.logs.instances import Good, Stretch, Wanted
from ekf_companion.logs.series import FIX_3D
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.logs.ulog_messages import Messages, Table
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.earth import is_place

SECOND_NS = 1_000_000_000
PLACE = "place"
"""Column of rows of several sensors: 0 of the one used first, 1 of the next."""
SELECTED = "estimator_selector_status"
ANGLES, VELOCITIES = (
    tuple(f"{field}[{axis}]" for axis in range(3)) for field in ("delta_angle", "delta_velocity")
)
ASKED = ("vehicle_imu", SELECTED)
"""Topics that only this module reads."""
INTEGRATED = (*ANGLES, *VELOCITIES, "delta_angle_dt", "delta_velocity_dt")
"""Of vehicle_imu: angle, rad, velocity, m/s, and the times of both, us."""
_RATES = tuple(
    f"{field}[{axis}]" for field in ("gyro_rad", "accelerometer_m_s2") for axis in range(3)
)
_FIELD = tuple(f"magnetometer_ga[{axis}]" for axis in range(3))
_PLACES = (("latitude_deg", "longitude_deg"), ("lat", "lon"))
_VELOCITY = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")


class Family(NamedTuple):
    """The topics of one kind of sensor."""

    name: str
    topics: tuple[str, ...]
    """The topic of what the autopilot uses, then those of its sensors."""
    patience_ns: int
    """Time without a good row after which another sensor is taken."""
    lack: str
    """What a sensor that is left lacks, for the note."""
    device: str
    """Column of the sensor's id here, and in estimator_selector_status."""
    selected: str
    aligned: tuple[str, ...]
    """Columns that are continued from the sensor before."""
    is_good: Callable[[Column, Column | None], Mask]
    """Returns which of some rows are good, given the row before them."""


def _is_sample(rows: Column, before: Column | None) -> Mask:
    values = series.stack(rows, *_RATES)
    good = np.isfinite(values).all(axis=1) & (values != 0.0).any(axis=1)
    last = values[:1] * np.nan if before is None else series.stack(before, *_RATES)
    return np.asarray(good & (np.diff(values, axis=0, prepend=last) != 0.0).any(axis=1))


def _is_fix(rows: Column, before: Column | None) -> Mask:
    names = rows.dtype.names or ()
    unit, way = (1.0, _PLACES[0]) if "latitude_deg" in names else (1e-7, _PLACES[1])
    place = is_place(*(rows[name] * unit for name in way))
    time = ("time_utc_usec",) if "time_utc_usec" in names else ()
    height = [name for name in ("altitude_msl_m", "alt") if name in names]
    repeated = series.is_repeated(rows, before, time, [*way, *height], _VELOCITY)
    return np.asarray((rows["fix_type"] >= FIX_3D) & place & ~repeated)


def _is_field(rows: Column, _: Column | None) -> Mask:
    field = series.stack(rows, *_FIELD)
    return np.asarray(np.isfinite(field).all(axis=1) & (field != 0.0).any(axis=1))


def _is_height(rows: Column, _: Column | None) -> Mask:
    return np.asarray(np.isfinite(rows["baro_alt_meter"]))


FAMILIES = (
    Family(
        "IMU",
        ("sensor_combined", "vehicle_imu"),
        SECOND_NS // 5,
        "has no good sample there",
        "gyro_device_id",
        "gyro_device_id",
        _RATES,
        _is_sample,
    ),
    Family(
        "GPS",
        ("vehicle_gps_position", "sensor_gps"),
        2 * SECOND_NS,
        "has no new fix there",
        "device_id",
        "",
        (),
        _is_fix,
    ),
    Family(
        "magnetometer",
        ("vehicle_magnetometer",),
        3 * SECOND_NS,
        "has no good field there",
        "device_id",
        "mag_device_id",
        _FIELD,
        _is_field,
    ),
    Family(
        "barometer",
        ("vehicle_air_data",),
        3 * SECOND_NS,
        "has no good height there",
        "baro_device_id",
        "baro_device_id",
        ("baro_alt_meter",),
        _is_height,
    ),
)


class _Sensor(NamedTuple):
    """The rows of one sensor, or of the selection that the autopilot has made among several."""

    topic: str
    instance: int
    rows: StoredRows
    device: int | None

    @property
    def words(self) -> str:
        return f"{self.topic} {self.instance}"


def choose(log: Messages, tables: Sequence[Table], notes: list[str]) -> dict[str, StoredRows]:
    """Return the rows of the sensors in use, by the topic that they count as.

    ``tables`` are those with the fields needed, in the order in which they are preferred.
    """
    chosen: dict[str, StoredRows] = {}
    begun_ns = min((_stamps(one.rows.read(0, 1))[0] for one in tables), default=0)
    for family in FAMILIES:
        sensors = _sensors(log, family, tables)
        if not sensors:
            continue
        units = [one for one in sensors if one.topic == "vehicle_imu"]
        if len(units) > 1:
            said, samples = _judge_units(family, units, tables, int(begun_ns))
            notes += said
            if samples is not None:
                chosen[family.topics[0]] = samples
                continue
        used = [Stretch(0, 0, is_wanted=True)]
        if len(sensors) > 1:
            good = {key: _good(family, one) for key, one in enumerate(sensors)}
            wanted = _wanted(family, sensors, tables)
            used = instances.choose(good, wanted) or used
        names = {key: one.words for key, one in enumerate(sensors)}
        if len(used) > 1:
            notes += instances.describe(used, family.name, names, family.lack, int(begun_ns))
        elif used[0].key:
            why = "" if used[0].is_wanted else f": {names[0]} {family.lack}"
            by = " as by the autopilot" if used[0].is_wanted else ""
            notes.append(f"{family.name}: {names[used[0].key]} is used{by}{why}")
        topic = family.topics[0] if family.name == "IMU" else sensors[0].topic
        chosen[topic] = _put_together(family, sensors, used)
    return chosen


def _sensors(log: Messages, family: Family, tables: Sequence[Table]) -> list[_Sensor]:
    """Return the sensors of a kind, the preferred one first."""
    found: list[_Sensor] = []
    for topic in family.topics:
        own = [one for one in tables if one.topic == topic]
        if topic == "sensor_gps":
            prime = log.parameters.get("SENS_GPS_PRIME", 0.0)
            own.sort(key=lambda one: one.instance != prime)
        for one in own:
            rows = _as_combined(one.rows) if topic == "vehicle_imu" else one.rows
            if rows is None or any(
                (each.topic, each.instance) == (topic, one.instance) for each in found
            ):
                continue
            is_named = family.device in one.rows.names
            device = int(one.rows.read(0, 1)[family.device][0]) if is_named else None
            found.append(_Sensor(topic, one.instance, rows, device))
    if family.name == "GPS":
        # Rows of two ways to write a place do not fit in one table
        known = [
            next((way for way in _PLACES if {*way} <= {*one.rows.names}), None) for one in found
        ]
        found = [one for one, way in zip(found, known, strict=True) if way and way == known[0]]
    if family.name == "IMU" and (ids := _selected(tables, family.selected)):
        last = ids[-1][1]
        found.sort(key=lambda one: one.topic == "vehicle_imu" and one.device != last)
    return found


def _as_combined(rows: StoredRows) -> StoredRows | None:
    """Return what sensor_combined holds of vehicle_imu; None if rows of it were left out.

    Each row is the mean over its time: rows that cover less than half of the log were thinned.
    """
    first = rows.read(0, 1 << 10)
    steps = np.diff(_stamps(first))
    covered_ns = float(np.median(first["delta_angle_dt"])) * 1e3
    if not (steps > 0).any() or covered_ns < 0.5 * float(np.median(steps[steps > 0])):
        return None
    found = StoredRows(np.dtype([("timestamp", "<u8"), *((name, "<f4") for name in _RATES)]))
    is_sampled = "timestamp_sample" in rows.names
    for _, some in rows.parts():
        part = np.zeros(len(some), dtype=found.dtype)
        part["timestamp"] = some["timestamp_sample" if is_sampled else "timestamp"]
        for names, sums, over in (
            (_RATES[:3], ANGLES, "delta_angle_dt"),
            (_RATES[3:], VELOCITIES, "delta_velocity_dt"),
        ):
            seconds = np.where(some[over] > 0, some[over] * 1e-6, np.nan)
            for name, each in zip(names, sums, strict=True):
                part[name] = some[each] / seconds
        found.append(part)
    return found


def _stamps(rows: Column) -> Stamps:
    return series.nanoseconds(rows["timestamp"])


def _good(family: Family, sensor: _Sensor) -> Good:
    """Return when a sensor measures."""
    good = Good(family.patience_ns)
    before: Column | None = None
    for _, rows in sensor.rows.parts():
        good.add(_stamps(rows), family.is_good(rows, before))
        before = rows[-1:]
    good.finish()
    return good


def _wanted(family: Family, sensors: Sequence[_Sensor], tables: Sequence[Table]) -> Wanted:
    """Return the sensor that the autopilot uses, over time."""
    first = sensors[0].topic
    if first == family.topics[0] and any(one.topic != first for one in sensors):
        return [(0, 0)]  # its own choice, beside the sensors
    keys = {one.device: key for key, one in enumerate(sensors) if one.device is not None}
    ids = _selected(tables, family.selected)
    return [(t_ns, keys[device]) for t_ns, device in ids if device in keys]


def _selected(tables: Sequence[Table], column: str) -> list[tuple[int, int]]:
    """Return the times at which the selected sensor changes, with its id."""
    found: list[tuple[int, int]] = []
    for one in tables:
        if one.topic != SELECTED or column not in one.rows.names:
            continue
        for _, rows in one.rows.parts():
            for t_ns, device in zip(_stamps(rows).tolist(), rows[column].tolist(), strict=True):
                if device and (not found or device != found[-1][1]):
                    found.append((t_ns, device))
    return sorted(found)


def _judge_units(
    family: Family, units: Sequence[_Sensor], tables: Sequence[Table], begun_ns: int
) -> tuple[list[str], StoredRows | None]:
    """Judge the inertial units by each other.

    Return notes on them, and the samples in use where not all are the first one's.
    """
    wanted = _wanted(family, units, tables)
    good = {key: _good(family, one) for key, one in enumerate(units)}
    used = instances.choose(good, wanted)
    samples = Samples(used[0].key if used else 0, wanted)
    fields = [("timestamp", "<u8"), *((name, "<f4") for name in (*_RATES, *STDS))]
    found = StoredRows(np.dtype(fields))
    for number, rows in by_time([one.rows for one in units], "timestamp"):
        values = series.stack(rows, *_RATES)
        is_bad = np.zeros(len(rows), dtype=bool)
        _, used_ns, values = samples.take(number, _stamps(rows), values, is_bad)
        part = np.zeros(len(used_ns), dtype=found.dtype)
        part["timestamp"] = used_ns // 1000
        for name, column in zip((*_RATES, *STDS), values.T, strict=True):
            part[name] = column
        found.append(part)
    names = {key: one.words for key, one in enumerate(units)}
    return samples.notes(family.name, names, begun_ns), found if samples.lanes.changes else None


def _put_together(
    family: Family, sensors: Sequence[_Sensor], used: Sequence[Stretch]
) -> StoredRows:
    """Return the rows in use, in the order of use."""
    if len({one.key for one in used}) == 1:
        return sensors[used[0].key].rows
    keys = [*dict.fromkeys(one.key for one in used)]
    first = sensors[keys[0]].rows
    names = [name for name in first.names if all(name in sensors[key].rows.names for key in keys)]
    dtype = np.dtype([*((name, first.dtype[name]) for name in names), (PLACE, "u1")])
    steps = np.zeros((len(used), len(family.aligned)))
    if family.aligned:
        steps = instances.steps(used, _rows_between(family, sensors))
    found = StoredRows(dtype)
    for number, one in enumerate(used):
        for _, rows in sensors[one.key].rows.parts():
            rows = rows[instances.place_of(used, _stamps(rows)) == number]
            if not len(rows):
                continue
            part = np.zeros(len(rows), dtype=dtype)
            for name in names:
                part[name] = rows[name]
            for name, step in zip(family.aligned, steps[number], strict=True):
                part[name] = rows[name] + step
            part[PLACE] = keys.index(one.key)
            found.append(part)
    return found


def _rows_between(
    family: Family, sensors: Sequence[_Sensor]
) -> Callable[[instances.Key, int, int], tuple[Stamps, Array]]:
    """Return a function that finds the good rows of a sensor between two times."""

    def rows_of(key: instances.Key, begin_ns: int, end_ns: int) -> tuple[Stamps, Array]:
        times, values = [np.empty(0, dtype=np.int64)], [np.empty((0, len(family.aligned)))]
        for _, rows in sensors[key].rows.parts():
            t_ns = _stamps(rows)
            rows = rows[(t_ns >= begin_ns) & (t_ns < end_ns)]
            rows = rows[family.is_good(rows, None)] if len(rows) else rows
            if len(rows):
                later = series.ascending(_stamps(rows))
                times.append(_stamps(rows)[later])
                values.append(series.stack(rows[later], *family.aligned))
        return np.concatenate(times), np.concatenate(values)

    return rows_of
