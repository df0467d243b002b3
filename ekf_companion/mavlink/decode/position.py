"""The autopilot's own position."""

from __future__ import annotations

import math
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.fix import Fixes
from ekf_companion.mavlink.decode.heading import NORTH_CDEG, Heading
from ekf_companion.mavlink.decode.preference import ABSENT_NS, Pace
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.measurements import GnssFix, GnssFlag

_DERIVED = 3.0
"""The autopilot's own position repeats the errors of its fixes: nine count as one."""
_DERIVED_STD = (3.0, 4.5, 0.9)
"""Floors, m and m/s: three times a plain receiver's 1.0, 1.5 and 0.3."""
_ALONE_NS = ABSENT_NS
"""The autopilot's own position waits for so long for a receiver that speaks."""


class Position:
    """Reads the position of the autopilot's own estimate."""

    def __init__(self, context: Context, heading: Heading, fixes: Fixes) -> None:
        self._context, self._heading, self._fixes = context, heading, fixes
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.derived_pace = Pace(self._context.options.derived_rate)
        """Of the autopilot's own positions."""
        self._derived_ns: int | None = None
        """When the autopilot's own position came first."""

    def global_position_int(self, frame: Frame) -> Measurements:
        """Read GLOBAL_POSITION_INT, marked as derived: the filter uses it only if configured to."""
        m = unpack(frame)
        out, t_ns = self._context.follow_ms(m.time_boot_ms, "GLOBAL_POSITION_INT")
        if t_ns is None:
            return out
        if m.hdg <= NORTH_CDEG:
            self._heading.add(out, 1, t_ns, math.radians(m.hdg * 1e-2))
        if not is_place(1e-7 * m.lat, 1e-7 * m.lon):
            self._context.refuse("GLOBAL_POSITION_INT: no position")
            return out
        if self._context.is_ours:
            self._context.refuse("GLOBAL_POSITION_INT: made of our own")
            return out
        if (refusal := self._derived_refusal(t_ns)) is not None:
            self._context.refuse(f"GLOBAL_POSITION_INT: {refusal}")
            return out
        if not self.derived_pace.admit(t_ns):
            return out
        out.append(self.derived(m, t_ns))
        return out

    def derived(self, m: Any, t_ns: int) -> GnssFix:
        """Return what a GLOBAL_POSITION_INT says as a fix."""
        stds = zip(_DERIVED_STD, self._fixes.std, strict=True)
        std_h, std_v, std_vel = (max(least, _DERIVED * std) for least, std in stds)
        return GnssFix(
            t_ns=t_ns,
            lat=math.radians(m.lat * 1e-7),
            lon=math.radians(m.lon * 1e-7),
            alt=m.alt * 1e-3,
            vel_north=m.vx * 1e-2,
            vel_east=m.vy * 1e-2,
            vel_down=m.vz * 1e-2,
            std_h=std_h,
            std_v=std_v,
            std_vel=std_vel,
            flags=GnssFlag.DERIVED,
        )

    def _derived_refusal(self, t_ns: int) -> str | None:
        """Return why the autopilot's own position is none yet; None if it may be one.

        Before the first fix of its receiver ArduPilot sends where its dead reckoning began, moved
        by wind that it assumes.
        """
        if self._derived_ns is None or t_ns < self._derived_ns:
            self._derived_ns = t_ns
        if self._fixes.has_fix:
            return None
        if not self._fixes.is_alone:
            return "the receiver has no fix yet"
        if t_ns - self._derived_ns < _ALONE_NS:
            return "a receiver may still speak"
        self._fixes.is_settled = True
        return None
