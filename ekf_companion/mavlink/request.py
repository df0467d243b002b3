"""Requests to the autopilot: for its messages and its version, one after the other."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, FirmwareReported, Noted, PeerFound, RequestAnswered
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.loop_rate import LoopRate
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_TIMEOUT_NS = SECOND_NS
_LONGEST_NS = 4 * SECOND_NS
"""The time for an answer grows with how long they take, up to here."""
_TRIES = 3
_IN_PROGRESS = 5
ACCEPTED = "accepted"
_RESULTS = (
    ACCEPTED,
    "temporarily rejected",
    "denied",
    "unsupported",
    "failed",
    "in progress",
    "cancelled",
    "only as COMMAND_LONG",
    "only as COMMAND_INT",
    "unsupported frame",
    "not in control",
)
"""MAV_RESULT in words."""

_GROUPS = {
    "RAW_IMU": 1,
    "SCALED_IMU2": 1,
    "SCALED_IMU3": 1,
    "SCALED_PRESSURE": 1,
    "GPS_RAW_INT": 2,
    "GLOBAL_POSITION_INT": 6,
    "ATTITUDE": 10,
    "SYSTEM_TIME": 12,
}
"""MAV_DATA_STREAM of each message, as an ArduPilot from before SET_MESSAGE_INTERVAL knows it."""


_ARDUPILOTS = ("SCALED_IMU2", "SCALED_IMU3")
"""Asked of ArduPilot alone: of the other compasses only their fields are used."""
_INERTIAL = ("HIGHRES_IMU", "RAW_IMU")
_STEPS = (100.0, 50.0, 40.0, 25.0, 10.0)
"""Hz; ArduPilot denies more than 0.8 of its loop's rate, where that could not be read."""
NO_ANSWER = "no answer"


@dataclass(slots=True)
class _Request:
    """One command: SET_MESSAGE_INTERVAL, or REQUEST_MESSAGE where there is no rate."""

    name: str
    rate: float | None
    sent: int = 0
    first_ns: int = 0
    """When it was sent first, and last."""
    last_ns: int = 0
    deadline_ns: int = 0

    @property
    def command(self) -> int:
        return encode.REQUEST_MESSAGE if self.rate is None else encode.SET_MESSAGE_INTERVAL


class Requests(Service):
    """Requests every message at its rate, and notes the answers.

    COMMAND_ACK names only the command, not the message. So one request is under way at a time, and
    after one that was sent more than once the next waits until its other answers have come, as
    late as the first did: none of them is taken for the next one's. An answer that comes after
    all three tries were given up, or that is meant for somebody else and has no address, may still
    mislead us; then the audit finds that the message does not come, and requests it again.
    """

    def __init__(self, outbox: Outbox, emit: Emit, rates: Mapping[str, float]) -> None:
        self.handles = {
            "COMMAND_ACK": self._take,
            "AUTOPILOT_VERSION": self._take_version,
            "PARAM_VALUE": self._take_parameter,
        }
        self.results: dict[str, str] = {}
        """The last answer to the request for each message."""
        self.rates = rates
        """Requested rates by message, Hz."""
        self._granted: dict[str, float] = {}
        self.version = ""
        """Of the autopilot's firmware, as in ``1.16.0``; empty: not known."""
        self._outbox = outbox
        self._emit = emit
        self._peer: PeerFound | None = None
        self._loop_rate = LoopRate(outbox)
        self._wanted: deque[_Request] = deque()
        self._has_fallen_back = False
        self._is_lowered = False
        """Whether less is requested than is configured, so that fixes have room."""
        self._timeout_ns = _TIMEOUT_NS
        self._quiet_ns = 0
        """Until then answers to settled requests may come."""

    def begin(self, peer: PeerFound) -> None:
        """Request everything."""
        if peer != self._peer:
            self.version = ""
        self._peer = peer
        self._loop_rate.begin(peer)
        self.results.clear()
        self._granted.clear()
        self._is_lowered = False
        self._timeout_ns, self._quiet_ns = _TIMEOUT_NS, 0
        is_ardupilot = peer.family is Family.ARDUPILOT
        self._wanted = deque(
            _Request(name, rate)
            for name, rate in self.rates.items()
            if is_ardupilot or name not in _ARDUPILOTS
        )
        if self._wanted:
            self._wanted.append(_Request("AUTOPILOT_VERSION", None))

    def end(self) -> None:
        """Request nothing: nobody would hear."""
        self._wanted.clear()

    def retune(self, rates: Mapping[str, float]) -> None:
        """Request other rates from now on, Hz, by message."""
        changed = [name for name in rates if rates[name] != self.rates.get(name)]
        self.rates = rates
        inertial = self.inertial
        if "HIGHRES_IMU" in changed:
            self._granted.clear()
        if self._peer is not None:
            for name in changed:
                self.repeat(inertial or name if name == "HIGHRES_IMU" else name)

    def is_under_way(self, names: Collection[str]) -> bool:
        """Return whether one of some messages is still to be requested, or to be answered for."""
        return any(request.name in names for request in self._wanted)

    @property
    def inertial(self) -> str:
        """The inertial message that an ArduPilot has granted; empty: none, or another autopilot."""
        return next((name for name in _INERTIAL if name in self._granted), "")

    def repeat(self, name: str) -> None:
        """Request once more a message that should come at its rate."""
        self._ask_next(_Request(name, self.expected_rate(name)))

    def ask_once(self, name: str) -> None:
        """Request a message once, soon, where messages are requested at all."""
        if self.rates and not any(one.name == name and one.rate is None for one in self._wanted):
            self._wanted.insert(1, _Request(name, None))

    def _ask_next(self, one: _Request) -> None:
        """Request it after the one under way, unless it waits already."""
        if not self.is_under_way((one.name,)):
            self._wanted.insert(1, one)

    def lower(self, name: str, measured: float) -> bool:
        """Request an inertial message of ArduPilot's at less than half of what comes, Hz.

        On a full line all that is asked for waits, and the samples with it. Return whether there is
        a lower rate to ask for.
        """
        rate = next((step for step in _STEPS if step < 0.5 * measured), _STEPS[-1])
        if rate >= self._granted.get(name, 0.0):
            return False
        if not self.is_under_way((name,)):
            self._granted[name], self._is_lowered = rate, True
            self._ask_next(_Request(name, rate))
            self._emit(
                Noted(
                    f"{name} fills the link from the autopilot, and no fix comes through: "
                    f"{rate:g} Hz are requested; a faster line would carry {self._rate(name):g}"
                )
            )
        return True

    def expected_rate(self, name: str) -> float:
        """Return the rate to expect of a message, Hz: the granted one, else the requested one."""
        return self._granted.get(name, self._rate(name))

    def tick(self, now_ns: int) -> None:
        """Send the first request in line, again when its time is over."""
        while self._wanted and self._peer:
            request = self._wanted[0]
            if now_ns < (request.deadline_ns if request.sent else self._quiet_ns):
                return
            if request.sent == _TRIES:
                self._settle(NO_ANSWER)
                continue
            if request.rate is not None and not request.sent:
                if not self._loop_rate.may_request(request.rate, now_ns):
                    return
                request.rate = self._loop_rate.limit(request.rate)
            self._send(request, self._peer, now_ns)
            return
        if self._peer and self._peer.family is Family.ARDUPILOT and not self._has_fallen_back:
            self._fall_back(self._peer, now_ns)

    def _send(self, request: _Request, peer: PeerFound, now_ns: int) -> None:
        payload = encode.request_message(
            IDS[request.name], request.rate, **peer.target, confirmation=request.sent
        )
        request.first_ns = request.first_ns if request.sent else now_ns
        request.sent, request.last_ns = request.sent + 1, now_ns
        request.deadline_ns = now_ns + self._timeout_ns
        self._outbox.send("COMMAND_LONG", payload, now_ns)

    def _fall_back(self, peer: PeerFound, now_ns: int) -> None:
        """Request by REQUEST_DATA_STREAM the groups of which no message was granted."""
        self._has_fallen_back = True
        granted = {_GROUPS.get(name) for name, result in self.results.items() if result == ACCEPTED}
        groups: dict[int, float] = {}
        for name in self.results:
            if (group := _GROUPS.get(name)) is not None and group not in granted:
                groups[group] = max(self._rate(name), groups.get(group, 0.0))
        for group, rate in groups.items():
            payload = encode.request_data_stream(group, rate, **peer.target)
            self._outbox.send("REQUEST_DATA_STREAM", payload, now_ns)

    def _rate(self, name: str) -> float:
        return self.rates.get("HIGHRES_IMU" if name == "RAW_IMU" else name, 0.0)

    def _take(self, ack: Any, frame: Frame, now_ns: int) -> None:
        request = self._wanted[0] if self._wanted else None
        if request is None or not request.sent or ack.command != request.command:
            return
        if ack.result == _IN_PROGRESS:
            request.deadline_ns = now_ns + self._timeout_ns
            return
        if request.sent > 1:
            self._expect_others(now_ns, request)
        self._settle(_RESULTS[ack.result] if ack.result < len(_RESULTS) else f"result {ack.result}")
        self.tick(now_ns)

    def _expect_others(self, now_ns: int, request: _Request) -> None:
        """Wait for the other answers to a request sent more than once, and longer from now on."""
        took_ns = now_ns - request.first_ns
        self._timeout_ns = min(max(self._timeout_ns, took_ns * 3 // 2), _LONGEST_NS)
        self._quiet_ns = request.last_ns + took_ns * 3 // 2

    def _take_parameter(self, message: Any, frame: Frame, now_ns: int) -> None:
        if self._loop_rate.take(message, frame):
            self.tick(now_ns)

    def _take_version(self, message: Any, frame: Frame, now_ns: int) -> None:
        version = ".".join(str(byte) for byte in message.flight_sw_version.to_bytes(4, "big")[:3])
        if message.flight_sw_version and version != self.version:
            self.version = version
            self._emit(FirmwareReported(version))

    def _settle(self, result: str) -> None:
        """Note the answer to the request under way, and queue another where it was refused."""
        request = self._wanted.popleft()
        if request.rate is None:
            return  # an old autopilot does not know this request
        if self.results.get(request.name) != result:
            self.results[request.name] = result
            self._emit(RequestAnswered(request.name, result))
        self._has_fallen_back = False
        if request.name in _INERTIAL and self._peer and self._peer.family is Family.ARDUPILOT:
            self._settle_inertial(request.name, request.rate, result)

    def _settle_inertial(self, name: str, rate: float, result: str) -> None:
        """Request the coarser message where ArduPilot refuses the finer one, then a lower rate."""
        lower = [step for step in _STEPS if step < rate]
        if result != NO_ANSWER:
            self._granted.pop(name, None)
        if result == ACCEPTED:
            self._granted = {name: rate}  # one message is enough
            if rate < self._rate(name) and not self._is_lowered:
                self._emit(
                    Noted(
                        f"{name} is granted at {rate:g} Hz, and {self._rate(name):g} were asked "
                        "for: raise SCHED_LOOP_RATE, of which 0.8 is the most"
                    )
                )
        elif name == "HIGHRES_IMU":
            self._wanted.appendleft(_Request("RAW_IMU", rate))
        elif result != NO_ANSWER and lower:
            self._wanted.appendleft(_Request("HIGHRES_IMU", lower[0]))
