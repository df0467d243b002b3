"""The parameter microservice of the fake autopilot: read, list and set."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

Send = Callable[..., None]
_INT32, _REAL32 = 6, 9


class ParameterServer:
    """Parameters by name; like the real ones they outlast a reboot."""

    def __init__(self, values: dict[str, float], send: Send, *, is_bytewise: bool) -> None:
        """Serve ``values``; ``is_bytewise``: integers have the float's bytes, as in PX4."""
        self.values = values
        self._send = send
        self._is_bytewise = is_bytewise

    def read(self, request: Any) -> None:
        """Answer PARAM_REQUEST_READ, by index or by name; an unknown one gets no answer."""
        name = request.param_id.decode("ascii", "replace")
        if 0 <= request.param_index < len(self.values):
            name = list(self.values)[request.param_index]
        if name in self.values:
            self._send_value(name)

    def send_all(self) -> None:
        """Answer PARAM_REQUEST_LIST."""
        for name in self.values:
            self._send_value(name)

    def set(self, request: Any) -> bool:
        """Execute PARAM_SET and send the new value; return whether the parameter exists."""
        name = request.param_id.decode("ascii", "replace")
        if name not in self.values:
            return False
        value = request.param_value
        if request.param_type == _INT32 and self._is_bytewise:
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        self.values[name] = value
        self._send_value(name)
        return True

    def _send_value(self, name: str) -> None:
        value = self.values[name]
        is_integer = float(value).is_integer()
        if is_integer and self._is_bytewise:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self._send(
            "PARAM_VALUE",
            param_id=name.encode(),
            param_value=value,
            param_type=_INT32 if is_integer else _REAL32,
            param_count=len(self.values),
            param_index=list(self.values).index(name),
        )
