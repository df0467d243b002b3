"""The autopilot's parameters that decide what becomes of ODOMETRY and of our requests.

Sources: PX4's and ArduPilot's parameter references; MAVLink's parameter protocol (values of PX4
are laid bytewise into the float, ArduPilot's are cast).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass

from ekf_companion.mavlink.codec import pack

_SETS = ("EK3_SRC1", "EK3_SRC2", "EK3_SRC3")
_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
DECIDING: Mapping[str, tuple[str, ...]] = {
    "px4": ("EKF2_EV_CTRL", "EKF2_GPS_CTRL"),
    "ardupilot": ("VISO_TYPE", *(f"EK3_SRC1_{part}" for part in _PARTS)),
}
"""Without these it cannot be said what the autopilot would do with our ODOMETRY."""
_FURTHER: Mapping[str, tuple[str, ...]] = {
    "px4": (
        *("EKF2_AID_MASK", "EKF2_EV_QMIN", "EKF2_EV_DELAY", "EKF2_HGT_REF"),
        "IMU_INTEG_RATE",
        *("MAV_0_RATE", "MAV_1_RATE", "MAV_2_RATE"),
    ),
    "ardupilot": (
        *(f"{name}_{part}" for name in _SETS[1:] for part in _PARTS),
        *("VISO_QUAL_MIN", "SCHED_LOOP_RATE"),
    ),
}
_PERIOD_NS = 40_000_000
"""Between two requests: a second for all, and little beside the streams."""
_TIMEOUT_NS = 1_000_000_000
_TRIES = 3
_REAL32 = 9
_EXTERNAL, _GPS = 6, 3
"""Of EK3_SRCn_*."""
_MASK_GPS, _MASK_VISION = 1, 8 | 16 | 256
"""Bits of EKF2_AID_MASK: GNSS; position, yaw and velocity of external vision."""


def decode(value: float, param_type: int, family: str) -> float:
    """Give a PARAM_VALUE's number: PX4 lays the integer's bytes where the float's would be."""
    if family == "px4" and param_type != _REAL32:
        return float(struct.unpack("<i", struct.pack("<f", value))[0])
    return value


@dataclass(frozen=True, slots=True)
class Fusion:
    """What the autopilot would take from where."""

    ours: tuple[str, ...]
    """Parts of our ODOMETRY that it takes, as the parameter that says so."""
    gnss: tuple[str, ...]
    """Parts of its own GNSS that it takes beside them, likewise."""

    @property
    def is_double(self) -> bool:
        """Whether the same fixes would count twice."""
        return bool(self.ours and self.gnss)


def fusion(parameters: Mapping[str, float], family: str) -> Fusion | None:
    """Say what an autopilot with these parameters takes; None: too little is known."""
    if family == "px4":
        return _px4(parameters)
    return _ardupilot(parameters) if family == "ardupilot" else None


def _px4(parameters: Mapping[str, float]) -> Fusion | None:
    vision, gnss = parameters.get("EKF2_EV_CTRL"), parameters.get("EKF2_GPS_CTRL")
    mask = parameters.get("EKF2_AID_MASK")
    if vision is None and mask is not None:
        # Before 1.14 one parameter said both
        told = (f"EKF2_AID_MASK = {mask:g}",)
        return Fusion(
            told if int(mask) & _MASK_VISION else (), told if int(mask) & _MASK_GPS else ()
        )
    if vision == 0.0:
        return Fusion((), ())
    if vision is None or gnss is None:
        return None
    ours = (f"EKF2_EV_CTRL = {vision:g}",) if int(vision) & 15 else ()
    return Fusion(ours, (f"EKF2_GPS_CTRL = {gnss:g}",) if int(gnss) & 7 else ())


def _ardupilot(parameters: Mapping[str, float]) -> Fusion | None:
    kind = parameters.get("VISO_TYPE")
    if kind == 0.0:
        return Fusion((), ())
    if kind is None or any(f"{_SETS[0]}_{part}" not in parameters for part in _PARTS):
        return None
    # The sets are alternatives: only within one are two sources fused at once
    best = Fusion((), ())
    for name in _SETS:
        said = [(f"{name}_{part}", parameters.get(f"{name}_{part}")) for part in _PARTS]
        ours = tuple(f"{key} = 6" for key, value in said if value == _EXTERNAL)
        gnss = tuple(f"{key} = 3" for key, value in said if value == _GPS)
        if ours and (gnss or not best.ours):
            best = Fusion(ours, gnss)
        if best.is_double:
            break
    return best


class Reader:
    """Asks for parameters one by one, each three times at most. Without a clock."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.asked: dict[str, int] = {}
        """How often, by name."""
        self._family = ""
        self._due_ns: dict[str, int] = {}
        self._next_ns = 0

    @property
    def is_done(self) -> bool:
        """Whether each that is needed has been answered or given up."""
        return bool(self._family) and not self._due_ns

    def begin(self, family: str, now_ns: int) -> None:
        """Ask an autopilot of this family from now on; of an unknown one nothing is known."""
        if family == self._family:
            return
        self._family = family
        names = (*DECIDING.get(family, ()), *_FURTHER.get(family, ()))
        self._due_ns = dict.fromkeys(names, now_ns)

    def take(self, name: str, value: float, param_type: int, family: str) -> None:
        """Take a PARAM_VALUE, whoever asked; others than ours are left."""
        number = decode(value, param_type, family)
        if math.isfinite(number) and name in (
            *DECIDING.get(family, ()),
            *_FURTHER.get(family, ()),
        ):
            self.values[name] = number
            self._due_ns.pop(name, None)

    def request(self, system_id: int, component_id: int, now_ns: int) -> bytes | None:
        """Give the payload of the PARAM_REQUEST_READ that is due; None: none is."""
        if now_ns < self._next_ns:
            return None
        for name, due_ns in self._due_ns.items():
            if now_ns < due_ns:
                continue
            if self.asked.get(name, 0) == _TRIES:
                del self._due_ns[name]
                return None
            self.asked[name] = self.asked.get(name, 0) + 1
            self._due_ns[name] = now_ns + _TIMEOUT_NS
            self._next_ns = now_ns + _PERIOD_NS
            return pack(
                "PARAM_REQUEST_READ",
                target_system=system_id,
                target_component=component_id,
                param_id=name.encode(),
                param_index=-1,
            )
        return None
