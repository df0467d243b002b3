"""Somebody else under our ids: to the autopilot, two of us would look like one that jumps.

One heartbeat that is not ours says nothing: it may be the last run's, still on its way. Somebody
who is there sends another.
"""

from __future__ import annotations

from ekf_companion.mavlink.discovery import Presence
from ekf_companion.mavlink.event import Clash, Emit
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.heartbeat import Heartbeat
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_HEARTBEAT_ID = IDS["HEARTBEAT"]
_AGAIN_NS = 30 * SECOND_NS
"""Between two warnings."""
_GONE_NS = 5 * SECOND_NS
"""Without another of its heartbeats, the other has gone."""


class ClashWatch(Service):
    """Notices foreign heartbeats under our ids, and leaves out the echo of our own."""

    def __init__(self, emit: Emit, heartbeat: Heartbeat) -> None:
        self._emit = emit
        self._heartbeat = heartbeat
        self.is_clash = False
        """Whether somebody else speaks under our ids now."""
        self._other = Presence(_GONE_NS)
        self._warned_ns: int | None = None

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Handle a frame that came in under our ids."""
        if frame.message_id != _HEARTBEAT_ID or not self._heartbeat.is_sending:
            return
        if self._heartbeat.is_echo(frame):
            return
        self._other.on_heartbeat(now_ns)
        self.is_clash = self._other.is_there
        now_ns = quantise(now_ns)
        if self.is_clash and (self._warned_ns is None or now_ns - self._warned_ns >= _AGAIN_NS):
            self._warned_ns = now_ns
            self._emit(Clash(frame.system_id, frame.component_id))

    def tick(self, now_ns: int) -> None:
        """Notice that the other has gone."""
        self._other.tick(now_ns)
        self.is_clash = self._other.is_there
