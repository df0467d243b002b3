"""One simulated flight as a .tlog, and its measurements as .bin, .ulg and .csv.

Inertial samples at 250 Hz, magnetometer and barometer at 50 Hz (10 Hz in a .bin, as ArduPilot logs
them), heading at 10 Hz, fixes at 5 Hz, without what the reader passes over anyway.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.measurements import Events, Kind
from sim_autopilot import events as wireless
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.recording import TlogWriter

Bytes = npt.NDArray[np.uint8]
RATE = 250.0
"""Inertial samples per second."""
SLOW = {Kind.MAG: 5, Kind.BARO: 5}
"""Every which inertial sample has one."""
BIN_EVERY_NS = 100_000_000
"""Between two rows of MAG and of BARO in a .bin: in the recorded ones they come at 9.9 to 10 Hz."""


def plan(duration: float) -> Flight:
    """Draw a figure-eight."""
    return Flight.plan("figure-eight", SimConfig(), duration=duration)


def write_tlog(path: Path, flight: Flight) -> None:
    """Write what the autopilot sends."""
    autopilot = Autopilot(flight.config)
    with TlogWriter(path, flight.config.home.unix) as writer:
        for cycle in flight.cycles():
            autopilot.cycle(cycle)
            for frame in autopilot.data_to_send():
                writer.write(cycle.t_ns, frame)


def by_kind(flight: Flight) -> dict[Kind, Events]:
    """Return the measurements of a flight, with a still barometer and a plausible field."""
    table = wireless.events(flight, has_vel_down=True)
    found = {kind: table.take(table.kind == kind) for kind in (Kind.IMU, Kind.GNSS)}
    imu = found[Kind.IMU]
    truth = flight.truth_at(imu.t_ns)
    rng = np.random.default_rng(flight.seed)
    for kind, step in SLOW.items():
        if kind in table.kind:
            found[kind] = table.take(table.kind == kind)
        elif kind == Kind.BARO:
            t_ns = imu.t_ns[::step]
            alt = truth.alt[::step] + 0.1 * rng.standard_normal(len(t_ns))
            found[kind] = Events.from_columns(t_ns, kind, alt)
    t_ns = imu.t_ns[::25]
    found[Kind.HEADING] = Events.from_columns(t_ns, Kind.HEADING, truth.euler[::25, 2])
    return found


def write_csv(path: Path, found: dict[Kind, Events]) -> None:
    """Write a row per inertial sample; what was not measured since the last is an empty cell."""
    import pyarrow as pa
    from pyarrow import csv

    imu = found[Kind.IMU]
    columns: dict[str, Any] = {"time_us": imu.t_ns // 1000}
    names = [f"gyro_{axis}_rps" for axis in "xyz"] + [f"accel_{axis}_mps2" for axis in "xyz"]
    for index, name in enumerate(names):
        columns[name] = imu.values[:, index]
    for kind, more in (
        (Kind.MAG, [f"mag_{axis}_gauss" for axis in "xyz"]),
        (Kind.BARO, ["baro_alt_m"]),
        (Kind.HEADING, ["heading_rad"]),
        (
            Kind.GNSS,
            ["gps_lat_rad", "gps_lon_rad", "gps_alt_m", "gps_vn_mps", "gps_ve_mps", "gps_vd_mps"],
        ),
    ):
        if kind not in found:
            continue
        rows = np.minimum(np.searchsorted(imu.t_ns, found[kind].t_ns), len(imu) - 1)
        for index, name in enumerate(more):
            cells = np.full(len(imu), np.nan)
            cells[rows] = found[kind].values[:, index]
            columns[name] = pa.array(cells, mask=np.isnan(cells))
    csv.write_csv(pa.table(columns), path, csv.WriteOptions(quoting_style="none"))


def _interleave(parts: Sequence[tuple[npt.NDArray[Any], npt.NDArray[np.int64]]]) -> bytes:
    """Return packed records in order of time; each part has one size of record."""
    sizes = np.concatenate([np.full(len(rows), rows.dtype.itemsize) for rows, _ in parts])
    order = np.argsort(np.concatenate([t for _, t in parts]), kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.cumsum(sizes[order]) - sizes[order]
    out = np.empty(int(sizes.sum()), dtype=np.uint8)
    first = 0
    for rows, _ in parts:
        size = rows.dtype.itemsize
        raw = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), size)
        where = place[first : first + len(rows)]
        first += len(rows)
        for index in range(size):
            out[where + index] = raw[:, index]
    return out.tobytes()


BIN_TYPES = {
    "B": "u1",
    "Q": "<u8",
    "L": "<i4",
    "c": "<i2",
    "e": "<i4",
    "f": "<f4",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
}
"""Types of a DataFlash log, by their letter."""
_BIN = {
    Kind.IMU: (1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    Kind.GNSS: (2, "GPS", "QBcLLefff", "TimeUS,Status,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"),
    Kind.MAG: (3, "MAG", "Qfff", "TimeUS,MagX,MagY,MagZ"),
    Kind.BARO: (4, "BARO", "Qf", "TimeUS,Alt"),
    Kind.HEADING: (5, "ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw"),
}


def write_bin(path: Path, found: dict[Kind, Events]) -> None:
    """Write a DataFlash log."""
    declaration = (128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    head, parts = b"", []
    for number, name, characters, columns in [declaration, *_BIN.values()]:
        size = 3 + sum(np.dtype(BIN_TYPES[one]).itemsize for one in characters)
        words = (name.encode(), characters.encode(), columns.encode())
        head += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, *words)
    for kind, (number, _, characters, names) in _BIN.items():
        if kind not in found:
            continue
        types = [BIN_TYPES[one] for one in characters]
        fields = [("magic", "<u2"), ("type", "u1"), *zip(names.split(","), types, strict=True)]
        events = found[kind]
        if kind in SLOW:
            turns = events.t_ns // BIN_EVERY_NS
            events = events.take(np.diff(turns, prepend=-1) > 0)
        v = events.values
        rows = np.zeros(len(events), dtype=np.dtype(fields))
        rows["magic"], rows["type"], rows["TimeUS"] = 0x95A3, number, events.t_ns // 1000
        if kind == Kind.GNSS:
            rows["Status"], rows["HDop"] = 3, 100
            rows["Lat"], rows["Lng"] = np.rint(np.degrees(v[:, 0:2]).T * 1e7)
            rows["Alt"], rows["VZ"] = np.rint(v[:, 2] * 100), v[:, 5]
            rows["Spd"] = np.hypot(v[:, 3], v[:, 4])
            rows["GCrs"] = np.degrees(np.arctan2(v[:, 4], v[:, 3])) % 360.0
        elif kind == Kind.HEADING:
            rows["Yaw"] = np.rint(np.degrees(v[:, 0]) * 100)
        else:
            for index, name in enumerate(names.split(",")[1:]):
                rows[name] = v[:, index] * (1000.0 if kind == Kind.MAG else 1.0)
        parts.append((rows, events.t_ns))
    path.write_bytes(head + _interleave(parts))


_ULOG_TYPES = {"u8": "uint64_t", "f4": "float", "f8": "double", "u1": "uint8_t"}
_VECTORS = {
    "gyro_rad": 3,
    "accelerometer_m_s2": 3,
    "magnetometer_ga": 3,
    "q": 4,
}
_ULOG: dict[Kind, tuple[str, list[tuple[str, str]]]] = {
    Kind.IMU: ("sensor_combined", [("gyro_rad", "f4"), ("accelerometer_m_s2", "f4")]),
    Kind.GNSS: (
        "vehicle_gps_position",
        [(f"{name}_deg", "f8") for name in ("latitude", "longitude")]
        + [("altitude_msl_m", "f8")]
        + [(f"vel_{axis}_m_s", "f4") for axis in "ned"]
        + [("eph", "f4"), ("epv", "f4"), ("s_variance_m_s", "f4"), ("fix_type", "u1")],
    ),
    Kind.MAG: ("vehicle_magnetometer", [("magnetometer_ga", "f4")]),
    Kind.BARO: ("vehicle_air_data", [("baro_alt_meter", "f4")]),
    Kind.HEADING: ("vehicle_attitude", [("q", "f4")]),
}


def write_ulog(path: Path, found: dict[Kind, Events]) -> None:
    """Write a ULog."""
    head, parts = b"ULog\x01\x12\x35\x01" + bytes(8), []
    subscriptions = b""
    for number, (kind, (topic, fields)) in enumerate(_ULOG.items()):
        if kind not in found:
            continue
        layout = [("timestamp", "u8"), *fields]
        text = "".join(
            f"{_ULOG_TYPES[code]}{f'[{_VECTORS[name]}]' if name in _VECTORS else ''} {name};"
            for name, code in layout
        )
        head += _message(b"F", f"{topic}:{text}".encode())
        subscriptions += _message(b"A", struct.pack("<BH", 0, number) + topic.encode())
        types = [
            (name, f"<{code}", _VECTORS[name]) if name in _VECTORS else (name, f"<{code}")
            for name, code in layout
        ]
        header = [("size", "<u2"), ("kind", "S1"), ("id", "<u2")]
        rows = np.zeros(len(found[kind]), dtype=np.dtype([*header, *types]))
        rows["size"], rows["kind"], rows["id"] = rows.dtype.itemsize - 3, b"D", number
        rows["timestamp"] = found[kind].t_ns // 1000
        _fill(rows, kind, found[kind].values)
        parts.append((rows, found[kind].t_ns))
    path.write_bytes(head + subscriptions + _interleave(parts))


def _message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def _fill(rows: npt.NDArray[Any], kind: Kind, v: npt.NDArray[np.float64]) -> None:
    if kind == Kind.IMU:
        rows["gyro_rad"], rows["accelerometer_m_s2"] = v[:, :3], v[:, 3:6]
    elif kind == Kind.GNSS:
        rows["latitude_deg"], rows["longitude_deg"] = np.degrees(v[:, 0]), np.degrees(v[:, 1])
        rows["altitude_msl_m"] = v[:, 2]
        for index, axis in enumerate("ned", 3):
            rows[f"vel_{axis}_m_s"] = v[:, index]
        rows["eph"], rows["epv"], rows["s_variance_m_s"] = 1.0, 1.5, 0.3
        rows["fix_type"] = 3
    elif kind == Kind.MAG:
        rows["magnetometer_ga"] = v[:, :3]
    elif kind == Kind.BARO:
        rows["baro_alt_meter"] = v[:, 0]
    else:
        rows["q"] = np.stack([np.cos(v[:, 0] / 2), 0 * v[:, 0], 0 * v[:, 0], np.sin(v[:, 0] / 2)]).T


def main() -> None:
    """Write ``flight.tlog``, ``.bin``, ``.ulg`` and ``.csv`` of a duration, s, into a folder."""
    folder, flight = Path(sys.argv[1]), plan(float(sys.argv[2]))
    write_tlog(folder / "flight.tlog", flight)
    found = by_kind(flight)
    write_bin(folder / "flight.bin", found)
    write_ulog(folder / "flight.ulg", found)
    write_csv(folder / "flight.csv", found)


if __name__ == "__main__":
    main()
