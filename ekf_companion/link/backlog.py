"""Messages that wait for a slow stream, in the order of sending. No descriptor and no clock.

What waits grows old, and an old estimate does harm: so the time is bounded that a message may
wait, and of those that a newer one replaces only the newest waits. The order is never changed,
since frames are numbered and signed in it. A message that has begun is always finished.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

FRESH_NS = 150_000_000
"""How long a replaceable message may wait: a delayed estimate is worth less than none."""
PATIENCE_NS = 500_000_000
"""How long any other may: heartbeats, answers and acknowledgements are asked for again at 1 s."""
LARGEST = 1 << 16
"""Bytes that wait at most, whoever makes us answer; the oldest message is dropped beyond."""


@dataclass(slots=True)
class Waiting:
    """A message, or the rest of one that has begun."""

    data: bytes
    since_ns: int
    is_replaceable: bool
    has_begun: bool = False


class Backlog:
    """What could not be sent at once."""

    def __init__(self) -> None:
        self._waiting: deque[Waiting] = deque()
        self._size = 0

    def __len__(self) -> int:
        """Give how many wait."""
        return len(self._waiting)

    @property
    def replaceable(self) -> int:
        """How many of them are replaceable."""
        return sum(one.is_replaceable for one in self._waiting)

    def add(self, data: bytes, now_ns: int, *, is_replaceable: bool = False) -> int:
        """Put a message at the end; give how many were dropped for it."""
        before = len(self._waiting)
        if is_replaceable:
            self._keep([one for one in self._waiting if one.has_begun or not one.is_replaceable])
        self.expire(now_ns)
        self._waiting.append(Waiting(data, now_ns, is_replaceable))
        self._size += len(data)
        while self._size > LARGEST and len(self._waiting) > 1:
            # What has begun stands first, and must follow
            oldest = 1 if self._waiting[0].has_begun else 0
            if oldest == len(self._waiting) - 1:
                break
            self._size -= len(self._waiting[oldest].data)
            del self._waiting[oldest]
        return before + 1 - len(self._waiting)

    def expire(self, now_ns: int) -> int:
        """Drop what has waited too long; give how many."""
        before = len(self._waiting)
        if any(_is_old(one, now_ns) for one in self._waiting):
            self._keep([one for one in self._waiting if not _is_old(one, now_ns)])
        return before - len(self._waiting)

    def take(self) -> Waiting | None:
        """Give the first, and forget it; None: nothing waits."""
        if not self._waiting:
            return None
        first = self._waiting.popleft()
        self._size -= len(first.data)
        return first

    def put_back(self, first: Waiting, written: int) -> None:
        """Let what was taken stand first again, less the bytes that were written of it."""
        first.data = first.data[written:]
        first.has_begun |= written > 0
        self._waiting.appendleft(first)
        self._size += len(first.data)

    def clear(self) -> int:
        """Drop everything; give how many."""
        count = len(self._waiting)
        self._keep([])
        return count

    def _keep(self, kept: list[Waiting]) -> None:
        self._waiting = deque(kept)
        self._size = sum(len(one.data) for one in kept)


def _is_old(one: Waiting, now_ns: int) -> bool:
    limit_ns = FRESH_NS if one.is_replaceable else PATIENCE_NS
    return not one.has_begun and now_ns - one.since_ns > limit_ns
