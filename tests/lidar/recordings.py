"""A small simulated recording, in every form that the readers know."""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

from sim_autopilot.lidar.beams import Beams
from sim_autopilot.lidar.record import TICK, UNIT, Simulated, simulate, usual_lidar

DIALECTS = {
    "t": ("<u4", lambda stamp, after: np.round(after * 1e9)),
    "time": ("<f4", lambda stamp, after: after),
    "timestamp": ("<f8", lambda stamp, after: stamp + after),
    "timestamp in ns": ("<f8", lambda stamp, after: np.round((stamp + after) * 1e9)),
    "none": (None, None),
}


@lru_cache
def small(duration: float = 12.0) -> Simulated:
    beams = Beams("small", 16, 75, -15, 15)
    return simulate("room", 3, duration=duration, lidar=usual_lidar("room", beams))


def points(flown: Simulated, k: int) -> np.ndarray:
    return flown.xyz[flown.first[k] : flown.first[k + 1]] * UNIT


def after(flown: Simulated, k: int) -> np.ndarray:
    return flown.dt[flown.first[k] : flown.first[k + 1]] * TICK


def arrays(flown: Simulated) -> tuple[dict, dict]:
    """Return what lidar.npz and imu.npz hold, to be changed and saved."""
    lidar = {name: getattr(flown, name).copy() for name in ("stamp", "first", "xyz", "dt", "ring")}
    imu = {"stamp": flown.imu_stamp.copy(), "gyro": flown.gyro.copy(), "accel": flown.accel.copy()}
    return {**lidar, "unit": np.float64(UNIT), "tick": np.float64(TICK)}, imu


def table(flown: Simulated, k: int, dialect: str = "t") -> np.ndarray:
    """Return a scan as a structured array of the fields of a driver."""
    kind, times = DIALECTS[dialect]
    names = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2")]
    if kind:
        names.append((dialect.split()[0], kind))
    rows = np.zeros(flown.first[k + 1] - flown.first[k], names)
    for axis, name in enumerate("xyz"):
        rows[name] = points(flown, k)[:, axis]
    rows["ring"] = flown.ring[flown.first[k] : flown.first[k + 1]]
    if kind:
        rows[dialect.split()[0]] = times(flown.stamp[k], after(flown, k))
    return rows


def write_pcd(path, rows: np.ndarray, form: str) -> None:
    names = rows.dtype.names
    kinds = [rows.dtype[name] for name in names]
    head = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(names)}\n"
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}\n"
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}\n"
        f"COUNT {' '.join('1' for _ in names)}\nWIDTH {len(rows)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        lines = [" ".join(repr(value.item()) for value in row) for row in rows]
        body = "\n".join(lines).encode()
    elif form == "binary":
        body = rows.tobytes()
    else:
        flat = b"".join(rows[name].tobytes() for name in names)
        packed = pack_lzf(flat)
        body = struct.pack("<II", len(packed), len(flat)) + packed
    path.write_bytes(head + body)


def pack_lzf(data: bytes) -> bytes:
    """Pack by LZF, greedily: literals, and copies of three bytes and more seen before."""
    out, literals, seen, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for begin in range(0, len(literals), 32):
            piece = literals[begin : begin + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        literals.clear()

    while at < len(data):
        key = data[at : at + 3]
        before = seen.get(key)
        seen[key] = at
        if len(key) == 3 and before is not None and at - before <= 8192:
            length = 3
            while at + length < len(data) and length < 264:
                if data[before + length] != data[at + length]:
                    break
                length += 1
            flush()
            back = at - before - 1
            if length - 2 < 7:
                out.append(((length - 2) << 5) | (back >> 8))
            else:
                out.append((7 << 5) | (back >> 8))
                out.append(length - 2 - 7)
            out.append(back & 255)
            at += length
        else:
            literals.append(data[at])
            at += 1
    flush()
    return bytes(out)


def write_folder(path, flown: Simulated, form: str) -> None:
    """Write .pcd or .npz scans named by their stamps in ns, with imu.csv and calib.json."""
    path.mkdir()
    for k, stamp in enumerate(flown.stamp):
        name = f"{round(stamp * 1e9):012d}"
        if form == "npz":
            times = np.round(after(flown, k) * 1e9).astype(np.uint32)
            np.savez(path / f"{name}.npz", xyz=points(flown, k).astype(np.float32), t=times)
        else:
            write_pcd(path / f"{name}.pcd", table(flown, k), form)
    rows = np.column_stack((flown.imu_stamp, flown.gyro, flown.accel))
    names = "stamp,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
    lines = [",".join(repr(float(value)) for value in row) for row in rows]
    (path / "imu.csv").write_text("\n".join([names, *lines]))


@lru_cache
def _types():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).types


def header(ns: int, frame: str):
    types = _types()
    time = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def cloud(flown: Simulated, k: int, ns: int, dialect: str = "t", epoch: float = 0.0):
    """Return a scan as PointCloud2; ``epoch`` is that of absolute times of points, s."""
    types, rows = _types(), table(flown, k, dialect)
    numbers = {"<f4": 7, "<f8": 8, "<u2": 4, "<u4": 6}
    if "timestamp" in rows.dtype.names:
        rows["timestamp"] += epoch * (1e9 if "ns" in dialect else 1.0)
    fields = [
        types["sensor_msgs/msg/PointField"](
            field, rows.dtype.fields[field][1], numbers[rows.dtype[field].str], 1
        )
        for field in rows.dtype.names
    ]
    step = rows.dtype.itemsize
    return types["sensor_msgs/msg/PointCloud2"](
        header(ns, "lidar"), 1, len(rows), fields, False, step, step * len(rows),
        rows.view(np.uint8), True,
    )  # fmt: skip


def imu(flown: Simulated, k: int, ns: int, unit: float = 1.0):
    """Return an inertial sample as Imu; ``unit`` is that of its specific force, m/s2."""
    types = _types()
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header(ns, "imu"), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1), zeros,
        vector(*map(float, flown.gyro[k])), zeros,
        vector(*map(float, flown.accel[k] / unit)), zeros,
    )  # fmt: skip


def write_dialect(path, flown: Simulated, dialect: str, *, epoch: float = 0.0, livox=False) -> None:
    """Write a bag of ROS 2 in one dialect of time, or of CustomMsg, without /tf_static."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from ekf_companion.lidar.readers import custom_message

    store = get_typestore(Stores.ROS2_HUMBLE)
    name = custom_message.NAMES[1]
    package = name.partition("/")[0]
    kinds = get_types_from_msg(custom_message.POINT_DEFINITION, f"{package}/msg/CustomPoint")
    kinds |= get_types_from_msg(custom_message.DEFINITION.format(package=package), name)
    store.register(kinds)
    types = store.types

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kind = name if livox else "sensor_msgs/msg/PointCloud2"
        lidar = writer.add_connection("/livox/lidar", kind, typestore=store)
        imu_topic = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for k, stamp in enumerate(flown.stamp):
            ns = round((stamp + epoch) * 1e9)
            rows = table(flown, k, dialect)
            if livox:
                one = types[f"{package}/msg/CustomPoint"]
                listed = [
                    one(int(row["t"]), row["x"], row["y"], row["z"], 9, 0, int(row["ring"]))
                    for row in rows
                ]
                message = types[name](
                    header(ns, "lidar frame"[: k % 9]),
                    ns,
                    len(rows),
                    0,
                    np.zeros(3, np.uint8),
                    listed,
                )
            else:
                message = cloud(flown, k, ns, dialect, epoch)
            writer.write(lidar, ns, store.serialize_cdr(message, kind))
        for k, stamp in enumerate(flown.imu_stamp):
            ns = round((stamp + epoch) * 1e9)
            message = imu(flown, k, ns)
            writer.write(imu_topic, ns, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
