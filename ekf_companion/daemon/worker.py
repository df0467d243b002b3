"""Threads beside the loop: each may wait for a disk or a network without delaying the loop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Worker:
    """Runs one piece of work on a thread of its own, each time it is woken."""

    def __init__(
        self,
        name: str,
        work: Callable[[bool], None],
        *,
        begin: Callable[[], None] = lambda: None,
        period: float = 0.0,
    ) -> None:
        """Start the thread.

        Args:
            name: Name of the thread.
            work: Called after a wake-up, and once more at the end; the argument is True then.
            begin: Called once, first.
            period: Least time from the start of one call to the next, s; the last does not wait.
        """
        self._work, self._begin, self._period = work, begin, period
        self._wake, self._finish = threading.Event(), threading.Event()
        self._started_s: float | None = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def busy_s(self) -> float:
        """Duration of the present call, s; 0 between calls."""
        started_s = self._started_s
        return 0.0 if started_s is None else time.monotonic() - started_s

    def wake(self) -> None:
        """Have the work done as soon as the period allows."""
        self._wake.set()

    def finish(self) -> None:
        """Have the work done for the last time; does not wait for it."""
        self._finish.set()
        self._wake.set()

    def join(self, end_s: float) -> bool:
        """Wait until that is done, or until a time of the monotonic clock, s; return if it is."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._begin()
        is_last = False
        while not is_last:
            self._started_s = None
            self._wake.wait()
            self._wake.clear()
            is_last = self._finish.is_set()
            self._started_s = started_s = time.monotonic()
            self._work(is_last)
            self._started_s = None
            self._finish.wait(max(started_s + self._period - time.monotonic(), 0.0))
