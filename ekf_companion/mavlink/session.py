"""The conversation with one autopilot, without a socket and without a clock.

Bytes and ``now_ns`` go in; measurements, events and bytes to send come out. The same object runs
live and over a recorded .tlog: what it makes of the frames depends on their order only, and where
a time of arrival decides anything, it is taken as a .tlog can hold it (:func:`quantise`).

The session only routes: each conversation of the protocol is a ``Service`` in a file of its own.

``now_ns`` must never step: the companion's monotonic clock, or that clock set to unix time once
at start where it is recorded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping

from ekf_companion.mavlink.admission import Admission
from ekf_companion.mavlink.audit import Audit
from ekf_companion.mavlink.clash import ClashWatch
from ekf_companion.mavlink.clock import Timesync, TimesyncService
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.commands import Commands
from ekf_companion.mavlink.decode import Decoder
from ekf_companion.mavlink.discovery import Discovery
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import (
    Answered,
    Event,
    GuardChanged,
    Noted,
    PeerFound,
    PeerLost,
    Rebooted,
)
from ekf_companion.mavlink.frame import JUNK, Frame, Sequence, Splitter
from ekf_companion.mavlink.guard import Guard, GuardOptions
from ekf_companion.mavlink.heartbeat import Heartbeat
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.options import RATES, SessionOptions
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.parameters import ParameterServer
from ekf_companion.mavlink.request import Requests
from ekf_companion.mavlink.service import Handler, Service
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import quantise
from ekf_companion.mavlink.statustext import StatusText
from ekf_companion.mavlink.verdict import StreamState, stream_state
from ekf_companion.nav.measurements import Measurement, Restart

__all__ = [
    "RATES",
    "Answered",
    "Event",
    "GuardChanged",
    "Noted",
    "PeerFound",
    "PeerLost",
    "Rebooted",
    "Session",
    "SessionOptions",
    "quantise",
]


MISADDRESSED = "addressed to another"
"""Of a message of a kind that we answer: why it was not."""
JUNK_BYTES = 1 << 16
"""Of what is no frame, recorded beyond as many bytes as of frames: enough to see a wrong baud rate,
and no way to fill a disk, where the oldest recordings make room for it."""


class Session:
    """One autopilot: found, asked, listened to and answered."""

    def __init__(
        self, options: SessionOptions | None = None, signing: Signing | None = None
    ) -> None:
        self.options = options = options or SessionOptions()
        self.admission = Admission(
            options.allow_systems, options.allow_components, signing, options.accept_unsigned
        )
        self.decoder = Decoder(options=options.decoder)
        self.timesync = Timesync(options.timesync)
        self.received: Counter[int] = Counter()
        """Frames of the autopilot by message id."""
        self.heard = 0
        """Frames of the autopilot."""
        self.believed = 0
        """Frames of others, signed where that is asked: who sent one may be answered."""
        self.ignored: Counter[str] = Counter()
        """Frames that are not the autopilot's, by whose they are."""
        self.misaddressed: Counter[int] = Counter()
        """Messages of a kind that we answer, addressed to another, by message id."""
        self.on_frame: Callable[[Frame], None] | None = None
        """Called with each frame that came in, junk included, before anything is made of it."""
        self.sequence = Sequence()
        self.outbox = Outbox(
            Sender(options.system_id or 1, options.component_id, signing),
            is_recording=options.is_recording,
        )
        self._events: list[Event] = []
        emit = self._events.append

        self.discovery = Discovery(
            emit,
            self._begin,
            self._end,
            self._share,
            wanted=options.autopilot_system_id,
            expected=options.expected,
        )
        self.heartbeat = Heartbeat(self.outbox)
        self.clash = ClashWatch(emit, self.heartbeat)
        self.commands = Commands(self.outbox, emit, self.heartbeat)
        self.parameters = ParameterServer(self.outbox, emit, options.parameters)
        self.requests = Requests(self.outbox, emit, options.rates)
        guard = options.guard or GuardOptions(mode="never")
        self.guard = Guard(self.outbox, emit, self.decoder.beware, guard)
        self.audit = Audit(self.received, self.requests, emit)
        self.statustext = StatusText(self.outbox)

        # Held with everybody
        self._with_all: tuple[Service, ...] = (
            *(self.heartbeat, self.discovery, self.clash),
            *(self.commands, self.parameters),
        )
        # Held with the autopilot only, while it is heard
        self._with_peer: tuple[Service, ...] = (
            self.requests,
            *(() if options.guard is None else (self.guard,)),
            TimesyncService(self.outbox, self.timesync),
            self.audit,
            self.statustext,
        )
        self._all_routes = _routes(self._with_all)
        self._peer_routes = _routes(self._with_peer)
        self._splitter = Splitter()
        self._junk_left = JUNK_BYTES
        self._autopilot_sender: Hashable = None
        self._vehicle: PeerFound | None = None
        """The one begun with last; kept when it is lost."""

    # What goes in

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> list[Measurement]:
        """Take bytes that were read at a time of ours; give what they say, in order.

        ``sender`` tells apart who sends datagrams to one socket.
        """
        steps = self.steps(data, now_ns, sender)
        return [measurement for measurements in steps for measurement in measurements]

    def steps(
        self, data: bytes, now_ns: int, sender: Hashable = None
    ) -> Iterator[list[Measurement]]:
        """Do the same frame by frame: what a frame makes happen comes before what it measured.

        What is not admitted is not recorded either: a stranger neither fills the disk nor speaks
        in a replay, which so needs no key.
        """
        for frame in self._splitter.feed(data, sender):
            if self.on_frame is not None:
                self.on_frame(frame)
            if frame.message_id == JUNK:
                self._record_junk(frame.raw, now_ns, sender)
                continue
            is_beside = sender == self._autopilot_sender and self.peer is not None
            if self.admission.refuse(frame, now_ns, is_beside_autopilot=is_beside):
                continue
            if self.options.is_recording:
                self.outbox.record(frame.raw, now_ns)
                self._junk_left = min(self._junk_left + len(frame.raw), JUNK_BYTES)
            heard = self.heard
            measurements = self._take(frame, now_ns)
            if self.heard != heard:
                self._autopilot_sender = sender
            yield measurements

    def _record_junk(self, raw: bytes, now_ns: int, sender: Hashable) -> None:
        """Keep what was no frame, if the autopilot may have said it, and no more than of frames."""
        is_single = sender is None  # there is but one other end
        if (is_single or sender == self._autopilot_sender) and len(raw) <= self._junk_left:
            self._junk_left -= len(raw)
            self.outbox.record(raw, now_ns)

    def _take(self, frame: Frame, now_ns: int) -> list[Measurement]:
        # Leave out what bears our own name: an echo, or somebody who must not
        sender = frame[1:3]
        if sender == self.outbox.ids:
            self.ignored["our own"] += 1
            self.clash.hear(frame, now_ns)
            return []

        if self.admission.is_proven(frame):
            self.believed += 1

        # Hear what anybody may say
        if (handlers := self._all_routes.get(frame.message_id)) is not None:
            self._hand(handlers, frame, now_ns)
        if self.discovery.peer is None:
            self.discovery.recognise(sender, now_ns)

        # Hear what only the autopilot may
        if sender != self.discovery.peer:
            self.ignored["of another system or component"] += 1
            return []
        self.heard += 1
        self.received[frame.message_id] += 1
        self.sequence.count(frame.sequence, now_ns)
        if (handlers := self._peer_routes.get(frame.message_id)) is not None:
            self._hand(handlers, frame, now_ns)
        if self.guard.is_waiting:
            self.guard.hear(now_ns)

        # Take what it measured
        measurements = self.decoder.decode(frame)
        while self.decoder.notes:
            self._events.append(Noted(self.decoder.notes.popleft()))
        first = measurements[0] if measurements else None
        if type(first) is Restart and not first.goes_on:
            self._events.append(Rebooted())
            self._begin(PeerFound(*sender, self.discovery.family))
        return measurements

    def _hand(self, handlers: Iterable[Handler], frame: Frame, now_ns: int) -> None:
        """Give a message to who handles it, if it is for us."""
        message = unpack(frame)
        ours = self.outbox.ids
        is_system = getattr(message, "target_system", 0) in (0, ours[0])
        if not is_system or getattr(message, "target_component", 0) not in (0, ours[1]):
            self.misaddressed[frame.message_id] += 1
            return
        for handler in handlers:
            handler(message, frame, now_ns)

    # What changes

    def _begin(self, peer: PeerFound) -> None:
        """Begin every conversation anew: the autopilot knows nothing of us."""
        if self._vehicle not in (None, peer):
            self.decoder.begin()
        self._vehicle = peer
        self.decoder.family = peer.family
        if self.options.system_id is None:
            self.outbox.adopt(peer.system_id)
        self.sequence.begin()
        for service in (*self._with_all, *self._with_peer):
            service.begin(peer)

    def _share(self, other_id: int | None) -> None:
        self.guard.share(other_id)

    def _end(self) -> None:
        for service in (*self._with_all, *self._with_peer):
            service.end()

    def tick(self, now_ns: int) -> None:
        """Do what is due; to be called ten times a second or more."""
        for service in self._with_all:
            service.tick(now_ns)
        if self.peer is not None:
            for service in self._with_peer:
                service.tick(now_ns)

    # What goes out

    def set_state(self, status: SystemStatus, mode: int = 0) -> None:
        """Say in the heartbeat from now on how we are."""
        self.heartbeat.status, self.heartbeat.mode = status, mode

    def send(self, name: str, payload: bytes, now_ns: int) -> None:
        """Queue a message of ours."""
        self.outbox.send(name, payload, now_ns)

    def note(self, name: str, payload: bytes, now_ns: int) -> None:
        """Record a message of ours that is not sent."""
        self.outbox.note(name, payload, now_ns)

    def data_to_send(self) -> list[bytes]:
        """Give what is to be sent, one frame an item, and forget it."""
        return self.outbox.take()

    def take_record(self) -> list[tuple[int, bytes]]:
        """Give stamp (us) and bytes of all that went in and out, in order, and forget it.

        Each item is a frame or, of what came in, a run of junk. Nothing unless recording.
        """
        return self.outbox.take_record()

    def events(self) -> list[Event]:
        """Give what has happened, and forget it."""
        if not self._events:
            return []
        events = self._events[:]
        self._events.clear()  # the services hold on to the list
        return events

    @property
    def peer(self) -> tuple[int, int] | None:
        """System and component id of the autopilot; None: not heard or lost."""
        return None if self.discovery.is_lost else self.discovery.peer

    @property
    def heard_ns(self) -> int:
        """When the autopilot's last heartbeat came, our clock; 0: none has."""
        return self.discovery.heard_ns

    @property
    def sent(self) -> Mapping[str, int]:
        """Messages of ours by name."""
        return self.outbox.sent

    @property
    def may_stream(self) -> bool:
        """Whether ODOMETRY may be sent, if only when asked for: the guard lets it, nobody is us."""
        return self.guard.is_streaming and not self.clash.is_clash

    @property
    def stream_state(self) -> StreamState:
        """Whether ODOMETRY is sent, why, and what would change it."""
        twin = self.outbox.ids if self.clash.is_clash else None
        return stream_state(self.guard.verdict, twin, self.commands.slowed_by("ODOMETRY"))

    @property
    def results(self) -> Mapping[str, str]:
        """The last answer to the request for each message."""
        return self.requests.results

    def counters(self) -> dict[str, int]:
        """Give how many of what, from bytes to refusals, by name."""
        return {
            "frames": self._splitter.frames,
            "bad_crc": self._splitter.bad_crc,
            "unknown_id": self._splitter.unknown_id,
            "incompatible": self._splitter.incompatible,
            "junk_bytes": self._splitter.junk_bytes,
            "lost": self.sequence.lost,
            "late": self.sequence.late,
            "duplicate": self.sequence.duplicate,
            "signed": self.admission.signed,
            **{f"not admitted: {why}": count for why, count in self.admission.refused.items()},
            **{f"ignored: {whose}": count for whose, count in self.ignored.items()},
            **{f"refused: {why}": count for why, count in self.refused.items()},
        }

    @property
    def refused(self) -> Mapping[str, int]:
        """How often what a message said was not taken, or not as it was, ``message: why``."""
        misaddressed = {
            f"{LAYOUTS[number].name}: {MISADDRESSED}": count
            for number, count in self.misaddressed.items()
        }
        return {**self.decoder.refused, **self.parameters.refused, **misaddressed}


def _routes(services: Iterable[Service]) -> dict[int, tuple[Handler, ...]]:
    """Give whoever handles a message, by its id."""
    routes: dict[int, tuple[Handler, ...]] = {}
    for service in services:
        for name, handler in service.handles.items():
            routes[IDS[name]] = (*routes.get(IDS[name], ()), handler)
    return routes
