"""Evidence collected from a companion at work, without a socket and without a clock."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.doctor.counters import MessageCounter, Stamps
from ekf_companion.doctor.evidence import Evidence, Means, Opening, Sent
from ekf_companion.doctor.parameters import ParameterReader
from ekf_companion.doctor.rate_override import RateOverride
from ekf_companion.doctor.reports import AutopilotReports
from ekf_companion.doctor.traffic import Traffic
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decision import Decision
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.frame import Frame, Splitter
from ekf_companion.mavlink.fusion import decide
from ekf_companion.mavlink.guard import DOES_NOT_EXIST
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.signing import Signing
from ekf_companion.status.collect import (
    frame_state,
    output_state,
    peer_state,
    time_state,
)
from ekf_companion.status.snapshot import LinkState, MessageState

_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress")
_IN_PROGRESS = 5
_ODOMETRY, _VISION = (IDS[name] for name in encode.POSES[:2])
_COMMAND_LONG = IDS["COMMAND_LONG"]
_PARAM_REQUEST_READ, _TIMESYNC = IDS["PARAM_REQUEST_READ"], IDS["TIMESYNC"]
_LIMITED = ("HIGHRES_IMU", "RAW_IMU")
_STAMPS = {
    "HIGHRES_IMU": (8, 1),
    "RAW_IMU": (8, 1),
    "SCALED_IMU": (4, 1000),
    "SCALED_IMU2": (4, 1000),
    "SCALED_IMU3": (4, 1000),
}
"""Size of the time stamp with which an inertial message begins, bytes, and its unit, us."""
_PARAMETERS = 64
"""Names of parameters kept from the requests in a recording, at most."""
_FRAMES = 8
"""Pairs of reference frames of ODOMETRY kept, at most."""
_EARLY = 4096
"""Frames kept from before the first heartbeat, which comes once a second and shows whose they are.
A recording of a daemon that continued from a checkpoint has the answers to its requests there."""


class EvidenceCollector:
    """Runs a companion, and counts what the companion does not."""

    def __init__(self, config: Config, means: Means, signing: Signing | None = None) -> None:
        self.companion = Companion(config, signing=signing)
        self.parameters = ParameterReader()
        self._config = config
        self._means = means
        self._frames: list[Frame] = []
        self.companion.session.on_frame = self._frames.append
        self._traffic = Traffic()
        self._reports = AutopilotReports()
        self._counters: defaultdict[str, MessageCounter] = defaultdict(MessageCounter)
        self._stamps: dict[str, Stamps] = {}
        self._override = RateOverride()
        self._odometry = MessageCounter()
        self._odometry_frames: set[tuple[int, int]] = set()
        self._last_peer: tuple[int, int] | None = None
        self._early: deque[tuple[Frame, int]] = deque(maxlen=_EARLY)
        self._requested = ""
        self._asked_parameters: set[str] = set()
        self._bytes = self._last_ns = 0
        self._first_ns: int | None = None

    @property
    def _family(self) -> Family:
        return self.companion.session.decoder.family

    def _granted(self) -> dict[str, float]:
        return {name: one.granted for name, one in self._counters.items() if one.granted}

    # What goes in, and what comes out

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> None:
        """Process bytes read at ``now_ns``, or recorded.

        ``sender`` distinguishes the senders of datagrams to one socket.
        """
        if self._first_ns is None:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._bytes += len(data)
        self.companion.receive(data, now_ns, sender)
        self._last_peer = self.companion.session.peer or self._last_peer
        for frame in self._frames:
            self._traffic.add(frame)
            if frame.message_id >= 0:
                self._early.append((frame, now_ns))
        self._frames.clear()
        if self._last_peer is not None:
            while self._early:
                self._receive(*self._early.popleft())

    def tick(self, now_ns: int) -> None:
        """Run what is periodic, and ask for the parameters that the guard does not read."""
        self.companion.tick(now_ns)
        peer, session = self.companion.session.peer, self.companion.session
        if peer is None or self._means is not Means.LIVE:
            return
        self.parameters.begin(self._family, is_deciding=not session.guard.is_reading)
        payload = self.parameters.request(*peer, now_ns)
        if payload is not None:
            session.outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    def data_to_send(self, now_ns: int) -> list[bytes]:
        """Return the frames to send; none where we only listen."""
        waiting = self.companion.data_to_send()
        if self._means is not Means.LIVE:
            return []
        for frame in Splitter().feed(b"".join(waiting)):
            self._count_ours(frame, now_ns)
        return waiting

    # What passes by

    def _receive(self, frame: Frame, now_ns: int) -> None:
        sender, link = (frame.system_id, frame.component_id), self._config.link
        ours = link.system_id or (self.companion.session.peer or (1, 0))[0], link.component_id
        if self._means is not Means.LIVE and sender == ours:
            self._count_ours(frame, now_ns)
        if sender != self.companion.session.peer:
            return
        name = LAYOUTS[frame.message_id].name
        self._counters[name].add(now_ns)
        self._override.add(name, now_ns, self._granted)
        self._reports.receive(name, frame, now_ns)
        if name in _STAMPS:
            size, unit = _STAMPS[name]
            stamp = int.from_bytes(frame.payload[:size], "little")
            self._stamps.setdefault(name, Stamps(message=name)).add(stamp * unit, now_ns)
        elif name == "PARAM_VALUE":
            m = unpack(frame)
            if (value := value_of(m, frame, self._family)) is not None:
                self.parameters.receive(_name(m), value, self._family)
        elif name == "PARAM_ERROR":
            m = unpack(frame)
            if m.error == DOES_NOT_EXIST:
                self.parameters.receive(_name(m), None, self._family)
        elif name == "COMMAND_ACK" and self._requested:
            m = unpack(frame)
            if m.command == encode.SET_MESSAGE_INTERVAL and m.result != _IN_PROGRESS:
                # To the request that is under way: there is one at a time
                known = m.result < len(_RESULTS)
                answer = _RESULTS[m.result] if known else f"result {m.result}"
                self._counters[self._requested].receive_answer(answer)
                self._requested = ""
                self._override.restart()

    def _count_ours(self, frame: Frame, now_ns: int) -> None:
        """Count a frame of ours: live as it is sent, in a recording as it stands there."""
        if frame.message_id in (_ODOMETRY, _VISION):
            self._odometry.add(now_ns)
        if frame.message_id == _ODOMETRY:
            odometry = unpack(frame)
            if len(self._odometry_frames) < _FRAMES:
                self._odometry_frames.add((odometry.frame_id, odometry.child_frame_id))
        elif frame.message_id == _COMMAND_LONG:
            command = unpack(frame)
            layout = LAYOUTS.get(int(command.param1)) if 0.0 <= command.param1 < 2**24 else None
            if command.command != encode.SET_MESSAGE_INTERVAL or layout is None:
                return
            counter = self._counters[layout.name]
            counter.request(1e6 / command.param2 if command.param2 > 0.0 else 0.0)
            self._override.restart()
            if self._requested != layout.name:
                self._requested = layout.name
                counter.restart()
        elif frame.message_id == _TIMESYNC and self._means is Means.RECORDING:
            if (request := unpack(frame)).tc1 == 0:
                self.companion.session.timesync.note_request(request.ts1)
        elif frame.message_id == _PARAM_REQUEST_READ and len(self._asked_parameters) < _PARAMETERS:
            self._asked_parameters.add(_name(unpack(frame)))

    # What was collected

    def evidence(
        self,
        now_ns: int,
        opening: Opening | None = None,
        link: LinkState | None = None,
        damaged: int = 0,
    ) -> Evidence:
        """Return everything at one moment."""
        companion, session, traffic = self.companion, self.companion.session, self._traffic
        peer = self._last_peer
        span = max(self._last_ns - (self._first_ns or 0), 1) * 1e-9
        return Evidence(
            means=self._means,
            seconds=span if self._first_ns is not None else 0.0,
            config=self._config,
            opening=opening,
            link=link,
            bytes_in=self._bytes,
            sample=traffic.sample,
            frames=frame_state(session),
            damaged=damaged,
            first_version=traffic.first_version,
            mismatched=dict(traffic.mismatched),
            sources=tuple(traffic.sources.values()),
            peer=peer and peer_state(companion, peer, now_ns),
            is_clash=session.clash.is_clash,
            messages=self._messages(now_ns),
            granted=self._granted(),
            overridden=self._override.rate,
            bytes_rate=self._bytes / span,
            stream_requests=traffic.stream_requests,
            refused=session.refused,
            time=time_state(session, now_ns),
            stamps=self._stamps_in_use(),
            receiver=self._reports.receiver,
            estimator=None if companion.pipeline is None else companion.pipeline.health(),
            output=output_state(
                session, self._odometry.count, self._odometry.rate(), now_ns=now_ns
            ),
            parameters=self.parameters.values,
            asked_parameters=frozenset(self._asked_parameters),
            following=self.companion.session.following.state,
            decision=self._decision(),
            sent=Sent(
                count=self._odometry.count,
                rate=self._odometry.rate(),
                frames=frozenset(self._odometry_frames),
            ),
            feedback=self._reports.feedback,
        )

    def _messages(self, now_ns: int) -> dict[str, MessageState]:
        is_live = self._means is not Means.RECORDING
        answers = self.companion.session.requests.results if self._means is Means.LIVE else {}
        # An ArduPilot whose loop is known to be slow is asked for no more than that gives
        wanted = self._config.link.imu_rate if self._means is Means.LIVE else 0.0
        return {
            name: MessageState(
                count=counter.count,
                rate=counter.rate(now_ns if is_live else None),
                asked=max(counter.asked, wanted if name in _LIMITED else 0.0)
                if counter.asked
                else 0.0,
                answer=answers.get(name) or counter.answer,
            )
            for name, counter in self._counters.items()
        }

    def _stamps_in_use(self) -> Stamps:
        source = self.companion.session.decoder.imu_source
        if source not in self._stamps and self._stamps:
            source = max(self._stamps, key=lambda name: self._counters[name].count)
        return self._stamps.get(source, Stamps())

    def _decision(self) -> Decision:
        """Return the guard's decision, or the same one from the parameters that were read."""
        is_live, guard = self._means is Means.LIVE, self.companion.session.guard
        if is_live and guard.is_reading:
            return guard.decision
        is_complete = is_live and self.parameters.is_done
        return decide(self._family, self.parameters.answers, is_complete=is_complete)


def _name(message: Any) -> str:
    return str(message.param_id.decode("ascii", "replace"))
