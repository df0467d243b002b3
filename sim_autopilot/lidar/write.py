"""Files of a simulated recording: a folder of arrays, or a bag of ROS 1 or ROS 2."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import part_of
from ekf_companion.nav import so3
from sim_autopilot.lidar.motion import GRAVITY
from sim_autopilot.lidar.record import TICK, UNIT, Simulated

_LATENCY = 5_000_000
"""ns, from the end of a scan or sample to its record."""


def write_sequence(folder: Path, flown: Simulated) -> None:
    """Write lidar.npz, imu.npz, truth.npz and calib.json; the same recording gives the same bytes.

    Raises:
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    speeds: dict[str, Any] = {} if flown.doppler is None else {"doppler": flown.doppler}
    np.savez_compressed(
        folder / "lidar.npz",
        stamp=flown.stamp,
        first=flown.first,
        xyz=flown.xyz,
        dt=flown.dt,
        ring=flown.ring,
        unit=np.float64(UNIT),
        tick=np.float64(TICK),
        **speeds,
    )
    np.savez_compressed(
        folder / "imu.npz", stamp=flown.imu_stamp, gyro=flown.gyro, accel=flown.accel
    )
    t = np.arange(0.0, flown.imu_stamp[-1], 0.01)
    every = round(0.1 * flown.errors.rate)
    np.savez_compressed(
        folder / "truth.npz",
        t=t,
        p=flown.motion.position(t),
        q=np.roll(so3.from_matrix(flown.motion.rotation(t)), -1, axis=-1),
        v=flown.motion.velocity(t).astype(np.float32),
        bias_t=flown.imu_stamp[::every],
        gyro_bias=flown.gyro_bias[::every].astype(np.float32),
        accel_bias=flown.accel_bias[::every].astype(np.float32),
        label=flown.label,
        T_imu_lidar_R=flown.lidar.rotation,
        T_imu_lidar_p=flown.lidar.position,
        imu_delay=np.float64(0.0),
        Mg=np.eye(3),
        Ma=np.eye(3),
    )
    (folder / "calib.json").write_text(json.dumps(_calib(flown), indent=1) + "\n")


def _calib(flown: Simulated) -> dict[str, Any]:
    beams, errors = flown.lidar.beams, flown.errors
    return {
        "name": flown.name,
        "lidar": beams.name,
        "scan_rate_hz": beams.rate,
        "range_max_m": beams.farthest,
        "range_min_m": beams.nearest,
        "T_imu_lidar": {
            "R": flown.lidar.rotation.tolist(),
            "p": flown.lidar.position.tolist(),
            "sigma_rot_deg": 0.1,
            "sigma_pos_m": 0.002,
        },
        "imu": {
            "rate_hz": errors.rate,
            "gyro_noise_density": errors.gyro_noise,
            "accel_noise_density": errors.accel_noise,
            "gyro_bias_walk": errors.gyro_walk,
            "accel_bias_walk": errors.accel_walk,
            "gyro_bias_sigma": errors.gyro_bias,
            "accel_bias_sigma": errors.accel_bias,
            "gravity": GRAVITY,
        },
        "lidar_noise": {
            "range_sigma_m": beams.range_sigma,
            "range_bias_sigma_m": beams.range_bias,
            "angle_sigma_rad": beams.angle_sigma,
        },
    }


def write_bag(path: Path, flown: Simulated) -> None:
    """Write PointCloud2, Imu and /tf_static: .bag, or a folder of ROS 2.

    Points have x, y, z, ring and t in ns; those of a radar have x, y, z and velocity.

    Args:
        path: .bag, or the folder of a bag of ROS 2: .mcap at its end, .db3 else.
        flown: The recording.

    Raises:
        MissingPackageError: rosbags is not installed.
        OSError: It cannot be written, or is there already.
    """
    with part_of("lidar", f"writing {path.name}"):
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    if path.exists():
        raise FileExistsError(17, "is there already", str(path))
    is_ros1 = path.suffix == ".bag"
    store: Any = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    kind = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    messages = Messages(store, is_ros1)
    rows = [(round(flown.imu_stamp[0] * 1e9), "/tf_static", messages.transforms(flown))]
    for k, stamp in enumerate(flown.stamp):
        ns = round(stamp * 1e9)
        part = slice(flown.first[k], flown.first[k + 1])
        end = ns + round(1e9 / flown.lidar.beams.rate)
        rows.append((end + _LATENCY, "/points", messages.cloud(ns, flown, part)))
    for k, stamp in enumerate(flown.imu_stamp):
        ns = round(stamp * 1e9)
        rows.append((ns + _LATENCY, "/imu", messages.imu(ns, flown.gyro[k], flown.accel[k])))
    rows.sort(key=lambda row: row[0])
    writer: Any = Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=kind)
    with writer:
        connections = {}
        for _, topic, message in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=store
                )
        serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
        for ns, topic, message in rows:
            writer.write(connections[topic], ns, serialize(message, message.__msgtype__))


class Messages:
    """Messages of a type store."""

    def __init__(self, store: Any, is_ros1: bool) -> None:
        self._types = store.types
        self._seq = {"seq": 0} if is_ros1 else {}

    def _head(self, ns: int, frame: str) -> Any:
        time = self._types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        return self._types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **self._seq)

    def cloud(self, ns: int, flown: Simulated, part: slice) -> Any:
        """Return a scan as PointCloud2."""
        layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("t", "<u4")])
        numbers = {"x": 7, "y": 7, "z": 7, "ring": 4, "t": 6}
        if flown.doppler is not None:
            layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("velocity", "<f4")])
            numbers = {"x": 7, "y": 7, "z": 7, "velocity": 7}
        rows = np.zeros(part.stop - part.start, layout)
        for axis, name in enumerate("xyz"):
            rows[name] = flown.xyz[part, axis] * UNIT
        if flown.doppler is not None:
            rows["velocity"] = flown.doppler[part]
        else:
            rows["ring"] = flown.ring[part]
            rows["t"] = np.round(flown.dt[part] * (TICK * 1e9))
        field = self._types["sensor_msgs/msg/PointField"]
        fields = [
            field(name, layout.fields[name][1], number, 1)  # type: ignore[index]
            for name, number in numbers.items()
        ]
        return self._types["sensor_msgs/msg/PointCloud2"](
            self._head(ns, "lidar"),
            1,
            len(rows),
            fields,
            False,
            layout.itemsize,
            layout.itemsize * len(rows),
            rows.view(np.uint8),
            True,
        )

    def imu(self, ns: int, gyro: Any, accel: Any) -> Any:
        """Return a sample as Imu."""
        vector = self._types["geometry_msgs/msg/Vector3"]
        unknown = np.array([-1.0, *[0.0] * 8])
        return self._types["sensor_msgs/msg/Imu"](
            self._head(ns, "imu"),
            self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            unknown,
            vector(*map(float, gyro)),
            np.zeros(9),
            vector(*map(float, accel)),
            np.zeros(9),
        )

    def transforms(self, flown: Simulated) -> Any:
        """Return the mounting as TFMessage."""
        vector = self._types["geometry_msgs/msg/Vector3"]
        w, x, y, z = so3.from_matrix(flown.lidar.rotation).tolist()
        one = self._types["geometry_msgs/msg/TransformStamped"](
            self._head(0, "imu"),
            "lidar",
            self._types["geometry_msgs/msg/Transform"](
                vector(*map(float, flown.lidar.position)),
                self._types["geometry_msgs/msg/Quaternion"](x, y, z, w),
            ),
        )
        return self._types["tf2_msgs/msg/TFMessage"]([one])
