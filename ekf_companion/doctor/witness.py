"""A companion at work, and everything that passes by it, counted. No socket and no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.doctor.evidence import Evidence, Means, Opening, Sent
from ekf_companion.doctor.overruling import Overruling
from ekf_companion.doctor.parameters import Reader
from ekf_companion.doctor.tally import StampTally, Tally
from ekf_companion.doctor.told import Told
from ekf_companion.doctor.traffic import Traffic
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decision import Decision
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.frame import JUNK, Frame, Splitter
from ekf_companion.mavlink.fusion import decide
from ekf_companion.mavlink.guard import DOES_NOT_EXIST, value_of
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.signing import Signing
from ekf_companion.status.collect import frames, output_state, part, peer_state, time_state
from ekf_companion.status.snapshot import LinkState, MessageState

_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress")
_IN_PROGRESS = 5
_ODOMETRY, _COMMAND_LONG = IDS["ODOMETRY"], IDS["COMMAND_LONG"]
_PARAM_REQUEST_READ = IDS["PARAM_REQUEST_READ"]
_STAMPS = {
    "HIGHRES_IMU": (8, 1),
    "RAW_IMU": (8, 1),
    "SCALED_IMU": (4, 1000),
    "SCALED_IMU2": (4, 1000),
    "SCALED_IMU3": (4, 1000),
}
"""Bytes of the stamp that an inertial message begins with, and its unit, us."""
_PARAMETERS = 64
"""More names of a recording's requests are not kept."""
_FRAMES = 8
"""More pairs of frames in ODOMETRY are not told apart."""
_EARLY = 4096
"""Frames kept from before the first heartbeat, which comes once a second: whose they are shows
then. A recording of a daemon that went on from a checkpoint has its answers there."""


class Witness:
    """Runs a companion, and sees what it does not keep."""

    def __init__(self, config: Config, means: Means, signing: Signing | None = None) -> None:
        self.companion = Companion(config, signing=signing)
        self.reader = Reader()
        self._config = config
        self._means = means
        self._splitter = Splitter()
        self._traffic = Traffic()
        self._told = Told()
        self._tallies: dict[str, Tally] = {}
        self._stamps: dict[str, StampTally] = {}
        self._overruling = Overruling()
        self._odometry = Tally()
        self._odometry_frames: set[tuple[int, int]] = set()
        self._found: tuple[int, int] | None = None
        self._early: deque[tuple[Frame, int]] = deque(maxlen=_EARLY)
        self._asking = ""
        self._asked_parameters: set[str] = set()
        self._bytes = self._last_ns = 0
        self._first_ns: int | None = None

    @property
    def peer(self) -> tuple[int, int] | None:
        """System and component id of the autopilot; None: not heard or lost."""
        return self.companion.session.peer

    @property
    def _family(self) -> Family:
        return self.companion.session.decoder.family

    def _granted(self) -> dict[str, float]:
        return {name: tally.granted for name, tally in self._tallies.items() if tally.granted}

    # What goes in, and what comes out

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> None:
        """Take bytes that were read at a time of ours, or that a recording holds.

        ``sender`` tells apart who sends datagrams to one socket.
        """
        if self._first_ns is None:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._bytes += len(data)
        self.companion.receive(data, now_ns, sender)
        self._found = self.peer or self._found
        for frame in self._splitter.feed(data, sender):
            if frame.message_id == JUNK:
                self._traffic.take_junk(frame.raw)
            else:
                self._traffic.take(frame)
                self._early.append((frame, now_ns))
        if self._found is not None:
            while self._early:
                self._take(*self._early.popleft())

    def tick(self, now_ns: int) -> None:
        """Do what time brings: also ask for parameters that the guard does not read."""
        self.companion.tick(now_ns)
        peer, session = self.peer, self.companion.session
        if peer is None or self._means is not Means.LIVE:
            return
        self.reader.begin(self._family, is_deciding=not session.guard.is_reading)
        payload = self.reader.request(*peer, now_ns)
        if payload is not None:
            session.outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    def data_to_send(self, now_ns: int) -> list[bytes]:
        """Give what is to be sent, one frame an item; nothing where we only listen."""
        waiting = self.companion.data_to_send()
        if self._means is not Means.LIVE:
            return []
        for frame in Splitter().feed(b"".join(waiting)):
            self._take_ours(frame, now_ns)
        return waiting

    # What passes by

    def _take(self, frame: Frame, now_ns: int) -> None:
        sender = frame.system_id, frame.component_id
        system_id = self._config.link.system_id or (self.peer or (1, 0))[0]
        if self._means is not Means.LIVE and sender == (
            system_id,
            self._config.link.component_id,
        ):
            self._take_ours(frame, now_ns)
        if sender != self.peer:
            return
        name = LAYOUTS[frame.message_id].name
        self._tally(name).add(len(frame.raw), now_ns)
        self._overruling.take(name, now_ns, self._granted)
        self._told.take(name, frame, now_ns)
        if name in _STAMPS:
            size, unit = _STAMPS[name]
            stamp = int.from_bytes(frame.payload[:size], "little")
            self._stamps.setdefault(name, StampTally(name)).add(stamp * unit)
        elif name == "PARAM_VALUE":
            m = unpack(frame)
            if (value := value_of(m, frame, self._family)) is not None:
                self.reader.take(_name(m), value, self._family)
        elif name == "PARAM_ERROR":
            m = unpack(frame)
            if m.error == DOES_NOT_EXIST:
                self.reader.take(_name(m), None, self._family)
        elif name == "COMMAND_ACK":
            m = unpack(frame)
            if m.command == encode.SET_MESSAGE_INTERVAL and m.result != _IN_PROGRESS:
                self._take_answer(m.result)

    def _tally(self, name: str) -> Tally:
        return self._tallies.setdefault(name, Tally())

    def _take_answer(self, result: int) -> None:
        """Note the answer to the request that is under way: there is one at a time."""
        if self._asking:
            tally, self._asking = self._tally(self._asking), ""
            tally.take_answer(_RESULTS[result] if result < len(_RESULTS) else f"result {result}")
            self._overruling.restart()

    def _take_ours(self, frame: Frame, now_ns: int) -> None:
        """Count what we say: live as it leaves, in a recording as it stands there."""
        if frame.message_id == _ODOMETRY:
            self._odometry.add(len(frame.raw), now_ns)
            odometry = unpack(frame)
            if len(self._odometry_frames) < _FRAMES:
                self._odometry_frames.add((odometry.frame_id, odometry.child_frame_id))
        elif frame.message_id == _COMMAND_LONG:
            command = unpack(frame)
            layout = LAYOUTS.get(int(command.param1)) if 0.0 <= command.param1 < 2**24 else None
            if command.command != encode.SET_MESSAGE_INTERVAL or layout is None:
                return
            tally = self._tally(layout.name)
            tally.ask(1e6 / command.param2 if command.param2 > 0.0 else 0.0)
            self._overruling.restart()
            if self._asking != layout.name:
                self._asking = layout.name
                tally.restart()
        elif frame.message_id == _PARAM_REQUEST_READ and len(self._asked_parameters) < _PARAMETERS:
            self._asked_parameters.add(_name(unpack(frame)))

    # What has been seen

    def evidence(
        self,
        now_ns: int,
        opening: Opening | None = None,
        link: LinkState | None = None,
        damaged: int = 0,
    ) -> Evidence:
        """Give everything, frozen, at a time of ours."""
        companion, session, traffic = self.companion, self.companion.session, self._traffic
        counters = session.counters()
        span = max(self._last_ns - (self._first_ns or 0), 1) * 1e-9
        return Evidence(
            means=self._means,
            seconds=span if self._first_ns is not None else 0.0,
            config=self._config,
            opening=opening,
            link=link,
            bytes_in=self._bytes,
            sample=traffic.sample,
            frames=frames(counters),
            damaged=damaged,
            first_version=traffic.first_version,
            mismatched=dict(traffic.mismatched),
            sources=traffic.sources(),
            peer=None if self._found is None else peer_state(companion, self._found, now_ns),
            is_clash=session.clash.is_clash,
            messages=self._messages(now_ns),
            granted=self._granted(),
            overruled=self._overruling.rate,
            bytes_rate=self._bytes / span,
            stream_requests=traffic.stream_requests,
            refused=part(counters, "refused: "),
            time=time_state(session.timesync, session.decoder, now_ns),
            stamps=self._stamps_in_use().state(),
            receiver=self._told.receiver,
            estimator=None if companion.pipeline is None else companion.pipeline.health(),
            output=output_state(session, self._odometry.count, self._odometry.rate()),
            parameters=self.reader.values,
            asked_parameters=frozenset(self._asked_parameters),
            taken=self._taken(),
            sent=Sent(
                count=self._odometry.count,
                rate=self._odometry.rate(),
                frames=frozenset(self._odometry_frames),
            ),
            feedback=self._told.feedback(),
        )

    def _messages(self, now_ns: int) -> dict[str, MessageState]:
        is_live, results = (
            self._means is not Means.RECORDING,
            self.companion.session.requests.results,
        )
        return {
            name: MessageState(
                count=tally.count,
                rate=tally.rate(now_ns if is_live else None),
                asked=tally.asked,
                answer=(results.get(name, "") if self._means is Means.LIVE else "") or tally.answer,
            )
            for name, tally in self._tallies.items()
        }

    def _stamps_in_use(self) -> StampTally:
        source = self.companion.session.decoder.imu_source
        if source not in self._stamps and self._stamps:
            source = max(self._stamps, key=lambda name: self._tally(name).count)
        return self._stamps.get(source, StampTally(""))

    def _taken(self) -> Decision:
        """Give the guard's decision; where it asks nothing, the same one by what was told."""
        is_live, guard = self._means is Means.LIVE, self.companion.session.guard
        if is_live and guard.is_reading:
            return guard.decision
        is_complete = is_live and self.reader.is_done
        return decide(self._family, self.reader.answers, is_complete=is_complete)


def _name(message: Any) -> str:
    return str(message.param_id.decode("ascii", "replace"))
