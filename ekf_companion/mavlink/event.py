"""Events of a session: what has happened on the link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ekf_companion.mavlink.decision import Decision, Hold
from ekf_companion.mavlink.decode import Family


class Event:
    """Something that has happened on the link."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class PeerFound(Event):
    """An autopilot was heard: the first time, or again after it was lost."""

    system_id: int
    component_id: int
    family: Family

    @property
    def target(self) -> dict[str, int]:
        """The fields that address a message to it."""
        return {"target_system": self.system_id, "target_component": self.component_id}


@dataclass(frozen=True, slots=True)
class PeerLost(Event):
    """No heartbeat of the autopilot for five seconds."""

    last_ns: int
    """When its last heartbeat arrived, our clock."""


@dataclass(frozen=True, slots=True)
class Rebooted(Event):
    """The autopilot's clock has restarted."""


@dataclass(frozen=True, slots=True)
class Noted(Event):
    """A peculiarity of the autopilot's messages that a human should know of."""

    text: str


@dataclass(frozen=True, slots=True)
class Advised(Event):
    """Something about the link that the pilot should know of, too."""

    sentence: str
    """For the log, without its full stop."""
    text: str
    """For the pilot."""


@dataclass(frozen=True, slots=True)
class RequestAnswered(Event):
    """A request for a message was answered, or given up."""

    message: str
    result: str
    """``accepted``, the autopilot's reason against it, or ``no answer``."""


@dataclass(frozen=True, slots=True)
class SeveralAutopilots(Event):
    """Another vehicle's autopilot is heard, and the configuration names none to listen to."""

    system_id: int
    """Of the one that is listened to."""
    other_id: int


@dataclass(frozen=True, slots=True)
class PeerChanged(Event):
    """Another autopilot is listened to from now on; a PeerFound follows."""

    was: tuple[int, int]
    """System and component id."""
    now: tuple[int, int]
    is_lost: bool
    """Whether the one before had fallen silent; else the other is the better choice: component 1,
    of a known family, or the one that was replaced while it was silent."""


@dataclass(frozen=True, slots=True)
class FirmwareReported(Event):
    """The autopilot has reported its firmware."""

    version: str
    """As in ``1.16.0``."""


@dataclass(frozen=True, slots=True)
class Clash(Event):
    """Somebody else speaks under our system and component id."""

    system_id: int
    component_id: int
    is_yielding: bool = True
    """Whether we send no ODOMETRY because of that."""


@dataclass(frozen=True, slots=True)
class RateTooLow(Event):
    """A message comes too rarely, however often it is requested."""

    message: str
    asked: float
    """Hz."""
    measured: float
    """Hz."""
    cause: str
    """The probable one, and what to change."""


@dataclass(frozen=True, slots=True)
class ParameterSet(Event):
    """Somebody has set one of our parameters to a value that is in its range."""

    name: str
    key: str
    """Of the configuration, dotted."""
    value: float
    """As the parameter carries it."""
    is_late: bool = False
    """Whether it takes effect only at the next start."""


@dataclass(frozen=True, slots=True)
class IntervalSet(Event):
    """Somebody has set the rate of one of our messages."""

    message: str
    rate: float
    """Hz; 0: not at all."""


@dataclass(frozen=True, slots=True)
class GuardChanged(Event):
    """ODOMETRY is sent from now on, or no longer, or for another reason."""

    decision: Decision


@dataclass(frozen=True, slots=True)
class OriginTold(Event):
    """The autopilot has told another origin of its local frame than before."""

    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """Above mean sea level, m."""


@dataclass(frozen=True, slots=True)
class FollowingChanged(Event):
    """The autopilot's own estimate is no longer what it is sent, or is so again."""

    apart: str
    """What is too far off; empty: nothing any more."""
    may_be_own: bool
    """Whether it may as well have been switched to its own receiver."""


@dataclass(frozen=True, slots=True)
class HoldChanged(Event):
    """ODOMETRY waits from now on, or no longer, or for another reason."""

    hold: Hold | None
    """None: it is sent again."""


Emit = Callable[[Event], None]
"""Takes an event."""
