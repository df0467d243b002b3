"""What the readers of one autopilot's messages and the compiled reader write both (compiled).

A reader inherits its record, whose fields stand in the ``.pxd``: there is one copy of each.
"""

from __future__ import annotations


class Ranked:
    """Record of a quantity that several messages carry."""


class InertialState(Ranked):
    """Record of the inertial samples."""


class FieldState(Ranked):
    """Record of the magnetic field."""


class PressureState(Ranked):
    """Record of the air pressure."""


class HeadingState(Ranked):
    """Record of the autopilot's heading."""


class ContextState:
    """Record of what all readers share."""


class TrimState:
    """Record of the board's mounting."""


class DecoderState:
    """Record of the frames that wait."""
