"""The topics of a PX4 log (.ulg) that are used, as columns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series, ulog_messages
from ekf_companion.logs.ulog_messages import Messages
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows

Topic = dict[str, npt.NDArray[Any]]
"""Columns of one topic by field name, and ``t_ns``: when each row was published."""
Topics = dict[str, Topic]

_ROTATION = ("q[0]", "q[1]", "q[2]", "q[3]")
_LOCAL = ("x", "y", "z", "vx", "vy", "vz", "ref_lat", "ref_lon", "ref_alt")
_GLOBAL = ("lat", "lon", "alt")
_RECEIVER = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "fix_type")
_TOPICS: dict[str, tuple[str, ...]] = {
    "sensor_combined": tuple(
        f"{field}[{axis}]" for field in ("gyro_rad", "accelerometer_m_s2") for axis in range(3)
    ),
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
}
"""The topics that are used, and the fields that each needs."""

UNUSED = (
    "gyro_integral_dt",
    "accelerometer_integral_dt",
    "accelerometer_timestamp_relative",
    "accelerometer_clipping",
    "gyro_clipping",
    "accel_calibration_count",
    "gyro_calibration_count",
)
"""Fields that are not kept: of the inertial samples of hours they would be tens of MB."""


def load(path: Path) -> Messages:
    """Read the topics that are used.

    Raises:
        LogError: The file cannot be read as a ULog.
    """
    return ulog_messages.read(path, _TOPICS, UNUSED)


def choose(log: Messages, notes: list[str]) -> Topics:
    """Return each topic's first instance that has the fields needed, on one clock run.

    Rows whose stamps are damaged, or of another boot, are dropped.
    """
    topics: Topics = {}
    for table in sorted(log.tables, key=lambda table: (table.instance, -len(table.rows))):
        names = table.rows.dtype.names or ()
        if {"timestamp", *_TOPICS[table.topic]} <= {*names} and table.topic not in topics:
            columns = {name: table.rows[name] for name in names if name != "timestamp"}
            topics[table.topic] = {
                **columns,
                "t_ns": series.nanoseconds_in_place(table.rows["timestamp"]),
            }
    stamps = {name: topic["t_ns"] for name, topic in topics.items()}
    masks = series.common_run(stamps, "sensor_combined")
    if wild := sum(int((~mask).sum()) for mask in masks.values()):
        notes.append(f"{wild} rows whose time stamps do not fit the log's clock were dropped")
    kept: Topics = {}
    for name, topic in topics.items():
        mask = masks[name]
        if mask.all():
            kept[name] = topic
        elif mask.any():
            kept[name] = {field: column[mask] for field, column in topic.items()}
    return kept


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
