"""Commands to us: a message once, a message at a rate; an answer to all that are ours to answer.

Source: mavlink.io, Command Protocol; guide/message_rates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import Emit, IntervalSet
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.heartbeat import Heartbeat
from ekf_companion.mavlink.layout import LAYOUTS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.version import __version__

_MAVLINK_2 = 8192
_COMMAND_INT = 8
_PARAM_C_CAST = 131072
_UNKNOWN_PROGRESS = 255
_SLOWEST = 1.0 / 3600.0
"""Hz: rarer is a mistake."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """A message of ours that may be asked for."""

    rate: float
    """By default, Hz."""
    largest: float
    """Hz."""
    request: Callable[[], bool]
    """Has it sent with the next estimate; False: there is none to send."""


class Commands(Service):
    """Obeys and answers, whoever commands."""

    def __init__(self, outbox: Outbox, emit: Emit, heartbeat: Heartbeat) -> None:
        self.handles = {"COMMAND_LONG": self._take_long, "COMMAND_INT": self._take_int}
        self._outbox = outbox
        self._emit = emit
        self._heartbeat = heartbeat
        self._streams: dict[str, Stream] = {}
        self._chosen: dict[str, float] = {}

    def offer(self, name: str, stream: Stream) -> None:
        """Let a message be asked for, or change what is offered."""
        self._streams[name] = stream

    def rate(self, name: str) -> float:
        """Give the rate of an offered message, Hz: as asked for, or by default; 0: off."""
        stream = self._streams[name]
        return min(self._chosen.get(name, stream.rate), stream.largest)

    def _take_long(self, command: Any, frame: Frame, now_ns: int) -> None:
        self._take(command, frame, now_ns)

    def _take_int(self, command: Any, frame: Frame, now_ns: int) -> None:
        self._take(command, frame, now_ns)

    def _take(self, command: Any, frame: Frame, now_ns: int) -> None:
        is_direct = command.target_component == self._outbox.ids[1]
        message = LAYOUTS[number].name if (number := _whole(command.param1)) in LAYOUTS else ""
        result = Result.UNSUPPORTED
        if command.command == encode.REQUEST_MESSAGE:
            result = self._request(message, command.param2, now_ns)
        elif command.command == encode.SET_MESSAGE_INTERVAL and is_direct:
            result = self._set_interval(message, command.param2)
        if result is Result.UNSUPPORTED and not is_direct:
            return  # everybody was told, and it is somebody else's to answer
        payload = pack(
            "COMMAND_ACK",
            command=command.command,
            result=result,
            progress=_UNKNOWN_PROGRESS,
            target_system=frame.system_id,
            target_component=frame.component_id,
        )
        self._outbox.send("COMMAND_ACK", payload, now_ns)

    def _request(self, message: str, param2: float, now_ns: int) -> Result:
        if message == "HEARTBEAT":
            self._heartbeat.beat(now_ns)
        elif message == "AUTOPILOT_VERSION":
            self._outbox.send(message, _version(), now_ns)
        elif message == "MESSAGE_INTERVAL":
            self._outbox.send(message, self._interval(_whole(param2)), now_ns)
        elif message not in self._streams:
            return Result.UNSUPPORTED
        elif not self._streams[message].request():
            return Result.TEMPORARILY_REJECTED
        return Result.ACCEPTED

    def _interval(self, message_id: int) -> bytes:
        """Give the payload of MESSAGE_INTERVAL: 0 for what is never sent, -1 for what is off."""
        name, interval_us = LAYOUTS[message_id].name if message_id in LAYOUTS else "", 0
        if name == "HEARTBEAT":
            interval_us = 1_000_000
        elif name in self._streams:
            rate = self.rate(name)
            interval_us = round(1e6 / rate) if rate > 0.0 else -1
        return pack("MESSAGE_INTERVAL", message_id=max(message_id, 0), interval_us=interval_us)

    def _set_interval(self, name: str, interval_us: float) -> Result:
        if name not in self._streams:
            return Result.UNSUPPORTED
        stream = self._streams[name]
        if interval_us == 0.0:
            self._chosen.pop(name, None)
        elif interval_us == -1.0:
            self._chosen[name] = 0.0
        elif not _SLOWEST <= (rate := _rate(interval_us)) <= stream.largest:
            return Result.DENIED
        else:
            self._chosen[name] = rate
        self._emit(IntervalSet(name, self.rate(name)))
        return Result.ACCEPTED


def _rate(interval_us: float) -> float:
    """Give the rate of an interval, Hz; NaN where there is none."""
    return 1e6 / interval_us if interval_us > 0.0 else math.nan


def _whole(number: float) -> int:
    """Give a message id out of a float, which a stranger may have made anything; -1: none."""
    return int(number) if 0.0 <= number <= 65535.0 else -1


def _version() -> bytes:
    parts = [int(part) if part.isdigit() else 0 for part in __version__.split(".")[:3]]
    major, minor, patch = [*parts, 0, 0, 0][:3]
    return pack(
        "AUTOPILOT_VERSION",
        capabilities=_MAVLINK_2 | _COMMAND_INT | _PARAM_C_CAST,
        flight_sw_version=major << 24 | minor << 16 | patch << 8 | 255,
    )
