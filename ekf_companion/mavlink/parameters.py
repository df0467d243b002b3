"""Our parameters, as a ground station reads and sets them: the server of the parameter protocol.

Source: mavlink.io, Parameter Protocol. All are REAL32, so that the two encodings of an integer in a
float do not matter. The table is fixed: names, order and count never change.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import Emit, ParameterSet
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import DOES_NOT_EXIST
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_REAL32 = 9
"""MAV_PARAM_TYPE of all of them."""
_PACE_NS = SECOND_NS // 20
"""Between two of a list: with 37 bytes each an eighth of a link at 57600 baud."""
_FLOAT = Struct("<f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One number that may be set over MAVLink."""

    name: str
    """At most 16 characters."""
    key: str
    """Of the configuration, dotted."""
    value: float
    lowest: float
    highest: float
    is_whole: bool = False
    """Whether it is a whole number: a count or a choice."""
    is_late: bool = False
    """Whether a new value takes effect only at the next start."""

    def accepts(self, value: float) -> bool:
        """Whether a value, as a float32 holds it, is in range."""
        if not math.isfinite(value) or (self.is_whole and not value.is_integer()):
            return False
        return _float32(self.lowest) <= value <= _float32(self.highest)


class ParameterServer(Service):
    """Answers lists, reads and sets from anybody."""

    def __init__(self, outbox: Outbox, emit: Emit, table: Sequence[Parameter]) -> None:
        self.handles = {
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_REQUEST_READ": self._read,
            "PARAM_SET": self._set,
        }
        self.refused: Counter[str] = Counter()
        """Requests that were refused, by ``message: why``."""
        self._outbox = outbox
        self._emit = emit
        self._table = tuple(table)
        self._values = [_written(parameter.value) for parameter in table]
        self._index = {parameter.name: index for index, parameter in enumerate(table)}
        self._listed: deque[int] = deque()
        self._next_ns = 0

    def tick(self, now_ns: int) -> None:
        """Send the next of a list, slowly enough to leave most of the link to others."""
        if self._listed and now_ns >= self._next_ns:
            self._next_ns = now_ns + _PACE_NS
            self._send(self._listed.popleft(), now_ns)

    def retune(self, table: Sequence[Parameter]) -> None:
        """Take new values of the same table; send those that have changed."""
        for index, parameter in enumerate(table):
            value = _written(parameter.value)
            if value != self._values[index]:
                self._values[index] = value
                if index not in self._listed:
                    self._listed.append(index)

    def _list(self, request: Any, frame: Frame, now_ns: int) -> None:
        self._listed = deque(range(len(self._table)))

    def _read(self, request: Any, frame: Frame, now_ns: int) -> None:
        index = request.param_index
        if index < 0:
            index = self._index.get(request.param_id.decode("ascii", "replace"), len(self._table))
        if index < len(self._table):
            self._send(index, now_ns)
        else:
            self._refuse(request, frame, now_ns)

    def _set(self, request: Any, frame: Frame, now_ns: int) -> None:
        index = self._index.get(request.param_id.decode("ascii", "replace"))
        if index is None:
            self._refuse(request, frame, now_ns)
            return
        parameter, value = self._table[index], float(request.param_value)
        if request.param_type != _REAL32:
            self.refused["PARAM_SET: is no REAL32"] += 1
        elif not parameter.accepts(value):
            why = f"{parameter.name} is not in {parameter.lowest:g} to {parameter.highest:g}"
            self.refused[f"PARAM_SET: {why}"] += 1
        elif value != _float32(self._values[index]):
            self._values[index] = value = _written(value)
            self._emit(ParameterSet(parameter.name, parameter.key, value, parameter.is_late))
        self._send(index, now_ns)  # the old value, where the new one is refused

    def _send(self, index: int, now_ns: int) -> None:
        payload = pack(
            "PARAM_VALUE",
            param_id=self._table[index].name.encode("ascii"),
            param_value=self._values[index],
            param_type=_REAL32,
            param_count=len(self._table),
            param_index=index,
        )
        self._outbox.send("PARAM_VALUE", payload, now_ns)

    def _refuse(self, request: Any, frame: Frame, now_ns: int) -> None:
        """Answer that there is no such parameter, unless everybody was asked."""
        if not self._table or request.target_component == 0:
            return
        self.refused[f"{LAYOUTS[frame.message_id].name}: no such parameter"] += 1
        payload = pack(
            "PARAM_ERROR",
            target_system=frame.system_id,
            target_component=frame.component_id,
            param_id=request.param_id,
            param_index=getattr(request, "param_index", -1),
            error=DOES_NOT_EXIST,
        )
        self._outbox.send("PARAM_ERROR", payload, now_ns)


def _written(value: float) -> float:
    """Return a number as a person would write it, not as a float32 holds it."""
    return float(f"{value:.7g}")


def _float32(value: float) -> float:
    """Return the nearest number that a float32 can hold."""
    held: float = _FLOAT.unpack(_FLOAT.pack(value))[0]
    return held
