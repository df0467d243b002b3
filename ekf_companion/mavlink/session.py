"""The conversation with one autopilot, without a socket and without a clock.

Bytes and ``now_ns`` go in; measurements, events and bytes to send come out. The same object runs
live and over a recorded .tlog: what it makes of the frames depends on their order only, and where
a time of arrival decides anything, it is taken as a .tlog can hold it (:func:`quantise`).

``now_ns`` must never step: the companion's monotonic clock, or that clock set to unix time once
at start where it is recorded.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.clock import Timesync, TimesyncOptions
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.decode import Decoder, DecoderOptions, Family
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.frame import JUNK, Frame, Splitter
from ekf_companion.mavlink.layout import IDS
from ekf_companion.nav.measurements import Measurement, Restart

_SECOND_NS = 1_000_000_000
_HEARTBEAT_NS = _SECOND_NS
_PEER_TIMEOUT_NS = 5 * _SECOND_NS
_COMMAND_TIMEOUT_NS = _SECOND_NS
_TRIES = 3

_OVERTAKEN = 16
"""A number so little behind is a frame that came late; further behind, the numbers went round."""

_HEARTBEAT_ID = IDS["HEARTBEAT"]
_TIMESYNC_ID = IDS["TIMESYNC"]
_COMMAND_ACK_ID = IDS["COMMAND_ACK"]
_NO_AUTOPILOT = 8
_GROUND_STATION = 6
_FAMILIES = {3: Family.ARDUPILOT, 12: Family.PX4}
_ACCEPTED, _IN_PROGRESS = 0, 5
_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress")

RATES: Mapping[str, float] = MappingProxyType(
    {
        "HIGHRES_IMU": 250.0,
        "GPS_RAW_INT": 10.0,
        "ATTITUDE": 10.0,
        "GLOBAL_POSITION_INT": 5.0,
        "SCALED_PRESSURE": 10.0,
        "SYSTEM_TIME": 1.0,
        "EXTENDED_SYS_STATE": 1.0,
    }
)
"""What is asked of the autopilot, Hz. GNSS at twice the usual rate halves the wait for its turn."""


def quantise(now_ns: int) -> int:
    """Give a time, ns, as a .tlog holds it: whole microseconds, the low two bits cleared.

    Those two bits hold the number of the link.
    """
    return now_ns // 4000 * 4000


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Who we are, whom we listen to, and what we ask for."""

    system_id: int | None = None
    """Ours; None: the autopilot's, and 1 until it is known."""
    component_id: int = 194
    """Ours: MAV_COMP_ID_ONBOARD_COMPUTER4."""
    autopilot_system_id: int | None = None
    """The one autopilot to listen to; None: the first that is heard."""
    rates: Mapping[str, float] = field(default_factory=lambda: RATES)
    """Messages to ask for, Hz, by name; 0 stops one; empty: nothing is asked."""
    expected: PeerFound | None = None
    """An autopilot that is known from an earlier run: found by whatever it says first, so that its
    heartbeat need not be waited for."""
    is_recording: bool = False
    """Whether what goes in and out is kept for ``take_record``."""
    decoder: DecoderOptions = field(default_factory=DecoderOptions)
    timesync: TimesyncOptions = field(default_factory=TimesyncOptions)


@dataclass(frozen=True, slots=True)
class PeerFound:
    """An autopilot was heard: the first time, or again after it was lost."""

    system_id: int
    component_id: int
    family: Family


@dataclass(frozen=True, slots=True)
class PeerLost:
    """No heartbeat of the autopilot for five seconds."""

    last_ns: int
    """When its last heartbeat arrived, our clock."""


@dataclass(frozen=True, slots=True)
class Rebooted:
    """The autopilot's clock began anew."""


@dataclass(frozen=True, slots=True)
class Answered:
    """What became of a request for a message."""

    message: str
    result: str
    """``accepted``, the autopilot's reason against it, or ``no answer``."""


@dataclass(frozen=True, slots=True)
class Noted:
    """What the autopilot's messages are like, where a human should hear of it."""

    text: str


Event = PeerFound | PeerLost | Rebooted | Answered | Noted


@dataclass(slots=True)
class _Request:
    """The one SET_MESSAGE_INTERVAL that is under way."""

    name: str
    rate: float
    sent: int = 0
    deadline_ns: int = 0


class Session:
    """One autopilot: found, asked, listened to and answered."""

    def __init__(self, options: SessionOptions | None = None) -> None:
        self.options = options or SessionOptions()
        self.decoder = Decoder(options=self.options.decoder)
        self.timesync = Timesync(self.options.timesync)
        self.results: dict[str, str] = {}
        """The last answer to the request for each message."""
        self.received: Counter[int] = Counter()
        """Frames of the autopilot by message id."""
        self.ignored: Counter[str] = Counter()
        """Frames that are not the autopilot's, by whose they are."""
        self.lost = 0
        """Frames of the autopilot that never came, by its sequence numbers."""
        self.late = 0
        """Frames that came twice, or after their successors."""
        self._splitter = Splitter()
        self._sender = Sender(self.options.system_id or 1, self.options.component_id)
        self._status = SystemStatus.BOOT
        self._peer: tuple[int, int] | None = None
        self._is_lost = False
        self._heard_ns = 0
        self._sequence: int | None = None
        self._next_heartbeat_ns: int | None = None
        self._wanted: deque[_Request] = deque()
        self._events: list[Event] = []
        self._out: list[bytes] = []
        self._record: list[tuple[int, bytes]] = []

    # What goes in

    def receive(self, data: bytes, now_ns: int) -> list[Measurement]:
        """Take bytes that were read at a time of ours; give what they say, in order."""
        measurements: list[Measurement] = []
        for frame in self._splitter.feed(data):
            if self.options.is_recording:
                self._record.append((quantise(now_ns) // 1000, frame.raw))
            if frame.message_id != JUNK:
                measurements += self._take(frame, now_ns)
        return measurements

    def _take(self, frame: Frame, now_ns: int) -> list[Measurement]:
        sender = frame[1:3]
        if sender == (self._sender.system_id, self._sender.component_id):
            self.ignored["our own"] += 1
            return []
        if frame.message_id == _HEARTBEAT_ID:
            self._take_heartbeat(frame, now_ns)
        elif self._peer is None:
            self._recognise(sender, now_ns)
        if sender != self._peer:
            self.ignored["of another system or component"] += 1
            return []

        self.received[frame.message_id] += 1
        self._count_lost(frame.sequence)
        if frame.message_id == _TIMESYNC_ID:
            self._take_timesync(frame, now_ns)
        elif frame.message_id == _COMMAND_ACK_ID:
            self._take_ack(frame, now_ns)
        measurements = self.decoder.decode(frame)
        while self.decoder.notes:
            self._events.append(Noted(self.decoder.notes.popleft()))
        if measurements and type(measurements[0]) is Restart:
            self._events.append(Rebooted())
            self._begin_anew()
        return measurements

    def _recognise(self, sender: tuple[int, int], now_ns: int) -> None:
        expected, wanted = self.options.expected, self.options.autopilot_system_id
        if expected is None or sender != (expected.system_id, expected.component_id):
            return
        if wanted not in (None, sender[0]):
            return
        self._peer = sender
        if self.options.system_id is None:
            self._sender.system_id = sender[0]
        self._find(expected.family, now_ns)

    def _find(self, family: Family, now_ns: int) -> None:
        self._heard_ns = quantise(now_ns)
        self._is_lost = False
        self.decoder.family = family
        self._events.append(PeerFound(*(self._peer or (0, 0)), family))
        self._begin_anew()

    def _take_heartbeat(self, frame: Frame, now_ns: int) -> None:
        heartbeat = unpack(frame)
        if heartbeat.autopilot == _NO_AUTOPILOT or heartbeat.type == _GROUND_STATION:
            return
        wanted = self.options.autopilot_system_id
        if self._peer is None and wanted in (None, frame.system_id):
            self._peer = (frame.system_id, frame.component_id)
            self._is_lost = True  # until now
            if self.options.system_id is None:
                self._sender.system_id = frame.system_id
        if self._peer != frame[1:3]:
            return
        self._notice_silence(now_ns)
        self._heard_ns = quantise(now_ns)
        family = _FAMILIES.get(heartbeat.autopilot, Family.UNKNOWN)
        is_other = self.options.expected is not None and family is not self.decoder.family
        self.decoder.family = family
        if self._is_lost or is_other:
            self._find(family, now_ns)

    def _begin_anew(self) -> None:
        """Ask for everything again: the autopilot knows nothing of us."""
        self._sequence = None
        self.timesync.reset()
        self.results.clear()
        self._wanted = deque(_Request(name, rate) for name, rate in self.options.rates.items())

    def _count_lost(self, sequence: int) -> None:
        if self._sequence is not None:
            gap = (sequence - self._sequence - 1) & 0xFF
            if gap > 0xFF - _OVERTAKEN:
                self.late += 1
                return
            self.lost += gap
        self._sequence = sequence

    def _is_for_us(self, message: Any) -> bool:
        return message.target_system in (0, self._sender.system_id) and (
            message.target_component in (0, self._sender.component_id)
        )

    def _take_timesync(self, frame: Frame, now_ns: int) -> None:
        message = unpack(frame)
        if not self._is_for_us(message):
            return
        if message.tc1 != 0:
            self.timesync.receive(message.tc1, message.ts1, now_ns)
            return
        tc1 = self.timesync.answer(message.ts1, now_ns)
        if tc1 is not None:
            self._send_timesync(tc1, message.ts1, now_ns)

    def _take_ack(self, frame: Frame, now_ns: int) -> None:
        ack = unpack(frame)
        if (
            ack.command != encode.SET_MESSAGE_INTERVAL
            or not self._is_for_us(ack)
            or not (self._wanted and self._wanted[0].sent)
        ):
            return
        if ack.result == _IN_PROGRESS:
            self._wanted[0].deadline_ns = now_ns + _COMMAND_TIMEOUT_NS
            return
        self._settle(_RESULTS[ack.result] if ack.result < len(_RESULTS) else f"result {ack.result}")
        self._ask(now_ns)

    # What time brings

    def tick(self, now_ns: int) -> None:
        """Do what is due; to be called ten times a second or more."""
        if self._next_heartbeat_ns is None or now_ns >= self._next_heartbeat_ns:
            # From the plan, not from now, so that lateness does not add up
            planned = self._next_heartbeat_ns
            late = planned is None or now_ns - planned > _HEARTBEAT_NS
            self._next_heartbeat_ns = (now_ns if late else planned or 0) + _HEARTBEAT_NS
            self.send("HEARTBEAT", encode.heartbeat(self._status), now_ns)
        if self._peer is None or self._is_lost:
            return
        self._notice_silence(now_ns)
        if self._is_lost:
            return
        self._ask(now_ns)
        ts1 = self.timesync.request(now_ns)
        if ts1 is not None:
            self._send_timesync(0, ts1, now_ns)

    def _notice_silence(self, now_ns: int) -> None:
        if not self._is_lost and quantise(now_ns) - self._heard_ns > _PEER_TIMEOUT_NS:
            self._is_lost = True
            self._wanted.clear()
            self._events.append(PeerLost(self._heard_ns))

    def _ask(self, now_ns: int) -> None:
        """Send the request that is first in line, again where its time is over."""
        while self._wanted and self._peer:
            request = self._wanted[0]
            if request.sent and now_ns < request.deadline_ns:
                return
            if request.sent == _TRIES:
                self._settle("no answer")
                continue
            system_id, component_id = self._peer
            payload = encode.set_message_interval(
                IDS[request.name],
                request.rate,
                target_system=system_id,
                target_component=component_id,
                confirmation=request.sent,
            )
            request.sent += 1
            request.deadline_ns = now_ns + _COMMAND_TIMEOUT_NS
            self.send("COMMAND_LONG", payload, now_ns)
            return

    def _settle(self, result: str) -> None:
        """Note the answer to the request that is under way, and think of another for it."""
        request = self._wanted.popleft()
        self.results[request.name] = result
        self._events.append(Answered(request.name, result))
        if (
            request.name == "HIGHRES_IMU"
            and result != _RESULTS[_ACCEPTED]
            and self.decoder.family is Family.ARDUPILOT
        ):
            self._wanted.appendleft(_Request("RAW_IMU", request.rate))

    # What goes out

    def set_state(self, status: SystemStatus) -> None:
        """Say in the heartbeat from now on how we are."""
        self._status = status

    def send(self, name: str, payload: bytes, now_ns: int) -> None:
        """Queue a message of ours."""
        frame = self._sender.frame(name, payload)
        self._out.append(frame)
        if self.options.is_recording:
            self._record.append((quantise(now_ns) // 1000, frame))

    def _send_timesync(self, tc1: int, ts1: int, now_ns: int) -> None:
        system_id, component_id = self._peer or (0, 0)
        payload = encode.timesync(tc1, ts1, target_system=system_id, target_component=component_id)
        self.send("TIMESYNC", payload, now_ns)

    def data_to_send(self) -> list[bytes]:
        """Give what is to be sent, one frame an item, and forget it."""
        out, self._out = self._out, []
        return out

    def take_record(self) -> list[tuple[int, bytes]]:
        """Give stamp (us) and bytes of all that went in and out, in order, and forget it.

        Each item is a frame or, of what came in, a run of junk. Nothing unless recording.
        """
        record, self._record = self._record, []
        return record

    def events(self) -> list[Event]:
        """Give what has happened, and forget it."""
        events, self._events = self._events, []
        return events

    @property
    def peer(self) -> tuple[int, int] | None:
        """System and component id of the autopilot; None: not heard or lost."""
        return None if self._is_lost else self._peer

    def counters(self) -> dict[str, int]:
        """Give how many of what, from bytes to refusals, by name."""
        return {
            "frames": self._splitter.frames,
            "bad_crc": self._splitter.bad_crc,
            "unknown_id": self._splitter.unknown_id,
            "incompatible": self._splitter.incompatible,
            "junk_bytes": self._splitter.junk_bytes,
            "lost": self.lost,
            "late": self.late,
            **{f"ignored: {whose}": count for whose, count in self.ignored.items()},
            **{f"refused: {why}": count for why, count in self.decoder.refused.items()},
        }
