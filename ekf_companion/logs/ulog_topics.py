"""The topics of a PX4 log (.ulg), by pyulog, which copes with damaged files."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pyulog import ULog
from pyulog.exceptions import ULogException

from ekf_companion.errors import LogError
from ekf_companion.logs import series
from ekf_companion.logs.source import read_bytes
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Topic = dict[str, npt.NDArray[Any]]
"""Columns of one topic by field name, and ``t_ns``: when each row was published."""
Topics = dict[str, Topic]

KIND = "ULog (.ulg) of PX4"

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
"""The topics that count, and the fields without which they are of no use."""


class _Watched(io.BytesIO):
    """A file in which pyulog, misled by damaged sizes, does not go in circles for ever."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._missing = 0  # bytes that the last read was short of
        self._visits: dict[int, int] = {}

    def read(self, size: int | None = -1, /) -> bytes:
        """Give bytes; a message header (3 bytes) may be read at one place a few times only."""
        if size == 3:
            place = self.tell()
            self._visits[place] = self._visits.get(place, 0) + 1
            if self._visits[place] > 4:
                raise ULogException("its message sizes lead in circles")
        data = super().read(size)
        self._missing = max(0, (size or 0) - len(data))
        return data

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Go to a place; back over a message, over as much of it as there is before the end."""
        if whence == 1 and offset < 0:
            offset = min(0, offset + self._missing)
        return super().seek(offset, whence)


def load(path: Path) -> ULog:
    """Read the topics that count.

    Raises:
        LogError: The file is missing, empty, no ULog, or too damaged for pyulog.
    """
    data = read_bytes(path, KIND)
    if data[:7] != ULog.HEADER_BYTES:
        raise LogError(f"{path}: does not begin as a {KIND}; check the file or its name")
    try:
        # pyulog prints what it finds damaged; the notes say so in our words.
        with contextlib.redirect_stdout(io.StringIO()):
            return ULog(_Watched(data), list(_TOPICS))
    except (
        ULogException,
        RecursionError,
        MemoryError,
        LookupError,
        ValueError,
        TypeError,
    ) as error:
        raise LogError(f"{path}: too damaged to be read as a {KIND}: {error}") from None


def first_instances(log: ULog) -> Topics:
    """Give each topic's first instance, if it has the fields that it needs."""
    topics: Topics = {}
    for data in sorted(log.data_list, key=lambda found: found.multi_id):
        needed = {"timestamp", *_TOPICS[data.name]}
        if needed <= data.data.keys() and data.name not in topics:
            topics[data.name] = {**data.data, "t_ns": nanoseconds(data.data["timestamp"])}
    return topics


def nanoseconds(stamps_us: npt.NDArray[Any]) -> Stamps:
    """Bring unsigned microseconds to ns; what would overflow is damaged, and just stays huge."""
    return np.asarray(np.minimum(stamps_us, 2**62 // 1000), dtype=np.int64) * 1000


def on_course(topics: Topics, notes: list[str]) -> Topics:
    """Drop rows whose stamps leave the one course of time: damage, or another boot."""
    spans: series.Spans = []
    if "sensor_combined" in topics:
        spans = series.course(topics["sensor_combined"]["t_ns"])[1]
    wild, kept = 0, {}
    for name, topic in topics.items():
        mask = series.course(topic["t_ns"])[0]
        if spans:
            mask &= series.inside(topic["t_ns"], spans)
        wild += len(mask) - int(mask.sum())
        if mask.any():
            kept[name] = {field: column[mask] for field, column in topic.items()}
    if wild:
        notes.append(f"{wild} rows whose time stamps leave the log's course were dropped")
    return kept


def vectors(topic: Topic, field: str, size: int = 3) -> Array:
    """Give an array field as rows, shape (n, size)."""
    names = [f"{field}[{index}]" for index in range(size)]
    return np.stack([topic[name] for name in names], axis=1).astype(float)


def sample_ns(topic: Topic) -> Stamps:
    """Give when the sensor sampled, or where it is not said, when it was published, ns."""
    if "timestamp_sample" not in topic:
        return topic["t_ns"]
    sample_ns = nanoseconds(topic["timestamp_sample"])
    # A sample is older than its message, by less than a second, or its stamp is damaged.
    said = (sample_ns > 0) & (np.abs(sample_ns - topic["t_ns"]) < 1_000_000_000)
    return np.where(said, sample_ns, topic["t_ns"])


def rotations(topic: Topic) -> tuple[npt.NDArray[np.bool_], Array]:
    """Say where ``q`` is a rotation, and give it (elsewhere none)."""
    q = vectors(topic, "q", 4)
    # Clipped first: damaged numbers overflow when squared.
    norm = np.linalg.norm(np.clip(np.nan_to_num(q), -2.0, 2.0), axis=1)
    valid = np.isfinite(q).all(axis=1) & (np.abs(norm - 1.0) < 0.01)
    return valid, so3.normalise(np.where(valid[:, None], q, [1.0, 0.0, 0.0, 0.0]))
