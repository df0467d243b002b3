"""The autopilot's own estimate beside ours at the same time: both are on its clock."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

from ekf_companion.engine.autopilot_frame import AutopilotFrame, Height
from ekf_companion.engine.pipeline import Estimate
from ekf_companion.mavlink.autopilot_estimate import AutopilotEstimate
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.following import Separation
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.timebase import TimeBase
from ekf_companion.nav import projection
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.state import COLUMNS

_RATE_NS = 40_000_000
"""Between two of our estimates that are kept: on a line between them it is off by millimetres."""
_KEPT = 64
"""Of them: two and a half seconds. What the autopilot says is not older, or no use."""
_HELD = 20
"""mm by which the height above home moves while the altitude beside it stays the same: that is sent
in steps of 1 cm, so it is held. ArduPilot repeats its last place where it knows none."""
_POSITION, _ATTITUDE = IDS["GLOBAL_POSITION_INT"], IDS["ATTITUDE"]
_AT = [
    COLUMNS.index(name) - 1
    for name in ("lat_deg", "lon_deg", "alt_m", "vel_n", "vel_e", "vel_d", "yaw")
]


class Ours(NamedTuple):
    """Our estimate at one time."""

    t_ns: int
    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """m."""
    vel_n: tuple[float, float, float]
    """m/s."""
    yaw: float
    """rad."""


class Comparison:
    """Keeps our last estimates, and compares each new one of the autopilot's with ours."""

    def __init__(self) -> None:
        self._kept: deque[Ours] = deque(maxlen=_KEPT)
        self.forget()

    def forget(self) -> None:
        """Forget our estimates: the autopilot's clock begins anew."""
        self._kept.clear()
        self.pause = 0, 0
        """From which stamp until which an estimate of ours is not kept, ns."""
        self.seen = -1
        """:attr:`AutopilotEstimate.changes` at the last comparison."""
        self._position: Frame | None = None
        self._attitude: Frame | None = None
        self._yaw = math.nan
        self._place = 0, 0, 0
        """Latitude, longitude and altitude of the autopilot's last place that was another."""
        self._above_home = 0
        """The height above home that came with it, mm."""

    def keep(self, estimate: Estimate) -> None:
        """Keep an estimate of ours, if the last that was kept is old enough."""
        kept, t_ns = self._kept, estimate.t_ns
        if self.pause[0] <= t_ns < self.pause[1]:
            return
        if kept and t_ns < kept[-1].t_ns:
            kept.clear()
            self.pause = 0, 0
        values = estimate.values
        lat, lon, alt, north, east, down, yaw = (float(values[place]) for place in _AT)
        if math.isfinite(lat):
            place = math.radians(lat), math.radians(lon), alt
            kept.append(Ours(t_ns, *place, (north, east, down), yaw))
            self.pause = t_ns, t_ns + _RATE_NS

    def compare(
        self, said: AutopilotEstimate, clock: TimeBase, frame: AutopilotFrame
    ) -> tuple[Height | None, Separation] | None:
        """Return how the autopilot's newest position lies beside ours; None: it is not new.

        It has no height while it repeats an old place: how far it is from ours still counts.
        """
        self.seen = said.changes
        attitude = said.frame(_ATTITUDE)
        if attitude is not None and attitude is not self._attitude:
            self._attitude = attitude
            self._yaw = self._turned(unpack(attitude), clock)
        position = said.frame(_POSITION)
        if position is None or position is self._position:
            return None
        self._position = position
        m = unpack(position)
        t_ns = clock.from_boot_ms(m.time_boot_ms)
        if (
            t_ns is None
            or not is_place(1e-7 * m.lat, 1e-7 * m.lon)
            or (ours := self._at(t_ns)) is None
        ):
            return None
        sphere = projection.ARDUPILOT
        lat, lon = math.radians(m.lat * 1e-7), math.radians(m.lon * 1e-7)
        north, east = sphere.to_metres(lat, lon, ours.lat, ours.lon)
        vel_n = (m.vx * 1e-2, m.vy * 1e-2, m.vz * 1e-2)
        off_n = vel_n[0] - ours.vel_n[0], vel_n[1] - ours.vel_n[1], vel_n[2] - ours.vel_n[2]
        separation = Separation(
            t_ns=t_ns,
            pos_n=(north, east, ours.alt + frame.datum - m.alt * 1e-3),
            vel_n=off_n,
            yaw=self._yaw,
            moving=ours.vel_n[:2],
            turning=self._acceleration(),
        )
        if self._is_held(m):
            return None, separation
        return Height(t_ns, m.alt * 1e-3, ours.alt, -ours.vel_n[2]), separation

    def _is_held(self, m: Any) -> bool:
        """Whether a GLOBAL_POSITION_INT repeats a place, while the vehicle climbs or sinks."""
        if (place := (m.lat, m.lon, m.alt)) != self._place:
            self._place, self._above_home = place, m.relative_alt
        return bool(abs(m.relative_alt - self._above_home) > _HELD)

    def _turned(self, m: Any, clock: TimeBase) -> float:
        """Return what the autopilot's yaw is off ours at the same time, rad; NaN: not known."""
        t_ns = clock.from_boot_ms(m.time_boot_ms)
        ours = None if t_ns is None else self._at(t_ns)
        if ours is None or not math.isfinite(m.yaw):
            return math.nan
        return math.remainder(m.yaw - ours.yaw, math.tau)

    def _at(self, t_ns: int) -> Ours | None:
        """Return our estimate at a time that lies among those kept, or a moment after."""
        kept = self._kept
        if len(kept) < 2 or not kept[0].t_ns <= t_ns < kept[-1].t_ns + 5 * _RATE_NS:
            return None
        k = len(kept) - 2
        while k > 0 and kept[k].t_ns > t_ns:
            k -= 1
        a, b = kept[k], kept[k + 1]
        share = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
        north, east, down = (
            va + share * (vb - va) for va, vb in zip(a.vel_n, b.vel_n, strict=True)
        )
        return Ours(
            t_ns,
            a.lat + share * (b.lat - a.lat),
            a.lon + share * math.remainder(b.lon - a.lon, math.tau),
            a.alt + share * (b.alt - a.alt),
            (north, east, down),
            a.yaw + share * math.remainder(b.yaw - a.yaw, math.tau),
        )

    def _acceleration(self) -> float:
        """Return how fast our velocity has changed over the last moment, m/s^2."""
        a, b = self._kept[max(0, len(self._kept) - 6)], self._kept[-1]
        span = (b.t_ns - a.t_ns) * 1e-9
        gain = math.hypot(*(vb - va for va, vb in zip(a.vel_n, b.vel_n, strict=True)))
        return gain / span if span > 0.0 else 0.0
