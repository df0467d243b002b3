"""The vehicles of a telemetry log: which one is estimated, and which others it holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ekf_companion.logs.tlog import Autopilot, Tlog
from ekf_companion.logs.tlog_senders import others, senders, unannounced
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Event, Noted, PeerFound

if TYPE_CHECKING:
    from ekf_companion.engine.checkpoint import Vehicle
    from ekf_companion.engine.companion import Companion
    from ekf_companion.replay.worker import Worker


MOST_NAMED = 8
"""Others that are named; in a log of strangers or of noise there may be thousands."""


class Vehicles:
    """Follows who is listened to in a log, and notes the others."""

    def __init__(self, log: Tlog, wanted: int | None, notes: list[str]) -> None:
        """Look who speaks.

        ``wanted`` is the system id of the configuration; sentences are added to ``notes``.
        """
        self._wanted, self._notes = wanted, notes
        self._senders = senders(log)
        self._silent = unannounced(self._senders, wanted)
        self._found: list[tuple[Vehicle, Worker]] = []

    def attend(self, companion: Companion) -> None:
        """Let a companion find an autopilot without heartbeats; keep what it notes."""
        companion.on_event = self._on_event
        if (one := self._silent) is not None:
            peer = PeerFound(one.system_id, one.component_id, Family(one.family))
            companion.session.discovery.expect(peer)

    def follow(self, companion: Companion, worker: Worker | None) -> bool:
        """Note who is listened to from now on; return whether it is another than before."""
        vehicle = companion.vehicle
        if vehicle is None or (self._found and vehicle is self._found[-1][0]):
            return False
        if self._found and self._found[-1][1].measured:
            self._notes.append(
                f"the autopilot is another from some time on: system {vehicle.system_id}, "
                f"component {vehicle.component_id}, {vehicle.family}; the estimate begins anew "
                "there"
            )
        if worker is not None:
            self._found.append((vehicle, worker))
        return True

    def finish(self, companion: Companion) -> None:
        """Note what is known at the end of the log."""
        for event in companion.session.events():
            self._on_event(event)
        self._notes += self.notes()

    def _on_event(self, event: Event) -> None:
        if isinstance(event, Noted) and event.text not in self._notes:
            self._notes.append(event.text)

    @property
    def compared(self) -> Autopilot | None:
        """The one that measured most: with its own estimate ours is compared."""
        if not self._found:
            return None
        vehicle, _ = max(self._found, key=lambda one: one[1].measured)
        return Autopilot(vehicle.system_id, vehicle.component_id, vehicle.family)

    def notes(self) -> list[str]:
        """Return a sentence on each other vehicle, and on one that sends no heartbeats."""
        notes, used = [], self.compared
        if used is None:
            return []
        if self._silent is not None:
            notes.append(
                "no autopilot of this log sends heartbeats: the inertial samples of system "
                f"{used.system_id}, component {used.component_id} are taken, by its messages "
                f"{_firmware(used.family)}"
            )
        rest = others(self._senders, used)
        notes += [
            f"the log also holds the vehicle of system {one.system_id} ({_firmware(one.family)}): "
            f"that of system {used.system_id} is used; set link.autopilot = {one.system_id} for "
            "the other"
            for one in rest[:MOST_NAMED]
        ]
        if len(rest) > MOST_NAMED:
            notes.append(f"the log also holds {len(rest) - MOST_NAMED} more vehicles")
        return notes

    @property
    def elsewhere(self) -> str:
        """Whose inertial samples are not taken, in words; empty: there are none."""
        used = self.compared
        ids = None if used is None else (used.system_id, used.component_id)
        rest = [one for one in self._senders if (one.system_id, one.component_id) != ids]
        rest = [one for one in rest if one.samples]
        if not rest:
            return ""
        words = ", ".join(
            f"system {one.system_id} component {one.component_id}" for one in rest[:MOST_NAMED]
        )
        if len(rest) > MOST_NAMED:
            words += f" and {len(rest) - MOST_NAMED} more"
        why = "" if self._wanted is None else f", and link.autopilot is {self._wanted}"
        return f"those in it are of {words}{why}"


def _firmware(family: str) -> str:
    return {"px4": "a PX4", "ardupilot": "an ArduPilot"}.get(family, "an unknown autopilot")
