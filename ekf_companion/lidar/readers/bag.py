"""Bags of ROS 1, and of ROS 2 as .db3 and .mcap, by the library rosbags."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.errors import LogError, part_of
from ekf_companion.lidar.readers import custom_message
from ekf_companion.lidar.readers.point_cloud import Cloud, unpack_message
from ekf_companion.lidar.readers.source import Source, StoredInertial, StoredScan
from ekf_companion.lidar.recording import Mounting
from ekf_companion.nav import so3

CLOUD = "sensor_msgs/msg/PointCloud2"
IMU = "sensor_msgs/msg/Imu"
HEADER = "std_msgs/msg/Header"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_DAMAGE = (
    ValueError,
    IndexError,
    KeyError,
    EOFError,
    OSError,
    AssertionError,
    struct.error,
    sqlite3.Error,
)
"""What the library raises, besides its own, where a bag is damaged."""


def open_bag(path: Path, lidar: str | None, imu: str | None) -> Source:
    """Open a bag.

    Args:
        path: The .bag, .db3 or .mcap, or the folder of a bag of ROS 2.
        lidar: The topic of the scans; None: the one with the most messages.
        imu: The topic of the inertial samples; None: likewise.

    Raises:
        LogError: It cannot be read, or has no scans or no inertial samples.
        MissingPackageError: rosbags is not installed.
    """
    notes = list[str]()
    faults = list[str]()
    with _opened(path) as reader:
        lidar = _topic(path, reader, (CLOUD, *custom_message.NAMES), lidar, "scans", notes)
        imu = _topic(path, reader, (IMU,), imu, "inertial samples", notes)
        inertial, imu_frame = _inertial(path, reader, imu, faults)
        clouds = list(islice(_clouds(path, reader, lidar, []), 2))
        first = clouds[0] if clouds else None
        restamp = None
        if len(clouds) > 1 and not any(one.stamp for one in clouds):
            restamp, words = _stamps_of(path, reader, clouds[0].number, inertial)
            notes += words
        mounting = None
        if first is not None and inertial is not None:
            mounting, words = _mounting(reader, imu_frame, first.frame)
            notes += words
    return Source(
        name=path.name,
        scans=lambda: _scans(path, lidar, faults, restamp),
        inertial=inertial,
        mounting=mounting,
        notes=tuple(notes),
        faults=faults,
        time_field="none" if first is None else first.cloud.time_field,
        inertial_name=imu,
        stamp_unit=None,
    )


class _Stored(NamedTuple):
    """A message of a cloud."""

    arrival: int
    """ns."""
    stamp: int
    """ns."""
    number: int | None
    """Of the header, which ROS 1 has."""
    frame: str
    cloud: Cloud


_Restamp = Callable[[_Stored], int | None]
"""Returns the stamp of a message whose header has none, ns; None: it is lost."""


def _scans(
    path: Path, topic: str, faults: list[str], restamp: _Restamp | None
) -> Iterator[StoredScan]:
    with _opened(path) as reader:
        for one in _clouds(path, reader, topic, faults):
            ns = one.stamp if restamp is None else restamp(one)
            stamp = float("nan") if ns is None else ns / 1e9
            cloud = one.cloud
            yield StoredScan(
                stamp, cloud.points, cloud.times, cloud.ring, one.arrival / 1e9, cloud.doppler
            )


def _stamps_of(
    path: Path, reader: Any, number: int | None, inertial: StoredInertial
) -> tuple[_Restamp, list[str]]:
    """Return stamps for scans without: those of a trigger of the same number, or of arrival."""
    for topic in sorted({one.topic for one in reader.connections if one.msgtype == HEADER}):
        connections = [one for one in reader.connections if one.topic == topic]
        triggers = dict[int | None, int]()
        for connection, _, raw in _messages(path, reader, connections, []):
            head = reader.deserialize(raw, connection.msgtype)
            triggers[getattr(head, "seq", None)] = _ns(head.stamp)
        if number is not None and number in triggers:
            return lambda one, known=triggers: known.get(one.number), [
                f"scans have no stamps: those of {topic} with the same number are taken"
            ]
    shift = 0
    if inertial.arrival is not None and len(inertial.stamp):
        shift = round(1e9 * float(np.median(inertial.stamp - inertial.arrival)))
    return lambda one: one.arrival + shift, [
        "scans have no stamps: their arrival is taken, on the clock of the inertial samples"
    ]


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _clouds(path: Path, reader: Any, topic: str, faults: list[str]) -> Iterator[_Stored]:
    """Return the messages of a topic."""
    connections = [one for one in reader.connections if one.topic == topic]
    for connection, arrival, raw in _messages(path, reader, connections, faults):
        number = None
        try:
            if connection.msgtype in custom_message.NAMES:
                stamp, frame, cloud = custom_message.decode(raw, reader.is2)
            else:
                message = reader.deserialize(raw, connection.msgtype)
                cloud = unpack_message(message)
                head = message.header
                stamp, frame, number = _ns(head.stamp), head.frame_id, getattr(head, "seq", None)
        except _damage() as error:
            raise LogError(
                f"{path}: {topic}: a message of {arrival / 1e9:.3f} s is no cloud: {error}"
            ) from None
        yield _Stored(arrival, stamp, number, frame, cloud)


def _inertial(path: Path, reader: Any, topic: str, faults: list[str]) -> tuple[StoredInertial, str]:
    """Return the samples of a topic and their frame."""
    connections = [one for one in reader.connections if one.topic == topic]
    rows, frame = [], ""
    for connection, arrival, raw in _messages(path, reader, connections, faults):
        try:
            message = reader.deserialize(raw, connection.msgtype)
        except _damage() as error:
            raise LogError(f"{path}: {topic}: a message is no Imu: {error}") from None
        w, f = message.angular_velocity, message.linear_acceleration
        frame, ns = message.header.frame_id, _ns(message.header.stamp)
        rows.append((ns / 1e9, w.x, w.y, w.z, f.x, f.y, f.z, arrival / 1e9))
    table = np.array(rows, np.float64).reshape(-1, 8)
    return StoredInertial(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7]), frame


def _messages(
    path: Path, reader: Any, connections: list[Any], faults: list[str]
) -> Iterator[tuple[Any, int, bytes]]:
    """Return the messages up to where the bag is damaged."""
    count = 0
    try:
        for message in reader.messages(connections=connections):
            yield message
            count += 1
    except _damage() as error:
        if isinstance(error, LogError):
            raise
        words = (
            f"the bag is damaged after {count} messages of {connections[0].topic} ({error}): what "
            "comes before is read"
        )
        if words not in faults:
            faults.append(words)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open the library's reader.

    Raises:
        LogError: It is no bag, or damaged.
        MissingPackageError: rosbags is not installed.
    """
    with part_of("lidar", f"reading {path.name}"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in custom_message.NAMES:
        package = name.partition("/")[0]
        kinds = get_types_from_msg(custom_message.POINT_DEFINITION, f"{package}/msg/CustomPoint")
        kinds |= get_types_from_msg(custom_message.DEFINITION.format(package=package), name)
        store.register(kinds)
    reader = None
    try:
        reader = AnyReader([path], default_typestore=store)
        reader.open()
    except _damage() as error:
        what = str(error).rstrip(".") or type(error).__name__
        raise LogError(
            f"{path}: cannot be read as a bag: {what}; a recording that was cut off is made whole "
            "by `rosbag reindex` (.bag), `ros2 bag reindex` (.db3) or `mcap recover` (.mcap)"
        ) from None
    try:
        yield reader
    finally:
        reader.close()


def _damage() -> tuple[type[Exception], ...]:
    """Return what a damaged bag raises, the library's own exceptions among it."""
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1.reader import ReaderError as ReaderError1
    from rosbags.rosbag2.errors import ReaderError as ReaderError2
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    return *_DAMAGE, AnyReaderError, ReaderError1, ReaderError2, SerdeError, TypesysError


def _topic(
    path: Path,
    reader: Any,
    kinds: tuple[str, ...],
    asked: str | None,
    what: str,
    notes: list[str],
) -> str:
    """Return the topic to read.

    Raises:
        LogError: There is none, or not the one asked for.
    """
    counts = dict[str, int]()
    for one in reader.connections:
        if one.msgtype in kinds:
            counts[one.topic] = counts.get(one.topic, 0) + one.msgcount
    if asked is None and counts:
        chosen = max(counts, key=lambda topic: counts[topic])
        others = ", ".join(
            f"{topic} ({count})" for topic, count in counts.items() if topic != chosen
        )
        beside = f"; not read: {others}" if others else ""
        notes.append(f"{what} are of {chosen} ({counts[chosen]} messages{beside})")
        return chosen
    if asked in counts:
        return str(asked)
    found = ", ".join(f"{one.topic} ({one.msgtype})" for one in reader.connections)
    wanted = f"no topic {asked} of" if asked else "no topic of"
    raise LogError(
        f"{path}: {wanted} {what} ({' or '.join(kinds)}); found: {found or 'no topics at all'}"
    )


def _mounting(reader: Any, imu: str, lidar: str) -> tuple[Mounting | None, list[str]]:
    """Return the mounting by the static transforms between two frames."""
    steps = dict[str, list[tuple[str, Any, Any]]]()
    connections = [
        one
        for one in reader.connections
        if one.topic.endswith("tf_static") and one.msgtype == TRANSFORMS
    ]
    if connections:
        for connection, _, raw in reader.messages(connections=connections):
            for one in reader.deserialize(raw, connection.msgtype).transforms:
                q, t = one.transform.rotation, one.transform.translation
                w_xyz = so3.normalise(np.array((q.w, q.x, q.y, q.z), np.float64))
                rotation, move = so3.to_matrix(w_xyz), np.array((t.x, t.y, t.z))
                if not np.isfinite(rotation).all():
                    continue  # of no length: no rotation
                parent, child = one.header.frame_id.strip("/"), one.child_frame_id.strip("/")
                steps.setdefault(child, []).append((parent, rotation, move))
                steps.setdefault(parent, []).append((child, rotation.T, -rotation.T @ move))
    imu, lidar = imu.strip("/"), lidar.strip("/")
    reached = {lidar: (np.eye(3), np.zeros(3))}
    waiting = [lidar]
    while waiting:
        frame = waiting.pop(0)
        rotation, move = reached[frame]
        for to, turn, along in steps.get(frame, ()):
            if to not in reached:
                reached[to] = (turn @ rotation, turn @ move + along)
                waiting.append(to)
    if imu == lidar and imu:
        return Mounting(), [f"lidar and inertial sensor are in one frame, {imu}"]
    if imu in reached:
        return Mounting(*reached[imu]), [f"the mounting is that of /tf_static, {lidar} in {imu}"]
    return None, [f"/tf_static does not join the frames {lidar or '(none)'} and {imu or '(none)'}"]
