"""The autopilot's own heading, from the best message that carries it."""

from __future__ import annotations

import math

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.preference import Pace, Preference
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.measurements import HeadingSample, HeadingSource

NORTH_CDEG = 36000
ZERO, REPEATED = "0 where there is none", "repeated"
"""Why a heading is no measurement."""
_HELD_NS = 1_000_000_000
"""The slowest receiver has a new one each second."""
_NORTH = math.radians(5.0)
"""Headings of 0 are such where others so near to it came just before."""
SOURCES = ("ATTITUDE", "GLOBAL_POSITION_INT", "VFR_HUD")
"""Messages that carry a heading, by rank."""


class HeldHeading:
    """Finds the headings of a receiver or a compass that are none, or the last one again.

    A receiver measures a heading less often than it speaks, and repeats the last one meanwhile, or
    says 0. What repeats to the bit counts again once in a second, and while the vehicle holds its
    heading; for a vehicle that turns, it is an old one.
    """

    def __init__(self) -> None:
        """Begin without a heading."""
        self._last = math.nan
        self._used_ns = 0
        self._north_ns: int | None = None

    def judge(
        self, t_ns: int, heading: float, *, is_still: bool, is_estimate: bool = False
    ) -> str | None:
        """Return why a heading is no measurement; None if it is one.

        Args:
            t_ns: Its stamp.
            heading: In [-pi, pi), rad.
            is_still: Whether the vehicle may have held its heading since it first said this one.
            is_estimate: Whether an autopilot estimates it anew for each row: then few digits repeat
                by chance, as often as they may.
        """
        if heading == 0.0 and not self._may_be_north(t_ns):
            return ZERO
        if heading == self._last:
            is_paced = not is_estimate and 0 <= t_ns - self._used_ns < _HELD_NS
            if not is_still or is_paced:
                return REPEATED
        elif heading != 0.0:
            self._north_ns = t_ns if abs(heading) < _NORTH else None
        self._last, self._used_ns = heading, t_ns
        return None

    def is_repeated(self, heading: float) -> bool:
        """Return whether a heading is the last one again."""
        return heading == self._last

    def _may_be_north(self, t_ns: int) -> bool:
        """Return whether a heading near north came just before."""
        return self._north_ns is not None and 0 <= t_ns - self._north_ns < 2 * _HELD_NS


class Heading:
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
