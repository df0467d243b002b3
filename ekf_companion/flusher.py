"""Files forced to the disk by a thread of its own: whoever writes to them never waits for that.

What was written outlives a kill at once, in the system's cache; a loss of power, once it is forced.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from typing import NamedTuple


class _Wish(NamedTuple):
    file: int
    has_new_name: bool
    is_last: bool
    """Whether the file is then to be closed."""


class Flusher:
    """Takes wishes from one thread, and fulfils them in another, in their order."""

    def __init__(self, force_names: Callable[[], None]) -> None:
        """Start the thread.

        Args:
            force_names: Forces the names in the folder to the disk; may raise OSError.
        """
        self._force_names = force_names
        self._wishes: queue.SimpleQueue[_Wish | None] = queue.SimpleQueue()
        self._errors: queue.SimpleQueue[OSError] = queue.SimpleQueue()
        # Each count has one writer
        self._asked = self._done = 0
        self._begun_s = 0.0
        self._thread = threading.Thread(target=self._run, name="flusher", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Wishes that are not fulfilled yet."""
        return self._asked - self._done

    @property
    def late_s(self) -> float:
        """Since the wish was taken up that is not fulfilled yet, s; 0: there is none."""
        return time.monotonic() - self._begun_s if self.waiting else 0.0

    def force(self, file: int, *, has_new_name: bool) -> bool:
        """Have an open file forced to the disk, unless the last time has not ended yet."""
        if self.waiting:
            return False
        self._ask(_Wish(file, has_new_name, is_last=False))
        return True

    def close(self, file: int, *, has_new_name: bool) -> None:
        """Have a file forced to the disk and closed; it is not the caller's any more."""
        self._ask(_Wish(file, has_new_name, is_last=True))

    def error(self) -> OSError | None:
        """Give what went wrong since, if anything, once."""
        return None if self._errors.empty() else self._errors.get()

    def finish(self) -> None:
        """End when all is done; does not wait."""
        self._wishes.put(None)

    def join(self, end_s: float) -> None:
        """Wait for the end, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _ask(self, wish: _Wish) -> None:
        if not self.waiting:
            self._begun_s = time.monotonic()
        self._asked += 1
        self._wishes.put(wish)

    def _run(self) -> None:
        while (wish := self._wishes.get()) is not None:
            self._begun_s = time.monotonic()
            try:
                self._fulfil(wish)
            except OSError as error:
                self._errors.put(error)
            self._done += 1

    def _fulfil(self, wish: _Wish) -> None:
        try:
            os.fdatasync(wish.file)
            if wish.has_new_name:
                self._force_names()
        finally:
            if wish.is_last:
                os.close(wish.file)
