"""Limits on connections: so many for each address, and some reserved for this computer.

A stranger who opens connections and sends nothing uses up the places of its own address only.
Requests from the board itself, as of ``ekf-companion status``, are answered all the same.
"""

from __future__ import annotations

import ipaddress
import threading
from collections.abc import Hashable
from typing import Generic, TypeVar

from ekf_companion.daemon.access import is_loopback

C = TypeVar("C", bound=Hashable)

PLACES = 24
"""Connections at once, without viewers of the page."""
KEPT = 8
"""Of these, reserved for this computer."""
BY_ADDRESS = 8
"""Connections of one other address: a browser opens six at once."""
LINE_WAIT = 1.0
"""Seconds for the request line: a client that has something to ask sends it at once."""
DEADLINE = 5.0
"""Seconds that one request may take in all."""
_NETWORK_BITS = 64
"""Prefix of an IPv6 address that is counted as one: who has one address there has the network."""


class Places(Generic[C]):
    """Counts connections by address; called from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._hosts: dict[C, str] = {}
        self._begins_s: dict[C, float] = {}
        self._ends_s: dict[C, float] = {}

    def __len__(self) -> int:
        return len(self._hosts)

    def take(self, client: C, address: str, now_s: float) -> bool:
        """Admit a new connection until its request line is due; return whether there is a place.

        Args:
            client: The connection.
            address: Where it is from.
            now_s: The monotonic clock.
        """
        host = "" if is_loopback(address) else host_of(address)
        with self._lock:
            hosts = list(self._hosts.values())
            if len(hosts) >= PLACES:
                return False
            if host and (
                hosts.count(host) >= BY_ADDRESS or len(hosts) - hosts.count("") >= PLACES - KEPT
            ):
                return False
            self._hosts[client] = host
            self._begins_s[client] = now_s
            self._ends_s[client] = now_s + LINE_WAIT
        return True

    def extend(self, client: C) -> None:
        """Allow a connection whose request line has come the time of a whole request."""
        with self._lock:
            if client in self._ends_s:
                self._ends_s[client] = self._begins_s[client] + DEADLINE

    def leave(self, client: C) -> None:
        """Release a place; twice does no harm."""
        with self._lock:
            for kept in (self._hosts, self._begins_s, self._ends_s):
                kept.pop(client, None)

    def late(self, now_s: float) -> list[C]:
        """Return the connections whose time is over."""
        with self._lock:
            return [client for client, end_s in self._ends_s.items() if now_s > end_s]


def host_of(address: str) -> str:
    """Return the address that a client is counted by: its own, or its IPv6 network."""
    found = ipaddress.ip_address(address.partition("%")[0])
    found = getattr(found, "ipv4_mapped", None) or found
    if found.version == 4 or found.is_link_local:
        return str(found)
    return str(ipaddress.ip_network((found, _NETWORK_BITS), strict=False))
