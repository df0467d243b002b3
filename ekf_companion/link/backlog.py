"""Messages that wait for a slow stream, in the order of sending; no descriptor and no clock.

An old estimate does harm, so the wait of a message is bounded, and of replaceable messages only the
newest waits. The order never changes, since frames are numbered and signed in it. A message that
has been written in part is always completed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

FRESH_NS = 150_000_000
"""Longest wait of a replaceable message: a delayed estimate is worse than none."""
PATIENCE_NS = 500_000_000
"""Longest wait of any other: heartbeats and answers are asked for again after 1 s."""
LARGEST = 1 << 16
"""Bytes that may wait, whatever is asked of us; beyond that the oldest message is dropped."""


@dataclass(slots=True)
class Waiting:
    """A message, or the rest of one that is partly written."""

    data: bytes
    since_ns: int
    is_replaceable: bool
    has_begun: bool = False


class Backlog:
    """The messages that could not be sent at once."""

    def __init__(self) -> None:
        self._waiting: deque[Waiting] = deque()
        self._size = 0

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    @property
    def replaceable(self) -> int:
        """How many of them are replaceable."""
        return sum(one.is_replaceable for one in self._waiting)

    def add(self, data: bytes, now_ns: int, *, is_replaceable: bool = False) -> int:
        """Add a message at the end; return how many were dropped for it."""
        before = len(self._waiting)
        if is_replaceable:
            self._keep([one for one in self._waiting if one.has_begun or not one.is_replaceable])
        self.expire(now_ns)
        self._waiting.append(Waiting(data, now_ns, is_replaceable))
        self._size += len(data)
        while self._size > LARGEST and len(self._waiting) > 1:
            # A message that is partly written is the first, and must be completed
            oldest = 1 if self._waiting[0].has_begun else 0
            if oldest == len(self._waiting) - 1:
                break
            self._size -= len(self._waiting[oldest].data)
            del self._waiting[oldest]
        return before + 1 - len(self._waiting)

    def expire(self, now_ns: int) -> int:
        """Drop the messages that have waited too long; return how many."""
        before = len(self._waiting)
        if any(_is_old(one, now_ns) for one in self._waiting):
            self._keep([one for one in self._waiting if not _is_old(one, now_ns)])
        return before - len(self._waiting)

    def take(self) -> Waiting | None:
        """Remove and return the first; None if nothing waits."""
        if not self._waiting:
            return None
        first = self._waiting.popleft()
        self._size -= len(first.data)
        return first

    def put_back(self, first: Waiting, written: int) -> None:
        """Put the message that was taken back in front, without the bytes that were written."""
        first.data = first.data[written:]
        first.has_begun |= written > 0
        self._waiting.appendleft(first)
        self._size += len(first.data)

    def clear(self) -> int:
        """Drop everything; return how many."""
        count = len(self._waiting)
        self._keep([])
        return count

    def _keep(self, kept: list[Waiting]) -> None:
        self._waiting = deque(kept)
        self._size = sum(len(one.data) for one in kept)


def _is_old(one: Waiting, now_ns: int) -> bool:
    limit_ns = FRESH_NS if one.is_replaceable else PATIENCE_NS
    return not one.has_begun and now_ns - one.since_ns > limit_ns
