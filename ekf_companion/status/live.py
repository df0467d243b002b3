"""What changes many times a second, for a page that is watched: the estimate and its tests.

It is taken in the loop, so it asks the filter for few things; the rest of the page is the Snapshot,
once a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Aid
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.state import (
    ACCEL_BIAS,
    COLUMNS,
    EULER,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Status,
)

_AT = {name: place for place, name in enumerate(COLUMNS[1:])}
_NN, _NE, _EE = 13, 14, 19
"""Of the numbers of an ODOMETRY: the horizontal part of the position's covariance."""
_SD = tuple(f"sd_{name}" for name in (*POSITION, *VELOCITY, *EULER))
SIGMAS = (*POSITION, *VELOCITY, "roll", "pitch", "heading")
"""Names of the sigmas: m, m/s, degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Live:
    """The newest estimate; NaN, which JSON writes as null: not known."""

    t_s: float
    """Its stamp on the autopilot's clock, s."""
    age_s: float
    """Since the newest inertial sample, s."""
    status: str
    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    vel_ned_m_s: tuple[float, ...]
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    """From true north, clockwise, in [0, 360)."""
    sigma: Mapping[str, float]
    """One sigma, by the names of ``SIGMAS``."""
    ellipse_m2: tuple[float, float, float]
    """Covariance of the horizontal position: north, north with east, east."""
    gyro_bias_deg_s: tuple[float, ...]
    accel_bias_m_s2: tuple[float, ...]
    ratios: Mapping[str, float]
    """Last normalised innovation squared over its gate, by aid: above 1 it was refused."""
    autopilot: Mapping[str, float] | None
    """The autopilot's own attitude and position; None: it has told none."""


def live(companion: Companion, age_s: float) -> bytes:
    """Return the newest estimate of a companion as JSON; ``null`` if there is none."""
    pipeline = companion.pipeline
    if pipeline is None or companion.estimate is None:
        return b"null"
    values, ratios = pipeline.values(), pipeline.filter_state.ratio
    odometry = companion.estimate.odometry
    nan = math.nan
    ellipse = (nan, nan, nan)
    if odometry is not None:
        numbers = memoryview(odometry.numbers).cast("f")
        ellipse = (numbers[_NN], numbers[_NE], numbers[_EE])
    sigmas = [*_take(values, _SD[:6]), *map(math.degrees, _take(values, _SD[6:]))]
    roll, pitch, yaw = (math.degrees(one) for one in _take(values, EULER))
    return msgspec.json.encode(
        Live(
            t_s=pipeline.stamp_ns * 1e-9,
            age_s=age_s,
            status=Status(int(values[_AT["status"]])).name.lower(),
            lat_deg=float(values[_AT["lat_deg"]]),
            lon_deg=float(values[_AT["lon_deg"]]),
            alt_m=float(values[_AT["alt_m"]]),
            vel_ned_m_s=_take(values, VELOCITY),
            roll_deg=roll,
            pitch_deg=pitch,
            heading_deg=yaw % 360.0,
            sigma=dict(zip(SIGMAS, sigmas, strict=True)),
            ellipse_m2=ellipse,
            gyro_bias_deg_s=tuple(math.degrees(one) for one in _take(values, GYRO_BIAS)),
            accel_bias_m_s2=_take(values, ACCEL_BIAS),
            ratios={aid.name.lower(): float(ratios[aid]) for aid in Aid},
            autopilot=None,
        )
    )


def _take(values: Array, names: Sequence[str]) -> tuple[float, ...]:
    return tuple(float(values[_AT[name]]) for name in names)
