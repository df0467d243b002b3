"""Whom the session listens to: the autopilot, found by its heartbeat, and missed without it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, PeerFound, PeerLost, SeveralAutopilots
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_PEER_TIMEOUT_NS = 5 * SECOND_NS
_NO_AUTOPILOT = 8
_GROUND_STATION = 6
_FAMILIES = {3: Family.ARDUPILOT, 12: Family.PX4}


class Discovery(Service):
    """Finds one autopilot and keeps to it."""

    def __init__(
        self,
        emit: Emit,
        begin: Callable[[PeerFound], None],
        end: Callable[[], None],
        *,
        wanted: int | None = None,
        expected: PeerFound | None = None,
    ) -> None:
        """Begin with nobody.

        Args:
            emit: Takes what has happened.
            begin: Called when an autopilot is found, the first time or again.
            end: Called when it is lost.
            wanted: System id of the one to listen to; None: the first that is heard.
            expected: One known from an earlier run, found by whatever it says first.
        """
        self.handles = {"HEARTBEAT": self._take}
        self.peer: tuple[int, int] | None = None
        """System and component id; kept when it is lost: it is waited for."""
        self.family = Family.UNKNOWN
        self.is_lost = False
        self.heard_ns = 0
        """When its last heartbeat arrived, our clock, ns."""
        self._emit = emit
        self._begin = begin
        self._end = end
        self._wanted = wanted
        self._expected = expected
        self._has_told_others = False

    def recognise(self, sender: tuple[int, int], now_ns: int) -> None:
        """Take the sender for the autopilot if it is the one expected."""
        expected = self._expected
        if expected is None or sender != (expected.system_id, expected.component_id):
            return
        if self._wanted not in (None, sender[0]):
            return
        self.peer = sender
        self._find(expected.family, now_ns)

    def tick(self, now_ns: int) -> None:
        """Notice that the autopilot has fallen silent."""
        if self.peer is None or self.is_lost:
            return
        if quantise(now_ns) - self.heard_ns > _PEER_TIMEOUT_NS:
            self.is_lost = True
            self._end()
            self._emit(PeerLost(self.heard_ns))

    def _take(self, heartbeat: Any, frame: Frame, now_ns: int) -> None:
        if heartbeat.autopilot == _NO_AUTOPILOT or heartbeat.type == _GROUND_STATION:
            return
        if self.peer is None and self._wanted in (None, frame.system_id):
            self.peer = (frame.system_id, frame.component_id)
            self.is_lost = True  # until now
        if self.peer != frame[1:3]:
            self._tell_of(frame.system_id)
            return
        self.tick(now_ns)
        self.heard_ns = quantise(now_ns)
        family = _FAMILIES.get(heartbeat.autopilot, Family.UNKNOWN)
        is_other = self._expected is not None and family is not self.family
        self.family = family
        if self.is_lost or is_other:
            self._find(family, now_ns)

    def _tell_of(self, other_id: int) -> None:
        """Say once that there is a choice to make, where nobody has made it."""
        if self.peer is None or self._wanted is not None or other_id == self.peer[0]:
            return
        if self._has_told_others:
            return
        self._has_told_others = True
        self._emit(SeveralAutopilots(self.peer[0], other_id))

    def _find(self, family: Family, now_ns: int) -> None:
        self.heard_ns = quantise(now_ns)
        self.is_lost = False
        self.family = family
        found = PeerFound(*(self.peer or (0, 0)), family)
        self._emit(found)
        self._begin(found)
