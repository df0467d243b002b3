"""Messages for the viewers of the page: made once for all of them, and only while there are any.

A thread asks the loop for the newest estimate ten times a second and for the whole state once a
second. Each viewer takes the newest of each kind when its connection is free: a slow one misses
some, and nobody waits for it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

_log = logging.getLogger(__name__)

PERIOD = 0.1
"""Seconds between two estimates."""
SLOW_EVERY = 10
"""Estimates for each message with the whole state."""
VIEWERS = 4
"""Largest number at once."""

Messages = Mapping[str, bytes | None]
"""JSON by the kind of message; None: nothing new of that kind."""


class Feed:
    """Makes messages while somebody watches."""

    def __init__(self, make: Callable[[bool], Messages]) -> None:
        """Begin with no viewer, and no thread.

        Args:
            make: Returns the current messages; the argument is whether the whole state is due.
                It is called on the feed's thread.
        """
        self._make = make
        self._changed = threading.Condition()
        self._viewers = 0
        self._has_thread = False
        self._newest: dict[str, tuple[int, bytes]] = {}
        """By kind: the number of the message, and its text."""
        self._number = 0
        self._is_over = False

    @contextmanager
    def watch(self) -> Iterator[Viewer | None]:
        """Register a viewer while the context lasts; None: too many, or the feed has ended."""
        with self._changed:
            if self._is_over or self._viewers >= VIEWERS:
                viewer = None
            else:
                viewer = Viewer(self)
                self._viewers += 1
                if not self._has_thread:
                    self._has_thread = True
                    threading.Thread(target=self._run, name="feed", daemon=True).start()
        try:
            yield viewer
        finally:
            if viewer is not None:
                with self._changed:
                    self._viewers -= 1

    def finish(self) -> None:
        """Send no more; does not wait."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return self._viewers

    @property
    def is_over(self) -> bool:
        """Whether no more messages will come."""
        return self._is_over

    def has(self, kind: str) -> bool:
        """Return whether a new viewer gets a message of this kind at once."""
        return kind in self._newest

    def newer(self, seen: dict[str, int], timeout: float) -> list[bytes]:
        """Return messages whose numbers are not in ``seen``, and add these; wait for the first."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or bool(self._unseen(seen)), timeout)
            found = self._unseen(seen)
            for kind in found:
                seen[kind] = self._newest[kind][0]
            return [self._newest[kind][1] for kind in found]

    def _unseen(self, seen: dict[str, int]) -> list[str]:
        return [kind for kind, (number, _) in self._newest.items() if number > seen.get(kind, 0)]

    def _run(self) -> None:
        count = 0
        while True:
            due_s = time.monotonic() + PERIOD
            try:
                messages = self._make(count % SLOW_EVERY == 0)
            except Exception:  # noqa: BLE001  # a bug here must not end a flight
                _log.exception("The state cannot be sent to the page")
                messages = {}
            with self._changed:
                if self._is_over or not self._viewers:
                    self._newest.clear()
                    self._has_thread = False
                    return
                for kind, text in messages.items():
                    if text is not None:
                        self._number += 1
                        self._newest[kind] = self._number, b'{"%s":%s}' % (kind.encode(), text)
                self._changed.notify_all()
            count += 1
            time.sleep(max(due_s - time.monotonic(), PERIOD / 2))


class Viewer:
    """One viewer, and the messages that it has taken."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._seen: dict[str, int] = {}

    @property
    def is_over(self) -> bool:
        """Whether no more messages will come."""
        return self._feed.is_over

    def take(self, timeout: float) -> list[bytes]:
        """Return the newest message of each kind that is new; wait for the first, at most so long.

        The list is empty if nothing came in this time, s, or the feed has ended.
        """
        return self._feed.newer(self._seen, timeout)
