"""Where the vehicle is by our estimate and by the autopilot's, what aids it, and the verdict."""

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
    """What the autopilot's own estimate says; NaN: not said, or it has none."""

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
    """One sigma of its position as it states it, m."""
    vertical_std_m: float
    """Likewise of its height, m."""
    age_s: float
    """Since the older of both came, s."""
    attitude_message: str
    """That its attitude is from; empty: none came."""
    attitude_age_s: float
    """Since that came, s."""
    position_message: str
    """That its position is from; empty: none came."""
    position_age_s: float
    """Since that came, s."""
    is_attitude_ours: bool
    """Whether its heading is made of our ODOMETRY, so that it proves nothing."""
    is_position_ours: bool
    """Whether its position is made of our ODOMETRY, likewise."""
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
    """What of it is too far from ours; empty: nothing, or it is not watched."""
    apart_horizontal_m: Annotated[float, gauge(*_SEPARATION, ("axis=horizontal",))]
    """m, at the same time."""
    apart_vertical_m: Annotated[float, gauge(*_SEPARATION, ("axis=vertical",))]
    """m, above ours."""
    apart_velocity_m_s: float
    """m/s."""
    apart_heading_deg: float
    """deg."""
    lag_s: Annotated[
        float, gauge("autopilot_lag_seconds", "How late its estimate follows ODOMETRY, in motion.")
    ]
    """s; NaN: nothing moves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AidState:
    """Where what corrects the estimate comes from."""

    source: Annotated[
        str,
        gauge(
            "aid_source",
            "1 for the source in use.",
            ("aid", "source"),
            rows=lambda source: {source: 1.0} if source else {},
        ),
    ]
    """The message, and of what in it; empty: it was never used."""
    state: str
    """``used``, ``refused``, ``lost`` (used before, and no more) or ``none``."""
    since_s: Annotated[float, gauge("aid_used_seconds", "Used without a break.", ("aid",))]
    """NaN: it is not used."""
    used_s: float
    """Since it was used last, s; NaN: never."""
    refused_s: float
    """Since it was refused last, s; NaN: never."""
    why: str = ""
    """Of the last refusal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """By how much the attitude has changed while the vehicle was at rest; NaN: not at rest."""

    seconds: float
    """Length of the rest so far, s, as far as it is looked at."""
    roll_deg: float
    """Largest less smallest in that time, deg."""
    pitch_deg: float
    """Likewise."""
    heading_deg: float
    """Likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleEstimate:
    """Where the vehicle is by our estimate, how sure that is, and what the autopilot says."""

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
    """By aid: ``position``, ``height``, ``velocity``, ``heading``, ``baro``, ``rest``."""
    drift: Drift
    autopilot: AutopilotState | None
    """None: it has said neither."""
    needs_fix: bool
    """Whether the configuration wants a position before take-off."""
    takes_own_position: bool
    """Whether it names the autopilot's own position as the source, not a receiver."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Preflight:
    """Whether the vehicle may take off on this estimate."""

    ready: Annotated[bool, gauge("preflight_ready", "1 if nothing speaks against a take-off.")]
    sentence: str
    """The verdict, and all reasons."""
    reasons: tuple[str, ...]
    """What speaks against it, the most basic first."""
    notes: tuple[str, ...] = ()
    """What could not be compared, and what is good to know."""
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
