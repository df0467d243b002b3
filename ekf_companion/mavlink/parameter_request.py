"""Requests for the parameters that say how the autopilot's sensors are mounted and how late."""

from __future__ import annotations

from collections.abc import Callable

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_TRIES = 3
_PERIOD_NS = SECOND_NS


class ParameterRequest(Service):
    """Asks for what is missing, three times; :mod:`~.decode` reads the answers."""

    def __init__(self, outbox: Outbox, missing: Callable[[], tuple[str, ...]]) -> None:
        self._outbox, self._missing = outbox, missing
        self._peer: PeerFound | None = None
        self._tries, self._next_ns = 0, 0

    def begin(self, peer: PeerFound) -> None:
        """Ask a new autopilot."""
        self._peer = peer
        self._tries = self._next_ns = 0

    def end(self) -> None:
        """Ask nobody."""
        self._peer = None

    def tick(self, now_ns: int) -> None:
        """Send the requests that are due."""
        if self._peer is None or self._tries == _TRIES or now_ns < self._next_ns:
            return
        self._tries, self._next_ns = self._tries + 1, now_ns + _PERIOD_NS
        for name in self._missing():
            payload = pack(
                "PARAM_REQUEST_READ", **self._peer.target, param_id=name.encode(), param_index=-1
            )
            self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)
