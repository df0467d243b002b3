"""Somebody else under our ids: two of us would take turns to jump in the autopilot's eyes."""

from __future__ import annotations

from ekf_companion.mavlink.event import Clash, Emit
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.heartbeat import Heartbeat
from ekf_companion.mavlink.layout import IDS
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_HEARTBEAT_ID = IDS["HEARTBEAT"]
_AGAIN_NS = 30 * SECOND_NS
"""Between two warnings."""
_GONE_NS = 5 * SECOND_NS
"""Without another of its heartbeats, the other has gone."""


class ClashWatch(Service):
    """Tells foreign heartbeats under our ids from the echo of our own."""

    def __init__(self, emit: Emit, heartbeat: Heartbeat) -> None:
        self.is_clash = False
        """Whether somebody else speaks as us now."""
        self._emit = emit
        self._heartbeat = heartbeat
        self._heard_ns = 0
        self._told_ns: int | None = None

    def hear(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that came in under our ids."""
        if frame.message_id != _HEARTBEAT_ID or not self._heartbeat.has_beaten:
            return
        if self._heartbeat.is_echo(frame):
            return
        self.is_clash, self._heard_ns = True, quantise(now_ns)
        if self._told_ns is None or self._heard_ns - self._told_ns >= _AGAIN_NS:
            self._told_ns = self._heard_ns
            self._emit(Clash(frame.system_id, frame.component_id))

    def tick(self, now_ns: int) -> None:
        """Notice that the other has gone."""
        if self.is_clash and quantise(now_ns) - self._heard_ns > _GONE_NS:
            self.is_clash = False
