"""What we ask of the autopilot: its messages, one request after the other."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Answered, Emit, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.layout import IDS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_TIMEOUT_NS = SECOND_NS
_TRIES = 3
_ACCEPTED, _IN_PROGRESS = 0, 5
_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress")


@dataclass(slots=True)
class _Request:
    """One SET_MESSAGE_INTERVAL."""

    name: str
    rate: float
    sent: int = 0
    deadline_ns: int = 0


class Requests(Service):
    """Asks for every message at its rate, and notes the answers."""

    def __init__(self, outbox: Outbox, emit: Emit, rates: Mapping[str, float]) -> None:
        self.handles = {"COMMAND_ACK": self._take}
        self.results: dict[str, str] = {}
        """The last answer to the request for each message."""
        self._outbox = outbox
        self._emit = emit
        self._rates = rates
        self._peer: PeerFound | None = None
        self._wanted: deque[_Request] = deque()

    def begin(self, peer: PeerFound) -> None:
        """Ask for everything."""
        self._peer = peer
        self.results.clear()
        self._wanted = deque(_Request(name, rate) for name, rate in self._rates.items())

    def end(self) -> None:
        """Ask for nothing: nobody would hear."""
        self._wanted.clear()

    def tick(self, now_ns: int) -> None:
        """Send the request that is first in line, again where its time is over."""
        while self._wanted and self._peer:
            request = self._wanted[0]
            if request.sent and now_ns < request.deadline_ns:
                return
            if request.sent == _TRIES:
                self._settle("no answer")
                continue
            payload = encode.set_message_interval(
                IDS[request.name],
                request.rate,
                target_system=self._peer.system_id,
                target_component=self._peer.component_id,
                confirmation=request.sent,
            )
            request.sent += 1
            request.deadline_ns = now_ns + _TIMEOUT_NS
            self._outbox.send("COMMAND_LONG", payload, now_ns)
            return

    def _take(self, ack: Any, frame: Frame, now_ns: int) -> None:
        if ack.command != encode.SET_MESSAGE_INTERVAL or not (
            self._wanted and self._wanted[0].sent
        ):
            return
        if ack.result == _IN_PROGRESS:
            self._wanted[0].deadline_ns = now_ns + _TIMEOUT_NS
            return
        self._settle(_RESULTS[ack.result] if ack.result < len(_RESULTS) else f"result {ack.result}")
        self.tick(now_ns)

    def _settle(self, result: str) -> None:
        """Note the answer to the request that is under way, and think of another for it."""
        request = self._wanted.popleft()
        self.results[request.name] = result
        self._emit(Answered(request.name, result))
        if (
            request.name == "HIGHRES_IMU"
            and result != _RESULTS[_ACCEPTED]
            and self._peer is not None
            and self._peer.family is Family.ARDUPILOT
        ):
            self._wanted.appendleft(_Request("RAW_IMU", request.rate))
