"""ROS 2 through zenoh, without an installation of ROS: topics by name, messages as CDR.

Two ways lead from ROS 2 to zenoh, and both are heard and served: the middleware rmw_zenoh, whose
keys are domain, topic, type and the hash of the type's definition, and the bridge
zenoh-bridge-ros2dds, whose keys are the topics alone. Of rmw_zenoh each publication carries an
attachment (33 bytes, 0.2.4 and later), and each end shows itself by a liveliness token.

Source: ros2/rmw_zenoh, docs/design.md; zenoh-plugin-ros2dds, README.
"""

from __future__ import annotations

import json
import logging
import re
import struct
import time
import uuid
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ekf_companion.errors import LinkError, part_of

_log = logging.getLogger(__name__)

ODOMETRY = "nav_msgs/msg/Odometry"
CLOUD = "sensor_msgs/msg/PointCloud2"
IMU = "sensor_msgs/msg/Imu"
ROUTER = "tcp/127.0.0.1:7447"
"""Where rmw_zenoh's router and the bridge listen."""
_NO_HASH = "TypeHashNotSupported"
"""In keys of ROS 2 Humble, whose types have no hash."""
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_ATTACHMENT = struct.Struct("<qqB16s")
"""Number, unix time (ns), and the length and bytes of the publisher's id."""
_QOS = "::,:,:,:,,"
"""All as usual: reliable, volatile, the last ones are kept."""


@dataclass(frozen=True, slots=True)
class Network:
    """Which zenoh network, and which ROS 2 domain in it."""

    connect: tuple[str, ...] = (ROUTER,)
    """Endpoints of routers, bridges or peers to connect to, tried until they answer."""
    listen: tuple[str, ...] = ("tcp/127.0.0.1:0",)
    """Endpoints at which others may connect to us."""
    domain: int = 0
    """ROS_DOMAIN_ID."""


class Ros2:
    """A session in a zenoh network, as a node of ROS 2. Close it at the end."""

    def __init__(self, network: Network, node: str = "ekf_companion") -> None:
        """Open it: who is not there yet is connected to later.

        Raises:
            LinkError: An endpoint is none, or taken.
            MissingPackageError: The extra is not installed.
        """
        with part_of("zenoh", "ROS 2 through zenoh"):
            import zenoh
            from rosbags.typesys import Stores, get_typestore
        self._network, self._node = network, node
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self.types = self._store.types
        """Classes of messages by name, as in ``nav_msgs/msg/Odometry``."""
        self.refused: Counter[str] = Counter()
        """Messages that are none of the type, by topic."""
        self._kept: list[Any] = []
        """What the session holds for as long as it is open."""
        config = zenoh.Config()
        said = {
            "mode": "peer",
            "connect/endpoints": network.connect,
            "listen/endpoints": network.listen,
            "scouting/multicast/enabled": False,
        }
        try:
            for key, value in said.items():
                config.insert_json5(key, json.dumps(value))
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            raise LinkError(f"zenoh: {_first(error)}; endpoints are as {ROUTER}") from None

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def subscribe(
        self, topic: str, kind: str, on_message: Callable[[Any, bytes, int], None]
    ) -> None:
        """Hear a topic.

        Args:
            topic: Its name, as in ``/odom``.
            kind: Of its messages, as in ``nav_msgs/msg/Odometry``.
            on_message: Called on a thread of zenoh with each message, its bytes and the monotonic
                time of its arrival, ns.

        Raises:
            LinkError: The topic is no name of one.
        """
        from rosbags.serde import SerdeError

        def read(sample: Any) -> None:
            now_ns = time.monotonic_ns()
            data = bytes(sample.payload)
            try:
                message = self._store.deserialize_cdr(data, kind)
            except (SerdeError, ValueError, IndexError, struct.error):
                self.refused[topic] += 1
                return
            on_message(message, data, now_ns)

        # Any hash: that of another definition is none of ours, and does not decode
        for key in (f"{self._key(topic, kind)}/*", self._plain(topic)):
            self._kept.append(self._session.declare_subscriber(key, read))
        self._show("MS", topic, kind)

    def advertise(self, topic: str, kind: str) -> Callable[[Any], None]:
        """Return a function that publishes a message on a topic.

        Raises:
            LinkError: The topic is no name of one.
        """
        key, gid, count = self._key(topic, kind), uuid.uuid4().bytes, 0
        hashes = (self._store.hash_rihs01(kind), _NO_HASH)
        publishers = [
            self._session.declare_publisher(one)
            for one in (*(f"{key}/{one}" for one in hashes), self._plain(topic))
        ]
        self._kept += publishers
        self._show("MP", topic, kind)

        def publish(message: Any) -> None:
            nonlocal count
            count += 1
            data = bytes(self._store.serialize_cdr(message, kind))
            # Without an attachment that it can read rmw_zenoh ends the process that receives it
            attachment = _ATTACHMENT.pack(count, time.time_ns(), len(gid), gid)
            with suppress(self._error):
                for one in publishers:
                    one.put(data, attachment=attachment)

        return publish

    @property
    def _error(self) -> type[Exception]:
        import zenoh

        error: type[Exception] = zenoh.ZError
        return error

    def _plain(self, topic: str) -> str:
        if not _TOPIC.fullmatch(topic):
            raise LinkError(f"{topic!r:.80}: is no topic of ROS 2, as in /odom")
        return topic.lstrip("/")

    def _key(self, topic: str, kind: str) -> str:
        return f"{self._network.domain}/{self._plain(topic)}/{_dds(kind)}"

    def _show(self, role: str, topic: str, kind: str) -> None:
        """Declare one end of a topic, so that ROS 2 lists it."""
        number = len(self._kept)
        token = "/".join(
            (
                f"@ros2_lv/{self._network.domain}/{self._session.zid()}/0/{number}/{role}/%/%",
                self._node,
                f"%{self._plain(topic).replace('/', '%')}",
                _dds(kind),
                self._store.hash_rihs01(kind),
                _QOS,
            )
        )
        self._kept.append(self._session.liveliness().declare_token(token))


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _dds(kind: str) -> str:
    """Return the name of a type as keys have it: nav_msgs::msg::dds_::Odometry_."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def _first(error: Exception) -> str:
    """Return what an error says without the places in its source."""
    return re.sub(r" at /\S+:\d+\.?", "", str(error))
