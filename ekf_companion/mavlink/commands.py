"""Commands to us: send a message once, or at a rate. Each that is addressed to us is answered.

Source: mavlink.io, Command Protocol; guide/message_rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import Emit, IntervalSet, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.heartbeat import APART_NS, Heartbeat
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.version import __version__

_MAVLINK_2 = 8192
_COMMAND_INT = 8
_PARAM_C_CAST = 131072
_CAPABILITIES = _MAVLINK_2 | _COMMAND_INT | _PARAM_C_CAST
_OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE."""


def _version() -> int:
    parts = [int(part) if part.isdigit() else 0 for part in __version__.split(".")]
    major, minor, patch = [*parts, 0, 0][:3]
    return int.from_bytes([major, minor, patch, _OFFICIAL], "big")


_IDENTITY: Mapping[str, bytes] = {
    "AUTOPILOT_VERSION": pack(
        "AUTOPILOT_VERSION", capabilities=_CAPABILITIES, flight_sw_version=_version()
    ),
    # Replaces AUTOPILOT_VERSION for components that are no autopilot
    "COMPONENT_INFORMATION_BASIC": pack(
        "COMPONENT_INFORMATION_BASIC",
        capabilities=_CAPABILITIES,
        model_name=b"EKF companion",
        software_version=__version__.encode("ascii", "replace")[:23],
    ),
    # MAVLink 1 is read, and 2 is sent
    "PROTOCOL_VERSION": pack("PROTOCOL_VERSION", version=200, min_version=100, max_version=200),
}
"""Payloads of the messages that identify us, by name."""


_UNKNOWN_PROGRESS = 255
_GONE_NS = 30 * SECOND_NS
"""After so long without a heartbeat of the commander, its command ends."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """A message of ours that may be requested."""

    rate: float
    """By default, Hz."""
    smallest: float
    """Hz; a lower one is refused as a mistake."""
    largest: float
    """Hz."""
    request: Callable[[], bool]
    """Sends it with the next estimate; returns False if there is none."""


@dataclass(slots=True)
class _CommandedRate:
    """A rate that somebody has commanded."""

    rate: float
    """Hz."""
    commander: tuple[int, int]
    """System and component id."""
    heard_ns: int | None = None
    """When its last heartbeat came since; None: it has sent none, and is not missed."""


class Commands(Service):
    """Obeys and answers commands of anybody.

    A commanded rate holds while its commander and the autopilot are there: it ends when either is
    lost, and when the autopilot reboots.
    """

    def __init__(self, outbox: Outbox, emit: Emit, heartbeat: Heartbeat) -> None:
        self.handles = {
            "COMMAND_LONG": self._take,
            "COMMAND_INT": self._take,
            "HEARTBEAT": self._take_heartbeat,
        }
        self._outbox = outbox
        self._emit = emit
        self._heartbeat = heartbeat
        self._streams: dict[str, Stream] = {}
        self._commanded: dict[str, _CommandedRate] = {}
        self._requested_ns: dict[str, int] = {}
        """When each message was last sent, or made due, on request."""

    def offer(self, name: str, stream: Stream) -> None:
        """Offer a message to be requested, or change the offer."""
        self._streams[name] = stream

    def rate(self, name: str) -> float:
        """Return the rate of an offered message, Hz: as commanded, or the default; 0: off."""
        stream = self._streams[name]
        commanded = self._commanded.get(name)
        return min(stream.rate if commanded is None else commanded.rate, stream.largest)

    def slowed_by(self, name: str) -> tuple[int, int, float] | None:
        """Return who has commanded a lower rate of a message than its default, and that rate, Hz.

        That is the system and component id; None: nobody has.
        """
        commanded = self._commanded.get(name)
        if commanded is None:
            return None
        rate, stream = self.rate(name), self._streams[name]
        is_less = rate < min(stream.rate, stream.largest)
        return (*commanded.commander, rate) if is_less else None

    def begin(self, peer: PeerFound) -> None:
        """Return to the default rates."""
        self.end()

    def end(self) -> None:
        """Return to the default rates."""
        for name in list(self._commanded):
            self._forget(name)

    def tick(self, now_ns: int) -> None:
        """End the commands of who has gone."""
        for name, commanded in list(self._commanded.items()):
            if commanded.heard_ns is not None and now_ns - commanded.heard_ns > _GONE_NS:
                self._forget(name)

    def _forget(self, name: str) -> None:
        del self._commanded[name]
        self._emit(IntervalSet(name, self.rate(name)))

    def _take_heartbeat(self, heartbeat: Any, frame: Frame, now_ns: int) -> None:
        for commanded in self._commanded.values():
            if commanded.commander == frame[1:3]:
                commanded.heard_ns = now_ns

    def _take(self, command: Any, frame: Frame, now_ns: int) -> None:
        is_direct = command.target_component == self._outbox.ids[1]
        message = LAYOUTS[number].name if (number := _whole(command.param1)) in LAYOUTS else ""
        result = Result.UNSUPPORTED
        if command.command == encode.REQUEST_MESSAGE:
            result = self._request(message, command.param2, now_ns)
        elif command.command == encode.SET_MESSAGE_INTERVAL and is_direct:
            result = self._set_interval(message, command.param2, frame[1:3])
        if result is Result.UNSUPPORTED and not is_direct:
            return  # sent to everybody, for somebody else to answer
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
            is_sent = self._heartbeat.request(now_ns)
            return Result.ACCEPTED if is_sent else Result.TEMPORARILY_REJECTED
        # MESSAGE_INTERVAL is about as small as its request, and asked for by message
        if message != "MESSAGE_INTERVAL" and self._is_early(message, now_ns):
            return Result.TEMPORARILY_REJECTED
        if message in _IDENTITY:
            self._outbox.send(message, _IDENTITY[message], now_ns)
        elif message == "MESSAGE_INTERVAL":
            self._outbox.send(message, self._interval(_whole(param2)), now_ns)
        elif message not in self._streams:
            return Result.UNSUPPORTED
        elif not self._streams[message].request():
            return Result.TEMPORARILY_REJECTED
        self._requested_ns[message] = now_ns
        return Result.ACCEPTED

    def _is_early(self, message: str, now_ns: int) -> bool:
        """Whether a message was requested a moment ago, by anybody: all on the link have got it."""
        last_ns = self._requested_ns.get(message)
        return last_ns is not None and 0 <= now_ns - last_ns < APART_NS

    def _interval(self, message_id: int) -> bytes:
        """Return the payload of MESSAGE_INTERVAL: 0 for what is never sent, -1 for what is off."""
        name, interval_us = LAYOUTS[message_id].name if message_id in LAYOUTS else "", 0
        if name == "HEARTBEAT":
            interval_us = 1_000_000
        elif name in self._streams:
            rate = self.rate(name)
            interval_us = round(1e6 / rate) if rate > 0.0 else -1
        return pack("MESSAGE_INTERVAL", message_id=max(message_id, 0), interval_us=interval_us)

    def _set_interval(self, name: str, interval_us: float, commander: tuple[int, int]) -> Result:
        if name not in self._streams:
            return Result.UNSUPPORTED
        stream = self._streams[name]
        if interval_us == 0.0:
            self._commanded.pop(name, None)
        elif interval_us == -1.0:
            self._commanded[name] = _CommandedRate(0.0, commander)
        elif interval_us > 0.0 and stream.smallest <= 1e6 / interval_us <= stream.largest:
            self._commanded[name] = _CommandedRate(1e6 / interval_us, commander)
        else:
            return Result.DENIED
        self._emit(IntervalSet(name, self.rate(name)))
        return Result.ACCEPTED


def _whole(number: float) -> int:
    """Return the message id in a float, which may be anything; -1: none."""
    return int(number) if 0.0 <= number <= 65535.0 else -1
