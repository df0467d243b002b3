"""The stretches of a log over which one clock runs on: a reboot in it begins another."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_companion.nav.arrays import Indices, Stamps
from ekf_companion.nav.measurements import Events, is_reboot
from ekf_companion.nav.stamps import BACK_NS

PAUSE_NS = 10_000_000_000
"""Between two stretches that are drawn one after another."""


@dataclass(slots=True)
class Stretch:
    """From one start of the autopilot's clock to the next."""

    first_ns: int
    last_ns: int
    rows: int = 0
    gap_ns: int = 0
    """The longest step from a stamp to the next."""
    gap_from_ns: int = 0
    """Where it began."""

    def add(self, t_ns: Stamps) -> None:
        """Add one or more stamps."""
        steps = np.diff(t_ns, prepend=self.last_ns)
        at = int(np.argmax(steps))
        if steps[at] > self.gap_ns:
            self.gap_ns, self.gap_from_ns = int(steps[at]), int(t_ns[at] - steps[at])
        self.last_ns = max(self.last_ns, int(t_ns.max()))
        self.rows += len(t_ns)


@dataclass(slots=True)
class Stretches:
    """The stretches of a log so far, in the order of the file."""

    found: list[Stretch] = field(default_factory=list)

    def add(self, t_ns: Stamps) -> Indices:
        """Add stamps in the order of the file, and return the stretch of each."""
        if not len(t_ns):
            return np.zeros(0, dtype=np.intp)
        if not self.found:
            self.found.append(Stretch(int(t_ns[0]), int(t_ns[0])))
        is_back = np.diff(t_ns, prepend=self.found[-1].last_ns) < -BACK_NS
        index = len(self.found) - 1 + np.cumsum(is_back)
        for one in range(int(index[0]), int(index[-1]) + 1):
            part = t_ns[index == one]
            if one == len(self.found):
                self.found.append(Stretch(int(part[0]), int(part[0])))
            self.found[one].add(part)
        return np.asarray(index, dtype=np.intp)

    @property
    def longest(self) -> int:
        """Which stretch has most rows: the readers' references and truths are of that one."""
        return int(np.argmax([one.rows for one in self.found])) if self.found else 0

    def shifts_ns(self) -> Stamps:
        """Return what is added to the stamps of each stretch to draw it after the one before."""
        shifts = np.zeros(len(self.found), dtype=np.int64)
        for i in range(1, len(self.found)):
            end_ns = self.found[i - 1].last_ns + int(shifts[i - 1])
            shifts[i] = end_ns + PAUSE_NS - self.found[i].first_ns
        return shifts


def of_events(events: Events, first: int, last: int) -> Indices:
    """Return the stretch of each event of a block.

    Args:
        events: In the order of arrival.
        first: The stretch in which the block begins.
        last: The one in which it ends.
    """
    return np.asarray(np.minimum(first + np.cumsum(is_reboot(events)), last), dtype=np.intp)
