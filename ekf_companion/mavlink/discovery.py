"""Whom the session listens to: the autopilot, found by its heartbeat, and missed without it.

One stray heartbeat must not blind it for ever: where the peer is lost another may take its place,
and component 1 goes before any other of its system.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, PeerChanged, PeerFound, PeerLost, SeveralAutopilots
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.presence import Presence
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_PEER_TIMEOUT_NS = 5 * SECOND_NS
_OTHER_TIMEOUT_NS = 10 * SECOND_NS
"""Longer than for the peer: a thin link must not make another come and go."""
_NO_AUTOPILOT = 8
_AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
_GROUND_STATION = 6
_FAMILIES = {3: Family.ARDUPILOT, 12: Family.PX4}


class Discovery(Service):
    """Finds one autopilot and keeps to it while it is there."""

    def __init__(
        self,
        emit: Emit,
        begin: Callable[[PeerFound], None],
        end: Callable[[], None],
        share: Callable[[int | None], None],
        *,
        wanted: int | None = None,
        expected: PeerFound | None = None,
    ) -> None:
        """Begin with nobody.

        Args:
            emit: Takes what has happened.
            begin: Called when an autopilot is found, the first time or again.
            end: Called when it is lost.
            share: Called with the system of another PX4 or ArduPilot that is heard too, and with
                None when it is no more.
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
        self._share = share
        self._expected = expected
        self._is_sure = False
        """Whether a heartbeat has said the family."""
        self._doubt: Family | None = None
        """Another one than is known, as the last heartbeat said."""
        self._others = Presence(_OTHER_TIMEOUT_NS)
        self._other_id = 0
        self._is_shared = False
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
        """Notice that the autopilot has fallen silent, or another."""
        self._others.tick(now_ns)
        if self._is_shared != self._others.is_there:
            self._is_shared = self._others.is_there
            self._share(self._other_id if self._is_shared else None)
        if self.peer is None or self.is_lost:
            return
        if quantise(now_ns) - self.heard_ns > _PEER_TIMEOUT_NS:
            self.is_lost = True
            self._end()
            self._emit(PeerLost(self.heard_ns))

    def _take(self, heartbeat: Any, frame: Frame, now_ns: int) -> None:
        if heartbeat.autopilot == _NO_AUTOPILOT or heartbeat.type == _GROUND_STATION:
            return
        self.tick(now_ns)
        sender = frame[1:3]
        family = _FAMILIES.get(heartbeat.autopilot, Family.UNKNOWN)
        if sender != self.peer:
            if not self._is_better(sender, family):
                self._hear_other(frame.system_id, family, now_ns)
                return
            self._change(sender)
        self.heard_ns = quantise(now_ns)
        if self._is_new(family) or self.is_lost:
            # A stack that is known stays so for a heartbeat that names none: a bootloader's
            is_named = family is not Family.UNKNOWN or not self._is_sure
            self._find(family if is_named else self.family, now_ns)
        self._is_sure = True

    def _is_better(self, sender: tuple[int, int], family: Family) -> bool:
        """Whether to listen to somebody who is not the peer from now on."""
        if self._wanted not in (None, sender[0]):
            return False
        if self.peer is None:
            return True
        is_of_it = sender[0] == self.peer[0]
        if not self.is_lost:
            return is_of_it and sender[1] == _AUTOPILOT
        # A gimbal that calls itself an autopilot does not stand in for the vehicle's
        ranks = [
            (one is not Family.UNKNOWN, ids[1] == _AUTOPILOT)
            for one, ids in ((family, sender), (self.family, self.peer))
        ]
        return not is_of_it or ranks[0] >= ranks[1]

    def _change(self, sender: tuple[int, int]) -> None:
        """Turn to somebody else, as if nobody had been heard before."""
        if self.peer is not None:
            if not self.is_lost:
                self._end()
            self._emit(PeerChanged(self.peer, sender, self.is_lost))
        self.peer, self.is_lost, self._is_sure = sender, True, False
        self.family = Family.UNKNOWN

    def _is_new(self, family: Family) -> bool:
        """Whether the peer is of another family than was thought; of a known one, said twice."""
        if family is self.family or (family is Family.UNKNOWN and self._is_sure):
            self._doubt = None
            return False
        is_sure = self._is_sure and self.family is not Family.UNKNOWN
        if is_sure and not self.is_lost and self._doubt is not family:
            self._doubt = family
            return False
        self._doubt = None
        return True

    def _hear_other(self, other_id: int, family: Family, now_ns: int) -> None:
        """Note that another autopilot is there, and say once that there is a choice to make."""
        if self.peer is None or other_id == self.peer[0]:
            return
        if family is not Family.UNKNOWN:
            self._others.hear(now_ns)
            self._other_id = other_id
            self.tick(now_ns)
        if self._wanted is None and not self._has_told_others:
            self._has_told_others = True
            self._emit(SeveralAutopilots(self.peer[0], other_id))

    def _find(self, family: Family, now_ns: int) -> None:
        self.heard_ns = quantise(now_ns)
        self.is_lost = False
        self.family = family
        found = PeerFound(*(self.peer or (0, 0)), family)
        self._emit(found)
        self._begin(found)
