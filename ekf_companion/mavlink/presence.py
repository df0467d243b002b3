"""Whether somebody is there, by its heartbeats: one alone may be an echo, or a stray."""

from __future__ import annotations

from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_APART_NS = SECOND_NS // 2
"""Two heartbeats so far apart are those of somebody who goes on: it sends one a second."""


class Presence:
    """There from the second heartbeat on, gone some seconds after the last."""

    def __init__(self, gone_ns: int) -> None:
        self.is_there = False
        self._gone_ns = gone_ns
        self._first_ns = 0
        self._last_ns: int | None = None

    def hear(self, now_ns: int) -> None:
        """Take a heartbeat of it."""
        now_ns = quantise(now_ns)
        if self._last_ns is None or now_ns - self._last_ns > self._gone_ns:
            self.is_there, self._first_ns = False, now_ns
        self._last_ns = now_ns
        self.is_there = self.is_there or now_ns - self._first_ns >= _APART_NS

    def tick(self, now_ns: int) -> None:
        """Notice that it has gone."""
        if self._last_ns is not None and quantise(now_ns) - self._last_ns > self._gone_ns:
            self.is_there, self._last_ns = False, None
