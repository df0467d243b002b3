"""The service manager: it is told that we are ready, live, reload and end, and how we are."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable

_log = logging.getLogger(__name__)


REPORT_NS = 1_000_000_000
"""Between two reports of how we are."""


class Systemd:
    """The service manager, where there is one.

    Source: sd_notify(3).
    """

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = int(os.environ.get("WATCHDOG_USEC") or 0) * 1000 // 2
        self._next_ns = self._report_ns = 0
        self._status = ""
        self._has_complained = False

    def tell(self, state: str) -> None:
        """Tell it, if there is one; that it does not listen is said once."""
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
        """Say twice in the watchdog's time that we live."""
        if self._period_ns and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self.tell("WATCHDOG=1")

    def report(self, now_ns: int, words: Callable[[], str]) -> None:
        """Say once a second how we are; the words are asked for when they are due, and needed."""
        if self._address and now_ns >= self._report_ns:
            self._report_ns = now_ns + REPORT_NS
            self.status(words())

    def status(self, text: str) -> None:
        """Say in one line how we are, for ``systemctl status``; the same is not said twice."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self.tell(f"STATUS={line}")

    def reloading(self) -> None:
        """Say that a reload begins; ``tell("READY=1")`` ends it."""
        self.tell(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
