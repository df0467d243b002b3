"""Points, times and rings out of the fields of a cloud: PointCloud2 of ROS, and .pcd."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.lidar.readers.source import Stored
from ekf_companion.nav.arrays import Array

TIMES = ("t", "time", "timestamp", "offset_time", "time_offset", "time_stamp", "ts", "point_time")
"""Names of the fields of points' times, as drivers have them."""
RINGS = ("ring", "line", "channel", "laser_id", "laserid")
DOPPLERS = (
    "doppler",
    "velocity",
    "v_doppler_mps",
    "radial_velocity",
    "doppler_velocity",
    "radial_speed",
    "range_rate",
)
"""Names of the fields of radial speeds, as drivers of radars have them."""
_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""NumPy's types of PointField, from INT8 = 1 on."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a point."""

    name: str
    offset: int
    """Bytes."""
    datatype: int
    """As PointField has it, 1 to 8."""
    count: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points, their times, rings and speeds as stored; None: there are no such fields."""

    points: Array
    """m, shape (n, 3)."""
    times: Stored | None
    ring: Stored | None
    time_field: str
    doppler: Stored | None = None
    """Radial speeds."""


def unpack_message(message: Any) -> Cloud:
    """Return the cloud of a PointCloud2 as the library rosbags has it.

    Raises:
        ValueError: See :func:`unpack`.
    """
    return unpack(
        message.data,
        [Field(one.name, one.offset, one.datatype, one.count) for one in message.fields],
        width=message.width,
        height=message.height,
        point_step=message.point_step,
        row_step=message.row_step,
        is_bigendian=bool(message.is_bigendian),
    )


def unpack(
    data: bytes | memoryview,
    fields: Sequence[Field],
    *,
    width: int,
    height: int,
    point_step: int,
    row_step: int,
    is_bigendian: bool,
) -> Cloud:
    """Return the cloud of a PointCloud2.

    Raises:
        ValueError: Its sizes or fields contradict each other, or x, y or z is missing.
    """
    count = width * height
    step = row_step if height > 1 else width * point_step
    if point_step <= 0 or step < width * point_step or len(data) < step * height:
        raise ValueError(
            f"{height} rows of {width} points of {point_step} bytes need more than the "
            f"{len(data)} bytes of the message"
        )
    known = [field for field in fields if 1 <= field.datatype <= 8 and field.count >= 1]
    order = ">" if is_bigendian else "<"
    names, formats, offsets = list[str](), list[str](), list[int]()
    for field in known:
        dtype = np.dtype(order + _TYPES[field.datatype - 1])
        if field.offset < 0 or field.offset + dtype.itemsize > point_step or field.name in names:
            raise ValueError(
                f"field {field.name!r} at byte {field.offset} does not fit a point of "
                f"{point_step} bytes, or stands twice"
            )
        names.append(field.name)
        formats.append(dtype.str)
        offsets.append(field.offset)
    layout = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    )
    rows = np.ndarray((height, width), layout, bytes(data), 0, (max(step, 1), point_step))
    flat = rows.reshape(count)
    return from_columns({name: flat[name] for name in names})


def from_columns(columns: Mapping[str, Stored]) -> Cloud:
    """Return the cloud of named columns, each of shape (n,).

    Raises:
        ValueError: x, y or z is missing.
    """
    lower = {name.lower(): name for name in columns}
    if not {"x", "y", "z"} <= lower.keys():
        raise ValueError(f"no fields x, y, z: found {', '.join(columns) or 'none'}")
    points = np.stack([columns[lower[name]].astype(np.float64) for name in "xyz"], -1)
    time = next((lower[name] for name in TIMES if name in lower), None)
    ring = next((lower[name] for name in RINGS if name in lower), None)
    doppler = next((lower[name] for name in DOPPLERS if name in lower), None)
    return Cloud(
        points,
        None if time is None else _native(columns[time]),
        None if ring is None else _native(columns[ring]),
        time or "none",
        None if doppler is None else _native(columns[doppler]),
    )


def _native(values: Stored) -> Stored:
    return values.astype(values.dtype.newbyteorder("="))
