"""The types for what an autopilot does with an ODOMETRY message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Stack(str, Enum):
    """The firmware whose rules apply."""

    PX4 = "px4"
    """1.14 and later: EKF2_EV_CTRL decides."""
    PX4_OLD = "px4-old"
    """1.11 to 1.13: EKF2_AID_MASK decides."""
    ARDUPILOT = "ardupilot"
    """4.5 and later."""


class Quantity(str, Enum):
    """A part of the message that a filter can fuse."""

    POSITION = "position"
    """Horizontal."""
    HEIGHT = "height"
    VELOCITY = "velocity"
    """Horizontal."""
    CLIMB = "climb"
    """Vertical velocity."""
    YAW = "yaw"


NOTHING: frozenset[Quantity] = frozenset()


@dataclass(frozen=True, slots=True)
class History:
    """What is kept of the messages before; ``History()`` for the first."""

    time_us: int | None = None
    """Stamp of the last one of sufficient quality (PX4), or that was written (ArduPilot)."""
    quality: int = 0
    """Of the last one of sufficient quality."""
    reset_counter: int = 0
    fused: frozenset[Quantity] = NOTHING
    """What was fused of it."""
    ignored_until_us: int = 0
    """A T265 is ignored for a second after a reset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What the autopilot does with one message."""

    is_accepted: bool
    """Whether the receiver passes it to the filter."""
    fused: frozenset[Quantity]
    """What the filter fuses of it, if it passes the gates."""
    reason: str
    """Why nothing, or not all, of it is fused; empty: all of it is."""
    text: str = ""
    """A critical STATUSTEXT that the pilot sees; empty: none."""
    is_reset: bool = False
    """Whether the filter moves to it at once, since its reset counter changed."""
    std_position: float = math.nan
    """One sigma of the position as ArduPilot takes it, m; NaN: not written."""
    std_yaw: float = math.nan
    """Likewise of the yaw, rad."""
    history: History
    """For the next message."""


def refused(reason: str, history: History, text: str = "") -> Judgement:
    """Return that the receiver drops the message."""
    return Judgement(is_accepted=False, fused=NOTHING, reason=reason, text=text, history=history)


def judged(
    reasons: list[str], fused: frozenset[Quantity], history: History, **more: Any
) -> Judgement:
    """Return what the filter fuses of a message that reaches it, and why not more."""
    return Judgement(
        is_accepted=True, fused=fused, reason="; ".join(reasons), history=history, **more
    )
