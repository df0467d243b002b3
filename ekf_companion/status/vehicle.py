"""Vehicle state by our estimate and by the autopilot's, the aids in use, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from ekf_companion.status.metric import gauge

_ATTITUDE = ("attitude_degrees", "Attitude of the vehicle; heading from true north.")
_AUTOPILOT_ATTITUDE = ("autopilot_attitude_degrees", "The same by the autopilot's own estimate.")
_SEPARATION = (
    "autopilot_separation_meters",
    "Of the autopilot's own estimate from ours at the same time.",
)
_ATTITUDE_STD = ("attitude_std_degrees", "One sigma.")
_POSITION_STD = ("position_std_meters", "One sigma.")


def _by_axis(vel_n: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(("north", "east", "down"), vel_n, strict=True))


def _one_of_each(words: tuple[Any, ...]) -> dict[tuple[str], float]:
    return {(str(word),): 1.0 for word in words}


@dataclass(frozen=True, slots=True, kw_only=True)
class Sigmas:
    """One sigma of each number of the estimate; NaN: not known."""

    north_m: Annotated[float, gauge(*_POSITION_STD, ("axis=north",))]
    """m."""
    east_m: Annotated[float, gauge(*_POSITION_STD, ("axis=east",))]
    """m."""
    horizontal_m: float
    """Of both together, m."""
    alt_m: float
    """m."""
    vel_ned_m_s: Annotated[
        tuple[float, float, float],
        gauge("velocity_std_meters_per_second", "One sigma.", ("axis",), rows=_by_axis),
    ]
    """m/s."""
    roll_deg: Annotated[float, gauge(*_ATTITUDE_STD, ("angle=roll",))]
    """deg."""
    pitch_deg: Annotated[float, gauge(*_ATTITUDE_STD, ("angle=pitch",))]
    """deg."""
    heading_deg: Annotated[float, gauge(*_ATTITUDE_STD, ("angle=heading",))]
    """deg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotState:
    """The autopilot's own estimate; NaN: not sent."""

    roll_deg: Annotated[float, gauge(*_AUTOPILOT_ATTITUDE, ("angle=roll",))]
    """deg."""
    pitch_deg: Annotated[float, gauge(*_AUTOPILOT_ATTITUDE, ("angle=pitch",))]
    """deg."""
    heading_deg: Annotated[float, gauge(*_AUTOPILOT_ATTITUDE, ("angle=heading",))]
    """deg, in [0, 360)."""
    lat_deg: Annotated[float, gauge("autopilot_latitude_degrees", "By its own estimate.")]
    lon_deg: Annotated[float, gauge("autopilot_longitude_degrees", "By its own estimate.")]
    alt_m: Annotated[float, gauge("autopilot_altitude_meters", "By its own estimate.")]
    """Above mean sea level."""
    vel_ned_m_s: tuple[float, float, float]
    """m/s."""
    horizontal_std_m: float
    """One sigma of its position as the autopilot states it, m."""
    vertical_std_m: float
    """One sigma of its height as the autopilot states it, m."""
    age_s: float
    """Age of the older of attitude and position, s."""
    attitude_message: str
    """Message of its attitude; empty: none came."""
    attitude_age_s: float
    """Age of its attitude, s."""
    position_message: str
    """Message of its position; empty: none came."""
    position_age_s: float
    """Age of its position, s."""
    is_attitude_ours: bool
    """Whether its heading comes from our ODOMETRY, so that it confirms nothing."""
    is_position_ours: bool
    """Whether its position comes from our ODOMETRY, likewise."""
    is_followed: Annotated[
        bool, gauge("autopilot_watched", "1 while it fuses ODOMETRY: its estimate must be ours.")
    ]
    apart: Annotated[
        str,
        gauge(
            "autopilot_apart",
            "1 while its estimate is not the ODOMETRY that it fuses.",
            rows=lambda apart: {(): float(bool(apart))},
        ),
    ]
    """Which parts differ too much from ours; empty: none, or they are not compared."""
    apart_horizontal_m: Annotated[float, gauge(*_SEPARATION, ("axis=horizontal",))]
    """Horizontal difference at the same time, m."""
    apart_vertical_m: Annotated[float, gauge(*_SEPARATION, ("axis=vertical",))]
    """Height above ours, m."""
    apart_velocity_m_s: float
    """m/s."""
    apart_heading_deg: float
    """deg."""
    lag_s: Annotated[
        float, gauge("autopilot_lag_seconds", "How late its estimate follows ODOMETRY, in motion.")
    ]
    """Delay behind ours, s; NaN: nothing moves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AidState:
    """Where an aid of the estimate comes from."""

    source: Annotated[
        str,
        gauge(
            "aid_source",
            "1 for the source in use.",
            ("aid", "source"),
            rows=lambda source: {source: 1.0} if source else {},
        ),
    ]
    """Its message and sensor; empty: never used."""
    state: str
    """``used``, ``refused``, ``lost`` (no longer used) or ``none``."""
    since_s: Annotated[float, gauge("aid_used_seconds", "Used without a break.", ("aid",))]
    """In use for so long, s; NaN: not in use."""
    used_s: float
    """Since its last use, s; NaN: never."""
    refused_s: float
    """Since its last refusal, s; NaN: never."""
    why: str = ""
    """Reason of the last refusal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Change of the attitude while the vehicle is at rest; NaN: not at rest."""

    seconds: float
    """Length of the rest that is looked at, s."""
    roll_deg: float
    """Largest less smallest in that time, deg."""
    pitch_deg: float
    """Likewise."""
    heading_deg: float
    """Likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleEstimate:
    """Vehicle state by our estimate, its sigmas, and what the autopilot says."""

    lat_deg: Annotated[float, gauge("latitude_degrees", "Of the estimate.")]
    lon_deg: Annotated[float, gauge("longitude_degrees", "Of the estimate.")]
    alt_m: Annotated[float, gauge("altitude_meters", "Above mean sea level.")]
    height_m: Annotated[float, gauge("height_meters", "Above the origin, or the start.")]
    vel_ned_m_s: Annotated[
        tuple[float, float, float],
        gauge("velocity_meters_per_second", "Of the estimate.", ("axis",), rows=_by_axis),
    ]
    """North, east, down, m/s."""
    roll_deg: Annotated[float, gauge(*_ATTITUDE, ("angle=roll",))]
    """deg."""
    pitch_deg: Annotated[float, gauge(*_ATTITUDE, ("angle=pitch",))]
    """deg."""
    heading_deg: Annotated[float, gauge(*_ATTITUDE, ("angle=heading",))]
    """deg, in [0, 360)."""
    turn_rate_deg_s: float
    """How fast it turns, about any axis, deg/s."""
    sigma: Sigmas
    aids: Mapping[str, AidState]
    """By aid, as :class:`~ekf_companion.engine.health.Aid` names them: ``position``, ``baro``."""
    drift: Drift
    autopilot: AutopilotState | None
    """None: it has sent neither attitude nor position."""
    needs_fix: bool
    """Whether the configuration wants a position before take-off."""
    takes_own_position: bool
    """Whether the configuration names the autopilot's own position as the source, not a
    receiver."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Preflight:
    """Whether the vehicle may take off on this estimate."""

    ready: Annotated[bool, gauge("preflight_ready", "1 if nothing speaks against a take-off.")]
    sentence: str
    """The verdict, and all reasons."""
    reasons: tuple[str, ...]
    """What prevents a take-off, the most basic first."""
    notes: tuple[str, ...] = ()
    """What could not be compared, and other remarks."""
    causes: Annotated[
        tuple[str, ...],
        gauge(
            "preflight_cause",
            "1 for what speaks against a take-off.",
            ("cause",),
            rows=_one_of_each,
        ),
    ] = field(default=())
    """The reasons, each in a word that does not change."""


NO_DRIFT = Drift(seconds=0.0, roll_deg=math.nan, pitch_deg=math.nan, heading_deg=math.nan)
