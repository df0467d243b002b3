"""The scans of a source in the order of their stamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from heapq import heappop, heappush

from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.readers.timing import Timing
from ekf_companion.lidar.recording import Scan
from ekf_companion.nav.arrays import Indices


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """The scans of a source in the order of their stamps, read anew in each pass."""

    source: Source
    timing: Timing
    order: Indices
    """Which of the stored scans, in the order to return them."""

    def __iter__(self) -> Iterator[Scan]:
        yield from (scan for _, scan in self.numbered(self.order))

    def numbered(self, chosen: Indices) -> Iterator[tuple[int, Scan]]:
        """Return some of the stored scans with their place in `chosen`.

        What comes before its turn waits: no more scans than the recording has out of order.
        """
        place = {int(stored): position for position, stored in enumerate(chosen)}
        waiting = list[tuple[int, Scan]]()
        due = 0
        for number, stored in enumerate(self.source.scans()):
            position = place.get(number)
            if position is None:
                continue
            heappush(waiting, (position, self.timing.apply(stored)))
            while waiting and waiting[0][0] == due:
                yield heappop(waiting)
                due += 1
            if due == len(chosen):
                return
