"""The topics of a PX4 log (.ulg), read by pyulog, which copes with damaged files."""

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
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows

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
"""The topics that are used, and the fields that each needs."""


DAMAGE = (ULogException, RecursionError, MemoryError, LookupError, ValueError, TypeError)
"""What pyulog fails with on a damaged file."""


class _Watched(io.BytesIO):
    """A file that stops pyulog where damaged message sizes lead it into an endless loop."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._missing = 0  # bytes that the last read was short of
        self._visits: dict[int, int] = {}

    def read(self, size: int | None = -1, /) -> bytes:
        """Return bytes; refuse to read a message header (3 bytes) at one place over and over."""
        if size == 3:
            place = self.tell()
            self._visits[place] = self._visits.get(place, 0) + 1
            if self._visits[place] > 4:
                raise ULogException("its message sizes lead in circles")
        data = super().read(size)
        self._missing = max(0, (size or 0) - len(data))
        return data

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Move to a position; back over a message, by no more than the file holds of it."""
        if whence == 1 and offset < 0:
            offset = min(0, offset + self._missing)
        return super().seek(offset, whence)


def load(path: Path) -> ULog:
    """Read the topics that are used.

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
    except DAMAGE as error:
        raise LogError(f"{path}: too damaged to be read as a {KIND}: {error}") from None


def nanoseconds(stamps_us: npt.NDArray[Any]) -> Stamps:
    """Convert unsigned microseconds to ns; what would overflow is damage, and stays huge."""
    return np.asarray(np.minimum(stamps_us, 2**62 // 1000), dtype=np.int64) * 1000


def choose(log: ULog, notes: list[str]) -> Topics:
    """Return each topic's first instance that has the fields needed, on one clock run.

    Rows whose stamps are damaged, or of another boot, are dropped.
    """
    topics: Topics = {}
    for data in sorted(log.data_list, key=lambda found: found.multi_id):
        needed = {"timestamp", *_TOPICS[data.name]}
        if needed <= data.data.keys() and data.name not in topics:
            topics[data.name] = {**data.data, "t_ns": nanoseconds(data.data["timestamp"])}
    stamps = {name: topic["t_ns"] for name, topic in topics.items()}
    masks = series.common_run(stamps, "sensor_combined")
    if wild := sum(int((~mask).sum()) for mask in masks.values()):
        notes.append(f"{wild} rows whose time stamps do not fit the log's clock were dropped")
    return {
        name: {field: column[masks[name]] for field, column in topic.items()}
        for name, topic in topics.items()
        if masks[name].any()
    }


def vectors(topic: Topic, field: str, size: int = 3) -> Array:
    """Return an array field as rows, shape (n, size)."""
    return series.stack(topic, *(f"{field}[{index}]" for index in range(size)))


def sample_ns(topic: Topic) -> Stamps:
    """Return the times of the samples, or where those are absent, of the publication, ns."""
    if "timestamp_sample" not in topic:
        return topic["t_ns"]
    sample_ns = nanoseconds(topic["timestamp_sample"])
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
