"""Which senders of datagrams are accepted, and which one is answered, without socket and clock.

Anybody can send a datagram. The first address from which the autopilot comes is pinned: while it
sends, all others are refused, so that a stranger can neither steal the answers nor mix into the
stream. The pin is released when it is silent: after a second for its own host, where a restarted
program comes back on another port, after five seconds for all others.

If every frame must be signed, the signature proves the sender, and the pin follows it at once.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection
from typing import Any

from ekf_companion.mavlink.stamp import SECOND_NS

_log = logging.getLogger(__package__)

Sender = tuple[Any, ...]
"""Host (numeric) and port; two more numbers with IPv6."""

SAME_HOST_NS = SECOND_NS
"""Silence of the autopilot after which other ports of its host are accepted."""
RELEASE_NS = 5 * SECOND_NS
"""Silence after which everybody is accepted: five heartbeats."""
NOT_NAMED = "not from link.peer"
NOT_PINNED = "not from the autopilot's address"


class Peers:
    """The senders to one socket."""

    def __init__(self, *, is_pinning: bool = True, is_signed: bool = False) -> None:
        """Begin without any.

        Pinning, the caller calls ``pin`` and ``set_target``; else everybody is accepted, and the
        last sender is answered. ``is_signed`` is whether the caller accepts signed frames only.
        """
        self.target: Sender | None = None
        """Where to send."""
        self.pinned: Sender | None = None
        """The autopilot's address."""
        self.refused: Counter[str] = Counter()
        """Datagrams by the reason why they were refused."""
        self.is_pinning = is_pinning
        self._is_signed = is_signed
        self._hosts: Collection[str] = ()
        self._port = 0
        self._default_target: Sender | None = None
        self._received_ns = 0

    def allow(self, hosts: Collection[str], port: int = 0) -> None:
        """Accept these hosts only, and this port of them; 0: any."""
        self._hosts, self._port = hosts, port

    def set_default_target(self, target: Sender) -> None:
        """Send there while nothing is pinned."""
        self._default_target = target
        if self.pinned is None:
            self.target = target

    def accepts(self, sender: Sender, now_ns: int) -> bool:
        """Return whether to accept a datagram; a refused one is counted."""
        if sender == self.pinned:
            return True
        if reason := self._refuse(sender, now_ns):
            if not self.refused:
                _log.warning(
                    "Datagrams from %s port %d are refused: %s; they are counted",
                    *sender[:2],
                    reason,
                )
            self.refused[reason] += 1
            return False
        if not self.is_pinning:
            self.target = sender
        return True

    def pin(self, sender: Sender, now_ns: int) -> None:
        """Note that the autopilot sends from there."""
        self._received_ns = now_ns
        if sender == self.pinned:
            return
        if not (self._is_signed and self.pinned):
            _log.info("The autopilot sends from %s port %d", *sender[:2])
        self.pinned = self.target = sender

    def set_target(self, sender: Sender) -> None:
        """Send there while nothing is pinned: an accepted frame came from there."""
        if self.pinned is None:
            self.target = sender

    def _refuse(self, sender: Sender, now_ns: int) -> str:
        if self._hosts and (
            sender[0] not in self._hosts or (self._port and sender[1] != self._port)
        ):
            return NOT_NAMED
        if self.pinned is None or self._is_signed:
            return ""
        silence = now_ns - self._received_ns
        if silence > RELEASE_NS:
            self.pinned = None
            self.target = self._default_target or self.target
            return ""
        if silence > SAME_HOST_NS and sender[0] == self.pinned[0]:
            return ""
        return NOT_PINNED
