"""The topics of a PX4 log (.ulg) that are used, as columns."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import aids, clock_run, repeats, series, ulog_instances, ulog_messages
from ekf_companion.logs.clock_run import Extent
from ekf_companion.logs.recording import Damage
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.logs.ulog_messages import Messages
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows

Topic = dict[str, npt.NDArray[Any]]
"""Columns of one topic by field name, and ``t_ns``: the time of publication of each row."""
Topics = dict[str, Topic]
"""By name, in memory."""
Stored = dict[str, StoredRows]
"""Rows of the topics by name, with ``timestamp`` as published, us."""

_ROTATION = ("q[0]", "q[1]", "q[2]", "q[3]")
_LOCAL = ("x", "y", "z", "vx", "vy", "vz", "ref_lat", "ref_lon", "ref_alt")
_GLOBAL = ("lat", "lon", "alt")
_RECEIVER = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "fix_type")
_TOPICS: dict[str, tuple[str, ...]] = {
    "sensor_combined": tuple(
        f"{field}[{axis}]" for field in ("gyro_rad", "accelerometer_m_s2") for axis in range(3)
    ),
    "vehicle_imu": ulog_instances.INTEGRATED,
    ulog_instances.SELECTED: (),
    "vehicle_gps_position": _RECEIVER,
    "sensor_gps": _RECEIVER,
    "vehicle_magnetometer": tuple(f"magnetometer_ga[{axis}]" for axis in range(3)),
    "sensor_mag": ("x", "y", "z"),
    "vehicle_air_data": ("baro_alt_meter",),
    "vehicle_status": ("arming_state",),
    "vehicle_land_detected": ("landed",),
    "vehicle_attitude": _ROTATION,
    "vehicle_local_position": _LOCAL,
    "vehicle_global_position": _GLOBAL,
    "vehicle_attitude_groundtruth": _ROTATION,
    "vehicle_local_position_groundtruth": _LOCAL,
    "vehicle_global_position_groundtruth": _GLOBAL,
    **{name: read_by[0][1].needed for name, read_by in aids.ULOG.items()},
}
"""The topics that are used, and the fields that each needs."""
_SENSORS = (
    "sensor_combined",
    "vehicle_gps_position",
    "sensor_gps",
    "vehicle_magnetometer",
    "sensor_mag",
    "vehicle_air_data",
)

NO_SAMPLE = 2**31 - 1
"""sensor_combined.*_timestamp_relative: RELATIVE_TIMESTAMP_INVALID."""
UNUSED = (
    "gyro_integral_dt",
    "accelerometer_integral_dt",
    "accelerometer_timestamp_relative",
    "accelerometer_clipping",
    "gyro_clipping",
    "accel_calibration_count",
    "gyro_calibration_count",
)
"""Fields that are not kept: those of inertial samples would be tens of MB for hours."""


def load(path: Path) -> Messages:
    """Read the topics that are used.

    Raises:
        LogError: The file cannot be read as a ULog.
    """
    return ulog_messages.read(path, _TOPICS, UNUSED)


def choose(log: Messages, notes: list[str]) -> tuple[Stored, Extent, Damage]:
    """Return each topic's rows that have the fields needed, on one clock run.

    They are those of the sensors in use, otherwise of the first instance. Rows whose stamps are
    damaged, or of another boot, are dropped. Also return first and last stamp of the log's sensors,
    of which the samples may be a part, and how many rows were dropped.
    """
    usable = [
        table
        for table in sorted(log.tables, key=lambda table: (table.instance, -len(table.rows)))
        if {"timestamp", *_TOPICS[table.topic]} <= {*table.rows.names}
    ]
    found: Stored = {}
    for table in usable:
        read_by = [one for _, one in aids.ULOG.get(table.topic, ())]
        read_by = [one for one in read_by if {*one.needed} <= {*table.rows.names}]
        # Of an aid's sensors the first that measures what the aid wants
        if not read_by or any(one.read(columns_of(table.rows.all()))[0].any() for one in read_by):
            found.setdefault(table.topic, table.rows)
    found |= ulog_instances.choose(log, usable, notes)
    for name in ulog_instances.ASKED:
        found.pop(name, None)
    found, twice = repeats.left_out(found, lambda rows: series.nanoseconds(rows["timestamp"]))
    notes += twice
    stamps = {name: stamps_of(rows) for name, rows in found.items()}
    runs = clock_run.common(stamps, "sensor_combined")
    kept = {name: _on_run(rows, runs[name]) for name, rows in found.items()}
    counts = {name: (len(rows), len(kept[name])) for name, rows in found.items()}
    left_out, lost = clock_run.left_out(runs, counts, lambda name: stamps_of(found[name]))
    notes += left_out
    extent = clock_run.extent(runs, [name for name in _SENSORS if name in found], "sensor_combined")
    return {name: rows for name, rows in kept.items() if len(rows)}, extent, lost


def _on_run(rows: StoredRows, run: clock_run.CommonRun) -> StoredRows:
    return rows.kept(lambda first, some: run.holds(first, series.nanoseconds(some["timestamp"])))


def stamps_of(rows: StoredRows) -> Iterator[Stamps]:
    """Yield the times of publication of a topic's rows, part by part, ns."""
    for _, some in rows.parts():
        yield series.nanoseconds(some["timestamp"])


def columns_of(rows: Column) -> Topic:
    """Return rows as columns."""
    columns = {name: rows[name] for name in rows.dtype.names or () if name != "timestamp"}
    return {**columns, "t_ns": series.nanoseconds(rows["timestamp"])}


def combined(stored: Stored, sensor: str, column: str) -> Topic | None:
    """Return the rows of sensor_combined with a new sample of another sensor: PX4 before 1.8.

    ``SENSOR_timestamp_relative`` is the sample's time less the row's, us; the largest number where
    the row has no sample.
    """
    rows, relative = stored.get("sensor_combined"), f"{sensor}_timestamp_relative"
    if rows is None or not {column, relative} <= {*rows.names}:
        return None
    found: list[Topic] = []
    last_ns: Stamps = np.zeros(0, dtype=np.int64)  # of the row before
    for _, some in rows.parts():
        topic = columns_of(some)
        behind_ns = np.asarray(topic[relative], dtype=np.int64) * 1000
        sampled_ns = topic["t_ns"] + behind_ns
        is_new = series.changed(np.append(last_ns, sampled_ns))[len(last_ns) :]
        is_new &= topic[relative] != NO_SAMPLE
        # From the row's own time by less than a second, or the stamp is damaged
        is_new &= np.abs(behind_ns) < 1_000_000_000
        last_ns = sampled_ns[-1:]
        new = {name: values[is_new] for name, values in topic.items()}
        found.append({**new, "timestamp_sample": sampled_ns[is_new].astype(np.uint64) // 1000})
    return {name: np.concatenate([one[name] for one in found]) for name in found[0]}


def vectors(topic: Topic, field: str, size: int = 3) -> Array:
    """Return an array field as rows, shape (n, size)."""
    return series.stack(topic, *(f"{field}[{index}]" for index in range(size)))


def sample_ns(topic: Topic) -> Stamps:
    """Return the times of the samples, or where those are absent, of the publication, ns."""
    if "timestamp_sample" not in topic:
        return topic["t_ns"]
    sample_ns = series.nanoseconds(topic["timestamp_sample"])
    # A sample is older than its message, by less than a second, or its stamp is damaged.
    said = (sample_ns > 0) & (np.abs(sample_ns - topic["t_ns"]) < 1_000_000_000)
    return np.where(said, sample_ns, topic["t_ns"])


def rotations(topic: Topic) -> tuple[Mask, Array]:
    """Return where ``q`` is a rotation, and the rotation (elsewhere the identity)."""
    q = vectors(topic, "q", 4)
    # Clipped first: damaged numbers overflow when squared.
    norm = np.linalg.norm(np.clip(np.nan_to_num(q), -2.0, 2.0), axis=1)
    valid = known_rows(q) & (np.abs(norm - 1.0) < 0.01)
    return valid, so3.normalise(np.where(valid[:, None], q, [1.0, 0.0, 0.0, 0.0]))
