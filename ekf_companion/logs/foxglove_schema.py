"""Schemas of Foxglove's messages as JSON, which it needs in full to show a channel.

Source: Foxglove's message schemas (names and fields).
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]
INFO, WARNING = 2, 3
"""Levels of foxglove.Log."""
FLOAT32 = 7
"""Type of a foxglove.PackedElementField."""


def object_of(**properties: Schema) -> Schema:
    """Return the schema of an object."""
    return {"type": "object", "properties": properties}


def time_of(stamp_ns: int) -> dict[str, int]:
    """Return a time as the schemas have it."""
    return {"sec": stamp_ns // 1_000_000_000, "nsec": stamp_ns % 1_000_000_000}


NUMBER, TEXT, WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
TIME = object_of(sec=WHOLE, nsec=WHOLE)
_VECTOR = object_of(x=NUMBER, y=NUMBER, z=NUMBER)
_QUATERNION = object_of(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
_POSE = object_of(position=_VECTOR, orientation=_QUATERNION)

POSE = "foxglove.PoseInFrame", object_of(timestamp=TIME, frame_id=TEXT, pose=_POSE)
TRANSFORM = (
    "foxglove.FrameTransform",
    object_of(
        timestamp=TIME,
        parent_frame_id=TEXT,
        child_frame_id=TEXT,
        translation=_VECTOR,
        rotation=_QUATERNION,
    ),
)
LOCATION = (
    "foxglove.LocationFix",
    object_of(
        timestamp=TIME,
        frame_id=TEXT,
        latitude=NUMBER,
        longitude=NUMBER,
        altitude=NUMBER,
        position_covariance={"type": "array", "items": NUMBER},
        position_covariance_type=WHOLE,
    ),
)
LOG = (
    "foxglove.Log",
    object_of(timestamp=TIME, level=WHOLE, message=TEXT, name=TEXT, file=TEXT, line=WHOLE),
)
POINTS = (
    "foxglove.PointCloud",
    object_of(
        timestamp=TIME,
        frame_id=TEXT,
        pose=_POSE,
        point_stride=WHOLE,
        fields={"type": "array", "items": object_of(name=TEXT, offset=WHOLE, type=WHOLE)},
        data={"type": "string", "contentEncoding": "base64"},
    ),
)
"""Each with its name."""
