"""The number in an autopilot's PARAM_VALUE."""

from __future__ import annotations

import math
import struct
from typing import Any

from ekf_companion.mavlink.decode.context import Family
from ekf_companion.mavlink.frame import Frame

_REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""
_INT32 = struct.Struct("<i")


def value_of(message: Any, frame: Frame, family: Family) -> float | None:
    """Return the number in an autopilot's PARAM_VALUE; None if it holds none.

    Source: MAVLink guide, "Parameter Protocol", on both encodings of the value.
    """
    value = message.param_value
    if family is Family.PX4 and message.param_type != _REAL32:
        # PX4 puts the integer's bytes where the float's would be
        (value,) = _INT32.unpack(frame.payload.ljust(4, b"\0")[:4])
    return float(value) if math.isfinite(value) else None
