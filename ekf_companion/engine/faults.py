"""Faults that were beyond doubt, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ekf_companion.core.memory.enums import Fault

_DEG = math.degrees(1.0)

WORDS: Mapping[Fault, tuple[str, float]] = {
    Fault.POSITION_STEP: ("GNSS position {:.1f} m off", 1.0),
    Fault.POSITION_RAMP: ("GNSS position slides at {:.2f} m/s", 1.0),
    Fault.DRAG: ("GNSS position and velocity led away at {:.2f} m/s", 1.0),
    Fault.DRAG_RAMP: ("GNSS position and velocity led away at {:.2f} m/s^2", 1.0),
    Fault.VELOCITY_STEP: ("GNSS velocity {:.2f} m/s off", 1.0),
    Fault.VELOCITY_SCALE: ("GNSS velocity {:.1f} % off in length", 100.0),
    Fault.VELOCITY_LAG: ("GNSS velocity {:.2f} s apart from the position", 1.0),
    Fault.VELOCITY_TURN: ("GNSS velocity turned by {:.1f} deg", _DEG),
    Fault.CLIMB_STEP: ("GNSS vertical velocity {:.2f} m/s off", 1.0),
    Fault.HEIGHT_STEP: ("GNSS height {:.1f} m off", 1.0),
    Fault.HEIGHT_RAMP: ("GNSS height slides at {:.2f} m/s", 1.0),
    Fault.FALL: ("GNSS height and vertical velocity led away at {:.2f} m/s", 1.0),
    Fault.FALL_RAMP: ("GNSS height and vertical velocity led away at {:.2f} m/s^2", 1.0),
    Fault.BARO_STEP: ("barometer {:.1f} m off", 1.0),
    Fault.BARO_RAMP: ("barometer slides at {:.2f} m/s", 1.0),
    Fault.BARO_SPEED: ("barometer {:.1f} m off at 15 m/s, by the air", 1.0),
    Fault.BARO_SCALE: ("barometer {:.1f} % off by the height", 100.0),
    Fault.ACCEL_STEP: ("accelerometer {:.2f} m/s^2 off", 1.0),
    Fault.GYRO_STEP: ("gyro {:.2f} deg/s off", _DEG),
    Fault.TILT: ("our roll and pitch were {:.1f} deg off", _DEG),
    Fault.YAW: ("our yaw was {:.1f} deg off", _DEG),
    Fault.KICK: ("our velocity was {:.2f} m/s off, as by a shock", 1.0),
    Fault.FIELD: ("magnetic field of {:.3f} gauss beside the Earth's", 1.0),
    Fault.BODY_FIELD: ("the vehicle's magnetic field changed by {:.3f} gauss", 1.0),
    Fault.HEADING_STEP: ("heading {:.1f} deg off", _DEG),
    Fault.DELAY: ("fixes {:.0f} ms off the delay that is set", 1000.0),
    Fault.LEVER: ("antenna {:.2f} m from where it is set", 1.0),
    Fault.SETTLE: ("GNSS position {:.1f} m off at first", 1.0),
    Fault.SETTLE_HEIGHT: ("GNSS height {:.1f} m off at first", 1.0),
    Fault.RECOVERY: ("GNSS position and velocity right again", 1.0),
    Fault.RECOVERY_HEIGHT: ("GNSS height and vertical velocity right again", 1.0),
}
"""What each is called, and its size in the unit of the words."""


class FoundFault(NamedTuple):
    """A fault that was beyond doubt, of constant size since its onset."""

    kind: Fault
    onset_ns: int
    """Stamp from which on it explains what was measured."""
    until_ns: int
    """Stamp at which that was so last."""
    size: tuple[float, float, float]
    """By component, in the fault's unit; what it has no component for is 0."""

    def words(self, first_ns: int) -> str:
        """Return what it is, how large, and when, counted from a stamp."""
        text, scale = WORDS[self.kind]
        begin, end = (1e-9 * (t - first_ns) for t in (self.onset_ns, self.until_ns))
        return (
            f"{text.format(scale * float(np.linalg.norm(self.size)))}, {begin:.0f} to {end:.0f} s"
        )
