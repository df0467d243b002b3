"""Listeners that are not autopilots: each is sent the estimate, even if the guard withholds it.

Their frames have sequence numbers of their own and are not recorded; what the listeners send is not
read. Nothing here changes the estimate or what the autopilot is sent.
"""

from __future__ import annotations

import logging

from ekf_companion.config.config import Config
from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.pipeline import Estimate, Pipeline
from ekf_companion.engine.publisher import NEVER_NS, Due, Publisher
from ekf_companion.link.address import parse_monitor
from ekf_companion.link.link import Link
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.outbox import Message
from ekf_companion.mavlink.signing import Signing
from ekf_companion.nav.state import Status

_log = logging.getLogger(__name__)


class Monitors:
    """The monitors of one configuration."""

    def __init__(self, config: Config, autopilot: Link, signing: Signing | None) -> None:
        """Make ready the ``links`` to the addresses of ``output.monitors``.

        No monitor may be at the address of the autopilot's link.

        Raises:
            LinkError: An address names no listener.
        """
        monitors = config.output.monitors
        self.links = [Link(parse_monitor(url, autopilot.address)) for url in monitors]
        self._autopilot = autopilot
        self._sender = Sender(1, config.link.component_id, signing)
        self._system_id = config.output.monitor_system_id
        self._heartbeat = Due(1.0)
        self._position = Due(config.output.monitor_position_rate)
        self._config: Config | None = None
        self._pipeline: Pipeline | None = None
        self._publisher: Publisher | None = None
        self._has_complained = False

    @property
    def due_ns(self) -> int:
        """Stamp from which something may be due of an estimate."""
        if not self.links:
            return NEVER_NS
        due_ns = self._position.pause[1]
        return 0 if self._publisher is None else min(self._publisher.due_ns, due_ns)

    def unsent(self) -> dict[str, int]:
        """Return how many datagrams found no listener, by its address."""
        return {str(link.address): link.unsent for link in self.links}

    def send_due(self, companion: Companion, now_ns: int, *, is_fresh: bool = True) -> None:
        """Send the heartbeat, and what is due of the newest estimate, if that is fresh."""
        session = companion.session
        self._sender.system_id = self._system_id or session.outbox.ids[0]
        if self._heartbeat.is_due(now_ns):
            state = session.heartbeat
            payload = encode.heartbeat(state.status, state.mode)
            self._send(Message("HEARTBEAT", payload), now_ns)
        if not is_fresh or (estimate := companion.estimate) is None:
            return
        for message in self._publisher_for(companion).due(estimate):
            self._send(message, now_ns)
        if self._position.is_due(estimate.t_ns) and (payload := _position_of(estimate)):
            self._send(Message("GLOBAL_POSITION_INT", payload), now_ns)

    def say_goodbye(self) -> None:
        """Send the last heartbeat with the next message."""
        self._heartbeat.request()

    def _publisher_for(self, companion: Companion) -> Publisher:
        """Return the publisher of the companion's present pipeline, at the present rates."""
        pipeline, config = companion.pipeline, companion.tuning.config
        if self._publisher is None or pipeline is not self._pipeline:
            # The true frame and type
            label = encode.label(Family.UNKNOWN, "LOCAL_NED", "GPS_INS")
            self._publisher = Publisher(config, Family.UNKNOWN, label, is_monitor=True)
        elif config is not self._config:
            self._publisher.set_rates(config)
            self._position.set_rate(config.output.monitor_position_rate)
        self._pipeline, self._config = pipeline, config
        return self._publisher

    def _send(self, message: Message, now_ns: int) -> None:
        frame = self._sender.frame(message.name, message.payload, now_ns)
        for link in self.links:
            if self._is_autopilot(link):
                link.unsent += 1
            else:
                link.send(frame)

    def _is_autopilot(self, link: Link) -> bool:
        """Whether the autopilot sends from that address, and would get what the guard withholds."""
        pinned, address = self._autopilot.peers.pinned, link.address
        if pinned is None or pinned[:2] != (address.host, address.port):
            return False
        if not self._has_complained:
            _log.warning(
                "output.monitors: the autopilot sends from %s, so nothing is sent there; "
                "leave it out",
                address,
            )
        self._has_complained = True
        return True


def _position_of(estimate: Estimate) -> bytes:
    """Return the payload of GLOBAL_POSITION_INT; empty: no position is fit for use."""
    now = as_estimate(estimate.values)
    if not Status.OK <= int(now.status) < Status.INVALID:
        return b""
    lat, lon, alt = now.lla
    north, east, down = now.vel_n
    return encode.global_position(
        estimate.t_ns, (lat, lon, alt), -now.pos_n[2], (north, east, down), now.euler[2]
    )
