"""The autopilot's clock against the world's: piecewise linear, with gaps while it starts."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

from sim_autopilot.faults.fault import Fault, Layer

_AHEAD_NS = 50_000_000
"""A stamp so far ahead of its arrival is of the same stretch: lateness of the loop, jitter."""


@dataclass(frozen=True, slots=True)
class _Stretch:
    """From one incident to the next."""

    from_ns: int
    """On the world's clock."""
    shown_ns: int
    """By the autopilot's clock at ``from_ns``."""
    rate: float
    boot: int
    """Number of reboots before."""
    silent_until_ns: int
    """The autopilot is starting up until then, on the world's clock."""

    def shown(self, t_ns: int) -> int:
        return self.shown_ns + round((t_ns - self.from_ns) * self.rate)

    def true(self, shown_ns: int) -> int:
        return self.from_ns + round((shown_ns - self.shown_ns) / self.rate)


class Clock:
    """The autopilot's clock; the world's is the one that flights are planned on."""

    def __init__(self, faults: Sequence[Fault], zero_ns: int) -> None:
        """Read the faults of a flight that starts at ``zero_ns``."""
        self._stretches = [_Stretch(0, 0, 1.0, 0, 0)]
        incidents = []
        for fault in (one for one in faults if one.kind.layer is Layer.CLOCK):
            begin_ns = zero_ns + _ns(fault.start)
            incidents.append((begin_ns, fault, True))
            if fault.kind.name == "clock-skew":
                incidents.append((zero_ns + _ns(fault.end), fault, False))
        for at_ns, fault, is_start in sorted(incidents, key=lambda one: one[0]):
            self._incident(at_ns, fault, is_start)
        self._starts = [stretch.from_ns for stretch in self._stretches]

    def shown_ns(self, t_ns: int) -> int:
        """Return what it shows at a time of the world's clock."""
        return self._at(t_ns).shown(t_ns)

    def boot(self, t_ns: int) -> int:
        """Return the number of reboots until a time."""
        return self._at(t_ns).boot

    def is_silent(self, t_ns: int) -> bool:
        """Whether the autopilot is starting up."""
        return t_ns < self._at(t_ns).silent_until_ns

    def true_ns(self, shown_ns: int, now_ns: int) -> int:
        """Return the world's time of a stamp of the autopilot's that arrived at ``now_ns``.

        By the newest stretch in which it was shown; if there is none, by the present one.
        """
        present = bisect.bisect_right(self._starts, now_ns) - 1
        for index in range(present, -1, -1):
            found = self._stretches[index].true(shown_ns)
            end_ns = now_ns + _AHEAD_NS if index == present else self._starts[index + 1]
            if self._starts[index] <= found < end_ns:
                return found
        return self._stretches[present].true(shown_ns)

    def _at(self, t_ns: int) -> _Stretch:
        return self._stretches[max(0, bisect.bisect_right(self._starts, t_ns) - 1)]

    def _incident(self, at_ns: int, fault: Fault, is_start: bool) -> None:
        last = self._stretches[-1]
        shown_ns = last.shown(at_ns)
        rate, boot, silent_ns = last.rate, last.boot, last.silent_until_ns
        name = fault.kind.name
        if name == "reboot":
            shown_ns, rate, boot, silent_ns = 0, 1.0, boot + 1, at_ns + _ns(fault.duration)
        elif name == "clock-jump":
            shown_ns = max(0, shown_ns + _ns(fault.number("by")))
        else:
            rate = 1.0 + fault.number("ppm") * 1e-6 if is_start else 1.0
        self._stretches.append(_Stretch(at_ns, shown_ns, rate, boot, silent_ns))


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
