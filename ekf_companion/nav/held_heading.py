"""Headings of a receiver or a compass that were not measured: 0, or the last one repeated."""

from __future__ import annotations

import math

ZERO, REPEATED = "0 where there is none", "repeated"
"""Why a heading is no measurement."""
HELD_NS = 1_000_000_000
"""The slowest receiver has a new one each second."""
_NORTH = math.radians(5.0)
"""rad; an exact 0 counts as measured where a heading nearer to north than this came just before."""


class HeldHeading:
    """Finds headings of a receiver or a compass that were not measured, or repeat the last.

    A receiver measures its heading less often than it sends one; in between it repeats the last, or
    sends 0. A heading that repeats to the bit counts once a second, and only while the vehicle may
    have kept its heading: for a vehicle that turns it is an old one.
    """

    def __init__(self) -> None:
        """Begin without a heading."""
        self._last = math.nan
        self._used_ns = 0
        self._north_ns: int | None = None

    def judge(
        self,
        t_ns: int,
        heading: float,
        *,
        is_still: bool,
        is_estimate: bool = False,
        is_north: bool = False,
    ) -> str | None:
        """Return why a heading is not a measurement; None if it is one.

        Args:
            t_ns: Its stamp.
            heading: In [-pi, pi), rad.
            is_still: Whether the vehicle may have kept its heading since this value first came.
            is_estimate: Whether it is an autopilot's estimate, made anew for each row: its few
                digits may repeat by chance.
            is_north: Whether a 0 is said to be north, and not that there is none.
        """
        if heading == 0.0 and not is_north and not self._may_be_north(t_ns):
            return ZERO
        if heading == self._last:
            is_paced = not is_estimate and 0 <= t_ns - self._used_ns < HELD_NS
            if not is_still or is_paced:
                return REPEATED
        elif heading != 0.0:
            self._north_ns = t_ns if abs(heading) < _NORTH else None
        self._last, self._used_ns = heading, t_ns
        return None

    def is_repeated(self, heading: float) -> bool:
        """Return whether a heading equals the last one."""
        return heading == self._last

    def _may_be_north(self, t_ns: int) -> bool:
        """Return whether a heading near north came just before."""
        return self._north_ns is not None and 0 <= t_ns - self._north_ns < 2 * HELD_NS
