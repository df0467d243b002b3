"""What happens in a session that somebody may want to know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.verdict import Verdict


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
class Noted:
    """What the autopilot's messages are like, where a human should hear of it."""

    text: str


@dataclass(frozen=True, slots=True)
class Answered:
    """What became of a request for a message."""

    message: str
    result: str
    """``accepted``, the autopilot's reason against it, or ``no answer``."""


@dataclass(frozen=True, slots=True)
class SeveralAutopilots:
    """Another vehicle's autopilot is heard, and nobody has said which one to listen to."""

    system_id: int
    """Of the one that is listened to."""
    other_id: int


@dataclass(frozen=True, slots=True)
class PeerChanged:
    """Another autopilot is listened to from now on; that it was found is said too."""

    was: tuple[int, int]
    """System and component id."""
    now: tuple[int, int]
    is_lost: bool
    """Whether the one before had fallen silent; else it goes after the other: no component 1, of no
    known stack, or taken only while the other was silent."""


@dataclass(frozen=True, slots=True)
class Versioned:
    """The autopilot told its firmware."""

    version: str
    """As in ``1.16.0``."""


@dataclass(frozen=True, slots=True)
class Clash:
    """Somebody else speaks under our system and component id."""

    system_id: int
    component_id: int


@dataclass(frozen=True, slots=True)
class RateInVain:
    """A message comes too rarely, however often it is asked for."""

    message: str
    asked: float
    """Hz."""
    measured: float
    """Hz."""
    cause: str
    """The probable one, and what to change."""


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """Somebody has set one of our parameters to a value that is in its range."""

    name: str
    key: str
    """Of the configuration, dotted."""
    value: float
    """As it is told over MAVLink."""
    is_late: bool = False
    """Whether it counts from the next start only."""


@dataclass(frozen=True, slots=True)
class IntervalSet:
    """Somebody wants one of our messages at another rate."""

    message: str
    rate: float
    """Hz; 0: not at all."""


@dataclass(frozen=True, slots=True)
class GuardChanged:
    """ODOMETRY is sent from now on, or no longer, or for another reason."""

    verdict: Verdict


Event = (
    PeerFound
    | PeerLost
    | Rebooted
    | Answered
    | SeveralAutopilots
    | PeerChanged
    | Versioned
    | Clash
    | RateInVain
    | ParameterSet
    | IntervalSet
    | GuardChanged
    | Noted
)

Emit = Callable[[Event], None]
"""Takes what has happened."""
