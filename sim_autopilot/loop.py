"""An autopilot and a companion on one bench: no socket, no clock, and faster than real time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import JUNK, Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from sim_autopilot.autopilot import SET_MESSAGE_INTERVAL, Kind, Received
from sim_autopilot.faults.fault import Fault
from sim_autopilot.flight import Flight
from sim_autopilot.personality import Personality
from sim_autopilot.rig import Rig
from sim_autopilot.score import Witness

_TICK_NS = 50_000_000
_AFTER_NS = 1_000_000_000
"""What is still under way at the end is waited for so long."""
_SECOND_NS = 1_000_000_000


class Peer(Protocol):
    """Whoever is at the other end; its clock is the bench's ``peer_ns``."""

    def receive(self, data: bytes, now_ns: int) -> object:
        """Take bytes that arrived at a time of its own."""

    def tick(self, now_ns: int) -> object:
        """Do what is due."""

    def data_to_send(self) -> list[bytes]:
        """Give what it sends, once."""


class Asker:
    """A companion that only asks for messages, every second until they are granted."""

    def __init__(
        self, rates: dict[str, float], system_id: int = 1, component_id: int = 191
    ) -> None:
        """Ask for ``rates``, Hz; RAW_IMU instead where HIGHRES_IMU is refused."""
        self._rates = dict(rates)
        self._sender = Sender(system_id, component_id)
        self._splitter = Splitter()
        self._next_ns: int | None = None
        self._asked: str | None = None
        self._out: list[bytes] = []

    def receive(self, data: bytes, now_ns: int) -> None:
        """Look for answers, and ask for the next."""
        for frame in self._splitter.feed(data):
            if frame.message_id != IDS["COMMAND_ACK"] or self._asked is None:
                continue
            rate = self._rates.pop(self._asked, 0.0)
            if self._asked == "HIGHRES_IMU" and unpack(frame).result != 0:
                self._rates["RAW_IMU"] = rate
            self._ask(now_ns)

    def tick(self, now_ns: int) -> None:
        """Ask again where no answer came."""
        if self._next_ns is None or now_ns >= self._next_ns:
            self._ask(now_ns)

    def data_to_send(self) -> list[bytes]:
        """Give the requests."""
        out, self._out = self._out, []
        return out

    def _ask(self, now_ns: int) -> None:
        self._asked = next(iter(self._rates), None)
        self._next_ns = now_ns + _SECOND_NS
        if self._asked is not None:
            self._out.append(
                self._sender.message(
                    "COMMAND_LONG",
                    command=SET_MESSAGE_INTERVAL,
                    target_system=1,
                    target_component=1,
                    param1=IDS[self._asked],
                    param2=1e6 / self._rates[self._asked],
                )
            )


class Bench:
    """Couples a flight with a peer; the same seed gives the same bytes, both ways."""

    def __init__(
        self,
        flight: Flight,
        peer: Peer | None = None,
        *,
        kind: Kind = Kind.PX4,
        personality: Personality | None = None,
        faults: Sequence[Fault] = (),
        latency: float = 0.0,
        peer_offset_ns: int = 0,
        peer_ppm: float = 0.0,
    ) -> None:
        """Lay them out.

        Args:
            flight: What is flown.
            peer: The companion; None: nobody answers. It may be exchanged while the bench runs.
            kind: Which autopilot, without traps.
            personality: With its traps; goes before ``kind``.
            faults: What goes wrong.
            latency: Of the link, each way, s.
            peer_offset_ns: What the peer's clock shows when the world's shows 0.
            peer_ppm: How much faster it runs, millionths.
        """
        self.flight = flight
        self.peer = peer
        self.rig = Rig(flight, kind=kind, personality=personality, faults=faults, latency=latency)
        self.witness = Witness(flight, self.rig.clock.true_ns)
        """Hears what the peer says where it says it, before the link."""
        self._offset_ns, self._rate = peer_offset_ns, 1.0 + peer_ppm * 1e-6
        self._splitter = Splitter()
        self._next_tick_ns = flight.first_ns
        self._now_ns = flight.first_ns

    def peer_ns(self, t_ns: int) -> int:
        """Give what the peer's clock shows at a time of the world's."""
        return self._offset_ns + round(t_ns * self._rate)

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Run; give each frame that reaches the peer, after its answer, and when it came."""
        now_ns = self.flight.first_ns
        for cycle in self.flight.cycles():
            now_ns = cycle.flight_ns
            self.witness.sent(now_ns)
            self.rig.cycle(cycle)
            yield from self._exchange(now_ns)
        yield from self._exchange(now_ns + _AFTER_NS)

    def run(self) -> Witness:
        """Run to the end; give who heard what came of it."""
        for _ in self.frames():
            pass
        return self.witness

    def _exchange(self, until_ns: int) -> Iterator[tuple[int, bytes]]:
        while (item := self.rig.pop(until_ns)) is not None:
            at_ns, frame = item
            self._now_ns = max(self._now_ns, at_ns)
            if self.peer is not None:
                self.peer.receive(frame, self.peer_ns(self._now_ns))
                self._answer()
            yield item
        if self.peer is not None and until_ns >= self._next_tick_ns:
            self._next_tick_ns = until_ns + _TICK_NS
            self._now_ns = max(self._now_ns, until_ns)
            self.peer.tick(self.peer_ns(self._now_ns))
            self._answer()

    def _answer(self) -> None:
        """Carry what the peer says to the autopilot, and to the witness."""
        if self.peer is None:
            return
        for data in self.peer.data_to_send():
            for frame in self._splitter.feed(data):
                if frame.message_id != JUNK:
                    name = LAYOUTS[frame.message_id].name
                    self.witness.hear(
                        Received(self._now_ns, frame.component_id, name, unpack(frame), frame.raw)
                    )
            self.rig.receive(data, self._now_ns)
        self.rig.heard()
