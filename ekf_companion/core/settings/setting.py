"""What the field of a setting says of itself, beside its type, default and text.

``Meta`` holds the range, for msgspec; ``Setting`` the rest; the string below the field is its text.
What a reload takes, our MAVLink parameters and ``config/reference.yaml`` follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

Auto = Literal["auto"]
Seconds = Annotated[float, Meta(ge=-1.0, le=1.0)]
DelayStd = Annotated[float, Meta(ge=0.0, le=0.5)]
Angle = Annotated[float, Meta(ge=-3.2, le=3.2)]
Declination = Annotated[float, Meta(ge=-3.2, le=3.2)]
Positive = Annotated[float, Meta(ge=1e-9, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.01, le=1.0)]
Probability = Annotated[float, Meta(gt=0.5, lt=1.0)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Factor = Annotated[float, Meta(ge=-10.0, le=10.0)]
Anchor = tuple[float, float, float, float]
AnchorBias = tuple[float, float]
MatrixRow = tuple[Factor, Factor, Factor]


@dataclass(frozen=True, slots=True)
class Param:
    """The MAVLink parameter that sets a setting."""

    index: int
    """In the list that a ground station reads: it stays as it is."""
    name: str
    """At most 16 characters."""
    lowest: float = 0.0
    highest: float = 1.0
    """Of a number: what a sensor can be, for anybody on the link may set it. The range of the
    setting, which the user's file may use, is wider. Of words and of false and true it is the index
    that is set."""
    is_sigma: bool = False
    """Whether a probability is set as the sigmas of one axis that enclose it."""


@dataclass(frozen=True, slots=True)
class Setting:
    """What the field of a setting carries besides its type and range."""

    unit: str = ""
    reload: bool = False
    """Whether a reload takes a change in flight. What decides on the meaning of the state, on who
    is on the link or on where files are waits for the next start."""
    auto: str = ""
    """Field of ``settings.Habit`` that ``auto`` stands for."""
    param: Param | None = None
