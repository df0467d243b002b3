"""Messages to the service manager: ready, watchdog, reloading, stopping, and a status line."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable

_log = logging.getLogger(__name__)

REPORT_NS = 1_000_000_000
"""Time between two status lines."""


class Systemd:
    """The service manager, if there is one."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = int(os.environ.get("WATCHDOG_USEC") or 0) * 1000 // 2
        self._next_ns = self._report_ns = 0
        self._status = ""
        self._has_complained = False

    def notify(self, state: str) -> None:
        """Send a state to the service manager, if there is one; warn once if it does not listen."""
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ours:
            try:
                ours.sendto(state.encode(), self._address)
            except OSError as error:
                if not self._has_complained:
                    _log.warning("NOTIFY_SOCKET: %s", error.strerror)
                self._has_complained = True

    def beat(self, now_ns: int) -> None:
        """Reset the watchdog, twice in its period."""
        if self._period_ns and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self.notify("WATCHDOG=1")

    def report(self, now_ns: int, line: Callable[[], str]) -> None:
        """Send the status line once a second; ``line`` is called only when it is due."""
        if self._address and now_ns >= self._report_ns:
            self._report_ns = now_ns + REPORT_NS
            self.status(line())

    def status(self, text: str) -> None:
        """Send a line for ``systemctl status``, unless it is the same as before."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self.notify(f"STATUS={line}")

    def notify_reloading(self) -> None:
        """Announce that a reload begins; ``notify("READY=1")`` ends it."""
        self.notify(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
