"""What happens in a session that somebody may want to know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.fusion import Verdict


@dataclass(frozen=True, slots=True)
class PeerFound:
    """An autopilot was heard: the first time, or again after it was lost."""

    system_id: int
    component_id: int
    family: Family


@dataclass(frozen=True, slots=True)
class PeerLost:
    """No heartbeat of the autopilot for five seconds."""

    last_ns: int
    """When its last heartbeat arrived, our clock."""


@dataclass(frozen=True, slots=True)
class Rebooted:
    """The autopilot's clock began anew."""


@dataclass(frozen=True, slots=True)
class Answered:
    """What became of a request for a message."""

    message: str
    result: str
    """``accepted``, the autopilot's reason against it, or ``no answer``."""


@dataclass(frozen=True, slots=True)
class GuardChanged:
    """ODOMETRY is sent from now on, or no longer, or for another reason."""

    verdict: Verdict


Event = PeerFound | PeerLost | Rebooted | Answered | GuardChanged

Emit = Callable[[Event], None]
"""Takes what has happened."""
