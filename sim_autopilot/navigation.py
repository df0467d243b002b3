"""Messages on the position of an autopilot that navigates by itself: SI to units of the wire."""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.nav import so3
from sim_autopilot.flight import Motion as State
from sim_autopilot.follower import Motion
from sim_autopilot.navigator import Navigator
from sim_autopilot.personality import Kind
from sim_autopilot.telemetry import Fields

_STRAY_SPEED = 0.3
"""m/s, of the place near 0, 0 that ArduPilot reports before its first fix: assumed."""
_ADRIFT = 6378100.0


def fields(name: str, own: Navigator, t_ns: int) -> Fields | None:
    """Return the fields of a message; None: it is not sent now."""
    if name == "EKF_STATUS_REPORT":
        return own.status()
    if (frame := own.origin) is None:
        return None
    if name == "GPS_GLOBAL_ORIGIN":
        return {**_place(frame.lat, frame.lon, frame.alt), "time_usec": t_ns // 1000}
    if own.home is None:
        return None
    place = _place(*frame.to_geodetic(own.home))
    return {**place, **dict(zip("xyz", own.home.tolist(), strict=True)), "q": (1.0, 0.0, 0.0, 0.0)}


def _place(lat: float, lon: float, alt: float) -> Fields:
    return {
        "latitude": round(math.degrees(lat) * 1e7),
        "longitude": round(math.degrees(lon) * 1e7),
        "altitude": round(alt * 1e3),
    }


def state(own: Navigator, motion: Motion, rate_b: np.ndarray, truth: State) -> State:
    """Return the autopilot's own estimate in the form of its telemetry.

    Without an origin ArduPilot reports its receiver's position, and before the first fix one near
    0, 0 that moves.
    """
    place = own.place(motion)
    if place is None and own.last_fix is not None:
        place = own.last_fix.lat, own.last_fix.lon, own.last_fix.alt
    if place is None:
        place = motion.t * _STRAY_SPEED / _ADRIFT, 0.0, 0.0
    lat, lon, alt = place
    return truth._replace(
        lat=lat,
        lon=lon,
        alt=alt,
        pos_n=tuple(motion.pos_n.tolist()),
        vel_n=tuple(motion.vel_n.tolist()),
        q_nb=tuple(motion.q_nb.tolist()),
        euler=tuple(so3.to_euler(motion.q_nb).tolist()),
        rate_b=tuple(rate_b.tolist()),
    )


def is_sent(name: str, own: Navigator) -> bool:
    """Return whether a message of its position is sent at all now."""
    if name == "LOCAL_POSITION_NED":
        return own.kind is Kind.PX4 or own.origin is not None
    # PX4 sends no place that it does not know
    return own.kind is Kind.ARDUPILOT or own.origin is not None
