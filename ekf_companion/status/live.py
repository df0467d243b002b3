"""The part of the state that changes many times a second, for the page: estimate and tests.

It is read in the loop, so it is small; the rest of the page is the Snapshot, once a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Aid
from ekf_companion.nav.state import Status
from ekf_companion.status.collect import autopilot_state, sigmas
from ekf_companion.status.vehicle import AutopilotState, Sigmas

_NN, _NE, _EE = 13, 14, 19
"""Of the numbers of an ODOMETRY: the horizontal part of the position's covariance."""
_NOWHERE = (math.nan,) * 3


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
    sigma: Sigmas
    ellipse_m2: tuple[float, float, float]
    """Covariance of the horizontal position: north, north with east, east."""
    gyro_bias_deg_s: tuple[float, ...]
    accel_bias_m_s2: tuple[float, ...]
    ratios: Mapping[str, float]
    """Last normalised innovation squared over its gate, by aid: above 1 it was refused. An aid that
    other evidence contradicts is refused at any ratio."""
    nis: Mapping[str, float]
    """Mean normalised innovation squared over its degrees of freedom, of 20 s, by aid."""
    resets: int
    """How often the estimate was reset: its track jumps there."""
    autopilot: AutopilotState | None
    """The autopilot's own attitude and position; None: none has come."""


def live(companion: Companion, age_s: float, nis: Mapping[Aid, float], now_ns: int) -> bytes:
    """Return the newest estimate of a companion as JSON; ``null`` if there is none."""
    pipeline, estimate = companion.pipeline, companion.estimate
    if pipeline is None or estimate is None:
        return b"null"
    now, ratios = as_estimate(pipeline.values()), pipeline.filter_state.ratio
    ellipse = _NOWHERE
    if estimate.odometry is not None:
        numbers = memoryview(estimate.odometry.numbers).cast("f")
        ellipse = (numbers[_NN], numbers[_NE], numbers[_EE])
    roll, pitch, yaw = map(math.degrees, now.euler)
    return msgspec.json.encode(
        Live(
            t_s=pipeline.stamp_ns * 1e-9,
            age_s=age_s,
            status=Status(int(now.status)).name.lower(),
            lat_deg=now.lla[0],
            lon_deg=now.lla[1],
            alt_m=now.lla[2],
            vel_ned_m_s=tuple(now.vel_n),
            roll_deg=roll,
            pitch_deg=pitch,
            heading_deg=yaw % 360.0,
            sigma=sigmas(now.std_pos, now.std_vel, now.std_euler),
            ellipse_m2=ellipse,
            gyro_bias_deg_s=tuple(map(math.degrees, now.gyro_bias)),
            accel_bias_m_s2=tuple(now.accel_bias),
            ratios={aid.name.lower(): ratios[aid] for aid in Aid},
            nis={aid.name.lower(): value for aid, value in nis.items()},
            resets=pipeline.resets,
            autopilot=autopilot_state(companion.session, now_ns),
        )
    )
