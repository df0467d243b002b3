"""The autopilot's clock in real time, or faster."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Coroutine
from typing import Any, TypeVar

import numpy as np

from sim_autopilot.score import quantiles

T = TypeVar("T")


class Pace:
    """A clock that shows ``first_ns`` now and runs ``speed`` times as fast as ours."""

    def __init__(self, first_ns: int, speed: float) -> None:
        self.late_ns: list[int] = []
        """Lateness of the end of each wait, ns of our clock."""
        self._first_ns = first_ns
        self._speed = speed
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time that it shows."""
        return self.shown_ns(time.monotonic_ns())

    def shown_ns(self, monotonic_ns: int) -> int:
        """Return the time that it shows when our monotonic clock shows ``monotonic_ns``."""
        return self._first_ns + round((monotonic_ns - self._start_ns) * self._speed)

    async def until(self, t_ns: int) -> None:
        """Wait until it shows a time, counted from the start, so that no error accumulates."""
        due_ns = self._start_ns + round((t_ns - self._first_ns) / self._speed)
        # Also when late: the receiver must get to run
        await asyncio.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        self.late_ns.append(time.monotonic_ns() - due_ns)

    def lateness(self) -> dict[str, float]:
        """Return how late the waits ended, ms of our clock."""
        return quantiles(np.array(self.late_ns or [0]) * 1e-6)


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine on a loop that sleeps to the microsecond.

    The usual loop waits in ``epoll``, which rounds up to whole milliseconds: a quarter of a period
    at 250 Hz. ``select`` does not.
    """
    loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
    try:
        asyncio.set_event_loop(loop)
        return loop.run_until_complete(main)
    finally:
        loop.run_until_complete(loop.shutdown_asyncgens())
        asyncio.set_event_loop(None)
        loop.close()
