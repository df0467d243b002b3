"""A partner in ROS 2 through zenoh: keys and attachments as rmw_zenoh and the bridge have them."""

from __future__ import annotations

import contextlib
import json
import struct

import zenoh
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
ODOMETRY = "nav_msgs/msg/Odometry"
TYPE = "nav_msgs::msg::dds_::Odometry_"
HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
"""Of nav_msgs/msg/Odometry, as a key of rmw_zenoh has it."""
GID = bytes(range(16))


@contextlib.contextmanager
def router(port):
    """Open a peer at which others connect, as rmw_zenoh's router or the bridge does."""
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


class Partner:
    """Publishes a topic as rmw_zenoh does (``key``), or as the bridge does."""

    def __init__(self, session, key, kind=ODOMETRY):
        self._publisher = session.declare_publisher(key)
        self._kind, self._is_rmw, self._count = kind, "/RIHS01_" in key, 0

    @property
    def is_heard(self):
        """Whether somebody has subscribed to it."""
        return self._publisher.matching_status.matching

    def put(self, message):
        self.put_bytes(bytes(STORE.serialize_cdr(message, self._kind)))

    def put_bytes(self, data):
        self._count += 1
        attachment = struct.pack("<qqB", self._count, 1, 16) + GID if self._is_rmw else None
        self._publisher.put(data, attachment=attachment)


def header(t_ns, frame="odom"):
    time = STORE.types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](time, frame)


def odometry(t_ns, place, q, speed, pose, twist):
    """Return a nav_msgs/Odometry; q is w, x, y, z, the covariances have shape (6, 6)."""
    types = STORE.types
    vector = types["geometry_msgs/msg/Vector3"]
    w, *xyz = map(float, q)
    at = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*map(float, place)),
        types["geometry_msgs/msg/Quaternion"](*xyz, w),
    )
    moves = types["geometry_msgs/msg/Twist"](vector(*map(float, speed)), vector(0.0, 0.0, 0.0))
    return types[ODOMETRY](
        header(t_ns),
        "base_link",
        types["geometry_msgs/msg/PoseWithCovariance"](at, pose.ravel()),
        types["geometry_msgs/msg/TwistWithCovariance"](moves, twist.ravel()),
    )
