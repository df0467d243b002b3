"""The autopilot's own heading, from the best message that carries it."""

from __future__ import annotations

import math

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.preference import Pace, Preference
from ekf_companion.mavlink.decode.state import HeadingState
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.measurements import HeadingSample, HeadingSource

NORTH_CDEG = 36000
SOURCES = ("ATTITUDE", "GLOBAL_POSITION_INT", "VFR_HUD")
"""Messages that carry a heading, by rank."""


class Heading(HeadingState):
    """Reads ATTITUDE, else GLOBAL_POSITION_INT, else VFR_HUD."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.sources = Preference()
        self.pace = Pace(self._context.options.heading_rate)

    def attitude(self, frame: Frame) -> Measurements:
        """Read ATTITUDE."""
        m = unpack(frame)
        out, t_ns = self._context.follow_ms(m.time_boot_ms, "ATTITUDE")
        if t_ns is not None:
            self.add(out, 0, t_ns, m.yaw)
        return out

    def vfr_hud(self, frame: Frame) -> Measurements:
        """Read VFR_HUD, which has no stamp of its own, and whole degrees."""
        heading, t_ns = unpack(frame).heading, self._context.clock.latest_ns
        out: Measurements = []
        if t_ns is not None and 0 <= heading <= 360:
            self.add(out, 2, t_ns, math.radians(heading))
        return out

    def add(self, out: Measurements, rank: int, t_ns: int, heading: float) -> None:
        """Append a heading in rad if its source is in use and a period has passed."""
        if not math.isfinite(heading):
            self._context.refuse("heading: not a number")
        elif self._context.is_yaw_ours:
            self._context.refuse("heading: made of our own")
        elif self.sources.admit(rank, t_ns) and self.pace.admit(t_ns):
            out.append(
                HeadingSample(
                    t_ns=t_ns,
                    heading=wrap(heading),
                    std=self._context.options.heading_std,
                    source=HeadingSource.AUTOPILOT,
                )
            )


def wrap(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
