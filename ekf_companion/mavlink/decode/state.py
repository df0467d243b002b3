"""What the readers of one autopilot's messages and the compiled reader write both (compiled).

A reader inherits its record: there is one copy of each field.
"""

from __future__ import annotations

from typing import Any

from ekf_companion.mavlink.decode.preference import Pace, Preference
from ekf_companion.mavlink.dejitter import Dejitter
from ekf_companion.mavlink.timebase import TimeBase
from ekf_companion.nav.lanes import Lanes
from ekf_companion.nav.repetition import Repetition


class Ranked:
    """Record of a quantity that several messages carry."""

    sources: Preference


class InertialState(Ranked):
    """Record of the inertial samples."""

    instances: Preference
    repetition: Repetition
    dejitter: Dejitter | None
    last_us: int
    is_watching: bool
    look_us: int
    lanes: Lanes


class FieldState(Ranked):
    """Record of the magnetic field."""

    last: tuple[float, ...]
    strange: int


class PressureState(Ranked):
    """Record of the air pressure."""

    last: float


class HeadingState(Ranked):
    """Record of the autopilot's heading."""

    pace: Pace


class ContextState:
    """Record of what all readers share."""

    clock: TimeBase
    is_submarine: bool
    is_ours: bool
    is_yaw_ours: bool


class TrimState:
    """Record of the board's mounting."""

    first_ns: int | None
    rows: list[list[float]] | None


class DecoderState:
    """Record of the frames that wait."""

    held: list[Any]
