"""One direction of a link that is slow, uneven or narrow: bytes in at their times, out at theirs.

A line of few bytes per second queues what it cannot carry, as a socket and a serial port do, so
that the delay grows. Losses are of whole datagrams.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """Properties of one direction of a link."""

    delay: float = 0.0
    """s."""
    jitter: float = 0.0
    """Random additional delay up to this, s; the order stays."""
    loss: float = 0.0
    """Share of the datagrams that is lost."""
    rate: float = 0.0
    """Capacity, bytes per second; the rest waits. 0: unlimited."""
    stall_every: float = 0.0
    """s; 0: it never stalls."""
    stall: float = 0.0
    """Duration of a stall, after which all passes at once, s."""


class Line:
    """One direction of a link."""

    def __init__(self, way: Way, seed: int, zero_ns: int = 0) -> None:
        """Begin empty; the seed is that of jitter and loss, stalls count from ``zero_ns``."""
        self.way = way
        self._rng = np.random.default_rng(seed)
        self._zero_ns = zero_ns
        self._queue: deque[tuple[int, bytes]] = deque()
        self._free_ns = self._latest_ns = 0

    def push(self, now_ns: int, data: bytes) -> None:
        """Send bytes at a time."""
        way = self.way
        late, lost = self._rng.random(2)
        if lost < way.loss:
            return
        out_ns = now_ns
        if way.rate > 0.0:
            out_ns = max(now_ns, self._free_ns) + round(len(data) / way.rate * _SECOND_NS)
            self._free_ns = out_ns
        if way.stall_every > 0.0:
            within_ns = (out_ns - self._zero_ns) % round(way.stall_every * _SECOND_NS)
            out_ns += max(0, round(way.stall * _SECOND_NS) - within_ns)
        at_ns = out_ns + round((way.delay + way.jitter * float(late)) * _SECOND_NS)
        self._latest_ns = max(at_ns, self._latest_ns)
        self._queue.append((self._latest_ns, data))

    def pop(self, now_ns: int) -> tuple[int, bytes] | None:
        """Return the next bytes that have arrived by a time, and when they did; None: nothing."""
        if not self._queue or self._queue[0][0] > now_ns:
            return None
        return self._queue.popleft()
