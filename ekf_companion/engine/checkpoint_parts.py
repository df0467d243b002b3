"""What a checkpoint is told apart by, and what is left of one that is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple


class Why(str, Enum):
    """Why a checkpoint was refused."""

    DAMAGED = "damaged"
    VERSION = "version"
    FOREIGN = "foreign"
    SETTINGS = "settings"
    ALIGNING = "aligning"
    REBOOTED = "rebooted"
    STALE = "stale"
    CLOCKS = "clocks"
    LOOP = "loop"

    @property
    def short(self) -> str:
        """The reason for a pilot, in 15 characters at most."""
        return _SHORT[self]


_SHORT = {
    Why.DAMAGED: "damaged state",
    Why.VERSION: "another version",
    Why.FOREIGN: "other vehicle",
    Why.SETTINGS: "other settings",
    Why.ALIGNING: "not aligned yet",
    Why.REBOOTED: "rebooted",
    Why.STALE: "state too old",
    Why.CLOCKS: "clocks disagree",
    Why.LOOP: "many restarts",
}


class Vehicle(NamedTuple):
    """The vehicle of a state."""

    family: str
    """``px4``, ``ardupilot`` or ``unknown``."""
    system_id: int
    component_id: int

    def __str__(self) -> str:
        return f"{self.family}, system {self.system_id}, component {self.component_id}"


class Clocks(NamedTuple):
    """The companion's clocks at one moment."""

    unix_ns: int
    boot_ns: int = 0
    """Since boot, time asleep included."""
    boot_id: bytes = bytes(16)
    """Of this boot, 16 bytes; zeros: not known."""

    def later(self, span_ns: int) -> Clocks:
        """Return them a span later."""
        return self._replace(unix_ns=self.unix_ns + span_ns, boot_ns=self.boot_ns + span_ns)

    def since(self, before: Clocks) -> int:
        """Return the time passed since others, ns, by the best clock that both have."""
        if self.boot_id == before.boot_id != bytes(16):
            return self.boot_ns - before.boot_ns
        return self.unix_ns - before.unix_ns


class Origin(NamedTuple):
    """Where the local frame lies, and what the receiver was off by in it."""

    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """Above mean sea level, m."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Slow error of the receiver's position, n, m."""

    def later(self, span: float, slow_time: float) -> Origin:
        """Return it a span later, s: a slow error fades with its time constant, s."""
        faded = math.exp(-max(span, 0.0) / slow_time) if slow_time > 0.0 else 0.0
        north, east, down = (faded * one for one in self.offset)
        return self._replace(offset=(north, east, down))


class SentFrame(NamedTuple):
    """What the autopilot was sent positions by, beside the origin of the estimate; NaN: unknown."""

    lat: float = math.nan
    """Of the place that PX4's numbers count from, rad."""
    lon: float = math.nan
    """rad."""
    datum: float = math.nan
    """What ArduPilot's altitudes are above ours, m."""

    @property
    def has_origin(self) -> bool:
        """Whether the place is known."""
        return math.isfinite(self.lat)


UNSENT = SentFrame()


@dataclass(frozen=True, slots=True)
class Remains:
    """What a cold start goes on from, where the state itself is of no use."""

    vehicle: Vehicle
    clocks: Clocks
    stamp_ns: int
    """Of the state, autopilot clock, ns: one that stands before it has rebooted since."""
    origin: Origin | None
    """None: there was none yet."""
    sent: SentFrame = UNSENT


@dataclass(frozen=True, slots=True)
class Refusal:
    """A checkpoint that is not used."""

    why: Why
    words: str
    """Why, and what to do; to be put behind a colon."""
    resets: int = 0
    """The count of resets to go on from all the same, as the autopilot may have received it: it
    must see that everything has moved."""
    remains: Remains | None = None
    """What is used all the same; None: nothing can be."""


class Sources(NamedTuple):
    """The source of each kind of measurement, by its rank (0: the best)."""

    imu: int = 0
    mag: int = 0
    baro: int = 0
    heading: int = 0
