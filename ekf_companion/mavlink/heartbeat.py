"""Our heartbeat: once a second, from the loop that runs the filter, or not at all."""

from __future__ import annotations

from collections import deque

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_ECHOES = 32
"""So many heartbeats old may an echo be: no router holds one back for longer."""
_APART_NS = SECOND_NS // 4
"""Between one that is asked for and the last: with those in turn, the echoes of 6 s are known."""


class Heartbeat(Service):
    """Says who we are and how we are."""

    def __init__(self, outbox: Outbox) -> None:
        self.status = SystemStatus.BOOT
        self.mode = 0
        """``custom_mode``: the ``nav.state.Status`` of the estimate."""
        self._outbox = outbox
        self._next_ns: int | None = None
        self._last_ns: int | None = None
        self._beats: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)

    def tick(self, now_ns: int) -> None:
        """Beat if it is time; what a stall has missed is not made up for."""
        if self._next_ns is not None and now_ns < self._next_ns:
            return
        # From the plan, not from now, so that lateness does not add up
        is_stalled = self._next_ns is None or now_ns - self._next_ns > SECOND_NS
        self._next_ns = (now_ns if is_stalled else self._next_ns or 0) + SECOND_NS
        self.beat(now_ns)

    def request(self, now_ns: int) -> bool:
        """Send one out of turn; False: one was sent a moment ago."""
        if self._last_ns is not None and now_ns - self._last_ns < _APART_NS:
            return False
        self.beat(now_ns)
        return True

    def beat(self, now_ns: int) -> None:
        """Send one."""
        self._last_ns = now_ns
        payload = encode.heartbeat(self.status, self.mode)
        self._beats.append((self._outbox.sequence, payload.rstrip(b"\0")))
        self._outbox.send("HEARTBEAT", payload, now_ns)

    @property
    def has_beaten(self) -> bool:
        """Whether any was sent: a recording that is read again sends none."""
        return bool(self._beats)

    def is_echo(self, frame: Frame) -> bool:
        """Whether a heartbeat is one of our last, come back from a router."""
        return (frame.sequence, frame.payload.rstrip(b"\0")) in self._beats
