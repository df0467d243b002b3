"""How late the autopilot takes the receiver's fixes to be, as its parameters say.

That is where the filter begins to look for the delay: what somebody has set is known better than
what is usual, and a simulator that has no delay says so.
"""

from __future__ import annotations

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.decode.vehicle import Vehicle
from ekf_companion.mavlink.frame import Frame

NAMES = {
    Family.PX4: ("SENS_GPS0_DELAY", "EKF2_GPS_DELAY"),
    Family.ARDUPILOT: ("GPS1_DELAY_MS", "GPS_DELAY_MS"),
}
"""Of the first receiver, ms: the newer name, then that of PX4 before 1.18 and ArduPilot before
4.6."""
LARGEST = 1000.0
"""ms; more is no delay."""


class Receiver:
    """Reads the delay of the first receiver."""

    def __init__(self, context: Context, vehicle: Vehicle) -> None:
        self._context, self._vehicle = context, vehicle
        self._is_told = False

    def forget(self) -> None:
        """Forget what another autopilot has said."""
        self._is_told, self._vehicle.gnss_delay = False, None

    @property
    def missing(self) -> tuple[str, ...]:
        """The parameters of which one is to be asked for: none has been said yet."""
        return () if self._is_told else NAMES.get(self._context.family, ())

    def param_value(self, frame: Frame) -> Measurements:
        """Read PARAM_VALUE."""
        m, family = unpack(frame), self._context.family
        name = m.param_id.decode("ascii", "replace")
        if name not in NAMES.get(family, ()):
            return []
        delay = value_of(m, frame, family)
        if delay is None or not 0.0 <= delay <= LARGEST:
            return self._context.refuse(f"{name}: no delay")
        self._is_told = True
        if delay == 0.0 and family is Family.ARDUPILOT:
            return []  # 0 leaves it to the receiver's driver, which does not tell
        self._vehicle.gnss_delay = delay * 1e-3
        return self._vehicle.state()
