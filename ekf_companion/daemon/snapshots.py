"""Snapshots of the daemon for other threads, taken in the loop at one moment."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from typing import TypeVar

from ekf_companion.status.host import Host, read_host
from ekf_companion.status.observer import Observer
from ekf_companion.status.snapshot import Snapshot

T = TypeVar("T")

PATIENCE = 1.0
"""Seconds to wait for the loop."""
FRESH = 0.2
"""Seconds for which one snapshot serves all requests."""
HOST_EVERY = 2.0
"""Seconds between two readings of the board."""


class SnapshotSource:
    """Takes snapshots in the loop, for any thread."""

    def __init__(self, observer: Observer, loop: asyncio.AbstractEventLoop) -> None:
        self._observer, self._loop = observer, loop
        self._lock = threading.Lock()
        self._request: Future[Snapshot] | None = None
        self._last: Snapshot | None = None
        self._last_s = -FRESH
        self._host, self._host_s = Host(), -HOST_EVERY
        self._live: Future[bytes] | None = None
        self._past: Future[bytes] | None = None

    def read(self) -> Snapshot | None:
        """Return the newest snapshot, or None if the loop does not answer."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._last_s >= FRESH:
                self._last = self._take(now_s)
                self._last_s = time.monotonic()
            return self._last

    def read_live(self) -> bytes | None:
        """Return the newest estimate as JSON, or None if the loop does not answer."""
        return self._ask(self._live_request())

    def read_past(self) -> bytes | None:
        """Return the estimates of the last minutes as JSON, or None if the loop does not answer."""
        with self._lock:
            if self._past is None or self._past.done():
                self._past = self._call(self._observer.past)
            return self._ask(self._past)

    def _take(self, now_s: float) -> Snapshot | None:
        if now_s - self._host_s >= HOST_EVERY:
            self._host, self._host_s = read_host(), now_s
        # One request at a time: one that a stalled loop did not answer still waits there
        if self._request is None or self._request.done():
            host = self._host
            self._request = self._call(lambda: self._observer.snapshot(host))
        return self._ask(self._request)

    def _live_request(self) -> Future[bytes] | None:
        if self._live is None or self._live.done():
            self._live = self._call(self._observer.live)
        return self._live

    def _call(self, take: Callable[[], T]) -> Future[T] | None:
        """Have a function called in the loop; return None if the loop has ended."""
        request: Future[T] = Future()

        def answer() -> None:
            try:
                request.set_result(take())
            except Exception as error:  # noqa: BLE001  # a bug here must not end a flight
                request.set_exception(error)

        try:
            self._loop.call_soon_threadsafe(answer)
        except RuntimeError:
            return None
        return request

    def _ask(self, request: Future[T] | None) -> T | None:
        try:
            return None if request is None else request.result(PATIENCE)
        except LateError:
            return None
