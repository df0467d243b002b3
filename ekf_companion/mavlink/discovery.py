"""Whom the session listens to: the autopilot, found by its heartbeat, and missed without it.

Nobody is waited for: the first autopilot that is heard is taken, and a choice is corrected as soon
as a better one beats steadily. A stack that is known goes before one that is not, and component 1
before any other of its system. One stray heartbeat must not blind us for ever: who is lost is
waited for while it may be rebooting, if it has ever beaten steadily; then another may take its
place, until it is back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, PeerChanged, PeerFound, PeerLost, SeveralAutopilots
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_APART_NS = SECOND_NS // 2
"""Two heartbeats so far apart are those of somebody who goes on: it sends one a second."""


class Presence:
    """There from the second heartbeat on, gone some seconds after the last."""

    def __init__(self, gone_ns: int) -> None:
        self.is_there = False
        self._gone_ns = gone_ns
        self._first_ns = 0
        self._last_ns: int | None = None

    def hear(self, now_ns: int) -> None:
        """Take a heartbeat of it."""
        now_ns = quantise(now_ns)
        if self._last_ns is None or now_ns - self._last_ns > self._gone_ns:
            self.is_there, self._first_ns = False, now_ns
        self._last_ns = now_ns
        self.is_there = self.is_there or now_ns - self._first_ns >= _APART_NS

    def tick(self, now_ns: int) -> None:
        """Notice that it has gone."""
        if self._last_ns is not None and quantise(now_ns) - self._last_ns > self._gone_ns:
            self.is_there, self._last_ns = False, None


_PEER_TIMEOUT_NS = 5 * SECOND_NS
_REBOOT_NS = 30 * SECOND_NS
"""So long after its last heartbeat a vehicle may be back: a bootloader, a self-test, a start."""
_SOON_NS = 300 * SECOND_NS
"""One that was given up is returned to if it is back by then; later, another was put in its place.
"""
_OTHER_TIMEOUT_NS = 10 * SECOND_NS
"""Longer than for the peer: a thin link must not make another come and go."""
_NO_AUTOPILOT = 8
_AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
_NO_VEHICLES = frozenset((6, 18, 26, 27, *range(30, 35), *range(36, 43), 44, 48, 49))
"""MAV_TYPE of what is on a vehicle or beside it: ground station, onboard controller, gimbal, ADS-B,
camera, charging station, FLARM, servo, remote id, battery, parachute, log, OSD, IMU, GPS, winch,
illuminator, gripper, radio."""
_FAMILIES = {3: Family.ARDUPILOT, 12: Family.PX4}


def is_autopilot(autopilot: int, kind: int) -> bool:
    """Whether a heartbeat's MAV_AUTOPILOT and MAV_TYPE say that its sender flies a vehicle."""
    return autopilot != _NO_AUTOPILOT and kind not in _NO_VEHICLES


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
            wanted: System id of the one to listen to; None: the best that is heard.
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
        self._beats: dict[int, Presence] = {}
        """Of each system whose autopilot was heard."""
        self._known: set[int] = set()
        """Those of them that are PX4 or ArduPilot."""
        self._other_id: int | None = None
        self._has_told_others = False
        self._awaited_ns = 0
        """Until when the peer that is lost is waited for."""
        self._given_up: tuple[int, int] | None = None
        """Who was not waited for any longer."""
        self._returns_ns = 0
        """Until when it is returned to."""

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
        if self.peer is not None and not self.is_lost:
            self._miss(self.peer, now_ns)
        for beat in self._beats.values():
            beat.tick(now_ns)
        self._tell_share()

    def _miss(self, peer: tuple[int, int], now_ns: int) -> None:
        if quantise(now_ns) - self.heard_ns <= _PEER_TIMEOUT_NS:
            return
        self.is_lost = True
        beat = self._beats.get(peer[0])
        is_steady = beat is not None and beat.is_there
        self._awaited_ns = self.heard_ns + (_REBOOT_NS if is_steady else 0)
        self._end()
        self._emit(PeerLost(self.heard_ns))

    def _tell_share(self) -> None:
        """Say which other system's autopilot is on the link, where that changes."""
        others = [
            system_id
            for system_id in self._known
            if self._beats[system_id].is_there and (self.peer is None or system_id != self.peer[0])
        ]
        other_id = min(others, default=None)
        if other_id != self._other_id:
            self._other_id = other_id
            self._share(other_id)

    def _take(self, heartbeat: Any, frame: Frame, now_ns: int) -> None:
        if not is_autopilot(heartbeat.autopilot, heartbeat.type):
            return
        self.tick(now_ns)
        sender = frame[1:3]
        family = _FAMILIES.get(heartbeat.autopilot, Family.UNKNOWN)
        self._note(sender[0], family, now_ns)
        if sender != self.peer:
            if not self._is_better(sender, family, now_ns):
                self._hear_other(sender[0])
                return
            self._change(sender)
        self._tell_share()
        self.heard_ns = quantise(now_ns)
        if self._is_new(family) or self.is_lost:
            # A stack that is known stays so for a heartbeat that names none: a bootloader's
            is_named = family is not Family.UNKNOWN or not self._is_sure
            self._find(family if is_named else self.family, now_ns)
        self._is_sure = True

    def _note(self, system_id: int, family: Family, now_ns: int) -> None:
        """Take an autopilot's heartbeat for its system's."""
        self._beats.setdefault(system_id, Presence(_OTHER_TIMEOUT_NS)).hear(now_ns)
        if family is not Family.UNKNOWN:
            self._known.add(system_id)

    def _is_better(self, sender: tuple[int, int], family: Family, now_ns: int) -> bool:
        """Whether to listen to somebody who is not the peer from now on."""
        if self._wanted not in (None, sender[0]):
            return False
        if self.peer is None:
            return True
        known, is_known = (one is not Family.UNKNOWN for one in (self.family, family))
        if sender[0] == self.peer[0]:
            if not self.is_lost:
                return sender[1] == _AUTOPILOT
            # A gimbal that calls itself an autopilot does not stand in for the vehicle's
            ours = (known, self.peer[1] == _AUTOPILOT)
            return (is_known, sender[1] == _AUTOPILOT) >= ours
        if self._beats[sender[0]].is_there:
            if is_known and not known and sender[1] == _AUTOPILOT:
                return True
            if sender == self._given_up and quantise(now_ns) <= self._returns_ns:
                return is_known or not known
        return self.is_lost and quantise(now_ns) > self._awaited_ns

    def _change(self, sender: tuple[int, int]) -> None:
        """Turn to somebody else, as if nobody had been heard before."""
        if self.peer is not None:
            is_given_up = self.is_lost and self._awaited_ns > self.heard_ns
            self._given_up = self.peer if is_given_up else None
            self._returns_ns = self.heard_ns + _SOON_NS
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

    def _hear_other(self, other_id: int) -> None:
        """Say once that there is a choice to make, where another system's autopilot is there."""
        self._tell_share()
        if self.peer is None or other_id == self.peer[0]:
            return
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
