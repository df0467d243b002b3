"""The autopilot's own estimate of attitude and position, as it said it last.

Only the frames are kept as they come; what they say is read when somebody asks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, seconds_since
from ekf_companion.nav import so3
from ekf_companion.nav.earth import is_place, radii

FRESH_NS = SECOND_NS
"""What is older is no longer compared with: the vehicle may have moved meanwhile."""
_STATUS_NS = 3 * SECOND_NS
"""ESTIMATOR_STATUS, of which only the sigmas are read, comes once a second."""
_STAMP = slice(0, 4)
"""Where the stamp lies in the payload, or what of it changes from one message to the next."""
KEPT = {
    IDS[name]
    for name in (
        "ATTITUDE",
        "ATTITUDE_QUATERNION",
        "GLOBAL_POSITION_INT",
        "LOCAL_POSITION_NED",
        "GPS_GLOBAL_ORIGIN",
        "ESTIMATOR_STATUS",
    )
}
"""Messages to be kept, by their ids."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotAttitude:
    """Attitude of the vehicle by the autopilot's own filter."""

    message: str
    """That said it."""
    age: float
    """Since it came, s."""
    euler: tuple[float, float, float]
    """Roll, pitch, yaw, rad; yaw in [-pi, pi)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotPosition:
    """Position and velocity of the vehicle by the autopilot's own filter."""

    message: str
    """That said it."""
    age: float
    """Since it came, s."""
    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """Above mean sea level, m."""
    vel_n: tuple[float, float, float]
    """North, east, down, m/s."""
    std_horizontal: float
    """One sigma of it by ESTIMATOR_STATUS, m; NaN: not told."""
    std_vertical: float
    """Likewise of the height, m."""


class AutopilotEstimate(Service):
    """Keeps the newest of each message about the autopilot's own estimate."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[Frame, int]] = {}
        """By message id; with when it came, ns."""
        self.changes = 0
        """Moves with what is kept."""

    def begin(self, peer: PeerFound) -> None:
        """Forget what another autopilot has said, or this one before it rebooted."""
        self._last.clear()
        self.changes += 1

    def keep(self, frame: Frame, now_ns: int) -> None:
        """Keep a frame whose id is in ``KEPT``; one with the stamp of the last is none anew."""
        last = self._last.get(frame.message_id)
        is_unstamped = frame.message_id == IDS["GPS_GLOBAL_ORIGIN"]
        if last is None or is_unstamped or frame.payload[_STAMP] != last[0].payload[_STAMP]:
            self._last[frame.message_id] = frame, now_ns
            self.changes += 1

    def frame(self, number: int) -> Frame | None:
        """Return the newest frame of a message that is kept, by its id; None: none came."""
        found = self._last.get(number)
        return None if found is None else found[0]

    def attitude(self, now_ns: int) -> AutopilotAttitude | None:
        """Return the newest attitude; None if none came, or it is no attitude."""
        found = self._newest(("ATTITUDE_QUATERNION", "ATTITUDE"), now_ns)
        if found is None:
            return None
        name, m, age = found
        if name == "ATTITUDE":
            euler = (m.roll, m.pitch, m.yaw)
        else:
            q_nb = np.array([m.q1, m.q2, m.q3, m.q4])
            size = float(np.linalg.norm(q_nb))
            if not 0.9 < size < 1.1:
                return None
            euler = tuple(so3.to_euler(q_nb / size).tolist())
        if not all(map(math.isfinite, euler)):
            return None
        return AutopilotAttitude(message=name, age=age, euler=euler)

    def position(self, now_ns: int) -> AutopilotPosition | None:
        """Return the newest position; None if none came, or it has none."""
        found = self._newest(("GLOBAL_POSITION_INT",), now_ns)
        if found is None or found[2] * SECOND_NS > FRESH_NS:
            found = self._newest(("LOCAL_POSITION_NED",), now_ns) or found
        if found is None:
            return None
        name, m, age = found
        place = _global(m) if name == "GLOBAL_POSITION_INT" else self._local(m)
        if place is None:
            return None
        lat, lon, alt, vel_n = place
        horizontal, vertical = self._sigmas(now_ns)
        return AutopilotPosition(
            message=name,
            age=age,
            lat=lat,
            lon=lon,
            alt=alt,
            vel_n=vel_n,
            std_horizontal=horizontal,
            std_vertical=vertical,
        )

    def _newest(self, names: tuple[str, ...], now_ns: int) -> tuple[str, Any, float] | None:
        """Return name, fields and age (s) of the newest of some messages."""
        kept = [(name, *found) for name in names if (found := self._last.get(IDS[name]))]
        if not kept:
            return None
        name, frame, came_ns = max(kept, key=lambda one: one[2])
        return name, unpack(frame), seconds_since(came_ns, now_ns)

    def _local(self, m: Any) -> tuple[float, float, float, tuple[float, float, float]] | None:
        """Return the place that a LOCAL_POSITION_NED means, where its origin is known."""
        if (found := self._last.get(IDS["GPS_GLOBAL_ORIGIN"])) is None:
            return None
        origin = unpack(found[0])
        if not all(map(math.isfinite, (m.x, m.y, m.z, m.vx, m.vy, m.vz))):
            return None
        lat, lon, alt = origin.latitude * 1e-7, origin.longitude * 1e-7, origin.altitude * 1e-3
        north, east = radii(math.radians(lat))
        lat_now = math.radians(lat) + m.x / (float(north) + alt)
        lon_now = math.radians(lon) + m.y / ((float(east) + alt) * math.cos(math.radians(lat)))
        return lat_now, lon_now, alt - m.z, (m.vx, m.vy, m.vz)

    def _sigmas(self, now_ns: int) -> tuple[float, float]:
        """Return one sigma of the horizontal position and of the height, m; NaN: not told."""
        found = self._last.get(IDS["ESTIMATOR_STATUS"])
        if found is None or now_ns - found[1] > _STATUS_NS:
            return math.nan, math.nan
        m = unpack(found[0])
        both = (m.pos_horiz_accuracy, m.pos_vert_accuracy)
        horizontal, vertical = (
            std if math.isfinite(std) and std > 0.0 else math.nan for std in both
        )
        return horizontal, vertical


def _global(m: Any) -> tuple[float, float, float, tuple[float, float, float]] | None:
    """Return the place that a GLOBAL_POSITION_INT means, if any."""
    if not is_place(1e-7 * m.lat, 1e-7 * m.lon):
        return None
    vel_n = (m.vx * 1e-2, m.vy * 1e-2, m.vz * 1e-2)
    return math.radians(m.lat * 1e-7), math.radians(m.lon * 1e-7), m.alt * 1e-3, vel_n
