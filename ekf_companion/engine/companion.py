"""A session and a pipeline joined: bytes in, bytes out, no socket and no clock.

The daemon runs it live and the converter over a recorded .tlog. What is sent is decided by the
stamps of the inertial samples, so both send the same.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from functools import partial

from ekf_companion.config.config import Config
from ekf_companion.engine.announcer import Announcer
from ekf_companion.engine.autopilot_frame import AutopilotFrame
from ekf_companion.engine.checkpoint import UNSENT, Clocks, Vehicle, Why
from ekf_companion.engine.comparison import Comparison
from ekf_companion.engine.intake import Intake, open_live
from ekf_companion.engine.options import session_options
from ekf_companion.engine.pipeline import Estimate, Pipeline
from ekf_companion.engine.publisher import (
    NEVER_NS,
    STREAMS,
    Due,
    Publisher,
    default_rate,
    largest_rate,
    smallest_rate,
)
from ekf_companion.engine.tuning import Tuning
from ekf_companion.engine.warm_start import Outcome, WarmStart
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.commands import Stream
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import (
    Event,
    FirmwareReported,
    GuardChanged,
    IntervalSet,
    OriginTold,
    ParameterSet,
    PeerFound,
    Rebooted,
)
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.outbox import Message, Outgoing
from ekf_companion.mavlink.reader import Reader
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.measurements import Kind, Row
from ekf_companion.nav.state import Status

_LOST = (Why.DAMAGED, Why.VERSION)
"""Refusals after which the frame that the run before has sent in may be unknown. Those of the other
kinds are of no flight that goes on, or have had no frame yet."""
UNFED_NS = 2 * SECOND_NS
"""Without an inertial sample for so long, our heartbeat no longer carries the last status."""


class Companion:
    """One vehicle's estimator on one link.

    It alone knows what follows from an event: an autopilot that is found begins the estimate, a
    parameter that is set retunes it.
    """

    def __init__(
        self,
        config: Config,
        is_recording: bool = False,
        warm_start: WarmStart | None = None,
        signing: Signing | None = None,
        tuning: Tuning | None = None,
        open_pipeline: Callable[[Config, str], tuple[Pipeline, Intake]] | None = None,
    ) -> None:
        """Begin with no autopilot.

        Args:
            config: The configuration.
            is_recording: Whether what goes in and out is kept for ``session.take_record``.
            warm_start: Checkpoints of this run and the last; None: the estimate begins cold.
            signing: What signs and verifies; None: nothing is signed.
            tuning: The configuration as it was tuned over MAVLink; None: as it is.
            open_pipeline: Opens the pipeline for a configuration and a family of autopilot, and
                what feeds it, where a recording is replayed: then nothing is logged, and nobody is
                sent a text.
        """
        self.tuning = tuning or Tuning(config)
        self.reloads = 0
        """How often the configuration was read again."""
        self.last_reload = ""
        """What became of it the last time."""
        is_live = open_pipeline is None
        self._warm_start = warm_start or (WarmStart() if is_live else None)
        expected = None if self._warm_start is None else self._warm_start.expected
        self.session = Session(session_options(self.tuning.config, is_recording, expected), signing)
        self.vehicle: Vehicle | None = None
        """The autopilot that is or was listened to; None: none was found yet."""
        self.pipeline: Pipeline | None = None
        self.estimate: Estimate | None = None
        """The newest; None: none since the autopilot was found or has rebooted."""
        self._intake: Intake | None = None
        """What takes the measurements for the pipeline."""
        self._open_pipeline = open_pipeline or open_live
        self._announcer = Announcer(self.session) if is_live else None
        self.on_event: Callable[[Event], None] | None = None
        """Called with each event of the session, before anything follows from it."""
        self._publisher: Publisher | None = None
        self.reader = Reader(self.session)
        """Of the frames that need no session."""
        self._comparison = Comparison()
        self._told = 0
        """Resets of ODOMETRY that the autopilot was told, at the last comparison."""
        self._family = Family.UNKNOWN
        self._health_due = Due(1.0)
        self._pause = 0, 0
        """From which stamp until which nothing of an estimate is looked at, unless the autopilot
        says something of itself."""
        self._has_sample = False
        self._early: list[Row] = []
        """What came before it was known what to begin with."""
        self._estimated_ns: int | None = None
        self._offer_streams()

    # What goes in

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> list[Message]:
        """Process bytes that were read at a time of ours.

        Args:
            data: The bytes.
            now_ns: When they were read.
            sender: Tells apart who sends datagrams to one socket.

        Returns:
            The messages about the estimates that follow from them. They wait to be sent too, but
            for an ODOMETRY that must not be.
        """
        rows = self.reader.read_datagram(data, now_ns, sender)
        if rows is not None:
            return self._process(rows, now_ns)
        messages: list[Message] = []
        for measurements in self.session.steps(data, now_ns, sender):
            messages += self._process([one.row() for one in measurements], now_ns)
        return messages

    def receive_from_board(
        self, data: bytes, now_ns: int, sender: Hashable = None
    ) -> list[Message]:
        """Process bytes that came beside the link, as :meth:`receive` does those of the link."""
        messages: list[Message] = []
        for measurements in self.session.steps_of_board(data, now_ns, sender):
            messages += self._process([one.row() for one in measurements], now_ns)
        return messages

    def may_wait(self, data: bytes, due_ns: int = NEVER_NS) -> bool:
        """Return whether bytes may as well be received later, with those that come after them.

        They hold one message, which nobody answers, and no estimate that follows from it is due:
        here, or from a stamp on that is due elsewhere.
        """
        publisher = self._publisher
        if publisher is None:
            return False
        due_ns = min(due_ns, publisher.due_ns, self._health_due.pause[1])
        return self.reader.may_wait(data, due_ns)

    def receive_frame(self, frame: Frame, now_ns: int) -> list[Message]:
        """Process a whole frame of a known message, as :meth:`receive` does its bytes."""
        measurements = self.session.receive_frame(frame, now_ns)
        return self._process([one.row() for one in measurements], now_ns)

    def _process(self, rows: Iterable[Row], now_ns: int) -> list[Message]:
        """Process what a frame measured, and what has happened with it."""
        # Begin with a new autopilot, take what somebody has set
        if self.session.has_events:
            self._handle_events(now_ns)
        found: list[Message] = []
        intake, publisher, session = self._intake, self._publisher, self.session
        if intake is None or publisher is None:
            return found
        if not self._has_sample:
            # Go on from a checkpoint, if there is one that fits the inertial samples
            rows = self._start_from(rows, now_ns)
        for row in rows:
            # Order and fuse it; the newest inertial sample gives an estimate
            if (estimate := intake.process_row(row)) is None:
                continue
            self.estimate, self._estimated_ns = estimate, now_ns

            # Look at it once a second, and compare what the autopilot says with it
            t_ns, (begin_ns, end_ns) = estimate.t_ns, self._pause
            is_said = session.autopilot_estimate.changes != self._comparison.seen
            if is_said or not begin_ns <= t_ns < end_ns:
                self._judge(estimate, publisher, now_ns)

            # Send what is due of it
            messages = publisher.due(estimate)
            for message in messages:
                session.publish(message, now_ns, t_ns)
            if messages and session.guard.decision.is_fused != session.origin.is_fixed:
                self._fix_frame(estimate, publisher.frame)
            found += messages
        return found

    def _fix_frame(self, estimate: Estimate, frame: AutopilotFrame) -> None:
        """Count from where what was just sent does, while the autopilot may fuse that."""
        if (is_fused := self.session.is_pose_fused) is not None:
            frame.fix(estimate.origin, is_fused=is_fused)
            self.session.origin.is_fixed = is_fused

    def tick(self, now_ns: int) -> None:
        """Do what is due: heartbeats, requests, time-outs."""
        self.session.tick(now_ns)
        self._handle_events(now_ns)
        if self._announcer is not None:
            self._announcer.tick(now_ns)
        if self._estimated_ns is not None and now_ns - self._estimated_ns > UNFED_NS:
            self._estimated_ns = None
            self.session.set_state(encode.SYSTEM_STATUS[Status.INIT], Status.INIT)

    def _start_from(self, rows: Iterable[Row], now_ns: int) -> list[Row]:
        """Return what can be processed by now; nothing until it is known what to begin with."""
        self._early += rows
        warm_start = self._warm_start
        stamps_ns = [row[0] for row in self._early if row[1] == Kind.IMU]
        if not stamps_ns:
            return self._take_early() if warm_start is None or warm_start.is_empty else []
        if warm_start is not None and self.pipeline is not None:
            if not warm_start.is_judged(stamps_ns[-1], now_ns):
                return []
            self._begin_with(warm_start.resume(self.pipeline, stamps_ns, now_ns), now_ns)
        self._has_sample = True
        return self._take_early()

    def _take_early(self) -> list[Row]:
        rows, self._early = self._early, []
        return rows

    def _begin_with(self, outcome: Outcome, now_ns: int) -> None:
        """Do what follows from how the estimate begins."""
        if self._publisher is not None:
            self._publisher.frame.keep(outcome.sent)
            self.session.origin.is_fixed = outcome.sent.has_origin
            if outcome.lost is not None:
                self._publisher.on_restart(outcome.lost)
        if outcome.why in _LOST and not outcome.is_origin_kept:
            self.session.new_frame.begin_anew()
        if self._announcer is not None:
            self._announcer.estimate.on_start(outcome, now_ns)

    def on_pause(self, seconds: float, now_ns: int) -> None:
        """Take into account that this process did not run: nobody was silent meanwhile."""
        self.session.excuse(round(seconds * SECOND_NS))
        if self._announcer is not None:
            self._announcer.estimate.on_pause(seconds, now_ns)

    def _judge(self, estimate: Estimate, publisher: Publisher, now_ns: int) -> None:
        """Look at the filter's health once a second, and at what the autopilot says of itself."""
        announcer = self._announcer
        if announcer is not None and self._health_due.is_due(estimate.t_ns):
            health = estimate.health
            announcer.estimate.on_health(health, now_ns)
            if (stream := publisher.stream) is not None:
                is_sent = self.session.stream_state.is_streaming
                announcer.estimate.on_stream(stream, is_sent=is_sent, now_ns=now_ns)
            self.session.set_state(encode.SYSTEM_STATUS[health.status], health.status)
        self._compare(estimate, publisher)
        self._pause = begin_ns, end_ns = self._comparison.pause
        if announcer is not None:
            due_ns, until_ns = self._health_due.pause
            self._pause = max(begin_ns, due_ns), min(end_ns, until_ns)

    def _compare(self, estimate: Estimate, publisher: Publisher) -> None:
        """Compare what the autopilot said last of itself with ours, if that is new."""
        session, stream = self.session, publisher.stream
        self._comparison.keep(estimate)
        said, clock = session.autopilot_estimate, session.decoder.clock
        if (found := self._comparison.compare(said, clock, publisher.frame)) is None:
            return
        height, separation = found
        decision, is_running = session.guard.decision, stream is not None and stream.is_running
        if height is not None:
            publisher.frame.take_height(
                height,
                may_follow=decision.is_fused and is_running,
                may_choose=decision.is_alternative,
            )
        if stream is not None and stream.told != self._told:
            self._told = stream.told
            session.following.note_jump()
        session.following.judge(separation, is_running=is_running)

    # What changes

    def _handle_events(self, now_ns: int) -> None:
        for event in self.session.events():
            if self._announcer is not None:
                self._announcer.on_event(event, now_ns)
            if self.on_event is not None:
                self.on_event(event)
            match event:
                case PeerFound():
                    self._begin(event)
                case GuardChanged() if self._publisher is not None and self.session.guard.is_old:
                    self._publisher.use_body_velocity()
                case FirmwareReported(version) if self._publisher is not None:
                    message = self.tuning.config.output.odometry.message
                    if message == "auto" and not encode.knows_odometry(self._family, version):
                        self._publisher.use_vision()
                case OriginTold(lat, lon, alt) if self._publisher is not None:
                    self._publisher.set_origin((lat, lon, alt))
                case Rebooted():
                    self.estimate = None
                    self.session.origin.is_fixed = False
                    self._comparison.forget()
                    self._pause = 0, 0
                    if self._publisher is not None:
                        self._publisher.frame.forget()
                case ParameterSet(key=key, value=value):
                    self._retune(self.tuning.set(key, value))
                case IntervalSet(message, rate) if self._publisher is not None:
                    self._publisher.set_rate(message, rate)

    def _begin(self, peer: PeerFound) -> None:
        """Begin to estimate, or anew where it is another autopilot, or of another family."""
        vehicle = Vehicle(peer.family.value, peer.system_id, peer.component_id)
        if vehicle == self.vehicle:
            return
        config = self.tuning.config
        self.vehicle, self._family, self.estimate = vehicle, peer.family, None
        self.pipeline, self._intake = self._open_pipeline(config, peer.family.value)
        target = peer.system_id, peer.component_id
        self._publisher = Publisher(config, peer.family, target=target)
        self._health_due, self._pause = Due(1.0), (0, 0)
        self._early = []
        self._offer_streams()
        if self._warm_start is not None:
            self._warm_start.on_vehicle(vehicle, self.pipeline, self.session.decoder)
        if self._announcer is not None:
            self._announcer.on_begin(self._publisher.label.warnings)

    def reload(self, read: Config | str) -> str:
        """Take from a new configuration what can be taken in flight; return what became of it.

        ``read`` may also say why there is none: all then stays as it was.
        """
        self.reloads += 1
        if isinstance(read, str):
            self.last_reload = f"{read}; all stays as it was"
        else:
            self.last_reload = str(self.tuning.reload(read))
            self._retune(self.tuning.config)
        return self.last_reload

    def _retune(self, config: Config) -> None:
        """Go on with another configuration."""
        if self._intake is not None:
            self._intake.retune(config)
        self.session.retune(session_options(config))
        if self._publisher is not None:
            self._publisher.retune(config)
        self._offer_streams()

    def _offer_streams(self) -> None:
        """Let the messages about the estimate be requested, and send each at its present rate."""
        commands = self.session.commands
        for name in STREAMS:
            stream = Stream(
                rate=default_rate(name, self.tuning.config, self._family),
                smallest=smallest_rate(name),
                largest=largest_rate(name, self._family),
                request=partial(self._request, name),
            )
            commands.offer(name, stream)
            if self._publisher is not None:
                self._publisher.set_rate(name, commands.rate(name))

    def _request(self, name: str) -> bool:
        """Send a message with the next estimate; return whether there is one to send."""
        if name == "ODOMETRY" and not self.session.may_stream:
            return False
        publisher, estimate = self._publisher, self.estimate
        return publisher is not None and estimate is not None and publisher.request(name, estimate)

    # What goes out

    def frames_to_send(self) -> list[Outgoing]:
        """Return the frames that wait to be sent, and forget them."""
        return self.session.outbox.take()

    def data_to_send(self) -> list[bytes]:
        """Return the bytes of the frames that wait to be sent, and forget them."""
        return self.session.data_to_send()

    def checkpoint(self, clocks: Clocks) -> bytes | None:
        """Return what a restart could go on from; None if nothing has been estimated yet.

        Nor is there anything in a frame that nobody was sent: the next start is to know that the
        one before it was lost.
        """
        is_lost = self.session.new_frame.hold is not None
        if self.pipeline is None or self._warm_start is None or is_lost:
            return None
        sent = UNSENT if self._publisher is None else self._publisher.frame.sent
        return self._warm_start.checkpoint(self.pipeline, self.session.decoder, clocks, sent)

    @property
    def silence(self) -> str:
        """Why no ODOMETRY is sent of the estimate that is there; empty: it is, or there is none."""
        publisher = self._publisher
        return "" if publisher is None or publisher.stream is None else publisher.stream.silence

    @property
    def resets(self) -> int:
        """How often the estimate has jumped on purpose."""
        return 0 if self.pipeline is None else self.pipeline.resets

    def close(self, now_ns: int) -> None:
        """Send the last heartbeat: we go."""
        self.session.set_state(SystemStatus.POWEROFF)
        self.session.outbox.send("HEARTBEAT", encode.heartbeat(SystemStatus.POWEROFF), now_ns)
