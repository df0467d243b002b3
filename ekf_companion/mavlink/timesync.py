"""TIMESYNC on the wire: our questions, and answers to the autopilot's."""

from __future__ import annotations

from typing import Any

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.clock import Timesync
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service


class TimesyncService(Service):
    """Compares our clock with the autopilot's."""

    def __init__(self, outbox: Outbox, timesync: Timesync) -> None:
        self.handles = {"TIMESYNC": self._take}
        self._outbox = outbox
        self._timesync = timesync
        self._target = (0, 0)

    def begin(self, peer: PeerFound) -> None:
        """Forget what was learned of the autopilot's clock."""
        self._target = (peer.system_id, peer.component_id)
        self._timesync.reset()

    def tick(self, now_ns: int) -> None:
        """Ask if it is time."""
        ts1 = self._timesync.request(now_ns)
        if ts1 is not None:
            self._send(0, ts1, now_ns)

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.tc1 != 0:
            self._timesync.receive(message.tc1, message.ts1, now_ns)
            return
        tc1 = self._timesync.answer(message.ts1, now_ns)
        if tc1 is not None:
            self._send(tc1, message.ts1, now_ns)

    def _send(self, tc1: int, ts1: int, now_ns: int) -> None:
        system_id, component_id = self._target
        payload = encode.timesync(tc1, ts1, target_system=system_id, target_component=component_id)
        self._outbox.send("TIMESYNC", payload, now_ns)
