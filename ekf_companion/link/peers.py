"""Which senders of datagrams are heard, and which one is answered. No socket and no clock.

Anybody can send a datagram. The first from whom the autopilot is heard is pinned: while it speaks
nobody else is heard, so that a stranger can neither steal the answers nor mix into the stream. The
pin is let go as soon as it is silent: after a second for its own host, where a program that was
restarted comes back on another port, after five for all others.

Where every frame must be signed, the signature says who speaks, and the pin follows it at once.
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
"""Silence of the autopilot after which other ports of its host are heard."""
LET_GO_NS = 5 * SECOND_NS
"""Silence after which anybody is: five heartbeats."""
NOT_NAMED = "not from link.peer"
NOT_PINNED = "not from the autopilot's address"


class Peers:
    """Those who speak to one socket."""

    def __init__(self, *, is_guarded: bool = True, is_signed: bool = False) -> None:
        """Begin with nobody.

        Args:
            is_guarded: Whether the caller says by ``pin`` and ``answer`` whom to believe; else
                everybody is heard, and whoever spoke last is answered.
            is_signed: Whether the caller believes signed frames alone.
        """
        self.target: Sender | None = None
        """Whom to answer."""
        self.pinned: Sender | None = None
        """From whom the autopilot is heard."""
        self.refused: Counter[str] = Counter()
        """Datagrams by the reason why they were not heard."""
        self.is_guarded = is_guarded
        self._is_signed = is_signed
        self._hosts: Collection[str] = ()
        self._port = 0
        self._first_target: Sender | None = None
        self._heard_ns = 0
        self._has_complained = False

    def allow(self, hosts: Collection[str], port: int = 0) -> None:
        """Hear these hosts only, and this port of them; 0: any."""
        self._hosts, self._port = hosts, port

    def aim(self, target: Sender) -> None:
        """Send there while nobody is believed."""
        self._first_target = target
        if self.pinned is None:
            self.target = target

    def listen(self, sender: Sender, now_ns: int) -> bool:
        """Whether to hear a datagram; a refused one is counted."""
        if sender == self.pinned:
            return True
        reason = self._refuse(sender, now_ns)
        if reason:
            self.refused[reason] += 1
            self._complain(sender, reason)
            return False
        if not self.is_guarded:
            self.target = sender
        return True

    def pin(self, sender: Sender, now_ns: int) -> None:
        """Say that the autopilot was heard from there."""
        self._heard_ns = now_ns
        if sender == self.pinned:
            return
        if not (self._is_signed and self.pinned):
            _log.info("The autopilot speaks from %s port %d", *sender[:2])
        self.pinned = self.target = sender

    def answer(self, sender: Sender) -> None:
        """Say that somebody believable was heard from there: answered while there is no pin."""
        if self.pinned is None:
            self.target = sender

    def _refuse(self, sender: Sender, now_ns: int) -> str:
        if self._hosts and (
            sender[0] not in self._hosts or (self._port and sender[1] != self._port)
        ):
            return NOT_NAMED
        if self.pinned is None or self._is_signed:
            return ""
        silence = now_ns - self._heard_ns
        if silence > LET_GO_NS:
            self.pinned = None
            self.target = self._first_target or self.target
            return ""
        if silence > SAME_HOST_NS and sender[0] == self.pinned[0]:
            return ""
        return NOT_PINNED

    def _complain(self, sender: Sender, reason: str) -> None:
        """Say once that somebody is not heard."""
        if not self._has_complained:
            _log.warning(
                "Datagrams from %s port %d are not heard: %s; they are counted", *sender[:2], reason
            )
        self._has_complained = True
