"""An autopilot and a companion in one process: no socket, no clock, faster than real time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from sim_autopilot.autopilot import SET_MESSAGE_INTERVAL, Received
from sim_autopilot.faults.fault import Fault
from sim_autopilot.flight import Flight
from sim_autopilot.personality import Kind, Personality
from sim_autopilot.rig import Rig
from sim_autopilot.score import Witness

_TICK_NS = 50_000_000
_AFTER_NS = 1_000_000_000
"""Messages are still delivered for so long after the last sample."""
_SECOND_NS = 1_000_000_000


class Peer(Protocol):
    """The other end of the link; its clock is the bench's ``peer_ns``."""

    def receive(self, data: bytes, now_ns: int) -> object:
        """Take bytes that arrived at a time of its own clock."""

    def tick(self, now_ns: int) -> object:
        """Do the periodic work."""

    def data_to_send(self) -> list[bytes]:
        """Return the bytes to send, once."""


class StreamRequester:
    """A companion that only requests messages, every second until they are granted."""

    def __init__(self, rates: dict[str, float]) -> None:
        """Request ``rates``, Hz; RAW_IMU instead where HIGHRES_IMU is refused."""
        self._rates = dict(rates)
        self._sender = Sender(1, 191)
        self._splitter = Splitter()
        self._next_ns: int | None = None
        self._requested: str | None = None
        self._out: list[bytes] = []

    def receive(self, data: bytes, now_ns: int) -> None:
        """Read the answers, and request the next message."""
        for frame in self._splitter.feed(data):
            if frame.message_id != IDS["COMMAND_ACK"] or self._requested is None:
                continue
            rate = self._rates.pop(self._requested, 0.0)
            if self._requested == "HIGHRES_IMU" and unpack(frame).result != 0:
                self._rates["RAW_IMU"] = rate
            self._request(now_ns)

    def tick(self, now_ns: int) -> None:
        """Request again if no answer came."""
        if self._next_ns is None or now_ns >= self._next_ns:
            self._request(now_ns)

    def data_to_send(self) -> list[bytes]:
        """Return the requests."""
        out, self._out = self._out, []
        return out

    def _request(self, now_ns: int) -> None:
        self._requested = next(iter(self._rates), None)
        self._next_ns = now_ns + _SECOND_NS
        if self._requested is not None:
            self._out.append(
                self._sender.message(
                    "COMMAND_LONG",
                    command=SET_MESSAGE_INTERVAL,
                    target_system=1,
                    target_component=1,
                    param1=IDS[self._requested],
                    param2=1e6 / self._rates[self._requested],
                )
            )


class Bench:
    """Connects a flight with a peer; the same seed gives the same bytes, both ways."""

    def __init__(
        self,
        flight: Flight,
        peer: Peer | None = None,
        *,
        personality: Personality | Kind = Kind.PX4,
        faults: Sequence[Fault] = (),
        latency: float = 0.0,
        peer_offset_ns: int = 0,
        peer_ppm: float = 0.0,
    ) -> None:
        """Connect them by a link of a latency, each way, s; a peer None never answers.

        The peer may be exchanged while the bench runs. Its clock shows ``peer_offset_ns`` when the
        world's shows 0, and runs ``peer_ppm`` millionths faster. The personality is the autopilot
        to imitate; of a kind the ideal one.
        """
        self.flight = flight
        self.peer = peer
        self.rig = Rig(flight, personality=personality, faults=faults, latency=latency)
        self.witness = Witness(flight, self.rig.clock.true_ns)
        """Receives the peer's messages where they are sent, before the link."""
        self._offset_ns, self._rate = peer_offset_ns, 1.0 + peer_ppm * 1e-6
        self._splitter = Splitter()
        self._next_tick_ns = flight.first_ns
        self._now_ns = flight.first_ns

    def peer_ns(self, t_ns: int) -> int:
        """Return the peer's clock at a time of the world's clock."""
        return self._offset_ns + round(t_ns * self._rate)

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Run; yield each frame that reaches the peer, after its answer, and its arrival."""
        now_ns = self.flight.first_ns
        for cycle in self.flight.cycles():
            now_ns = cycle.flight_ns
            self.witness.sent(now_ns)
            self.rig.cycle(cycle)
            yield from self._exchange(now_ns)
        yield from self._exchange(now_ns + _AFTER_NS)

    def run(self) -> Witness:
        """Run to the end; return the witness."""
        for _ in self.frames():
            pass
        return self.witness

    def _exchange(self, until_ns: int) -> Iterator[tuple[int, bytes]]:
        while (item := self.rig.pop(until_ns)) is not None:
            at_ns, frame = item
            self._now_ns = max(self._now_ns, at_ns)
            if self.peer is not None:
                self.peer.receive(frame, self.peer_ns(self._now_ns))
                self._deliver(self.peer.data_to_send())
            yield item
        if self.peer is not None and until_ns >= self._next_tick_ns:
            self._next_tick_ns = until_ns + _TICK_NS
            self._now_ns = max(self._now_ns, until_ns)
            self.peer.tick(self.peer_ns(self._now_ns))
            self._deliver(self.peer.data_to_send())

    def _deliver(self, answers: list[bytes]) -> None:
        """Deliver the peer's bytes to the autopilot and the witness."""
        for data in answers:
            for frame in self._splitter.feed(data):
                if frame.message_id >= 0:
                    name = LAYOUTS[frame.message_id].name
                    self.witness.receive(
                        Received(self._now_ns, frame.component_id, name, unpack(frame), frame.raw)
                    )
            self.rig.receive(data, self._now_ns)
        self.rig.received()
