"""Which of several sensors, receivers and estimator lanes of a DataFlash log is used, and when.

The autopilot says which receiver it uses (GPS.U), which lane of its filter is primary (XKF4.PI,
NKF4.PI), and which compass and barometer that lane fuses (XKFS). A lane belongs to the inertial
sensor of its number among those that EK3_IMU_MASK or EK2_IMU_MASK names.

Source: ArduPilot libraries/AP_NavEKF3/LogStructure.h, AP_GPS/LogStructure.h, AP_NavEKF3.cpp.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from ekf_companion.logs import instances
from ekf_companion.logs.dataflash_columns import boot_ns, parameter, stamps
from ekf_companion.logs.dataflash_records import OFFSET, Tables
from ekf_companion.logs.dataflash_sensors import (
    ALIGNED,
    FAMILIES,
    FOLLOWERS,
    INSTANCE,
    IS_GOOD,
    Family,
    Sensor,
    good_of,
    has_flag,
    is_numbered,
    sensors_of,
)
from ekf_companion.logs.inertial_units import STDS, Samples
from ekf_companion.logs.instances import Stretch, Wanted
from ekf_companion.logs.series import ascending, stack
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps

_LANES = (("XKF4", "XKF1", "EK3_IMU_MASK", 3), ("NKF4", "NKF1", "EK2_IMU_MASK", 2))
"""Messages that name the primary lane, those of the lanes, and the filter's AHRS_EKF_TYPE."""
ASKED: dict[str, tuple[str, ...]] = {
    "XKF4": ("TimeUS", "C", "PI"),
    "NKF4": ("TimeUS", "TimeMS", "C", "PI"),
    "XKFS": ("TimeUS", "C", "MI", "BI"),
}
"""Messages that name the sensors in use, and the columns that are read of each."""


def choose(tables: Tables, notes: list[str]) -> Tables:
    """Return the tables with the rows of the sensors in use, without the messages that name these.

    All rows of a kind are put in the table of its first message, and numbered where there were
    several.
    """
    lanes = _primary_lanes(tables)
    wanted = _wanted(tables, lanes)
    chosen = {name: table for name, table in tables.items() if name not in ASKED}
    begun_ns = _begun_ns(chosen)
    unused = []
    for name, family in FAMILIES.items():
        sensors = [*sensors_of(chosen, family.messages)]
        if len(sensors) < 2:
            if sensors and sensors[0].message != name:
                notes.append(f"{name}: {sensors[0].message} is used: the log holds no other")
                _rename(chosen, name, sensors)
            continue
        used = instances.choose(good_of(name, sensors, family), wanted.get(name, ()))
        if name == "IMU" and used:
            said, samples = _judge_units(
                chosen, sensors, used[0].key, wanted.get(name, ()), begun_ns
            )
            notes += said
            if samples is not None:
                for message in family.messages:
                    chosen.pop(message, None)
                chosen[name] = samples
                continue
            used = used[:1]
        keys = {one.key for one in used} or {sensors[0].number}
        used = used or [Stretch(0, sensors[0].number, is_wanted=False)]
        notes += _notes(name, family, used, sensors, begun_ns)
        unused += [one.message for one in sensors[1:] if one.is_named and one.number not in keys]
        _put_together(chosen, name, family, sensors, used)
    if unused:
        notes.append(f"only the first sensor of each kind is used, not {', '.join(unused)}")
    for name, messages in FOLLOWERS.items():
        sensors = [*sensors_of(chosen, messages)]
        if any(one.is_named for one in sensors[1:]):
            _join(chosen, name, sensors)
    for _, name, _, _ in _LANES:
        if name in chosen:
            chosen[name] = _of_lane(name, chosen[name], lanes, notes)
    return chosen


def _rename(tables: Tables, name: str, sensors: Sequence[Sensor]) -> None:
    """Let a sensor have the message of the first of its kind."""
    for one in sensors:
        tables[name] = tables.pop(one.message)


def _primary_lanes(tables: Tables) -> dict[str, Wanted]:
    """Return the primary lane over time, by the message that the lanes write.

    Of two filters that run, that which flies (AHRS_EKF_TYPE) comes first.
    """
    flies = parameter(tables, "AHRS_EKF_TYPE")
    found = {}
    for message, name, _, _ in sorted(_LANES, key=lambda one: one[3] != flies):
        table = tables.get(message)
        if table is not None and "PI" in table.names:
            # Before one is chosen it is -1
            found[name] = _changes(table, "PI", lambda rows: np.asarray(rows["PI"] >= 0))
    return {name: some for name, some in found.items() if some}


def _wanted(tables: Tables, lanes: dict[str, Wanted]) -> dict[str, Wanted]:
    """Return the sensor that the autopilot uses over time, by kind."""
    wanted: dict[str, Wanted] = {}
    gps = tables.get("GPS")
    if gps is not None and "U" in gps.names and is_numbered(gps):
        wanted["GPS"] = _changes(gps, INSTANCE, lambda rows: np.asarray(rows["U"] != 0))
    for name, changes in lanes.items():
        mask = next(mask for _, lane, mask, _ in _LANES if lane == name)
        numbers = _bits(parameter(tables, mask))
        imus = [(t_ns, numbers[lane] if lane < len(numbers) else lane) for t_ns, lane in changes]
        wanted.setdefault("IMU", imus)
    chosen = tables.get("XKFS")
    if chosen is not None and {"C", "MI", "BI"} <= {*chosen.names} and "XKF1" in lanes:
        used = [Stretch(t_ns, lane, is_wanted=True) for t_ns, lane in lanes["XKF1"]]

        def is_primary(rows: Column) -> Mask:
            return _is_of(used, "C", rows)

        wanted["MAG"] = _changes(chosen, "MI", is_primary)
        wanted["BARO"] = _changes(chosen, "BI", is_primary)
    return wanted


def _is_of(used: Sequence[Stretch], column: str, rows: Column) -> Mask:
    """Return which rows belong to the sensor, or the lane, in use, by the column of its number."""
    keys = np.array([one.key for one in used])
    return np.asarray(rows[column] == keys[instances.place_of(used, stamps(rows))])


def _changes(table: StoredRows, column: str, choose: Callable[[Column], Mask]) -> Wanted:
    """Return the times at which a column changes in some rows, with its value."""
    found: list[tuple[int, int]] = []
    for _, rows in table.parts():
        rows = rows[choose(rows)]
        t_ns = boot_ns(rows)
        if t_ns is None or not len(rows):
            continue
        values = rows[column].astype(np.int64)
        is_new = np.append(not found or values[0] != found[-1][1], np.diff(values) != 0)
        found += zip(t_ns[is_new].tolist(), values[is_new].tolist(), strict=True)
    return sorted(found)


def _bits(mask: float | None) -> list[int]:
    """Return which bits are set."""
    return [bit for bit in range(8) if int(mask or 0) >> bit & 1]


def _begun_ns(tables: Tables) -> int:
    """Return the first stamp of all sensors."""
    messages = [message for one in FAMILIES.values() for message in one.messages]
    found = [boot_ns(tables[message].read(0, 1)) for message in messages if message in tables]
    return min((int(t_ns[0]) for t_ns in found if t_ns is not None), default=0)


def _notes(
    name: str,
    family: Family,
    used: Sequence[Stretch],
    sensors: Sequence[Sensor],
    begun_ns: int,
) -> list[str]:
    """Return notes on the choice."""
    names = {
        one.number: one.message if one.is_named else f"instance {one.number}" for one in sensors
    }
    if len(used) > 1:
        return instances.describe(used, name, names, family.lack, begun_ns)
    one = used[0]
    others = [sensor for sensor in sensors if sensor.number != one.key]
    is_first = one.key == sensors[0].number
    if is_first and all(sensor.is_named for sensor in sensors):
        return []
    words = ", ".join(
        sensor.message if sensor.is_named else str(sensor.number) for sensor in others
    )
    why = ""
    if not is_first:
        why = (
            " as by the autopilot"
            if one.is_wanted
            else f", as {names[others[0].number]} {family.lack}"
        )
    return [f"{name}: {names[one.key]} is used{why}; the log also holds {words}"]


def _judge_units(
    tables: Tables, sensors: Sequence[Sensor], first: int, wanted: Wanted, begun_ns: int
) -> tuple[list[str], StoredRows | None]:
    """Judge the inertial units by each other.

    Return notes on them, and the samples in use where not all are the first one's.
    """
    if any(one.is_named for one in sensors):
        tables = dict(tables)
        _join(tables, "IMU", sensors)
        numbered = tables["IMU"]
    else:
        numbered = sensors[0].table
    samples = Samples(first, wanted)
    axes = ALIGNED["IMU"]
    fields = [(OFFSET, "<i8"), ("TimeUS", "<u8"), *((name, "<f4") for name in (*axes, *STDS))]
    found = StoredRows(np.dtype(fields))
    for _, rows in numbered.parts():
        t_ns = stamps(rows)
        is_bad = ~(has_flag(rows, "GH") & has_flag(rows, "AH"))
        values = stack(rows, *axes)
        at, used_ns, values = samples.take(rows[INSTANCE], t_ns, values, is_bad)
        part = np.zeros(len(at), dtype=found.dtype)
        part[OFFSET], part["TimeUS"] = rows[OFFSET][at], used_ns // 1000
        for name, column in zip((*axes, *STDS), values.T, strict=True):
            part[name] = column
        found.append(part)
    names = {
        one.number: one.message if one.is_named else f"instance {one.number}" for one in sensors
    }
    return samples.notes("IMU", names, begun_ns), found if samples.lanes.changes else None


def _put_together(
    tables: Tables,
    name: str,
    family: Family,
    sensors: Sequence[Sensor],
    used: Sequence[Stretch],
) -> None:
    """Put the rows in use in the table of the first message."""
    keys = {one.key for one in used}
    if len(keys) == 1 and all(one.is_named for one in sensors):
        _rename(tables, name, [one for one in sensors if one.number in keys])
    elif any(one.is_named for one in sensors) and keys != {sensors[0].number}:
        _join(tables, name, sensors)
        sensors = [*sensors_of(tables, (name,))]
    for message in family.messages:
        if message != name:
            tables.pop(message, None)

    def keep(_: int, rows: Column) -> Mask:
        return _is_of(used, INSTANCE, rows)

    if not is_numbered(tables[name]):
        return
    table = tables[name]
    tables[name] = table.kept(keep)
    if len(used) > 1 and name in ALIGNED:
        tables[name] = _aligned(name, tables[name], used, _rows_between(name, table))


def _rows_between(
    name: str, table: StoredRows
) -> Callable[[instances.Key, int, int], tuple[Stamps, Array]]:
    """Return a function that finds the good rows of a sensor between two times."""

    def rows_of(key: instances.Key, begin_ns: int, end_ns: int) -> tuple[Stamps, Array]:
        times, values = [np.empty(0, dtype=np.int64)], [np.empty((0, len(ALIGNED[name])))]
        for _, rows in table.parts():
            t_ns = boot_ns(rows)
            if t_ns is None or not (t_ns < end_ns).any() or not (t_ns >= begin_ns).any():
                continue
            rows = rows[(rows[INSTANCE] == key) & (t_ns >= begin_ns) & (t_ns < end_ns)]
            rows = rows[IS_GOOD[name](rows, None)] if len(rows) else rows
            if (t_ns := boot_ns(rows)) is not None and len(rows):
                later = ascending(t_ns)
                times.append(t_ns[later])
                values.append(stack(rows[later], *ALIGNED[name]))
        return np.concatenate(times), np.concatenate(values)

    return rows_of


def _aligned(
    name: str,
    table: StoredRows,
    used: Sequence[Stretch],
    rows_of: Callable[[instances.Key, int, int], tuple[Stamps, Array]],
) -> StoredRows:
    """Return the rows with the offset of each sensor to the first removed."""
    steps = instances.steps(used, rows_of)
    found = StoredRows(table.dtype)
    for _, rows in table.parts():
        rows = rows.copy()
        place = instances.place_of(used, stamps(rows))
        for column, each in zip(ALIGNED[name], steps.T, strict=True):
            moved = rows[column] + each[place]
            whole = rows.dtype[column].kind in "iu"
            rows[column] = np.round(moved) if whole else moved
        found.append(rows)
    return found


def _join(tables: Tables, name: str, sensors: Sequence[Sensor]) -> None:
    """Put the rows of several messages in one table, in the order of the file, with a number."""
    common = [
        column
        for column in sensors[0].table.names
        if all(column in one.table.names for one in sensors)
    ]
    first = sensors[0].table.dtype
    fields = [(column, first[column]) for column in common if column != INSTANCE]
    dtype = np.dtype([*fields, (INSTANCE, "u1")])
    parts = []
    for one in sensors:
        rows = one.table.all()
        rows = rows[one.rows_of(rows)]
        part = np.zeros(len(rows), dtype=dtype)
        for column, _ in fields:
            part[column] = rows[column]
        part[INSTANCE] = one.number
        parts.append(part)
    for one in sensors:
        tables.pop(one.message, None)
    joined = np.concatenate(parts)
    table = StoredRows(dtype)
    table.append(joined[np.argsort(joined[OFFSET], kind="stable")])
    tables[name] = table


def _of_lane(
    name: str, table: StoredRows, lanes: dict[str, Wanted], notes: list[str]
) -> StoredRows:
    """Return the estimates of the primary lane; where it is not known, of the lowest."""
    if "C" not in table.names or table.dtype["C"] != np.uint8:
        return table
    parts = [np.unique(rows["C"]) for _, rows in table.parts()]
    found: Indices = np.unique(np.concatenate(parts)).astype(np.int64)
    used = [
        Stretch(t_ns, lane, is_wanted=True) for t_ns, lane in lanes.get(name, ()) if lane in found
    ] or [Stretch(0, int(found[0]), is_wanted=False)]
    if len(found) == 1:
        return table
    rest = ", ".join(str(lane) for lane in found.tolist() if lane != used[0].key)
    notes.append(f"{name}: instance {used[0].key} is used; the log also holds {rest}")
    for before, one in itertools.pairwise(used[: instances.MOST + 1]):
        if one.key != before.key:
            seconds = (one.from_ns - used[0].from_ns) * 1e-9
            notes.append(f"{name}: instance {one.key} is primary from {seconds:.1f} s on")

    def keep(_: int, rows: Column) -> Mask:
        return _is_of(used, "C", rows)

    return table.kept(keep)
