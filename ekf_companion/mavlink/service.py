"""The services of which a session consists, each one conversation of the protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame

Handler = Callable[[Any, Frame, int], None]
"""Takes a message's fields, its frame and the time of its arrival, ns."""


class Service:
    """One conversation of the protocol.

    It sends through the session's ``Outbox`` and emits events through its ``Emit``. A message with
    a target comes to it only if that is us or everybody.
    """

    handles: Mapping[str, Handler] = MappingProxyType({})
    """Handlers by the message's name."""
    hold: Hold | None = None
    """Why no ODOMETRY may be sent now, by what this conversation has shown; None: it may."""

    def begin(self, peer: PeerFound) -> None:
        """Begin anew: the autopilot was found or rebooted, and knows nothing of us."""

    def end(self) -> None:
        """The autopilot is lost."""

    def tick(self, now_ns: int) -> None:
        """Do what is due; called ten times a second or more."""
