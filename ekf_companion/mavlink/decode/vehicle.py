"""Whether the vehicle is armed and landed, and what unix time it is there."""

from __future__ import annotations

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.measurements import VehicleState, VehicleType

_ARMED = 128
_INVALID_AUTOPILOT = 8
_ON_GROUND = 1
_SUBMARINE = 12
"""MAV_TYPE."""
_TYPES = {
    1: VehicleType.FIXED_WING,
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), VehicleType.ROTARY),
    10: VehicleType.GROUND,
}
"""By MAV_TYPE; all others move otherwise."""
_GENERIC = 0
_VTOL = range(19, 26)
_ON_WINGS = 4
"""MAV_VTOL_STATE_FW."""
_HOVERING = 3
"""MAV_VTOL_STATE_MC."""


class Vehicle:
    """Reads the state of the vehicle, and SYSTEM_TIME."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.gnss_delay: float | None = None
        """What the autopilot takes for the receiver's delay, s."""
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.is_armed = False
        self._is_landed: bool | None = None
        self._mav_type = _GENERIC
        self._vtol_state = 0

    @property
    def is_flying(self) -> bool:
        """Whether it is armed, and not reported on the ground."""
        return self.is_armed and self._is_landed is not True

    def heartbeat(self, frame: Frame) -> Measurements:
        """Read HEARTBEAT."""
        m = unpack(frame)
        if m.autopilot == _INVALID_AUTOPILOT:
            return []
        self.is_armed = bool(m.base_mode & _ARMED)
        self._context.is_submarine = m.type == _SUBMARINE
        self._mav_type = m.type
        return self.state()

    def extended_sys_state(self, frame: Frame) -> Measurements:
        """Read EXTENDED_SYS_STATE."""
        m = unpack(frame)
        is_landed = None if m.landed_state == 0 else m.landed_state == _ON_GROUND
        before = self._is_landed, self.type
        self._is_landed, self._vtol_state = is_landed, m.vtol_state
        return [] if before == (is_landed, self.type) else self.state()

    @property
    def type(self) -> VehicleType:
        """How the vehicle moves now: one that can hover, by how it flies."""
        if self._mav_type == _GENERIC:
            return VehicleType.UNKNOWN
        if self._mav_type in _VTOL:
            by_state = {_ON_WINGS: VehicleType.FIXED_WING, _HOVERING: VehicleType.ROTARY}
            return by_state.get(self._vtol_state, VehicleType.OTHER)
        return _TYPES.get(self._mav_type, VehicleType.OTHER)

    def system_time(self, frame: Frame) -> Measurements:
        """Read SYSTEM_TIME."""
        m = unpack(frame)
        return self._context.relate(m.time_unix_usec, m.time_boot_ms)

    def state(self) -> Measurements:
        """Return the state of now, if it is known when that is."""
        t_ns = self._context.clock.latest_ns
        if t_ns is None:
            return []
        return [
            VehicleState(
                t_ns=t_ns,
                is_armed=self.is_armed,
                is_landed=self._is_landed,
                gnss_delay=self.gnss_delay,
                type=self.type,
            )
        ]
