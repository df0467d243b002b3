"""Who we are and what we understand, as whoever asks is told: it does not change while we run."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ekf_companion.mavlink.codec import pack
from ekf_companion.version import __version__

_MAVLINK_2 = 8192
_COMMAND_INT = 8
_PARAM_C_CAST = 131072
_CAPABILITIES = _MAVLINK_2 | _COMMAND_INT | _PARAM_C_CAST
_OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE."""


def _version() -> int:
    parts = [int(part) if part.isdigit() else 0 for part in __version__.split(".")[:3]]
    major, minor, patch = [*parts, 0, 0, 0][:3]
    return major << 24 | minor << 16 | patch << 8 | _OFFICIAL


MESSAGES: Mapping[str, bytes] = MappingProxyType(
    {
        "AUTOPILOT_VERSION": pack(
            "AUTOPILOT_VERSION", capabilities=_CAPABILITIES, flight_sw_version=_version()
        ),
        # What stands in for AUTOPILOT_VERSION where there is no autopilot
        "COMPONENT_INFORMATION_BASIC": pack(
            "COMPONENT_INFORMATION_BASIC",
            capabilities=_CAPABILITIES,
            model_name=b"EKF companion",
            software_version=__version__.encode("ascii", "replace")[:23],
        ),
        # MAVLink 1 is heard, and 2 is spoken
        "PROTOCOL_VERSION": pack("PROTOCOL_VERSION", version=200, min_version=100, max_version=200),
    }
)
"""Payloads by the message that carries them."""
