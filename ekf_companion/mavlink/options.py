"""The options of a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from ekf_companion.mavlink.clock import TimesyncOptions
from ekf_companion.mavlink.decode import DecoderOptions
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.parameters import Parameter

RATES: Mapping[str, float] = MappingProxyType(
    {
        "HIGHRES_IMU": 250.0,
        "GPS_RAW_INT": 10.0,
        "ATTITUDE": 10.0,
        "GLOBAL_POSITION_INT": 5.0,
        "SCALED_PRESSURE": 10.0,
        "SYSTEM_TIME": 1.0,
        "EXTENDED_SYS_STATE": 1.0,
    }
)
"""Rates to request of the autopilot, Hz. GNSS at twice its usual rate comes half as late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Our ids, whom to listen to, and what to request."""

    system_id: int | None = None
    """Ours; None: the autopilot's, and 1 until it is known."""
    component_id: int = 194
    """Ours: MAV_COMP_ID_ONBOARD_COMPUTER4."""
    autopilot_system_id: int | None = None
    """The one autopilot to listen to; None: the best that is heard."""
    allow_systems: tuple[int, ...] = ()
    """System ids that may speak; empty: all."""
    allow_components: tuple[int, ...] = ()
    """Component ids that may speak; empty: all."""
    accept_unsigned: bool = False
    """Whether, with a key, frames without a signature are believed too."""
    rates: Mapping[str, float] = field(default_factory=lambda: RATES)
    """Messages to request, Hz, by name; 0 stops one; empty: nothing is requested."""
    expected: PeerFound | None = None
    """An autopilot that is known from an earlier run: found by its first frame of any kind, so that
    its heartbeat need not be waited for."""
    is_recording: bool = False
    """Whether what goes in and out is kept for ``take_record``."""
    parameters: tuple[Parameter, ...] = ()
    """Our own, as a ground station sees them; empty: none are served."""
    decoder: DecoderOptions = field(default_factory=DecoderOptions)
    timesync: TimesyncOptions = field(default_factory=TimesyncOptions)
    guard: GuardOptions | None = None
    """When ODOMETRY is withheld; None: this session sends none, and reads no parameter."""
