"""Which autopilot the session listens to: found by its heartbeat, and lost without it.

The first autopilot that is heard is taken at once, and the choice is corrected as soon as a better
one sends heartbeats steadily. A known firmware goes before an unknown one, and component 1 before
any other of its system. One stray heartbeat must not bind us for ever: an autopilot that is lost is
waited for while it may be rebooting, if its heartbeats ever came steadily; then another may take
its place until it is back. One that never sent an inertial sample is not waited for while another
one sends them, and not returned to: the vehicle is where the samples come from.
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
"""Two heartbeats so far apart prove a sender that stays: it sends one a second."""


class Presence:
    """Whether a sender is there: from its second heartbeat until some seconds after its last."""

    def __init__(self, gone_ns: int) -> None:
        self.is_there = False
        self._gone_ns = gone_ns
        self._first_ns = 0
        self._last_ns: int | None = None

    def on_heartbeat(self, now_ns: int) -> None:
        """Note one of its heartbeats."""
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
_FAMILY_NS = SECOND_NS * 3 // 2
_REBOOT_NS = 30 * SECOND_NS
"""A vehicle may be back so long after its last heartbeat: a bootloader, a self-test, a start."""
_SOON_NS = 300 * SECOND_NS
"""An autopilot that was given up is returned to if it is back by then; later, it was replaced."""
_OTHER_TIMEOUT_NS = 10 * SECOND_NS
"""Longer than for the peer: a lossy link must not make another come and go."""
_NO_AUTOPILOT = 8
_AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
_NO_VEHICLES = frozenset((6, 18, 26, 27, *range(30, 35), *range(36, 43), 44, 48, 49))
"""MAV_TYPE of what is no vehicle: ground station, onboard controller, gimbal, ADS-B,
camera, charging station, FLARM, servo, remote id, battery, parachute, log, OSD, IMU, GPS, winch,
illuminator, gripper, radio."""
_FAMILIES = {3: Family.ARDUPILOT, 12: Family.PX4}


def is_autopilot(autopilot: int, kind: int) -> bool:
    """Whether a heartbeat's MAV_AUTOPILOT and MAV_TYPE say that its sender flies a vehicle."""
    return autopilot != _NO_AUTOPILOT and kind not in _NO_VEHICLES


class Discovery(Service):
    """Finds one autopilot and stays with it while it is there."""

    def __init__(
        self,
        emit: Emit,
        begin: Callable[[PeerFound], None],
        end: Callable[[], None],
        on_other_autopilot: Callable[[int | None], None],
        *,
        wanted: int | None = None,
        expected: PeerFound | None = None,
    ) -> None:
        """Begin with nobody.

        Args:
            emit: Takes the events.
            begin: Called when an autopilot is found, the first time or again.
            end: Called when it is lost.
            on_other_autopilot: Called with the system of another PX4 or ArduPilot that is heard
                too, and with None when it no longer is.
            wanted: System id of the one to listen to; None: the best that is heard.
            expected: One known from an earlier run, found by its first frame of any kind.
        """
        self.handles = {"HEARTBEAT": self._take}
        self.peer: tuple[int, int] | None = None
        """System and component id; kept when it is lost, as it is waited for."""
        self.family = Family.UNKNOWN
        self.is_lost = False
        self.heard_ns = 0
        """When its last heartbeat arrived, our clock, ns."""
        self._emit = emit
        self._begin = begin
        self._end = end
        self._wanted = wanted
        self._on_other_autopilot = on_other_autopilot
        self._expected = expected
        self._is_bound = False
        """Whether no other than the expected one is listened to."""
        self._is_sure = False
        """Whether the family is known from a heartbeat."""
        self._doubt: Family | None = None
        """The other family that the last heartbeat named."""
        self._named_ns = 0
        """When a heartbeat last named the present family."""
        self._beats: dict[int, Presence] = {}
        """Of each system whose autopilot was heard."""
        self._known: set[int] = set()
        """Those of them that are PX4 or ArduPilot."""
        self.sampled: set[int] = set()
        """Systems that have sent inertial samples; who sees the frames adds them."""
        self._other_id: int | None = None
        self._has_warned = False
        self._awaited_ns = 0
        """Until when the peer that is lost is waited for."""
        self._given_up: tuple[int, int] | None = None
        """The autopilot that is no longer waited for."""
        self._returns_ns = 0
        """Until when it is returned to."""

    def recognise(self, sender: tuple[int, int], now_ns: int) -> None:
        """Find the autopilot if the sender is the one expected."""
        expected = self._expected
        if expected is None or sender != (expected.system_id, expected.component_id):
            return
        if self._wanted not in (None, sender[0]):
            return
        self.peer = sender
        self._find(expected.family, now_ns)

    def expect(self, peer: PeerFound) -> None:
        """Listen to one that sends no heartbeats, from its first frame on, and to nobody else."""
        self._expected, self._is_bound = peer, True

    def excuse(self, span_ns: int) -> None:
        """Do not count a time in which we did not listen as silence."""
        self.heard_ns += span_ns
        self._named_ns += span_ns

    def tick(self, now_ns: int) -> None:
        """Notice that the autopilot has fallen silent, or another."""
        is_late = quantise(now_ns) - self.heard_ns > _PEER_TIMEOUT_NS
        if self.peer is not None and not self.is_lost and is_late:
            self.is_lost = True
            beat = self._beats.get(self.peer[0])
            is_steady = beat is not None and beat.is_there
            self._awaited_ns = self.heard_ns + (_REBOOT_NS if is_steady else 0)
            self._end()
            self._emit(PeerLost(self.heard_ns))
        for beat in self._beats.values():
            beat.tick(now_ns)
        self._report_other()

    def _report_other(self) -> None:
        """Report which other system's autopilot is on the link, where that changes."""
        others = [
            system_id
            for system_id in self._known
            if self._beats[system_id].is_there and (self.peer is None or system_id != self.peer[0])
        ]
        other_id = min(others, default=None)
        if other_id != self._other_id:
            self._other_id = other_id
            self._on_other_autopilot(other_id)

    def _take(self, heartbeat: Any, frame: Frame, now_ns: int) -> None:
        if not is_autopilot(heartbeat.autopilot, heartbeat.type):
            return
        self.tick(now_ns)
        sender = frame[1:3]
        family = _FAMILIES.get(heartbeat.autopilot, Family.UNKNOWN)
        self._beats.setdefault(sender[0], Presence(_OTHER_TIMEOUT_NS)).on_heartbeat(now_ns)
        if family is not Family.UNKNOWN:
            self._known.add(sender[0])
        if sender != self.peer:
            if not self._is_better(sender, family, now_ns):
                self._warn_of_other(sender[0])
                return
            self._change(sender)
        self._report_other()
        self.heard_ns = quantise(now_ns)
        if self._is_new(family, self.heard_ns) or self.is_lost:
            # A known family stays known when a heartbeat names none, as a bootloader's does
            is_named = family is not Family.UNKNOWN or not self._is_sure
            self._find(family if is_named else self.family, now_ns)
        self._is_sure = True

    def _is_better(self, sender: tuple[int, int], family: Family, now_ns: int) -> bool:
        """Whether to listen, from now on, to somebody who is not the peer."""
        if self._is_bound or self._wanted not in (None, sender[0]):
            return False
        if self.peer is None:
            return True
        known, is_known = (one is not Family.UNKNOWN for one in (self.family, family))
        if sender[0] == self.peer[0]:
            if not self.is_lost:
                return sender[1] == _AUTOPILOT
            # A gimbal that calls itself an autopilot does not replace the vehicle's
            ours = (known, self.peer[1] == _AUTOPILOT)
            return (is_known, sender[1] == _AUTOPILOT) >= ours
        if self._beats[sender[0]].is_there:
            if is_known and not known and sender[1] == _AUTOPILOT:
                return True
            if sender == self._given_up and quantise(now_ns) <= self._returns_ns:
                return is_known or not known
        if not self.is_lost:
            return False
        if self._is_sampler(sender[0]):
            return self.peer[0] not in self.sampled or quantise(now_ns) > self._awaited_ns
        is_beside_one = any(map(self._is_sampler, self._beats.keys() - {self.peer[0]}))
        return quantise(now_ns) > self._awaited_ns and not is_beside_one

    def _is_sampler(self, system_id: int) -> bool:
        """Whether a system is there and has sent inertial samples."""
        return system_id in self.sampled and self._beats[system_id].is_there

    def _change(self, sender: tuple[int, int]) -> None:
        """Listen to somebody else, as if nobody had been heard before."""
        if self.peer is not None:
            is_given_up = self.is_lost and self._awaited_ns > self.heard_ns
            is_given_up &= self.peer[0] in self.sampled or sender[0] not in self.sampled
            self._given_up = self.peer if is_given_up else None
            self._returns_ns = self.heard_ns + _SOON_NS
            if not self.is_lost:
                self._end()
            self._emit(PeerChanged(self.peer, sender, self.is_lost))
        self.peer, self.is_lost, self._is_sure = sender, True, False
        self.family = Family.UNKNOWN

    def _is_new(self, family: Family, now_ns: int) -> bool:
        """Whether the peer proves to be of another family.

        One that is known takes two heartbeats, and none of its own for so long that it cannot be
        there any more: else two that are forged would begin the estimate anew.
        """
        if family is self.family or (family is Family.UNKNOWN and self._is_sure):
            if family is self.family:
                self._named_ns = now_ns
            self._doubt = None
            return False
        is_sure = self._is_sure and self.family is not Family.UNKNOWN
        is_proven = self._doubt is family and now_ns - self._named_ns > _FAMILY_NS
        if is_sure and not self.is_lost and not is_proven:
            self._doubt = family
            return False
        self._doubt = None
        return True

    def _warn_of_other(self, other_id: int) -> None:
        """Emit once that there are several autopilots to choose from."""
        self._report_other()
        if self.peer is None or other_id == self.peer[0]:
            return
        if self._wanted is None and not self._has_warned:
            self._has_warned = True
            self._emit(SeveralAutopilots(self.peer[0], other_id))

    def _find(self, family: Family, now_ns: int) -> None:
        self.heard_ns = self._named_ns = quantise(now_ns)
        self.is_lost = False
        self.family = family
        found = PeerFound(*(self.peer or (0, 0)), family)
        self._emit(found)
        self._begin(found)
