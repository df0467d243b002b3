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
from dataclasses import dataclass, field, replace
from typing import Any

from ekf_companion.mavlink.admission import SETUP_SIGNING, Admission
from ekf_companion.mavlink.audit import Audit
from ekf_companion.mavlink.autopilot_estimate import KEPT, AutopilotEstimate
from ekf_companion.mavlink.clock import Timesync, TimesyncOptions
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.commands import Commands
from ekf_companion.mavlink.decision import Decision, Hold, stream_state
from ekf_companion.mavlink.decode import Decoder, DecoderOptions, Family, aids
from ekf_companion.mavlink.decode.external import RANGES
from ekf_companion.mavlink.delivery import Delivery
from ekf_companion.mavlink.discovery import Discovery
from ekf_companion.mavlink.encode import POSES, RESET_COUNTER, SystemStatus, knows_odometry
from ekf_companion.mavlink.event import Event, HoldChanged, Noted, PeerFound, Rebooted
from ekf_companion.mavlink.following import Following
from ekf_companion.mavlink.frame import JUNK, UNKNOWN, Frame, Splitter, id_of
from ekf_companion.mavlink.global_position import MESSAGES, GlobalPosition
from ekf_companion.mavlink.guard import Guard, GuardOptions
from ekf_companion.mavlink.heartbeat import ClashWatch, Heartbeat
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.new_frame import NewFrame
from ekf_companion.mavlink.origin import OriginSetter
from ekf_companion.mavlink.outbox import Message, Outbox
from ekf_companion.mavlink.parameter_request import ParameterRequest
from ekf_companion.mavlink.parameters import Parameter, ParameterServer
from ekf_companion.mavlink.past_frames import SAMPLES, PastFrames
from ekf_companion.mavlink.request import Requests
from ekf_companion.mavlink.second_source import SecondSource
from ekf_companion.mavlink.sequence import Sequence
from ekf_companion.mavlink.service import Handler, Service
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import BOARD_LINK, quantise
from ekf_companion.mavlink.statustext import StatusText
from ekf_companion.nav.measurements import Measurement, Restart

MISADDRESSED = "addressed to another"
"""Why a message of a kind that we answer was not answered."""
ECHOES, STRANGERS = "our own", "of another system or component"
"""Whose frames are ignored."""

_TIMESYNC = IDS["TIMESYNC"]

RATES: Mapping[str, float] = {
    "HIGHRES_IMU": 250.0,
    "GPS_RAW_INT": 10.0,
    "ATTITUDE": 10.0,
    "GLOBAL_POSITION_INT": 5.0,
    "SCALED_PRESSURE": 10.0,
    "SYSTEM_TIME": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "GPS_GLOBAL_ORIGIN": 1.0,
    "GPS2_RAW": 5.0,
    "SCALED_IMU2": 10.0,
    "SCALED_IMU3": 10.0,
    **aids.RATES,
}
"""Rates to request of the autopilot, Hz. GNSS at twice its usual rate comes half as late. Of
a second receiver and of other compasses it is as slow as suffices to watch them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Our ids, whom to listen to, and what to request."""

    system_id: int | None = None
    """Ours; None: the autopilot's, and 1 until it is known."""
    component_id: int = 194
    """Ours: MAV_COMP_ID_ONBOARD_COMPUTER4."""
    autopilot_system_id: int | None = None
    """The one autopilot to listen to; None: the best that is heard."""
    allow_systems: tuple[int, ...] = ()
    """System ids that may speak; empty: all."""
    allow_components: tuple[int, ...] = ()
    """Component ids that may speak; empty: all."""
    accept_unsigned: bool = False
    """Whether, with a key, frames without a signature are believed too."""
    rates: Mapping[str, float] = field(default_factory=lambda: RATES)
    """Messages to request, Hz, by name; 0 stops one; empty: nothing is requested."""
    expected: PeerFound | None = None
    """An autopilot that is known from an earlier run: found by its first frame of any kind, so that
    its heartbeat need not be waited for."""
    is_recording: bool = False
    """Whether what goes in and out is kept for ``take_record``."""
    parameters: tuple[Parameter, ...] = ()
    """Our own, as a ground station sees them; empty: none are served."""
    decoder: DecoderOptions = field(default_factory=DecoderOptions)
    timesync: TimesyncOptions = field(default_factory=TimesyncOptions)
    withhold_unfollowed: bool = False
    """Whether no ODOMETRY is sent while the autopilot does not follow it."""
    reads_others: bool = False
    """Whether poses and velocities that other components send are measurements here."""
    guard: GuardOptions | None = None
    """When ODOMETRY is withheld; None: this session sends none, and reads no parameter."""


class Session:
    """The conversation with one autopilot: it is found, asked, listened to and answered."""

    def __init__(
        self, options: SessionOptions | None = None, signing: Signing | None = None
    ) -> None:
        self.options = options = options or SessionOptions()
        self.admission = Admission(
            options.allow_systems, options.allow_components, signing, options.accept_unsigned
        )
        self.decoder = Decoder(options=options.decoder)
        self.changes = 0
        """Moves with all that may change what is made of the next frame, but for plain samples."""
        self.received_bytes = 0
        self.received: Counter[int] = Counter()
        """Frames of the autopilot by message id."""
        self.heard = 0
        """Frames of the autopilot."""
        self.believed = 0
        """Frames of others, signed where that is asked: who sent one may be answered."""
        self.ignored: Counter[str] = Counter()
        """Frames that are not the autopilot's, by whose they are, or why they are left out."""
        self.misaddressed: Counter[int] = Counter()
        """Messages of a kind that we answer, addressed to another, by message id."""
        self.on_frame: Callable[[Frame], None] | None = None
        """Called with each frame that came in, junk included, before anything is made of it."""
        self.sequence, self.past = Sequence(), PastFrames(aids.RATES)
        self.outbox = Outbox(
            Sender(options.system_id or 1, options.component_id, signing),
            is_recording=options.is_recording,
        )
        self.has_events = False
        """Whether something has happened that :meth:`events` has not returned yet."""
        self._events: list[Event] = []
        when = options.guard or GuardOptions(mode="never")
        vehicle = self.decoder.vehicle

        def is_flying() -> bool:
            return vehicle.is_flying

        self.guard = Guard(self.outbox, self._emit, self.decoder.refuse_ours, when, is_flying)
        self.requests = Requests(self.outbox, self._emit, options.rates)
        self.origin = OriginSetter(
            self.outbox, self.guard, self._emit, self.requests.ask_once, is_flying
        )
        self.new_frame = NewFrame(self.guard, is_flying)
        self.global_position = GlobalPosition(self.outbox, self._emit, self.guard)
        self.discovery = Discovery(
            self._emit,
            self._begin,
            self._end,
            self.guard.on_other_autopilot,
            wanted=options.autopilot_system_id,
            expected=options.expected,
        )
        self.heartbeat = Heartbeat(self.outbox)
        self.clash = ClashWatch(self._emit, self.heartbeat, self._goes_on_in_flight)
        self.commands = Commands(self.outbox, self._emit, self.heartbeat)
        self.parameters = ParameterServer(self.outbox, self._emit, options.parameters)
        self.audit = Audit(self.received, self.requests, self._emit)
        self.statustext = StatusText(self.outbox)
        self.timesync = Timesync(self.outbox, options.timesync)
        self.delivery = Delivery(self.outbox, self._emit, self.guard, self.timesync, is_flying)
        self.second_source = SecondSource(
            self._emit, self.guard, is_flying, lambda: self.options.reads_others
        )
        self.delivery.pacing.is_signed = signing is not None
        self.autopilot_estimate = AutopilotEstimate()
        self.following = Following(
            self._emit,
            lambda: self.guard.decision,
            lambda: self.may_stream,
            withholds=options.withhold_unfollowed,
        )

        # Conversations with everybody
        self._with_all: list[Service] = [self.heartbeat, self.discovery, self.clash]
        self._with_all += [self.commands, self.parameters]
        # Conversations with the autopilot only, while it is heard
        guards: list[Service] = [self.guard, self.origin, self.delivery, self.second_source]
        guards += [self.following, self.new_frame, self.global_position]
        guards = [] if options.guard is None else guards
        asked = ParameterRequest(self.outbox, lambda: self.decoder.missing)
        self._with_peer: list[Service] = [self.requests, asked, *guards, self.timesync]
        self._with_peer += [self.audit, self.statustext, self.autopilot_estimate]
        self.all_routes, self.peer_routes = _routes(self._with_all), _routes(self._with_peer)
        self.splitter, self.board_splitter = Splitter(), Splitter()
        """Of what comes by the link, and of what software of this board sends beside it."""
        self.autopilot_sender: Hashable = None
        """Who sent the last frame of the autopilot."""
        self._is_pose_sent = False
        """Whether the last pose was sent; the velocity beside it goes with it."""
        self._held: Hold | None = None
        """What was announced last."""
        self._vehicle: PeerFound | None = None
        """The one begun with last; kept when it is lost."""

    # What goes in

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> list[Measurement]:
        """Process bytes that were read at a time of ours; return what they measured, in order.

        ``sender`` tells apart who sends datagrams to one socket.
        """
        steps = self.steps(data, now_ns, sender)
        return [measurement for measurements in steps for measurement in measurements]

    def steps(
        self, data: bytes, now_ns: int, sender: Hashable = None
    ) -> Iterator[list[Measurement]]:
        """Process bytes, and yield what each frame measured once its events have happened."""
        self.changes += 1
        self.received_bytes += len(data)
        for frame in self.splitter.feed(data, sender):
            if self.on_frame is not None:
                self.on_frame(frame)
            if frame.message_id == JUNK:
                continue  # of no use to a replay, and other readers of a .tlog would trip over it

            # What is not admitted is not recorded either: a stranger neither fills the disk nor
            # speaks in a replay, which so needs no key
            if self.admission.is_selective or frame.message_id == SETUP_SIGNING:
                is_beside = sender == self.autopilot_sender and self.peer is not None
                if self.admission.refuse(frame, now_ns, is_beside_autopilot=is_beside):
                    continue
            if self.options.is_recording:
                self.outbox.record(frame.raw, now_ns)

            if frame.message_id == UNKNOWN:
                if frame[1:3] == self.discovery.peer:
                    self.sequence.count_unverified(frame.sequence, now_ns)
            elif self._is_of_autopilot(frame, now_ns):
                self.autopilot_sender = sender
                yield self._receive_from_autopilot(frame, now_ns)
            else:
                yield self._receive_from_other(frame)

    def steps_of_board(
        self, data: bytes, now_ns: int, sender: Hashable = None
    ) -> Iterator[list[Measurement]]:
        """Process bytes that did not come by the autopilot's link, but from software of this board.

        What is no pose and no velocity, and what bears the autopilot's ids or ours, is counted and
        left out, also of the record.
        """
        self.changes += 1
        for frame in self.board_splitter.feed(data, sender):
            peer = self.peer if self.options.reads_others else None
            if peer is None:
                self.ignored["aid port: not used, or no autopilot yet"] += 1
            elif frame.message_id not in self.decoder.external.readers:
                self.ignored["aid port: no pose or velocity"] += 1
            elif frame[1:3] in (peer, self.outbox.ids):
                self.ignored["aid port: the autopilot's ids, or ours"] += 1
            else:
                self.outbox.record(frame.raw, now_ns, BOARD_LINK)
                yield self.decoder.external.read(frame, peer[0], quantise(now_ns))

    def is_of_board(self, stamp_us: int, raw: bytes) -> bool:
        """Return whether a whole frame of a record is of what came to :meth:`steps_of_board`."""
        return stamp_us & 3 == BOARD_LINK and id_of(raw) in self.decoder.external.readers

    def receive_frame(self, frame: Frame, now_ns: int) -> list[Measurement]:
        """Process a whole frame of a known message that anybody may send, as :meth:`steps` does.

        Nothing may wait in the splitter.
        """
        self.changes += 1
        self.received_bytes += len(frame.raw)
        self.splitter.pass_over(1)
        if self._is_of_autopilot(frame, now_ns):
            return self._receive_from_autopilot(frame, now_ns)
        return self._receive_from_other(frame)

    def pass_over(self, count: int, size: int, heard: int, echoes: int = 0) -> None:
        """Count frames, and their bytes, that were processed elsewhere (:mod:`.reader`).

        Args:
            count: All.
            size: Their bytes.
            heard: Those of the autopilot.
            echoes: Those under our ids.
        """
        self.received_bytes += size
        self.splitter.pass_over(count)
        self.heard += heard
        self.believed += count - echoes
        if strangers := count - heard - echoes:
            self.ignored[STRANGERS] += strangers
        if echoes:
            self.ignored[ECHOES] += echoes

    def note_frame(self, frame: Frame, now_ns: int) -> None:
        """Count, keep and record a frame of the autopilot that was processed elsewhere."""
        self.received_bytes += len(frame.raw)
        self.received[frame.message_id] += 1
        self.heard += 1
        self.believed += 1
        self.splitter.frames += 1
        self.splitter.is_framed = True
        self.past.note(frame)
        if frame.message_id in SAMPLES:
            self.discovery.sampled.add(frame.system_id)
        if frame.message_id in KEPT:
            self.autopilot_estimate.keep(frame, now_ns)
        if self.options.is_recording:
            self.outbox.record(frame.raw, now_ns)

    def _is_of_autopilot(self, frame: Frame, now_ns: int) -> bool:
        """Handle what anybody may say; return whether it was the autopilot who said it."""
        source = frame[1:3]
        if source == self.outbox.ids:  # an echo, or somebody who must not
            self.ignored[ECHOES] += 1
            self.clash.on_frame(frame, now_ns)
            return False
        if not self.admission.is_selective or self.admission.is_proven(frame):
            self.believed += 1
        if (handlers := self.all_routes.get(frame.message_id)) is not None:
            self._hand_to(handlers, frame, now_ns)
        if self.discovery.peer is None:
            self.discovery.recognise(source, now_ns)
        if frame.message_id in SAMPLES:
            self.discovery.sampled.add(source[0])
        if source != self.discovery.peer:
            self.ignored[STRANGERS] += 1
            self.second_source.on_frame(frame, now_ns)
            return False
        return True

    def _receive_from_other(self, frame: Frame) -> list[Measurement]:
        """Return what another component measured, which is neither the autopilot nor we."""
        peer, source = self.discovery.peer, frame[1:3]
        if not (self.options.reads_others or frame.message_id in RANGES):
            return []
        if peer is None or source in (peer, self.outbox.ids):
            return []
        return self.decoder.external.read(frame, peer[0])

    def _receive_from_autopilot(self, frame: Frame, now_ns: int) -> list[Measurement]:
        """Handle what only the autopilot may say; return what it measured."""
        number = frame.message_id
        if self.past.holds(frame, self.decoder.clock, now_ns):
            self.sequence.note_again(frame.sequence, now_ns)
            self.decoder.pass_again(self.past)
            self.emit_notes()
            return []
        self.heard += 1
        self.received[number] += 1
        is_old = self.sequence.count(frame.sequence, now_ns, self.past.is_late)
        if self.past.is_in_place:
            self.decoder.confirm()
        if (handlers := self.peer_routes.get(number)) is not None:
            self._hand_to(handlers, frame, now_ns)
        if self.guard.is_waiting:
            self.guard.on_frame(now_ns)
        if number in KEPT:
            self.autopilot_estimate.keep(frame, now_ns)

        if is_old and not self.past.is_stamped(number):
            return []  # it has no stamp to tell it by, but came among others that came again
        measurements = self.decoder.decode(frame, quantise(now_ns))
        if self.decoder.notes:
            self.emit_notes()
        first = measurements[0] if measurements else None
        if type(first) is Restart:
            self.past.forget()
        if type(first) is Restart and not first.goes_on:
            self._emit(Rebooted())
            self._begin(PeerFound(*frame[1:3], self.discovery.family))
        return measurements

    def _hand_to(self, handlers: Iterable[Handler], frame: Frame, now_ns: int) -> None:
        """Hand a message to its handlers, if it is addressed to us or to everybody."""
        message = unpack(frame)
        if not self._is_addressed_to_us(frame.message_id, message):
            self.misaddressed[frame.message_id] += 1
            return
        for handler in handlers:
            handler(message, frame, now_ns)

    def _is_addressed_to_us(self, number: int, message: Any) -> bool:
        """Return whether a message is to us or to everybody.

        Whose an answer to TIMESYNC is, its ``ts1`` tells: PX4 up to 1.17 leaves the target fields
        of its answers uninitialised (``mavlink_timesync.cpp``; set by PX4#25949).
        """
        if number == _TIMESYNC and message.tc1 != 0:
            return True
        ours = self.outbox.ids
        is_system = getattr(message, "target_system", 0) in (0, ours[0])
        return is_system and getattr(message, "target_component", 0) in (0, ours[1])

    # What changes

    def emit_notes(self) -> None:
        """Emit what the decoder has noted."""
        while self.decoder.notes:
            self._emit(Noted(self.decoder.notes.popleft()))

    def _emit(self, event: Event) -> None:
        self._events.append(event)
        self.has_events = True

    def _begin(self, peer: PeerFound) -> None:
        """Begin every conversation anew: the autopilot knows nothing of us."""
        if self._vehicle not in (None, peer):
            self.decoder.begin()
            self.past.forget()
        self._vehicle = peer
        self.decoder.family = peer.family
        if self.options.system_id is None:
            self.outbox.adopt(peer.system_id)
        self.sequence.begin()
        for service in (*self._with_all, *self._with_peer):
            service.begin(peer)

    def _end(self) -> None:
        for service in (*self._with_all, *self._with_peer):
            service.end()

    def tick(self, now_ns: int) -> None:
        """Do what is due; call it ten times a second or more."""
        self.changes += 1
        for service in self._with_all:
            service.tick(now_ns)
        if self.peer is not None:
            for service in self._with_peer:
                service.tick(now_ns)
        self._announce_hold()

    def _announce_hold(self) -> None:
        """Emit that ODOMETRY waits, or no longer, where the guard would let it through."""
        hold = self.hold if self.guard.decision.is_streaming else None
        shown = hold if hold is not None and hold.text else None
        if shown != self._held:
            self._held = shown
            self._emit(HoldChanged(shown))

    def retune(self, options: SessionOptions) -> None:
        """Go on with other rates, parameters, and options of the guard and of TIMESYNC."""
        self.changes += 1
        self.options = replace(self.options, reads_others=options.reads_others)
        self.timesync.options = options.timesync
        self.requests.retune(options.rates)
        self.following.withholds = options.withhold_unfollowed
        if options.guard is not None:
            self.guard.retune(options.guard)
        self.parameters.retune(options.parameters)

    # What goes out

    def excuse(self, span_ns: int) -> None:
        """Take into account that we did not listen for a while: nobody was silent meanwhile."""
        self.discovery.excuse(span_ns)

    def set_state(self, status: SystemStatus, mode: int = 0) -> None:
        """Carry this state of ours in the heartbeat from now on."""
        self.heartbeat.status, self.heartbeat.mode = status, mode

    def publish(self, message: Message, now_ns: int, t_ns: int | None = None) -> None:
        """Send a message about the estimate at ``t_ns``, or only record what is withheld.

        ``t_ns`` is on the autopilot's clock.
        """
        name, payload, is_replaceable = message
        if name == "GPS_GLOBAL_ORIGIN":
            self.origin.note(payload)
        elif name in POSES:
            if name != POSES[-1]:
                if self.origin.is_settled:
                    self.origin.sent_ns = now_ns
                else:
                    self.origin.on_odometry(now_ns)
                self._is_pose_sent = self.may_stream and self.delivery.pacing.takes(now_ns)
            if not self._is_pose_sent:
                self.outbox.withhold(name, payload, now_ns)
                return
            usual, counter = payload[RESET_COUNTER[name]], self.second_source.counter
            if counter.other is None and usual == counter.usual == counter.sent:
                counter.last_ns = now_ns
            else:
                payload = self._count(name, payload, now_ns)
            if name != POSES[0]:
                self._note_old_ardupilot()
        elif name in MESSAGES and not self.global_position.may_send(now_ns):
            self.outbox.withhold(name, payload, now_ns)
            return
        self.outbox.send(name, payload, now_ns, is_replaceable=is_replaceable, t_ns=t_ns)

    def _count(self, name: str, payload: bytes, now_ns: int) -> bytes:
        """Return a pose or velocity with the reset counter that is sent at present."""
        usual, counter = payload[RESET_COUNTER[name]], self.second_source.counter
        if not self.guard.decision.is_fused:
            counter.usual = counter.sent = usual
            return payload
        if name != POSES[-1]:
            counter.choose(
                usual,
                now_ns,
                self.delivery.lag.last_ns,
                is_followed=not self.following.state.apart,
            )
        if counter.sent == usual:
            return payload
        changed = bytearray(payload)
        changed[RESET_COUNTER[name]] = counter.sent
        return bytes(changed)

    def _note_old_ardupilot(self) -> None:
        """Take what is sent for fused, where the guard does not read by which parameters it is."""
        family = self.discovery.family
        if family is Family.ARDUPILOT and not knows_odometry(family, self.requests.version):
            self.guard.note_taken(is_yaw=True)

    def data_to_send(self) -> list[bytes]:
        """Return the bytes of the frames that wait to be sent, one item each, and forget them."""
        return [frame.data for frame in self.outbox.take()]

    def events(self) -> list[Event]:
        """Return what has happened, and forget it."""
        events, self._events, self.has_events = self._events, [], False
        return events

    @property
    def peer(self) -> tuple[int, int] | None:
        """System and component id of the autopilot; None: not heard or lost."""
        return None if self.discovery.is_lost else self.discovery.peer

    @property
    def may_stream(self) -> bool:
        """Whether ODOMETRY may be sent: the guard, a twin of ours and every service allow it."""
        if not self.guard.decision.is_streaming or self.clash.is_yielding:
            return False
        return all(service.hold is None for service in self._with_peer)

    @property
    def is_pose_fused(self) -> bool | None:
        """Whether the autopilot may fuse the last pose; None: it is not known, or was not sent."""
        decision = self.guard.decision
        if not decision.is_streaming or (decision.is_fused and not self._is_pose_sent):
            return None
        return decision.is_fused

    @property
    def hold(self) -> Hold | None:
        """Why ODOMETRY waits, by the first service that says so; None: by none."""
        for service in self._with_peer:
            if service.hold is not None:
                return service.hold
        return None

    def _goes_on_in_flight(self) -> bool:
        """Whether ODOMETRY is sent, in flight, and no doubt may stop it."""
        guard = self.guard
        is_flying = self.decoder.vehicle.is_flying and not guard.options.withhold_in_flight
        return is_flying and guard.decision.is_streaming

    @property
    def stream_state(self) -> Decision:
        """Whether ODOMETRY is sent, why, and what would change it."""
        twin = self.outbox.ids if self.clash.is_yielding else None
        slowed = self.commands.slowed_by("ODOMETRY")
        return stream_state(self.guard.decision, twin, slowed, self.hold)

    def counters(self) -> dict[str, int]:
        """Return all counts, from bytes to refusals, by name."""
        return {
            "frames": self.splitter.frames,
            "bad_crc": self.splitter.bad_crc,
            "unknown_id": self.splitter.unknown_id,
            "incompatible": self.splitter.incompatible,
            "junk_bytes": self.splitter.junk_bytes,
            "lost": self.sequence.lost,
            "late": self.sequence.late,
            "duplicate": self.sequence.duplicate,
            "again": self.past.again,
            "signed": self.admission.signed,
            **{f"not admitted: {why}": count for why, count in self.admission.refused.items()},
            **{f"ignored: {whose}": count for whose, count in self.ignored.items()},
            **{f"refused: {why}": count for why, count in self.refused.items()},
        }

    @property
    def refused(self) -> Mapping[str, int]:
        """How often a message's content was refused or corrected, by ``message: why``."""
        misaddressed = {
            f"{LAYOUTS[number].name}: {MISADDRESSED}": count
            for number, count in self.misaddressed.items()
        }
        return {**self.decoder.refused, **self.parameters.refused, **misaddressed}


def _routes(services: Iterable[Service]) -> dict[int, tuple[Handler, ...]]:
    """Return the handlers of each message, by its id."""
    routes: dict[int, tuple[Handler, ...]] = {}
    for service in services:
        for name, handler in service.handles.items():
            routes[IDS[name]] = (*routes.get(IDS[name], ()), handler)
    return routes
