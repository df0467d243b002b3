"""CustomMsg of Livox' drivers, read from its bytes: an object for each point would take a second.

Layout: livox_ros_driver2, msg/CustomMsg.msg and CustomPoint.msg.
"""

from __future__ import annotations

import struct

import numpy as np

from ekf_companion.lidar.readers.point_cloud import Cloud

NAMES = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")
DEFINITION = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "{package}/CustomPoint[] points\n"
)
POINT_DEFINITION = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\n"
    "uint8 line\n"
)


def decode(raw: bytes | memoryview, is_ros2: bool) -> tuple[int, str, Cloud]:
    """Return the header's stamp in ns, its frame and the cloud of a serialized message.

    Args:
        raw: The message in CDR (ROS 2), or as ROS 1 has it.
        is_ros2: Whether it is CDR.

    Raises:
        ValueError: It ends too early, or is not little-endian.
    """
    data = bytes(raw)
    try:
        if is_ros2 and data[1] != 1:
            raise ValueError("CustomMsg in big-endian CDR is not read")
        at = 4
        sec, nsec, size = struct.unpack_from("<IIi", data, at)
        at += 12
        frame = data[at : at + size].rstrip(b"\0").decode(errors="replace")
        at += size
        if is_ros2:
            at = 4 + (at - 4 + 7) // 8 * 8
        at += 8 + 4 + 4  # timebase; point_num; lidar_id and rsvd
        (count,) = struct.unpack_from("<I", data, at)
    except (struct.error, IndexError):
        raise ValueError(f"CustomMsg ends within its head, after {len(data)} bytes") from None
    at += 4
    step = 20 if is_ros2 else 19
    packed = np.dtype(
        {
            "names": ["offset_time", "x", "y", "z", "line"],
            "formats": ["<u4", "<f4", "<f4", "<f4", "u1"],
            "offsets": [0, 4, 8, 12, 18],
            "itemsize": step,
        }
    )
    # The last point of CDR lacks its padding
    if at + count * step - (step - 19) * bool(count) > len(data):
        raise ValueError(f"CustomMsg of {count} points ends after {len(data)} bytes")
    rows = np.frombuffer(data + b"\0", packed, count, at)
    points = np.stack([rows[name].astype(np.float64) for name in "xyz"], -1)
    return (
        sec * 1_000_000_000 + nsec,
        frame,
        Cloud(points, rows["offset_time"], rows["line"], "offset_time"),
    )
