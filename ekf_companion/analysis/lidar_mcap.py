"""A solution as MCAP, for Foxglove and what else reads it.

Channels, as JSON with schemas: ``/pose`` and ``/tf`` (``map``: the levelled world; ``base_link``:
the inertial sensor; forward, left, up), ``/estimate`` with the numbers of the .csv, ``/map`` with
the points of the map at the end, and ``/log`` with verdict and remarks.

Source: MCAP specification, mcap.dev.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
import orjson

from ekf_companion.errors import part_of
from ekf_companion.lidar.solution import Solution, lines_of
from ekf_companion.logs import foxglove_schema as schema
from ekf_companion.nav.relative_pose import SINCE

FRAME, BODY = "map", "base_link"


def write(solution: Solution, file: BinaryIO) -> None:
    """Write estimates, map and verdict.

    Raises:
        MissingPackageError: The library ``mcap`` is not installed.
    """
    with part_of("formats", "an .mcap"):
        from mcap.writer import Writer
    writer = Writer(file)
    writer.start(profile="", library="ekf-companion")
    head = next(_rows(solution))
    numbers = {name: schema.NUMBER for name in head if name != "t_s"}
    schemas = {
        "/pose": schema.POSE,
        "/tf": schema.TRANSFORM,
        "/estimate": (
            "ekf_companion.LidarEstimate",
            schema.object_of(timestamp=schema.TIME, **numbers),
        ),
        "/map": schema.POINTS,
        "/log": schema.LOG,
    }
    channels = {}
    for topic, (name, of_channel) in schemas.items():
        number = writer.register_schema(name, "jsonschema", orjson.dumps(of_channel))
        channels[topic] = writer.register_channel(topic, "json", number)
    for topic, stamp, message in _messages(solution):
        ns = round(stamp * 1e9)
        message["timestamp"] = schema.time_of(ns)
        writer.add_message(channels[topic], ns, orjson.dumps(message), ns)
    writer.finish()


def _rows(solution: Solution) -> Iterator[list[str]]:
    """Yield the cells of the .csv that are of each pose: relative ones end at some only."""
    lines = (line.split(",") for line in lines_of(solution, ".csv"))
    head = next(lines)
    kept = head.index(SINCE)
    yield head[:kept]
    yield from (row[:kept] for row in lines)


def _messages(solution: Solution) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Yield topic, time, s, and content of each message but its time."""
    head, *rows = _rows(solution)
    for row in rows:
        numbers = dict(zip(head, map(float, row), strict=True))
        stamp = numbers.pop("t_s")
        position = {axis: numbers[f"{axis}_m"] for axis in "xyz"}
        turn = {axis: numbers[f"q{axis}"] for axis in "xyzw"}
        yield (
            "/pose",
            stamp,
            {"frame_id": FRAME, "pose": {"position": position, "orientation": turn}},
        )
        names = {"parent_frame_id": FRAME, "child_frame_id": BODY}
        yield "/tf", stamp, {**names, "translation": position, "rotation": turn}
        yield "/estimate", stamp, dict(numbers)
    last = float(solution.track.stamp[-1])
    fields = [
        {"name": axis, "offset": 4 * k, "type": schema.FLOAT32} for k, axis in enumerate("xyz")
    ]
    data = base64.b64encode(solution.points.astype(np.float32).tobytes()).decode()
    here = {"position": dict.fromkeys("xyz", 0.0), "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    cloud = {"frame_id": FRAME, "pose": here, "point_stride": 12, "fields": fields, "data": data}
    yield "/map", last, cloud
    for text in (solution.verdict(), *solution.remarks()):
        line = {
            "level": schema.INFO,
            "message": text,
            "name": "ekf-companion",
            "file": "",
            "line": 0,
        }
        yield "/log", last, line
