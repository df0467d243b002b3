"""Writing of estimates as a ULog (.ulg), under PX4's own topic names.

Flight Review and PlotJuggler show ``vehicle_attitude``, ``vehicle_local_position`` and
``vehicle_global_position`` as they do those of an autopilot. Each row is a fixed sequence of
structs, so a chunk is written at once.

Source: PX4 user guide, "ULog file format"; PX4-Autopilot msg/*.msg (fields, units).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs.ulog_messages import MAGIC
from ekf_companion.logs.writer import EstimateWriter
from ekf_companion.nav.arrays import Array, Mask, known_rows
from ekf_companion.nav.state import GEODETIC, POSITION, QUATERNION, VELOCITY, Status, Table
from ekf_companion.version import __version__

Record = npt.NDArray[np.void]

_STAMPS = [("timestamp", "<u8"), ("timestamp_sample", "<u8")]
_TOPICS: dict[str, list[tuple[Any, ...]]] = {
    "vehicle_attitude": [*_STAMPS, ("q", "<f4", (4,)), ("quat_reset_counter", "u1")],
    "vehicle_local_position": [
        *_STAMPS,
        *((name, "<f4") for name in ("x", "y", "z", "vx", "vy", "vz", "heading", "eph", "epv")),
        *((name, "<f4") for name in ("evh", "evv")),
        *((f"{name}_valid", "?") for name in ("xy", "z", "v_xy", "v_z")),
        ("dead_reckoning", "?"),
        ("xy_reset_counter", "u1"),
    ],
    "vehicle_global_position": [
        *_STAMPS,
        *((name, "<f8") for name in ("lat", "lon")),
        *((name, "<f4") for name in ("alt", "eph", "epv")),
        ("dead_reckoning", "?"),
    ],
}
"""PX4's names of the topics and fields that are written."""
_NAMES = {"u8": "uint64_t", "f4": "float", "f8": "double", "u1": "uint8_t", "?": "bool"}


def _information(key: str, text: str) -> bytes:
    """Return the content of a message with a fact about what is logged."""
    name = f"char[{len(text)}] {key}".encode()
    return bytes([len(name)]) + name + text.encode()


SYSTEM = _information("sys_name", "ekf-companion")
"""By which a .ulg of ours is known."""


class Writer(EstimateWriter):
    """Writes the attitude of each estimate, and its position where it has one."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.file.write(MAGIC + b"\x01" + bytes(8))
        self._message("B", bytes(40))
        for content in (SYSTEM, _information("ver_sw", __version__)):
            self._message("I", content)
        for topic, fields in _TOPICS.items():
            texts = [_declared(*one) for one in fields]
            self._message("F", f"{topic}:{''.join(texts)}".encode())
        for number, topic in enumerate(_TOPICS):
            self._message("A", bytes([0, number, 0]) + topic.encode())

    def _message(self, kind: str, content: bytes) -> None:
        self.file.write(len(content).to_bytes(2, "little") + kind.encode() + content)

    def write(self, table: Table) -> None:
        """Append the messages of estimates.

        Raises:
            LogError: A time is before zero.
        """
        self.refuse_times_before_zero(table, "a .ulg")
        for number, (topic, make) in enumerate(_MAKERS.items()):
            self.file.write(make(table, topic, number).tobytes())


def _declared(name: str, code: str, shape: tuple[int, ...] = ()) -> str:
    size = f"[{shape[0]}]" if shape else ""
    return f"{_NAMES[code.lstrip('<')]}{size} {name};"


def _records(table: Table, topic: str, number: int, known: Mask) -> Record:
    """Return stamped messages of the rows that are known, with the other fields zero."""
    fields = np.dtype(_TOPICS[topic])
    dtype = np.dtype([("size", "<u2"), ("kind", "u1"), ("number", "<u2"), *fields.descr])
    records = np.zeros(int(known.sum()), dtype=dtype)
    records["size"], records["kind"], records["number"] = 2 + fields.itemsize, ord("D"), number
    for name in ("timestamp", "timestamp_sample"):
        records[name] = table.stamp_ns[known] // 1000
    return records


def _attitude(table: Table, topic: str, number: int) -> Record:
    q_nb = table.columns(QUATERNION)
    known = known_rows(q_nb)
    records = _records(table, topic, number, known)
    records["q"] = q_nb[known]
    records["quat_reset_counter"] = _wrapped(table.column("reset_count")[known])
    return records


def _local_position(table: Table, topic: str, number: int) -> Record:
    pos_n, vel_n = table.columns(POSITION), table.columns(VELOCITY)
    known = np.isfinite(pos_n[:, 2])
    records = _records(table, topic, number, known)
    for name, column in zip("xyz", pos_n[known].T, strict=True):
        records[name] = column
    for name, column in zip(("vx", "vy", "vz"), vel_n[known].T, strict=True):
        records[name] = column
    records["heading"] = table.column("yaw")[known]
    records["eph"], records["epv"] = _accuracies(table, "pos", known)
    records["evh"], records["evv"] = _accuracies(table, "vel", known)
    records["xy_valid"] = np.isfinite(pos_n[known, :2]).all(axis=1)
    records["z_valid"] = True
    records["v_xy_valid"] = np.isfinite(vel_n[known, :2]).all(axis=1)
    records["v_z_valid"] = np.isfinite(vel_n[known, 2])
    records["dead_reckoning"] = table.column("status")[known] == Status.DEAD_RECKONING
    records["xy_reset_counter"] = _wrapped(table.column("reset_count")[known])
    return records


def _global_position(table: Table, topic: str, number: int) -> Record:
    known = known_rows(table.columns(GEODETIC))
    records = _records(table, topic, number, known)
    for name, column in zip(("lat", "lon", "alt"), GEODETIC, strict=True):
        records[name] = table.column(column)[known]
    records["eph"], records["epv"] = _accuracies(table, "pos", known)
    records["dead_reckoning"] = table.column("status")[known] == Status.DEAD_RECKONING
    return records


def _accuracies(table: Table, of: str, known: Mask) -> tuple[Array, Array]:
    """Return the horizontal and the vertical sigma."""
    north, east, down = (table.column(f"sd_{of}_{axis}")[known] for axis in "ned")
    return np.hypot(north, east), down


def _wrapped(count: Array) -> npt.NDArray[np.uint8]:
    return (count.astype(np.int64) & 0xFF).astype(np.uint8)


_MAKERS = {
    "vehicle_attitude": _attitude,
    "vehicle_local_position": _local_position,
    "vehicle_global_position": _global_position,
}
